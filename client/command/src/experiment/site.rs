//! Where the commands of an experiment make attempts: each policy is deployed for them, and the server keeps the results.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use gleaner_client::Client;
use gleaner_proto::v1::{DeleteDeploymentRequest, DeployRequest, ReportEvaluationRequest};
use tonic::Code;

use super::attempts::{self, Trial};
use super::known::known_evaluation;
use super::standing::{Gap, StageResult};
use super::state::State;
use crate::connection::Reach;
use crate::failure::{Result, present};
use crate::output::Output;

/// Where attempts are made, during one run of an experiment.
pub(super) struct Site {
    output: Output,
    server: Reach,
    log: PathBuf,
    /// Why runs failed, by their keys: each is tried once.
    failed: HashMap<String, String>,
    /// Whether the command may run: once for each submission, so that reports appear in between.
    is_open: bool,
}

impl Site {
    pub(super) fn new(output: Output, server: Reach, out: &Path) -> Self {
        Self { output, server, log: out.join(attempts::LOG), failed: HashMap::new(), is_open: true }
    }

    /// Lets the command run once more.
    pub(super) fn open(&mut self) {
        self.is_open = true;
    }

    /// The evaluation of an earlier run of the command, or of one now.
    pub(super) async fn evaluation(
        &mut self,
        client: &Client,
        state: &mut State,
        key: &str,
        label: &str,
        trial: Trial<'_>,
    ) -> Result<std::result::Result<StageResult, Gap>> {
        if let Some(known) = known_evaluation(client, state, key).await? {
            return Ok(Ok(known));
        }
        if let Some(problem) = self.failed.get(key) {
            return Ok(Err(Gap::Failed(problem.clone())));
        }
        if !std::mem::take(&mut self.is_open) {
            return Ok(Err(Gap::NotYet));
        }
        // Its own name, so that no other experiment replaces or deletes the policy under it.
        let (policy_id, name) = (trial.policy_id.to_owned(), format!("experiment-{}@{}", own(key), trial.policy_id));
        let request = DeployRequest {
            name: name.clone(),
            policy_id: policy_id.clone(),
            hide_history: trial.hide_history,
            ..DeployRequest::default()
        };
        match client.policies().deploy(request).await {
            Ok(_) => {}
            // This policy cannot be deployed; the others may.
            Err(status) if status.code() == Code::FailedPrecondition => {
                return Ok(Err(self.failure(key, format!("deploying {policy_id}: {}", status.message()))));
            }
            Err(status) => return Err(status.into()),
        }
        let attempted = attempts::run(&self.server, &name, &self.log, trial).await;
        // An interrupted run leaves the name to the one that resumes it.
        if let Err(status) = client.policies().delete_deployment(DeleteDeploymentRequest { name: name.clone() }).await {
            self.output.note(format_args!("the deployment {name} remains: {}", status.message()));
        }
        let result = match attempted {
            Ok(result) => result,
            Err(failure) => return Ok(Err(self.failure(key, failure.to_string()))),
        };
        let solved = format_args!("evaluate {} of {} solved ({label})", result.successes, result.episodes);
        self.output.note(solved);
        let simulation = trial.attempts.simulation.clone();
        let request = ReportEvaluationRequest { policy_id, simulation, seeds: vec![result] };
        let reply = client.policies().report_evaluation(request).await?.into_inner();
        let id = present(reply.evaluation, "an evaluation")?.id;
        state.remember_evaluation(key, &id)?;
        Ok(Ok(StageResult { id, job: None }))
    }

    /// Keeps the problem of a run, which is not tried again.
    fn failure(&mut self, key: &str, problem: String) -> Gap {
        self.failed.insert(key.to_owned(), problem.clone());
        Gap::Failed(problem)
    }
}

/// A short word of a key, as a name of a deployment may have.
fn own(key: &str) -> String {
    blake3::hash(key.as_bytes()).to_hex()[..12].to_owned()
}
