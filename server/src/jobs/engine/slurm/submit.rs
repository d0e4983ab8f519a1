//! The submission of a Slurm job: repeated until Slurm has it, and never while an earlier one may have arrived.

use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::{From, SlurmJob, commands::Problem, replace};

/// Pauses between submissions.
#[cfg(not(test))]
const FIRST_PAUSE: Duration = Duration::from_secs(1);
#[cfg(test)]
const FIRST_PAUSE: Duration = Duration::from_millis(10);
const LONGEST_PAUSE: Duration = Duration::from_secs(60);

impl SlurmJob {
    /// Submits the job. A refusal or a failure is shown as the reason for waiting, and the submission is repeated after
    /// squeue has shown that no earlier one arrived: an answer of sbatch may be lost.
    pub(super) async fn submit(&mut self) {
        let From::Submission(submission) = &self.from else { return };
        let mut pause = FIRST_PAUSE;
        loop {
            let answer = self.commands.submit(&submission.arguments, &submission.variables, &submission.script).await;
            let problem = match answer {
                Ok(id) => return self.submitted(&id),
                Err(problem) => problem,
            };
            let problem = match problem {
                Problem::Refused(words) => format!("{words}; check {}", submission.sources),
                Problem::NoAnswer(words) => words,
            };
            let waiting = format!("{problem}; the submission is repeated");
            tracing::warn!(problem, "Slurm did not accept a job; retrying");
            self.placement.send_if_modified(|placement| replace(&mut placement.waiting, &waiting));
            sleep(pause).await;
            pause = LONGEST_PAUSE.min(pause * 2);
            let (_, snapshot) = self.view.after(Instant::now(), |_| ()).await;
            if let Some(entry) = snapshot.entry(&self.name) {
                return self.submitted(&entry.id.clone());
            }
        }
    }

    fn submitted(&self, id: &str) {
        tracing::info!(slurm.id = id, "submitted to Slurm");
        self.placement.send_if_modified(|placement| {
            replace(&mut placement.engine_id, id) | replace(&mut placement.waiting, "submitted to Slurm")
        });
    }
}
