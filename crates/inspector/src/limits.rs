//! Limits that an inspecting process sets on itself before it reads the recording.

use rustix::{
    io::Errno,
    process::{Resource, Rlimit, Signal, getrlimit, set_parent_process_death_signal, setrlimit},
};

use crate::{InspectError, Order};

/// For the recording, the spec, the frames, the verdict, the standard streams and the runtime.
const OPEN_FILES: u64 = 64;
/// The stack of a thread.
const STACK: u64 = 4 << 20;
/// Address space that the C library reserves for the memory of each thread; unused parts of it are no memory.
const THREAD_SPACE: u64 = 160 << 20;

/// Limits memory, processor time, file size and open files of this process, which ends with its parent.
///
/// # Errors
/// If the current memory is unknown or a limit cannot be set.
pub fn apply(order: &Order) -> Result<(), InspectError> {
    let fault = InspectError::when::<Errno>("limiting this process");
    set_parent_process_death_signal(Some(Signal::KILL)).map_err(&fault)?;
    let used = used().map_err(InspectError::when("reading the memory of this process"))?;
    // The memory of the program, its libraries and its threads' stacks is not caused by the recording.
    let threads = u64::try_from(order.threads).unwrap_or(u64::MAX);
    let data = used.data.saturating_add(order.memory_bytes).saturating_add(threads.saturating_mul(STACK));
    let address_space =
        used.size.saturating_add(order.memory_bytes).saturating_add(threads.saturating_mul(STACK + THREAD_SPACE));
    for (resource, limit) in [
        (Resource::Data, data),
        (Resource::As, address_space),
        (Resource::Fsize, order.most_written()),
        (Resource::Nofile, OPEN_FILES),
        (Resource::Core, 0),
    ] {
        limit_to(resource, limit, limit).map_err(&fault)?;
    }
    // The signal of the soft limit names the exceeded limit for the parent; that of the hard one does not.
    limit_to(Resource::Cpu, order.seconds, order.seconds_for(u64::MAX).saturating_add(1)).map_err(fault)
}

/// Raises the limit on processor time from `before` to `seconds`, for good, and returns the one that holds: a lower one of
/// the parent stays.
///
/// # Errors
/// If it cannot be set.
pub(crate) fn extend(before: u64, seconds: u64) -> Result<u64, InspectError> {
    let present = getrlimit(Resource::Cpu);
    let holds = match present.current {
        Some(current) if current < before => current,
        _ => present.maximum.map_or(seconds, |maximum| seconds.min(maximum)),
    };
    let limit = Rlimit { current: Some(holds), maximum: present.maximum.map(|most| most.min(holds.saturating_add(1))) };
    setrlimit(Resource::Cpu, limit).map_err(InspectError::when("limiting this process"))?;
    Ok(holds)
}

/// Limits a resource. A lower existing limit stays, because most users cannot raise it.
fn limit_to(resource: Resource, soft: u64, hard: u64) -> std::result::Result<(), Errno> {
    setrlimit(resource, lowered(soft, hard, getrlimit(resource)))
}

fn lowered(soft: u64, hard: u64, present: Rlimit) -> Rlimit {
    let maximum = present.maximum.map_or(hard, |maximum| maximum.min(hard));
    let current = present.current.map_or(soft, |current| current.min(soft)).min(maximum);
    Rlimit { current: Some(current), maximum: Some(maximum) }
}

/// The memory of this process in bytes.
struct Used {
    size: u64,
    data: u64,
}

fn used() -> std::io::Result<Used> {
    let status = std::fs::read_to_string("/proc/self/status")?;
    let kib = |name: &str| {
        let line = status.lines().find_map(|line| line.strip_prefix(name))?;
        line.trim_start_matches(':').trim().strip_suffix(" kB")?.parse::<u64>().ok()
    };
    let bytes = |name| kib(name).map(|kib| kib << 10).ok_or_else(|| std::io::Error::other(format!("no {name}")));
    Ok(Used { size: bytes("VmSize")?, data: bytes("VmData")? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processor_time_is_extended_once_and_for_good() {
        // Of this process: far more than its tests take.
        let limits = || (getrlimit(Resource::Cpu).current, getrlimit(Resource::Cpu).maximum);
        setrlimit(Resource::Cpu, Rlimit { current: Some(60_000), maximum: Some(90_000) }).unwrap();
        assert_eq!(extend(60_000, 70_000).unwrap(), 70_000);
        assert_eq!(limits(), (Some(70_000), Some(70_001)));
        assert_eq!(extend(60_000, 80_000).unwrap(), 70_001);
        // A lower limit than that of the order is the parent's.
        assert_eq!(extend(80_000, 90_000).unwrap(), 70_001);
        assert_eq!(limits().0, Some(70_001));
    }

    #[test]
    fn lower_existing_limit_stays() {
        let limits = |present: (Option<u64>, Option<u64>)| {
            let Rlimit { current, maximum } = lowered(120, 121, Rlimit { current: present.0, maximum: present.1 });
            (current, maximum)
        };
        assert_eq!(limits((None, None)), (Some(120), Some(121)));
        assert_eq!(limits((Some(200), Some(300))), (Some(120), Some(121)));
        assert_eq!(limits((Some(64), None)), (Some(64), Some(121)));
        assert_eq!(limits((Some(64), Some(64))), (Some(64), Some(64)));
    }
}
