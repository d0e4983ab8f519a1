//! The meaning of the states of Slurm jobs.

use super::{super::End, commands::Entry};

/// A state, as far as an attempt depends on it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum State {
    /// Not started.
    Waiting,
    /// Started; also every word that this version does not list.
    Running,
    /// The processes have ended or are about to.
    Completing,
    Completed,
    Failed,
    OutOfMemory,
    Cancelled,
    TimedOut,
    /// Ended by the cluster: the node failed, or a job of higher priority needed it.
    Lost,
}

impl State {
    pub(super) fn of(entry: &Entry) -> Self {
        match entry.state.as_str() {
            "PENDING" | "CONFIGURING" | "REQUEUED" | "REQUEUE_HOLD" | "REQUEUE_FED" | "SPECIAL_EXIT" => Self::Waiting,
            "COMPLETING" | "STAGE_OUT" => Self::Completing,
            "COMPLETED" => Self::Completed,
            "FAILED" => Self::Failed,
            "OUT_OF_MEMORY" => Self::OutOfMemory,
            "CANCELLED" => Self::Cancelled,
            "TIMEOUT" => Self::TimedOut,
            "NODE_FAIL" | "BOOT_FAIL" | "PREEMPTED" | "DEADLINE" | "REVOKED" => Self::Lost,
            _ => Self::Running,
        }
    }

    /// Whether the job has ended.
    pub(super) fn over(self) -> bool {
        match self {
            Self::Waiting | Self::Running | Self::Completing => false,
            Self::Completed | Self::Failed | Self::OutOfMemory | Self::Cancelled | Self::TimedOut | Self::Lost => true,
        }
    }
}

/// The end of an attempt whose Slurm job has ended in this state; `None` for a job that has not ended. `begun`: its worker
/// may have called.
pub(super) fn end(entry: &Entry, begun: bool) -> Option<End> {
    let Entry { id, state, node, reason, .. } = entry;
    let at = if node.is_empty() { String::new() } else { format!(" on {node}") };
    let why = if reason.is_empty() { String::new() } else { format!(", {reason}") };
    match State::of(entry) {
        State::Waiting | State::Running | State::Completing => None,
        // A worker succeeds without a result only after a request to stop: SIGTERM, which announces a limit.
        State::Completed => Some(End::Stopped(format!("Slurm job {id}{at} was stopped by SIGTERM"))),
        State::Failed => Some(End::Broken(format!(
            "the worker of Slurm job {id}{at} failed ({state}{why}); see the log, and where the worker did not start, \
                 --slurm-worker and --slurm-setup"
        ))),
        State::OutOfMemory => Some(End::Broken(format!(
            "the worker of Slurm job {id}{at} needed more memory than its limit ({state}); raise --mem in its options"
        ))),
        // By Slurm itself, when the node or the controller fails during the start.
        State::Cancelled if !begun && !node.is_empty() => {
            Some(End::Interrupted(format!("Slurm job {id} was cancelled while it started{at}")))
        }
        // By a person, or by a controller that has lost its last seconds.
        State::Cancelled => Some(End::Stopped(format!("Slurm job {id}{at} was cancelled in Slurm"))),
        State::TimedOut => {
            Some(End::Stopped(format!("Slurm job {id}{at} reached its time limit (--time in its options)")))
        }
        State::Lost => Some(End::Interrupted(format!("Slurm job {id}{at} was ended by the cluster ({state}{why})"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(state: &str) -> Entry {
        let text = |text: &str| text.to_owned();
        Entry { name: text("gleaner-1"), id: text("7"), state: text(state), node: text("node1"), reason: String::new() }
    }

    #[test]
    fn a_failed_worker_is_reported_with_the_flags_by_which_it_starts() {
        let end = end(&Entry { reason: "NonZeroExitCode".to_owned(), ..entry("FAILED") }, false);
        let expected = "the worker of Slurm job 7 on node1 failed (FAILED, NonZeroExitCode); see the log, and where the \
                        worker did not start, --slurm-worker and --slurm-setup";
        assert_eq!(end, Some(End::Broken(expected.to_owned())));
    }

    #[test]
    fn failures_of_the_cluster_are_no_failures_of_the_job() {
        for state in ["NODE_FAIL", "PREEMPTED", "BOOT_FAIL", "DEADLINE"] {
            let end = end(&entry(state), true);
            assert!(
                matches!(&end, Some(End::Interrupted(why)) if why.contains(state) && why.contains("node1")),
                "{end:?}"
            );
        }
        for state in ["FAILED", "OUT_OF_MEMORY"] {
            assert!(matches!(end(&entry(state), true), Some(End::Broken(_))), "{state}");
        }
        for state in ["TIMEOUT", "COMPLETED", "CANCELLED"] {
            assert!(matches!(end(&entry(state), true), Some(End::Stopped(_))), "{state}");
        }
        let started = end(&entry("CANCELLED"), false);
        assert!(
            matches!(&started, Some(End::Interrupted(why)) if why.contains("while it started on node1")),
            "{started:?}"
        );
        let waiting = Entry { node: String::new(), ..entry("CANCELLED") };
        assert!(matches!(end(&waiting, false), Some(End::Stopped(_))), "by a person");
        for state in ["PENDING", "RUNNING", "COMPLETING", "SUSPENDED", "SOMETHING_NEW"] {
            assert_eq!(end(&entry(state), true), None, "{state}");
            assert!(!State::of(&entry(state)).over());
        }
    }
}
