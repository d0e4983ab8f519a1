//! Arguments of the program, given by the server that starts it. The only module that reads the environment.

use std::path::PathBuf;

use clap::Parser;
use gleaner_core::Secret;
use gleaner_logs::LogOptions;

/// Works on one job of a gleaner server, which starts this program on its own machine or by a cluster. The token is passed by the environment, so that it
/// is not in the process list.
#[derive(Debug, Parser)]
#[command(name = "gleaner-worker", version)]
pub struct WorkerConfig {
    /// Address of the server's port for workers.
    #[arg(long)]
    pub server: String,
    /// The server's data directory.
    #[arg(long)]
    pub data_dir: PathBuf,
    /// Folder on this machine's own disk for decoded steps and copies of stored files, at most `--max-cache-bytes` of both.
    /// Default: the data directory.
    #[arg(long)]
    pub cache_dir: Option<PathBuf>,
    /// Threads of the tensor library. A training or score run uses one more, which reads episodes ahead, and on a GPU
    /// this many more.
    #[arg(long, default_value_t = 2)]
    pub threads: u32,
    /// Niceness of the process (0: unchanged).
    #[arg(long, default_value_t = 0)]
    pub nice: i32,
    /// Run compute threads at idle priority.
    #[arg(long)]
    pub idle: bool,
    /// Id of the server's process; the worker ends with it. Without it, the worker outlives a restart of the server.
    #[arg(long)]
    pub parent: Option<u32>,
    /// Names of the cluster's nodes where this job runs, shown with the job.
    #[arg(long, default_value = "")]
    pub node: String,
    /// Number of this process among those of its attempt, from 0. Under srun the variable has it.
    #[arg(long, env = "SLURM_PROCID", default_value_t = 0)]
    pub rank: u32,
    /// Processes of the attempt.
    #[arg(long, default_value_t = 1)]
    pub ranks: u32,
    /// Seconds without another of these processes after which this one ends.
    #[arg(long, default_value_t = 120)]
    pub rank_timeout_seconds: u64,
    /// Maximum size of a gRPC message in bytes.
    #[arg(long, default_value_t = 32 << 20)]
    pub max_message_bytes: usize,
    /// Bytes of the disk that stay free (0: use all).
    #[arg(long, default_value_t = 0)]
    pub min_free_bytes: u64,
    /// Maximum size of the cache in bytes (0: no limit). Default: half of the disk.
    #[arg(long)]
    pub max_cache_bytes: Option<u64>,
    /// The token of this attempt of its job.
    #[arg(long, env = "GLEANER_JOB_TOKEN", hide_env_values = true)]
    pub token: Secret,
    /// Authorities (PEM text) of which one signed the server's certificate. Default: those of the system.
    #[arg(long, env = "GLEANER_WORKER_CA", hide_env_values = true)]
    pub ca: Option<String>,
    /// What to log.
    #[command(flatten)]
    pub log: LogOptions,
    /// Exit at a fail point: `name`, or `name=n` for its n-th passing (tests only).
    #[cfg(feature = "fail-points")]
    #[arg(long, env = gleaner_data_folder::fail_point::VARIABLE, hide = true)]
    pub fail_point: Option<String>,
}

impl WorkerConfig {
    /// Makes this process exit at the fail point of its configuration, if that names one, and the server with it.
    ///
    /// # Errors
    /// A sentence that names the mistake.
    pub fn arm_fail_point(&self) -> Result<(), String> {
        #[cfg(feature = "fail-points")]
        if let Some(which) = &self.fail_point {
            return gleaner_data_folder::fail_point::arm(which, self.parent);
        }
        Ok(())
    }
}
