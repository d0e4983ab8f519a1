//! `policies`, `deploy`, `rollback`, `undeploy`, `deployments`.

use clap::Args;
use gleaner_client::Client;
use gleaner_core::TaskSpec;
use gleaner_core::proto::task::spec_from_proto;
use gleaner_proto::v1::{DeleteDeploymentRequest, DeployRequest, Deployment, GetTaskRequest, Policy, RollBackRequest};
use serde_json::json;

use super::follow;
use crate::context::Context;
use crate::failure::{Failure, Result, present};
use crate::table::Column::{Left, Right};
use crate::table::table;
use crate::{json, words};

#[derive(Args, Debug)]
pub(crate) struct PoliciesArgs {
    /// Name or id of the task. Default: the only task of the server.
    #[arg(long)]
    task: Option<String>,
}

impl PoliciesArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let client = context.client().await?;
        let reply = client.every_policy(&context.task(&client, self.task.as_deref()).await?).await?;
        let columns = [Left("ID"), Left("KIND"), Left("DATASET OR ADDRESS"), Left("ENCODER"), Left("CREATED")];
        let row = |policy: &Policy| {
            let dataset = match &policy.remote {
                Some(remote) => &remote.address,
                None if policy.dataset_id.is_empty() => "experts alone",
                None => &policy.dataset_id,
            };
            [
                policy.id.clone(),
                policy.kind.clone(),
                dataset.to_owned(),
                policy.encoder_id.clone(),
                words::moment(policy.create_time.as_ref()),
            ]
        };
        context.output.result(|| json::value(&reply), || table(columns, reply.policies.iter().map(row)))?;
        match reply.policies.first() {
            Some(policy) => context.output.next(format_args!("gleaner deploy NAME --policy {}", policy.id)),
            None => context.output.next("gleaner train --dataset DATASET --wait"),
        }
        Ok(())
    }
}

#[derive(Args, Debug)]
pub(crate) struct DeployArgs {
    /// Name of the deployment, such as pick_cube@prod; created if missing.
    name: String,
    /// Id of the policy, or latest: the newest one.
    #[arg(long)]
    policy: String,
    /// Score run of the same task, by which sessions are scored while they run.
    #[arg(long, default_value = "", hide_default_value = true, value_name = "RUN")]
    score_run: String,
    /// Hide the history from the policy, which then acts on the newest step alone, or without its past actions if it was
    /// trained with `--hidden-history actions`. The policy must have been trained with `--history-dropout` above 0.
    #[arg(long)]
    hide_history: bool,
}

impl DeployArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let request = DeployRequest {
            name: self.name,
            policy_id: self.policy,
            score_run_id: self.score_run,
            hide_history: self.hide_history,
        };
        let client = context.client().await?;
        let reply = client.policies().deploy(request).await?.into_inner();
        let deployment = present(reply.deployment.as_ref(), "a deployment")?;
        context.output.result(|| json::value(&reply), || pointed(deployment))?;
        // The deployment is made, so that a lookup that fails is no failure of it.
        let _ = follow::warn_of(context, &client, &deployment.task_id, &deployment.policy_id).await;
        context.output.next(evaluation(&client, deployment).await);
        Ok(())
    }
}

/// How to evaluate a deployment: in the embedded simulator if that knows its task, else in one's own. What the command did
/// is done, so a lookup that fails is no failure of it.
async fn evaluation(client: &Client, deployment: &Deployment) -> String {
    let Deployment { name, policy_id, task_id, .. } = deployment;
    match is_simulated(client, task_id).await {
        Ok(true) => format!("gleaner drive {name} (evaluates it in the simulator)"),
        Ok(false) => elsewhere(name, policy_id),
        Err(_) => "gleaner deployments".to_owned(),
    }
}

/// How to evaluate a policy, deployed or not. A restored server may have a policy without its job.
pub(super) async fn evaluation_of(context: &Context, client: &Client, policy: &str) -> String {
    let found = found_evaluation_of(context, client, policy).await;
    found.unwrap_or_else(|_| format!("gleaner deploy NAME --policy {policy}"))
}

async fn found_evaluation_of(context: &Context, client: &Client, policy: &str) -> Result<String> {
    let task = context.task_of_result(client, None, policy).await?;
    let simulated = is_simulated(client, &task).await?;
    let known = client.every_policy(&task).await?.policies;
    let then = match (simulated, known.iter().any(|known| known.id == policy && known.remote.is_some())) {
        (true, false) => return Ok(format!("gleaner evaluate --policy {policy} --wait")),
        // Jobs do not connect to other servers; sessions do.
        (true, true) => "gleaner drive NAME --report".to_owned(),
        (false, _) => elsewhere("NAME", policy),
    };
    Ok(format!("gleaner deploy NAME --policy {policy}, then {then}"))
}

/// Whether the embedded simulator knows a task.
async fn is_simulated(client: &Client, task: &str) -> Result<bool> {
    Ok(spec_of(client, task).await?.is_some_and(|spec| gleaner_sim::simulated(&spec, "").is_ok()))
}

