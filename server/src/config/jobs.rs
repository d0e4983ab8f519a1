//! Workers: how many, with which threads and priority, and where they run.

use std::path::PathBuf;

use clap::Args;

use super::{EngineConfig, RanksConfig};

/// Workers.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Jobs")]
pub struct JobsConfig {
    /// Maximum number of jobs that run at once, one worker process each (0: jobs are queued and do not run).
    #[arg(long, env = "GLEANER_WORKERS", default_value_t = 1, value_name = "N")]
    pub workers: usize,
    /// Compute threads of one worker; a training or score run uses one more, which reads episodes ahead, and on a GPU
    /// this many more. More threads finish a job sooner and leave fewer processors for serving; results are
    /// reproducible for a fixed number.
    #[arg(long, env = "GLEANER_WORKER_THREADS", default_value_t = 2, value_name = "N")]
    pub worker_threads: u32,
    /// Niceness of workers. A higher value slows jobs down in favour of serving (0: the server's own priority).
    #[arg(long, env = "GLEANER_WORKER_NICE", default_value_t = 10, value_name = "NICE")]
    pub worker_nice: i32,
    /// Run compute threads of jobs at idle priority (SCHED_IDLE), so that serving preempts them at once; niceness alone
    /// lets them finish a slice of a few milliseconds. Jobs stall beside programs that use every processor; `false`
    /// gives them a share.
    #[arg(long, env = "GLEANER_WORKER_IDLE", default_value_t = true, action = clap::ArgAction::Set, value_name = "BOOL")]
    pub worker_idle: bool,
    /// Folder of pretrained weights that jobs name by `image_weights`: safetensors files of up to 256 MiB, as
    /// `scripts/convert_resnet.py` writes them. A job gets a copy when it is submitted. Without a folder such jobs are
    /// rejected.
    #[arg(long, env = "GLEANER_IMAGE_WEIGHTS_DIR", value_name = "DIR")]
    pub image_weights_dir: Option<PathBuf>,
    /// End a job's attempt when its worker has not reported for this many seconds. Lower values detect stuck workers
    /// sooner but end attempts on a machine that is overloaded.
    #[arg(long, env = "GLEANER_WORKER_SILENCE_SECONDS", default_value_t = 120, value_name = "SECONDS")]
    pub worker_silence_seconds: u64,
    /// The processes of one job.
    #[command(flatten)]
    pub ranks: RanksConfig,
    /// Where jobs run.
    #[command(flatten)]
    pub engine: EngineConfig,
}

impl JobsConfig {
    /// Checks the folder of weights, and where jobs run.
    ///
    /// # Errors
    /// A sentence that names the flag and the fix.
    pub(super) fn validate(&self, tls: bool, insecure: bool) -> Result<(), String> {
        match &self.image_weights_dir {
            Some(folder) if !folder.is_dir() => Err(format!(
                "--image-weights-dir: {} is not a folder; create it, or leave the flag out",
                folder.display()
            )),
            Some(_) | None => self.engine.validate(tls, insecure),
        }
    }
}
