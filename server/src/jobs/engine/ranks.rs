//! The child processes of one attempt, and their end: that of rank 0, or of another one that fails. Must not depend on
//! their commands.

use std::{
    future::poll_fn, os::unix::process::ExitStatusExt as _, pin::pin, process::ExitStatus, task::Poll, time::Duration,
};

use tokio::process::Child;

use super::End;

/// Longest time from the failure of a rank until rank 0 is killed: it notices, and may have the reason to report.
const GRACE: Duration = Duration::from_secs(5);
/// Longest time from the failure of rank 0 until the others are killed: one of them may have failed before it.
const SETTLE: Duration = Duration::from_millis(500);

/// The processes by rank; one that has ended without a failure stays in its place.
pub(super) struct Ranks(pub(super) Vec<Child>);

/// A process that has ended, and how.
type Ended = (usize, std::io::Result<ExitStatus>);

impl Ranks {
    /// Waits for the end of rank 0 or for the failure of another rank, and kills the rest.
    pub(super) async fn ended(&mut self) -> End {
        self.ended_and_settled(SETTLE).await
    }

    async fn ended_and_settled(&mut self, settle: Duration) -> End {
        let (first, mut failed) = match next(&mut self.0, None).await {
            (0, status) => (Some(status), None),
            // Of the others only the first failure counts: an ended process is ready at each further look.
            ended => (self.rank_0().await, Some(ended)),
        };
        let without_failure = first.as_ref().is_some_and(|status| status.as_ref().is_ok_and(ExitStatus::success));
        if failed.is_none() && !without_failure && self.0.len() > 1 {
            failed = tokio::time::timeout(settle, next(&mut self.0, Some(0))).await.ok();
        }
        self.kill().await;
        match (first, failed) {
            // The end of another rank is no fault of the job, which resumes if it saved a checkpoint.
            (Some(Ok(status)), Some((rank, ended))) if !status.success() => End::Stopped(of_rank(rank, ended)),
            (None, Some((rank, ended))) => End::Stopped(of_rank(rank, ended)),
            // Failures of the job are reported: a rank 0 that fails without a report has lost another rank or the server.
            (Some(Ok(status)), None) if self.0.len() > 1 && !status.success() && status.signal().is_none() => {
                End::Stopped(describe(status))
            }
            (Some(Ok(status)), _) => End::Broken(describe(status)),
            (Some(Err(error)), _) => End::Broken(format!("the worker was lost: {error}")),
            (None, None) => End::Broken("the worker was lost".to_owned()),
        }
    }

    /// The end of rank 0 after a failure of another; `None` if it lasts too long.
    async fn rank_0(&mut self) -> Option<std::io::Result<ExitStatus>> {
        tokio::time::timeout(GRACE, self.0.first_mut()?.wait()).await.ok()
    }

    /// Kills every process that has not ended.
    pub(super) async fn kill(&mut self) {
        for child in &mut self.0 {
            if let Err(error) = child.kill().await {
                tracing::error!(%error, "the worker could not be killed");
            }
        }
    }
}

/// Waits for the end of rank 0, or the failure of another one but `known`.
async fn next(children: &mut [Child], known: Option<usize>) -> Ended {
    let mut waits: Vec<_> =
        children.iter_mut().enumerate().map(|(rank, child)| (rank, Box::pin(child.wait()))).collect();
    let mut wait = pin!(poll_fn(|context| {
        let mut at = 0;
        while let Some((rank, wait)) = waits.get_mut(at) {
            let rank = *rank;
            match wait.as_mut().poll(context) {
                Poll::Ready(status) => {
                    // A future that has ended is not polled again.
                    drop(waits.swap_remove(at));
                    let success = status.as_ref().is_ok_and(ExitStatus::success);
                    if known != Some(rank) && (rank == 0 || !success) {
                        return Poll::Ready((rank, status));
                    }
                }
                Poll::Pending => at += 1,
            }
        }
        Poll::Pending
    }));
    wait.as_mut().await
}

