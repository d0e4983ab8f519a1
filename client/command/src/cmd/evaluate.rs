//! `evaluate`: closed-loop evaluation in the simulator, as a job of the server.

use clap::Args;
use gleaner_core::arguments::{Evaluate, Given};
use gleaner_core::proto::to_struct;
use gleaner_proto::v1::EvaluateSpec;
use gleaner_proto::v1::evaluate_spec::Subject;
use gleaner_proto::v1::job_spec::Spec;

use super::queueing::{JobArgs, SubmitArgs};
use super::submit::Submission;
use crate::context::Context;
use crate::failure::{Failure, Result};

#[derive(Args, Debug)]
pub(crate) struct EvaluateCommand {
    /// Id of the policy, whose job may be queued.
    #[arg(long, required_unless_present = "deployment")]
    policy: Option<String>,
    /// Instead of --policy, evaluate the current policy of this deployment.
    #[arg(long, value_name = "NAME", conflicts_with = "policy")]
    deployment: Option<String>,
    /// Name or id of the task. Default: the policy's.
    #[arg(long)]
    task: Option<String>,
    #[command(flatten)]
    settings: Given<Evaluate>,
    #[command(flatten)]
    submit: SubmitArgs,
    #[command(flatten)]
    job: JobArgs,
}

impl EvaluateCommand {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let client = context.client().await?;
        let mut spec = EvaluateSpec { subject: None, settings: Some(to_struct(&self.settings.values)) };
        let task = if let Some(name) = self.deployment {
            let known = client.every_deployment("").await?;
            let deployment = known.deployments.into_iter().find(|deployment| deployment.name == name);
            let deployment = deployment.ok_or_else(|| {
                Failure::message(format!("{name}: unknown deployment; `gleaner deployments` lists them"))
            })?;
            spec.subject = Some(Subject::Deployment(name));
            self.task.unwrap_or(deployment.task_id)
        } else {
            let policy = self.policy.unwrap_or_default();
            let task = context.task_of_result(&client, self.task.as_deref(), &policy).await?;
            spec.subject = Some(Subject::PolicyId(policy));
            task
        };
        let submission = Submission { task, spec: Spec::Evaluate(spec), job: self.job };
        submission.submit(context, &client, &self.submit).await
    }
}
