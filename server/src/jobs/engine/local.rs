//! The engine of this machine: each worker is a child process of the server, which ends with it.

use std::{
    net::SocketAddr,
    os::unix::process::ExitStatusExt as _,
    process::{ExitStatus, Stdio},
    sync::Arc,
};

use async_trait::async_trait;
use tokio::{
    process::{Child, Command},
    sync::watch,
};

use super::{End, Engine, Execution, Launch, Output};
use crate::{
    config::{Secret, ServeConfig, worker_environment},
    domain::{attempt::Attempt, placement::Placement},
    jobs::lease::Lease,
    program::Program,
    telemetry::memory,
};

/// Child processes of this server.
pub(in crate::jobs) struct Local {
    config: Arc<ServeConfig>,
    /// The address that workers call.
    server: SocketAddr,
}

impl Local {
    pub(in crate::jobs) const NAME: &'static str = "local";

    pub(in crate::jobs) fn new(config: Arc<ServeConfig>, server: SocketAddr) -> Self {
        Self { config, server }
    }
}

impl Engine for Local {
    fn name(&self) -> &'static str {
        Self::NAME
    }

    fn outlives_server(&self) -> bool {
        false
    }

    fn start(&self, launch: Launch<'_>) -> Result<Box<dyn Execution>, String> {
        let child = start(&self.config, self.server, &launch.token).map_err(|error| error.to_string())?;
        crate::fail_point::pass("worker.started");
        let id = child.id().unwrap_or(0);
        let placement = Placement { engine: Self::NAME.to_owned(), engine_id: id.to_string(), ..Placement::default() };
        Ok(Box::new(Process {
            child,
            id,
            kind: launch.job.spec.kind().as_str(),
            placement: watch::Sender::new(placement),
        }))
    }

    fn resume(&self, _: &Attempt, _: &Placement, _: &Arc<Lease>) -> Option<Box<dyn Execution>> {
        None
    }
}

/// A running worker.
struct Process {
    child: Child,
    id: u32,
    kind: &'static str,
    placement: watch::Sender<Placement>,
}

#[async_trait]
impl Execution for Process {
    fn placement(&self) -> watch::Receiver<Placement> {
        self.placement.subscribe()
    }

    fn output(&mut self) -> Option<Output> {
        self.child.stderr.take().map(|output| Box::new(output) as Output)
    }

    async fn ended(&mut self) -> End {
        let memory = memory::of_worker(self.id, self.kind);
        tokio::select! {
            status = self.child.wait() => match status {
                Ok(status) => End::Broken(describe(status)),
                Err(error) => End::Broken(format!("the worker was lost: {error}")),
            },
            never = memory => match never {},
        }
    }

    async fn kill(&mut self, reason: String) -> End {
        if let Err(error) = self.child.kill().await {
            tracing::error!(%error, "the worker could not be killed");
        }
        End::Broken(reason)
    }
}

/// Starts a worker for the attempt with this token, with a pipe for its standard error. The worker is killed on drop,
/// and it ends with this process.
fn start(config: &ServeConfig, server: SocketAddr, token: &Secret) -> std::io::Result<Child> {
    let program = Program::Worker.path().map_err(std::io::Error::other)?;
    Command::new(program)
        .args(["--server", &format!("http://{server}")])
        .arg("--data-dir")
        .arg(&config.data_dir)
        .args(["--threads", &config.jobs.worker_threads.to_string()])
        .arg(format!("--nice={}", config.jobs.worker_nice))
        .args(config.jobs.worker_idle.then_some("--idle"))
        .args(["--max-message-bytes", &config.limits.max_message_bytes.to_string()])
        .args(["--min-free-bytes", &config.maintenance.min_free_bytes.to_string()])
        .args(config.maintenance.max_cache_bytes.map(|most| format!("--max-cache-bytes={most}")))
        .args(["--parent", &std::process::id().to_string()])
        .env_clear()
        .envs(worker_environment())
        .env("GLEANER_JOB_TOKEN", token.reveal())
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .kill_on_drop(true)
        .spawn()
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
    use super::*;

    #[test]
    fn an_end_of_a_process_is_described() {
        assert!(describe(ExitStatus::from_raw(9)).contains("killed by signal 9"));
        assert_eq!(describe(ExitStatus::from_raw(11)), "the worker was killed by signal 11");
        assert_eq!(describe(ExitStatus::from_raw(0)), "the worker ended without a result");
        assert_eq!(describe(ExitStatus::from_raw(101 << 8)), "the worker ended with code 101 and without a result");
    }
}
