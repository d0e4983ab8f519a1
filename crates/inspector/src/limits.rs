//! The limits that an inspecting process takes upon itself, before it touches a byte of the recording.

use rustix::{
    io::Errno,
    process::{Resource, Rlimit, Signal, getrlimit, set_parent_process_death_signal, setrlimit},
};

use crate::{InspectError, Order};

/// The recording, the spec, the frames, the verdict, standard streams, and some for the runtime.
const OPEN_FILES: u64 = 64;

/// Limits memory, processor time, file size and open files of this process, and lets it die with its parent.
///
/// # Errors
/// When the system does not say how much is taken, or does not take a limit.
pub fn take(order: &Order) -> Result<(), InspectError> {
    let fault = InspectError::when::<Errno>("limiting this process");
    set_parent_process_death_signal(Some(Signal::KILL)).map_err(&fault)?;
    let recording = std::fs::metadata(&order.recording).map_or(0, |file| file.len());
    let taken = taken().map_err(InspectError::when("asking how much memory is taken"))?;
    // What the program and its libraries take before they do anything is not the recording's doing.
    let data = taken.data.saturating_add(order.memory_bytes);
    // The recording itself may be mapped.
    let address_space = taken.size.saturating_add(order.memory_bytes).saturating_add(recording);
    for (resource, limit) in [
        (Resource::Data, data),
        (Resource::As, address_space),
        // What is mended is about as large as what was torn.
        (Resource::Fsize, order.memory_bytes.saturating_add(if order.salvage.is_some() { recording } else { 0 })),
        (Resource::Nofile, OPEN_FILES),
        (Resource::Core, 0),
    ] {
        limit_to(resource, limit, limit).map_err(&fault)?;
    }
    // The soft limit's signal tells the parent what was too much; the hard one's would not.
    limit_to(Resource::Cpu, order.seconds, order.seconds.saturating_add(1)).map_err(fault)
}

/// Limits a resource. A lower limit that the process has already stays: to raise it is refused to most users.
fn limit_to(resource: Resource, soft: u64, hard: u64) -> std::result::Result<(), Errno> {
    setrlimit(resource, lowered(soft, hard, getrlimit(resource)))
}

fn lowered(soft: u64, hard: u64, present: Rlimit) -> Rlimit {
    let maximum = present.maximum.map_or(hard, |maximum| maximum.min(hard));
    let current = present.current.map_or(soft, |current| current.min(soft)).min(maximum);
    Rlimit { current: Some(current), maximum: Some(maximum) }
}

/// Bytes of address space that this process has taken.
struct Taken {
    size: u64,
    data: u64,
}

fn taken() -> std::io::Result<Taken> {
    let status = std::fs::read_to_string("/proc/self/status")?;
    let kib = |name: &str| {
        let line = status.lines().find_map(|line| line.strip_prefix(name))?;
        line.trim_start_matches(':').trim().strip_suffix(" kB")?.parse::<u64>().ok()
    };
    let bytes = |name| kib(name).map(|kib| kib << 10).ok_or_else(|| std::io::Error::other(format!("no {name}")));
    Ok(Taken { size: bytes("VmSize")?, data: bytes("VmData")? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lower_limit_that_is_there_stays() {
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
