//! The engine of this machine: each worker is a child process of the server, which ends with it. An attempt with several
//! ranks has a child for each.

use std::{net::SocketAddr, process::Stdio, sync::Arc};

use async_trait::async_trait;
use tokio::{
    net::unix::pipe,
    process::{Child, Command},
    sync::watch,
};

use super::{End, Engine, Execution, Launch, Output, ranks::Ranks};
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
    pub(in crate::jobs) const NAME: &'static str = Placement::LOCAL;

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

    fn takes_options(&self) -> bool {
        false
    }

    fn start(&self, launch: Launch<'_>) -> Result<Box<dyn Execution>, String> {
        let kind = launch.job.spec.kind();
        let ranks = self.config.jobs.ranks.of(&launch.job.spec);
        let (children, output) =
            start_all(&self.config, self.server, &launch.token, ranks).map_err(|error| error.to_string())?;
        crate::fail_point::pass("worker.started");
        let id = children.first().and_then(Child::id).unwrap_or(0);
        let placement = Placement { engine: Self::NAME.to_owned(), engine_id: id.to_string(), ..Placement::default() };
        let placement = watch::Sender::new(placement);
        Ok(Box::new(Processes { ranks: Ranks(children), output: Some(output), id, kind: kind.as_str(), placement }))
    }

    fn resume(&self, _: &Attempt, _: &Placement, _: &Arc<Lease>) -> Option<Box<dyn Execution>> {
        None
    }
}

/// A running worker, of one or several ranks.
struct Processes {
    ranks: Ranks,
    output: Option<Output>,
    /// The process id of rank 0.
    id: u32,
    kind: &'static str,
    placement: watch::Sender<Placement>,
}

#[async_trait]
impl Execution for Processes {
    fn placement(&self) -> watch::Receiver<Placement> {
        self.placement.subscribe()
    }

    fn output(&mut self) -> Option<Output> {
        self.output.take()
    }

    async fn ended(&mut self) -> End {
        let memory = memory::of_worker(self.id, self.kind);
        tokio::select! {
            end = self.ranks.ended() => end,
            never = memory => match never {},
        }
    }

    async fn kill(&mut self, reason: String) -> End {
        self.ranks.kill().await;
        End::Broken(reason)
    }
}

/// Starts the ranks of a worker; the second value is the standard error of all.
fn start_all(
    config: &ServeConfig,
    server: SocketAddr,
    token: &Secret,
    ranks: u32,
) -> std::io::Result<(Vec<Child>, Output)> {
    let (reader, writer) = std::io::pipe()?;
    let start = |rank: u32| {
        let mut command = command(config, server, token)?;
        if ranks > 1 {
            command.args(["--rank", &rank.to_string(), "--ranks", &ranks.to_string()]);
            command.args(["--rank-timeout-seconds", &config.jobs.ranks.rank_timeout_seconds.to_string()]);
            command.env("CUDA_VISIBLE_DEVICES", device_of(std::env::var("CUDA_VISIBLE_DEVICES").ok().as_deref(), rank));
        }
        command.stderr(writer.try_clone()?).spawn()
    };
    let children = (0..ranks).map(start).collect::<std::io::Result<_>>()?;
    Ok((children, Box::new(pipe::Receiver::from_owned_fd(reader.into())?)))
}

/// The GPU of a rank: that of its number among the server's, or of the machine.
fn device_of(visible: Option<&str>, rank: u32) -> String {
    let listed = visible.and_then(|list| list.split(',').nth(rank as usize)).map(str::trim);
    listed.map_or_else(|| rank.to_string(), str::to_owned)
}

/// The command of a worker for the attempt with this token. The worker is killed on drop, and it ends with this process.
fn command(config: &ServeConfig, server: SocketAddr, token: &Secret) -> std::io::Result<Command> {
    let program = Program::Worker.path().map_err(std::io::Error::other)?;
    let mut command = Command::new(program);
    command
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
        .kill_on_drop(true);
    Ok(command)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_have_a_gpu_each() {
        assert_eq!([device_of(None, 1), device_of(Some("4, 6"), 1), device_of(Some("4"), 1)], ["1", "6", "1"]);
    }
}
