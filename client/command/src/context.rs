//! The input of every command beside its arguments: the connection, and where output goes.
//!
//! Must not depend on the commands.

use gleaner_client::Client;
use gleaner_proto::v1::{Job, ListJobsRequest};

use crate::connection::ConnectionArgs;
use crate::failure::{Failure, Result};
use crate::output::Output;
use crate::progress::Progress;

#[derive(Debug)]
pub(crate) struct Context {
    pub(crate) connection: ConnectionArgs,
    pub(crate) output: Output,
    pub(crate) progress: Progress,
}

impl Context {
    pub(crate) fn new(connection: ConnectionArgs, output: Output) -> Self {
        Self { connection, output, progress: Progress::new(output.interactive()) }
    }

    pub(crate) async fn client(&self) -> Result<Client> {
        self.connection.open().await
    }

    /// The task that was named, or the only one there is.
    pub(crate) async fn task(&self, client: &Client, named: Option<&str>) -> Result<String> {
        if let Some(task) = named {
            return Ok(task.to_owned());
        }
        let tasks = client.every_task().await?.tasks;
        let mut names: Vec<String> = tasks.into_iter().filter_map(|task| Some(task.spec?.name)).collect();
        match names.len() {
            0 => Err(Failure::message("no tasks yet; create one with `gleaner task create SPEC.toml`")),
            1 => Ok(names.remove(0)),
            _ => Err(Failure::message(format!(
                "the server has several tasks; add --task with one of: {}",
                names.join(", ")
            ))),
        }
    }

    /// The task that was named, or the one whose job makes this result (an encoder, a score run, ...).
    pub(crate) async fn task_of_result(&self, client: &Client, named: Option<&str>, result: &str) -> Result<String> {
        if let Some(task) = named {
            return Ok(task.to_owned());
        }
        if let Some(task) = remote_policy_task(client, result).await? {
            return Ok(task);
        }
        Ok(self.job_of_result(client, result).await?.task_id)
    }

    /// The job that makes this result.
    pub(crate) async fn job_of_result(&self, client: &Client, result: &str) -> Result<Job> {
        let mut request = ListJobsRequest { page_size: 1000, ..ListJobsRequest::default() };
        loop {
            let page = client.jobs().list_jobs(request.clone()).await?.into_inner();
            if let Some(job) = page.jobs.into_iter().find(|job| job.result_id == result) {
                return Ok(job);
            }
            if page.next_page_token.is_empty() {
                return Err(Failure::message(format!(
                    "{result}: no job has this result; `gleaner jobs` lists the jobs"
                )));
            }
            request.page_token = page.next_page_token;
        }
    }
}

/// The task of a policy that another server runs, which no job makes.
async fn remote_policy_task(client: &Client, result: &str) -> Result<Option<String>> {
    if !result.starts_with("pol_") {
        return Ok(None);
    }
    for task in client.every_task().await?.tasks {
        let policies = client.every_policy(&task.id).await?.policies;
        if policies.iter().any(|policy| policy.id == result && policy.remote.is_some()) {
            return Ok(Some(task.id));
        }
    }
    Ok(None)
}