async fn spec_of(client: &Client, task: &str) -> Result<Option<TaskSpec>> {
    let reply = client.tasks().get_task(GetTaskRequest { task: task.to_owned() }).await?.into_inner();
    Ok(reply.task.and_then(|task| spec_from_proto(task.spec?).ok()))
}

/// How to evaluate a deployment whose task the embedded simulator does not know.
fn elsewhere(name: &str, policy: &str) -> String {
    format!(
        "evaluate {name} on your robot or in your own simulator (client/python/README.md, \"Your own simulator\"), then gleaner \
         report-evaluation {policy} --simulation NAME --result SEED:EPISODES:SUCCESSES"
    )
}

/// Refuses a deployment whose task differs from the simulated one. A session refuses a name without a deployment.
pub(super) async fn check_simulated(client: &Client, name: &str, simulated: gleaner_sim::Task) -> Result<()> {
    let deployments = client.every_deployment("").await?.deployments;
    let Some(deployment) = deployments.iter().find(|deployment| deployment.name == name) else { return Ok(()) };
    let Some(spec) = spec_of(client, &deployment.task_id).await? else { return Ok(()) };
    let Err(difference) = gleaner_sim::compatible_with(simulated, &spec) else { return Ok(()) };
    if let Ok((other, _)) = gleaner_sim::simulated(&spec, "") {
        let problem = format!("{name} serves the task {other} of the simulator: add --task {other}");
        return Err(Failure::message(problem));
    }
    let problem = format!("{name} serves the task {}, which the simulator does not know ({difference})", spec.name);
    Err(Failure::message(format!("{problem}; {}", elsewhere(name, &deployment.policy_id))))
}

#[derive(Args, Debug)]
pub(crate) struct RollbackArgs {
    /// Name of the deployment.
    name: String,
}

impl RollbackArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let request = RollBackRequest { name: self.name };
        let reply = context.client().await?.policies().roll_back(request).await?.into_inner();
        let deployment = present(reply.deployment.as_ref(), "a deployment")?;
        context.output.result(|| json::value(&reply), || pointed(deployment))?;
        context.output.next("gleaner deployments");
        Ok(())
    }
}

#[derive(Args, Debug)]
pub(crate) struct UndeployArgs {
    /// Names of deployments. Running sessions keep their policy until they end; the policies stay.
    #[arg(required = true, value_name = "NAME")]
    names: Vec<String>,
}

impl UndeployArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let client = context.client().await?;
        for name in self.names {
            client.policies().delete_deployment(DeleteDeploymentRequest { name: name.clone() }).await?;
            context.output.result(|| Ok(json!({ "deleted": name })), || format!("{name} deleted"))?;
        }
        context.output.next("gleaner deployments");
        Ok(())
    }
}

fn pointed(deployment: &Deployment) -> String {
    let Deployment { name, policy_id, score_run_id: run, .. } = deployment;
    let scored = if run.is_empty() { String::new() } else { format!(", scored by {run}") };
    format!("{name} now serves {policy_id}{scored}")
}

#[derive(Args, Debug)]
pub(crate) struct DeploymentsArgs {
    /// List only deployments of this task.
    #[arg(long, default_value = "", hide_default_value = true)]
    task: String,
}

impl DeploymentsArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let client = context.client().await?;
        let reply = client.every_deployment(&self.task).await?;
        let columns = [Left("NAME"), Left("POLICY"), Left("SCORED BY"), Left("SINCE"), Right("CHANGES")];
        let row = |deployment: &Deployment| {
            let since = deployment.history.last().and_then(|change| change.deploy_time.as_ref());
            [
                deployment.name.clone(),
                deployment.policy_id.clone(),
                if deployment.score_run_id.is_empty() { "-".to_owned() } else { deployment.score_run_id.clone() },
                words::moment(since),
                deployment.history.len().to_string(),
            ]
        };
        context.output.result(|| json::value(&reply), || table(columns, reply.deployments.iter().map(row)))?;
        match reply.deployments.first() {
            Some(deployment) => context.output.next(evaluation(&client, deployment).await),
            None => context.output.next("gleaner deploy NAME --policy POLICY"),
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;
    use crate::cli::Cli;
    use crate::output::Output;

    #[tokio::test]
    async fn a_hint_without_a_server_is_no_failure_of_the_command() {
        // It keeps its port, so that no other process answers there.
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        let cli = Cli::try_parse_from(["gleaner", "--server", &url, "evaluations", "pol_1"]).unwrap();
        let context = Context::new(cli.connection, Output::new(false));
        let client = context.client().await.unwrap();
        // Closes this connection and every later one.
        let closing = tokio::spawn(async move { while listener.accept().await.is_ok() {} });
        let deployment = Deployment { name: "pick@prod".into(), policy_id: "pol_1".into(), ..Deployment::default() };
        assert_eq!(evaluation(&client, &deployment).await, "gleaner deployments");
        assert_eq!(evaluation_of(&context, &client, "pol_1").await, "gleaner deploy NAME --policy pol_1");
        closing.abort();
    }
}
