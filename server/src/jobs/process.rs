//! Worker processes: their start, and the description of their end.

use std::{
    net::SocketAddr,
    os::unix::process::ExitStatusExt as _,
    process::{ExitStatus, Stdio},
};

use tokio::process::{Child, Command};

use crate::config::{Secret, ServeConfig, worker_environment};
use crate::program::Program;

/// Starts a worker for the attempt with this token, with a pipe for its standard error. The worker is killed on drop,
/// and it ends with this process.
pub(super) fn start(config: &ServeConfig, server: SocketAddr, token: &Secret) -> std::io::Result<Child> {
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
pub(super) fn describe(status: ExitStatus) -> String {
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