fn of_rank(rank: usize, ended: std::io::Result<ExitStatus>) -> String {
    match ended {
        Ok(status) => format!("rank {rank}: {}", describe(status)),
        Err(error) => format!("rank {rank}: the worker was lost: {error}"),
    }
}

/// The end of a worker without a result, in words.
fn describe(status: ExitStatus) -> String {
    /// SIGKILL, which the system sends when memory has run out.
    const KILL: i32 = 9;
    match (status.signal(), status.code()) {
        (Some(KILL), _) => "the worker was killed by signal 9 (has memory run out?)".to_owned(),
        (Some(signal), _) => format!("the worker was killed by signal {signal}"),
        (None, Some(0)) => "the worker ended without a result".to_owned(),
        (None, code) => format!("the worker ended with code {} and without a result", code.unwrap_or(-1)),
    }
}

#[cfg(test)]
mod tests {
    use tokio::process::Command;

    use super::*;

    /// Processes that run these scripts.
    fn ranks(scripts: &[&str]) -> Ranks {
        let start = |script: &&str| Command::new("sh").args(["-c", script]).kill_on_drop(true).spawn().unwrap();
        Ranks(scripts.iter().map(start).collect())
    }

    const WAITS: &str = "exec sleep 1000";

    #[test]
    fn an_end_of_a_process_is_described() {
        assert!(describe(ExitStatus::from_raw(9)).contains("killed by signal 9"));
        assert_eq!(describe(ExitStatus::from_raw(11)), "the worker was killed by signal 11");
        assert_eq!(describe(ExitStatus::from_raw(0)), "the worker ended without a result");
        assert_eq!(describe(ExitStatus::from_raw(101 << 8)), "the worker ended with code 101 and without a result");
    }

    #[tokio::test]
    async fn rank_0_ends_an_attempt_and_another_rank_only_by_a_failure() {
        let without_result = End::Broken("the worker ended without a result".to_owned());
        assert_eq!(ranks(&["exit 0"]).ended().await, without_result);
        assert_eq!(ranks(&["exit 0", WAITS]).ended().await, without_result);
        // Rank 1 ends first.
        assert_eq!(ranks(&["read line; exit 0", "exit 0"]).ended().await, without_result);
        let failed = End::Stopped("the worker ended with code 3 and without a result".to_owned());
        assert_eq!(ranks(&["exit 3", WAITS, WAITS]).ended().await, failed);
    }

    /// With a thread to spare: a wait that never yields would keep a timeout on its own thread from firing.
    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn the_failure_of_a_rank_is_the_reason_and_ends_the_others() {
        let lost = End::Stopped("rank 1: the worker was killed by signal 9 (has memory run out?)".to_owned());
        let mut three = ranks(&[WAITS, "kill -9 $$", WAITS]);
        assert_eq!(three.ended().await, lost);
        assert!(three.0.iter_mut().all(|child| child.try_wait().unwrap().is_some()), "a process is left");
        // A rank that fails after the first does not keep the others from being ended. It fails once the first has closed
        // the pipe between them, and half a second has passed.
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe").display().to_string();
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let failed = End::Stopped("rank 1: the worker ended with code 3 and without a result".to_owned());
        let (first, second) = (format!("exec 3> {pipe}; exit 3"), format!("cat {pipe}; sleep 0.5; exit 4"));
        let both = tokio::spawn(async move { ranks(&[WAITS, &first, &second]).ended().await });
        assert_eq!(tokio::time::timeout(GRACE * 12, both).await.expect("the attempt does not end").unwrap(), failed);
        // Rank 0 notices at once, and its end may be seen first: on a busy machine, long before that of rank 1.
        assert_eq!(ranks(&["exit 1", "kill -9 $$"]).ended_and_settled(GRACE * 12).await, lost);
    }
}
