//! Arguments and environment of the processes that the server starts.

use std::path::PathBuf;

use clap::Args;

use super::Secret;

/// Arguments of `worker`. The token is passed by the environment, so that it is not in the process list.
#[derive(Debug, Clone, Args)]
pub struct WorkerConfig {
    /// Address of the server's port for workers.
    #[arg(long)]
    pub server: String,
    /// The server's data directory.
    #[arg(long)]
    pub data_dir: PathBuf,
    /// Threads of the tensor library.
    #[arg(long, default_value_t = 2)]
    pub threads: u32,
    /// Niceness of the process (0: unchanged).
    #[arg(long, default_value_t = 0)]
    pub nice: i32,
    /// Run compute threads at idle priority.
    #[arg(long)]
    pub idle: bool,
    /// Id of the server's process; the worker ends with it.
    #[arg(long)]
    pub parent: Option<u32>,
    /// Maximum size of a gRPC message in bytes.
    #[arg(long, default_value_t = 32 << 20)]
    pub max_message_bytes: usize,
    /// Bytes of the disk that stay free (0: use all).
    #[arg(long, default_value_t = 0)]
    pub min_free_bytes: u64,
    /// The token of this attempt of its job.
    #[arg(long, env = "GLEANER_JOB_TOKEN", hide_env_values = true)]
    pub token: Secret,
}

/// What of this process's environment a worker gets: where programs and libraries are, which devices may be
/// used, and what to log. Nothing else, so that no secret of the server's reaches it.
pub fn worker_environment() -> Vec<(&'static str, std::ffi::OsString)> {
    const PASSED: [&str; 11] = [
        "PATH",
        "HOME",
        "TMPDIR",
        "TZ",
        "LANG",
        "LD_LIBRARY_PATH",
        "CUDA_VISIBLE_DEVICES",
        "MKL_NUM_THREADS",
        "RUST_BACKTRACE",
        "GLEANER_LOG",
        "GLEANER_LOG_JSON",
    ];
    let passed = PASSED.into_iter().filter_map(|name| std::env::var_os(name).map(|value| (name, value)));
    #[cfg(feature = "fail-points")]
    let passed = passed.chain(std::env::var_os(super::FAIL_POINT).map(|name| (super::FAIL_POINT, name)));
    // Threads that wait must sleep: beside any other busy process, spinning ones make each step take ten times as long.
    passed.chain([("OMP_WAIT_POLICY", "PASSIVE".into())]).collect()
}
