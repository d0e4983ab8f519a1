//! The settings of the process: its end with its server or at a signal, its priority below serving, for processors and for
//! memory, and its peak memory.

use rustix::process::{Pid, Signal};
use thread_priority::{
    NormalThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy, set_thread_priority_and_policy, thread_native_id,
    thread_schedule_policy,
};

use tokio::signal::unix::{SignalKind, signal};
use tokio_util::sync::CancellationToken;

use crate::config::WorkerConfig;
use gleaner_core::error::{Error, Result};

/// What the system adds to the memory of a worker, in thousandths of the machine's, when it chooses a process to kill
/// because memory has run out. The server starts a job again for as long as the server is the one that is killed; the end
/// of a worker counts as an attempt. Not 1000: another program that has taken most of the memory is then chosen first.
const OUT_OF_MEMORY: &str = "500";

/// Sets the niceness, has the system kill this process when the server that started it ends, and before that server when
/// memory runs out.
///
/// # Errors
/// Unavailable when that server has already ended.
pub(crate) fn adopt_priority(config: &WorkerConfig) -> Result<()> {
    if let Some(parent) = config.parent {
        rustix::process::set_parent_process_death_signal(Some(Signal::KILL))
            .map_err(|error| Error::internal("tying the worker to its server", error))?;
        // The server may have ended before the line above took effect.
        let expected = i32::try_from(parent).ok().and_then(Pid::from_raw);
        if rustix::process::getppid() != expected {
            return Err(Error::unavailable("the server that started this worker is gone"));
        }
        if let Err(error) = yield_memory("self") {
            tracing::warn!(%error, "the system may end the server before this worker when memory runs out");
        }
    }
    if config.nice > 0
        && let Err(error) = rustix::process::setpriority_process(None, config.nice)
    {
        tracing::warn!(%error, "the worker runs at normal priority");
    }
    Ok(())
}

/// Has the system kill a process before others when memory runs out. `process`: its id, or `self`.
fn yield_memory(process: &str) -> std::io::Result<()> {
    std::fs::write(format!("/proc/{process}/oom_score_adj"), OUT_OF_MEMORY)
}

/// Requests the work to stop at SIGTERM, which a cluster sends some seconds before it kills a job: the work saves a
/// checkpoint first.
pub(crate) async fn stop_at_signal(stop: CancellationToken) {
    match signal(SignalKind::terminate()) {
        Ok(mut terminate) => {
            if terminate.recv().await.is_some() {
                tracing::info!("stopping at SIGTERM");
                stop.cancel();
            }
        }
        Err(error) => tracing::warn!(%error, "SIGTERM ends this worker without a last checkpoint"),
    }
}

/// Runs this thread, and those it starts, only on idle processors.
pub(crate) fn set_idle_priority() {
    let idle = ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Idle);
    // The call also resets the niceness, which needs privileges and fails; that error does not matter here, so the
    // resulting policy is checked instead.
    let _ = set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Min, idle);
    if !matches!(thread_schedule_policy(), Ok(policy) if policy == idle) {
        tracing::warn!("the worker competes with serving at its niceness");
    }
}

/// The most memory this process has held, in bytes; 0 where the system does not report it.
pub(crate) fn peak_memory() -> u64 {
    std::fs::read_to_string("/proc/self/status").map(|status| high_water(&status)).unwrap_or(0)
}

fn high_water(status: &str) -> u64 {
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kibibytes = line.and_then(|line| line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok());
    kibibytes.unwrap_or(0) * 1024
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_idle_thread_and_its_children_have_idle_priority() {
        let policies = std::thread::spawn(|| {
            set_idle_priority();
            let started = std::thread::spawn(thread_schedule_policy);
            (thread_schedule_policy().ok(), started.join().ok().and_then(|policy| policy.ok()))
        });
        let idle = Some(ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Idle));
        assert_eq!(policies.join().ok(), Some((idle, idle)));
        assert_ne!(thread_schedule_policy().ok(), idle, "the others stay as they are");
    }

    #[test]
    fn a_worker_is_killed_before_its_server_when_memory_runs_out() {
        // A process of its own, because an unprivileged one cannot take it back.
        let mut other = std::process::Command::new("cat").stdin(std::process::Stdio::piped()).spawn().unwrap();
        let pid = other.id().to_string();
        let set = yield_memory(&pid);
        let stored = std::fs::read_to_string(format!("/proc/{pid}/oom_score_adj"));
        let worse = |process: &str| -> u64 {
            std::fs::read_to_string(format!("/proc/{process}/oom_score")).unwrap().trim().parse().unwrap()
        };
        let scores = (worse(&pid), worse("self"));
        other.kill().unwrap();
        other.wait().unwrap();
        set.unwrap();
        assert_eq!(stored.unwrap().trim(), OUT_OF_MEMORY);
        assert!(scores.0 > scores.1, "{scores:?}");
    }

    #[test]
    fn the_high_water_mark_is_read() {
        assert_eq!(high_water("Name:\tgleaner\nVmHWM:\t  204800 kB\nVmRSS:\t 1 kB\n"), 204_800 * 1024);
        assert_eq!(high_water("Name:\tgleaner\n"), 0);
        assert!(peak_memory() > 0);
    }
}
