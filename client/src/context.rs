//! What every command is given: where the server is, who asks, and where output goes.

use std::path::Path;

use gleaner_client::{Client, ClientError, Credentials};
use gleaner_proto::v1::{ListJobsRequest, ListTasksRequest};

use crate::cli::ConnectionArgs;
use crate::failure::{Failure, Result};
use crate::output::Output;
use crate::progress::Progress;

const DEFAULT_SERVER: &str = "http://127.0.0.1:7400";

#[derive(Debug)]
pub(crate) struct Context {
    connection: ConnectionArgs,
    pub(crate) output: Output,
    pub(crate) progress: Progress,
}

impl Context {
    pub(crate) fn new(connection: ConnectionArgs, output: Output) -> Self {
        Self { connection, output, progress: Progress::new(output.interactive()) }
    }

    pub(crate) async fn client(&self) -> Result<Client> {
        let server = self.connection.server.as_deref().unwrap_or(DEFAULT_SERVER);
        Ok(Client::connect_with(server, self.credentials()?).await?)
    }

    /// The failure, with its likely cause where a lost connection hides it: a server that encrypts at an address without
    /// encryption, or one that asks for a client certificate (its refusal follows the handshake and may be lost).
    pub(crate) async fn explained(&self, failure: Failure) -> Failure {
        let server = self.connection.server.as_deref().unwrap_or(DEFAULT_SERVER);
        if !failure.is_lost_connection() {
            return failure;
        }
        let said = failure.to_string();
        if server.starts_with("https://") && self.connection.client_cert.is_none() && !said.contains("--client-cert") {
            return Failure::told(format!(
                "{said}; if the server asks for a client certificate, give --client-cert and --client-key"
            ));
        }
        if !Client::encrypts(server).await {
            return failure;
        }
        let address = server.trim_start_matches("http://");
        Failure::told(format!(
            "cannot talk to {server}: the server there encrypts; write https://{address} and name its authority with \
             --ca FILE"
        ))
    }

    // What the user gave; files are read now, so that a missing one is named.
    fn credentials(&self) -> Result<Credentials> {
        let ConnectionArgs { server: _, token, ca, client_cert, client_key, author: _ } = &self.connection;
        let read = |path: &Path| std::fs::read(path).map_err(ClientError::io(path));
        let identity = match (client_cert, client_key) {
            (Some(cert), Some(key)) => Some((read(cert)?, read(key)?)),
            (_, _) => None,
        };
        Ok(Credentials { token: token.clone(), ca: ca.as_deref().map(read).transpose()?, identity })
    }

    /// Whether the user named a server.
    pub(crate) fn names_server(&self) -> bool {
        self.connection.server.is_some()
    }

    /// Who labels, as recorded with each label.
    pub(crate) fn author(&self) -> String {
        self.connection.author.clone().unwrap_or_default()
    }

    /// The task that was named, or the only one there is.
    pub(crate) async fn task(&self, client: &Client, named: Option<&str>) -> Result<String> {
        if let Some(task) = named {
            return Ok(task.to_owned());
        }
        let tasks = client.tasks().list_tasks(ListTasksRequest {}).await?.into_inner().tasks;
        let mut names: Vec<String> = tasks.into_iter().filter_map(|task| Some(task.spec?.name)).collect();
        match names.len() {
            0 => Err(Failure::told("there is no task yet; make one: gleaner task create SPEC.toml")),
            1 => Ok(names.remove(0)),
            _ => Err(Failure::told(format!("which task? add --task with one of: {}", names.join(", ")))),
        }
    }

    /// The task that was named, or the one whose job makes this result (an encoder, a score run, ...).
    pub(crate) async fn task_of_result(&self, client: &Client, named: Option<&str>, result: &str) -> Result<String> {
        if let Some(task) = named {
            return Ok(task.to_owned());
        }
        let mut request = ListJobsRequest { page_size: 1000, ..ListJobsRequest::default() };
        loop {
            let page = client.jobs().list_jobs(request.clone()).await?.into_inner();
            if let Some(job) = page.jobs.into_iter().find(|job| job.result_id == result) {
                return Ok(job.task_id);
            }
            if page.next_page_token.is_empty() {
                return Err(Failure::told(format!("{result}: no job makes this; gleaner jobs lists what there is")));
            }
            request.page_token = page.next_page_token;
        }
    }
}
