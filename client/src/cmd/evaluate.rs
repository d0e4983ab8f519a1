//! `evaluate`: closed-loop trials in the simulator, as a job of the server.

use clap::Args;
use gleaner_proto::v1::evaluate_spec::Subject;
use gleaner_proto::v1::job_spec::Spec;
use gleaner_proto::v1::{EvaluateSpec, ListDeploymentsRequest};

use super::submit::{KeyArgs, Submission, SubmitArgs};
use crate::choice::DeviceWord;
use crate::context::Context;
use crate::failure::{Failure, Result};

/// How often a policy is tried.
#[derive(Args, Clone, Debug)]
pub(crate) struct TrialArgs {
    /// Simulated episodes for each seed of the evaluation.
    #[arg(long, value_name = "N")]
    episodes: Option<u32>,
    /// Seeds of the evaluation; no two share an attempt.
    #[arg(long, value_delimiter = ',', value_name = "SEED,SEED")]
    trial_seeds: Vec<u64>,
    /// Steps after which an attempt has failed.
    #[arg(long, value_name = "STEPS")]
    max_steps: Option<u32>,
    /// The simulator's task; by default the task's own name.
    #[arg(long, value_name = "TASK", default_value = "", hide_default_value = true)]
    simulation: String,
}

impl TrialArgs {
    /// Trials of a policy that is filled in later.
    pub(crate) fn spec(&self, device: DeviceWord) -> EvaluateSpec {
        EvaluateSpec {
            subject: None,
            simulation: self.simulation.clone(),
            episodes: self.episodes,
            seeds: self.trial_seeds.clone(),
            max_steps: self.max_steps,
            device: device.into(),
        }
    }
}

#[derive(Args, Debug)]
pub(crate) struct EvaluateCommand {
    /// The policy, or one that a queued job will make.
    #[arg(long, required_unless_present = "deployment")]
    policy: Option<String>,
    /// Instead: the policy that this deployment points at now.
    #[arg(long, value_name = "NAME", conflicts_with = "policy")]
    deployment: Option<String>,
    /// The task's name or id; by default that of the policy.
    #[arg(long)]
    task: Option<String>,
    #[command(flatten)]
    trials: TrialArgs,
    /// Where to compute.
    #[arg(long, value_enum, default_value = "cpu")]
    device: DeviceWord,
    #[command(flatten)]
    submit: SubmitArgs,
    #[command(flatten)]
    key: KeyArgs,
}

impl EvaluateCommand {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let client = context.client().await?;
        let mut spec = self.trials.spec(self.device);
        let task = if let Some(name) = self.deployment {
            let known = client.policies().list_deployments(ListDeploymentsRequest::default()).await?.into_inner();
            let deployment = known.deployments.into_iter().find(|deployment| deployment.name == name);
            let deployment = deployment
                .ok_or_else(|| Failure::told(format!("{name}: no such deployment; gleaner deployments lists them")))?;
            spec.subject = Some(Subject::Deployment(name));
            self.task.unwrap_or(deployment.task_id)
        } else {
            let policy = self.policy.unwrap_or_default();
            let task = context.task_of_result(&client, self.task.as_deref(), &policy).await?;
            spec.subject = Some(Subject::PolicyId(policy));
            task
        };
        let submission = Submission { task, spec: Spec::Evaluate(spec), key: self.key.key };
        submission.submit(context, &client, &self.submit).await
    }
}
