//! Where jobs run: this machine or a Slurm cluster, and the address that workers on other machines call.

use std::{net::SocketAddr, path::PathBuf};

use clap::{Args, ValueEnum};

use crate::domain::job::JobKind;

/// The programs that can run workers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum EngineKind {
    /// Child processes of the server.
    Local,
    /// Jobs of a Slurm cluster.
    Slurm,
}

/// Where jobs run.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Jobs on a cluster")]
pub struct EngineConfig {
    /// Where jobs run: `local`, as processes of this machine, or `slurm`, as jobs of a Slurm cluster by its commands sbatch,
    /// squeue and scancel. Workers on a cluster continue while the server is down; the data folder must be on a file
    /// system that the nodes share, at the same path.
    #[arg(long, env = "GLEANER_ENGINE", value_enum, default_value_t = EngineKind::Local, value_name = "ENGINE")]
    pub engine: EngineKind,
    /// Address for workers on other machines, with a fixed port, required with `--engine slurm`. It serves TLS with the
    /// certificate of --tls-cert; each call needs the token of a running attempt.
    #[arg(long, env = "GLEANER_WORKER_LISTEN", value_name = "ADDRESS")]
    pub worker_listen: Option<SocketAddr>,
    /// URL at which the nodes reach `--worker-listen`, such as `https://gleaner.lab:7402`. Default: that address itself.
    #[arg(long, env = "GLEANER_WORKER_URL", value_name = "URL")]
    pub worker_url: Option<String>,
    /// Authority that signed the certificate of --tls-cert: a PEM file on this machine, whose content is sent to the
    /// workers. Default: the authorities of the nodes.
    #[arg(long, env = "GLEANER_WORKER_CA", value_name = "FILE")]
    pub worker_ca: Option<PathBuf>,
    /// The cluster.
    #[command(flatten)]
    pub slurm: SlurmConfig,
}

/// The cluster.
#[derive(Debug, Clone, Args)]
pub struct SlurmConfig {
    /// Options of sbatch for every job, as in `#SBATCH` lines: `--partition=gpu --time=1-00:00:00`. They are passed to
    /// sbatch unread.
    #[arg(
        long,
        env = "GLEANER_SLURM_OPTIONS",
        default_value = "",
        hide_default_value = true,
        value_name = "OPTIONS",
        allow_hyphen_values = true
    )]
    pub slurm_options: String,
    /// Further options for pretrain jobs, which win over --slurm-options: `--gres=gpu:1 --mem=16G`.
    #[arg(
        long,
        env = "GLEANER_SLURM_PRETRAIN_OPTIONS",
        default_value = "",
        hide_default_value = true,
        value_name = "OPTIONS",
        allow_hyphen_values = true
    )]
    pub slurm_pretrain_options: String,
    /// Further options for score jobs, which win over --slurm-options.
    #[arg(
        long,
        env = "GLEANER_SLURM_SCORE_OPTIONS",
        default_value = "",
        hide_default_value = true,
        value_name = "OPTIONS",
        allow_hyphen_values = true
    )]
    pub slurm_score_options: String,
    /// Further options for train jobs, which win over --slurm-options.
    #[arg(
        long,
        env = "GLEANER_SLURM_TRAIN_OPTIONS",
        default_value = "",
        hide_default_value = true,
        value_name = "OPTIONS",
        allow_hyphen_values = true
    )]
    pub slurm_train_options: String,
    /// Further options for export jobs, which win over --slurm-options.
    #[arg(
        long,
        env = "GLEANER_SLURM_EXPORT_OPTIONS",
        default_value = "",
        hide_default_value = true,
        value_name = "OPTIONS",
        allow_hyphen_values = true
    )]
    pub slurm_export_options: String,
    /// Further options for evaluate jobs, which win over --slurm-options.
    #[arg(
        long,
        env = "GLEANER_SLURM_EVALUATE_OPTIONS",
        default_value = "",
        hide_default_value = true,
        value_name = "OPTIONS",
        allow_hyphen_values = true
    )]
    pub slurm_evaluate_options: String,
    /// Lines of shell that run on the node before the worker, such as `module load cuda`.
    #[arg(long, env = "GLEANER_SLURM_SETUP", default_value = "", hide_default_value = true, value_name = "SHELL")]
    pub slurm_setup: String,
    /// Path of gleaner-worker on the nodes. Default: its path on this machine, beside gleaner-server.
    #[arg(long, env = "GLEANER_SLURM_WORKER", value_name = "FILE")]
    pub slurm_worker: Option<PathBuf>,
    /// The node folder: an absolute path on each node's own disk, in which workers keep decoded steps and, with --blob-store,
    /// copies of the files that they read, at most --max-cache-bytes of both. A job reads its recordings over the network once
    /// and then from there; the disk holds them a second time. Default: those in the data folder, which all nodes share.
    #[arg(long, env = "GLEANER_SLURM_CACHE_DIR", value_name = "DIR")]
    pub slurm_cache_dir: Option<PathBuf>,
    /// Folder of sbatch, squeue and scancel on this machine. Default: those in PATH.
    #[arg(long, env = "GLEANER_SLURM_BIN", value_name = "DIR")]
    pub slurm_bin: Option<PathBuf>,
    /// Interval of squeue while attempts are open, in seconds, 1 to 300. A shorter one detects ends sooner and loads the
    /// controller more.
    #[arg(long, env = "GLEANER_SLURM_POLL_SECONDS", default_value_t = 5, value_name = "SECONDS",
          value_parser = clap::value_parser!(u64).range(1..=300))]
    pub slurm_poll_seconds: u64,
}

impl SlurmConfig {
    /// The flag of a kind's options, and its value.
    pub(crate) fn options_of(&self, kind: JobKind) -> (&'static str, &str) {
        match kind {
            JobKind::Pretrain => ("--slurm-pretrain-options", &self.slurm_pretrain_options),
            JobKind::Score => ("--slurm-score-options", &self.slurm_score_options),
            JobKind::Train => ("--slurm-train-options", &self.slurm_train_options),
            JobKind::Export => ("--slurm-export-options", &self.slurm_export_options),
            JobKind::Evaluate => ("--slurm-evaluate-options", &self.slurm_evaluate_options),
        }
    }
}

impl EngineConfig {
    /// The URL that workers on other machines call; `None` without `--worker-listen`.
    pub fn url(&self, encrypted: bool) -> Option<String> {
        let listen = self.worker_listen?;
        let scheme = if encrypted { "https" } else { "http" };
        Some(self.worker_url.clone().unwrap_or_else(|| format!("{scheme}://{listen}")))
    }

    /// Checks the address for workers.
    ///
    /// # Errors
    /// A sentence that names the flag and the fix.
    pub fn validate(&self, encrypted: bool, insecure: bool) -> Result<(), String> {
        let listen = match (self.engine, self.worker_listen) {
            (EngineKind::Local, None) => return Ok(()),
            (EngineKind::Local, Some(_)) => return Err("--worker-listen: has no use without --engine slurm".to_owned()),
            (EngineKind::Slurm, None) => {
                return Err(
                    "--engine slurm: workers on the nodes need an address to call; set --worker-listen, such as \
                            192.168.1.5:7402"
                        .to_owned(),
                );
            }
            (EngineKind::Slurm, Some(listen)) => listen,
        };
        if listen.port() == 0 {
            return Err(format!(
                "--worker-listen {listen}: needs a fixed port, so that workers find a restarted server"
            ));
        }
        if !listen.ip().is_loopback() && !encrypted && !insecure {
            return Err(format!(
                "--worker-listen {listen}: other machines can reach this address: encrypt with --tls-cert and --tls-key \
                 (`gleaner-server tls init` creates both files), or accept the risk with --insecure"
            ));
        }
        if let Some(folder) = self.slurm.slurm_cache_dir.as_ref().filter(|folder| folder.is_relative()) {
            return Err(format!(
                "--slurm-cache-dir {}: must be an absolute path, such as /scratch/gleaner",
                folder.display()
            ));
        }
        match &self.worker_url {
            None if listen.ip().is_unspecified() => Err(format!(
                "--worker-listen {listen}: nodes cannot call this address; set --worker-url to the one at which they reach \
                 this machine"
            )),
            Some(url) if encrypted && !url.starts_with("https://") => {
                Err(format!("--worker-url {url}: must begin with https://, because --tls-cert is set"))
            }
            Some(url) if !encrypted && !url.starts_with("http://") => {
                Err(format!("--worker-url {url}: must begin with http:// without --tls-cert"))
            }
            Some(_) | None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Flags {
        #[command(flatten)]
        engine: EngineConfig,
    }

    fn flags(flags: &[&str]) -> EngineConfig {
        Flags::try_parse_from([&["serve"], flags].concat()).unwrap().engine
    }

    #[test]
    fn workers_on_other_machines_need_an_encrypted_address_that_they_can_call() {
        let slurm = |more: &[&str]| flags(&[&["--engine", "slurm"], more].concat());
        for (config, encrypted, insecure, expected) in [
            (flags(&[]), false, false, None),
            (flags(&["--worker-listen", "127.0.0.1:7402"]), false, false, Some("--engine slurm")),
            (slurm(&[]), true, false, Some("--worker-listen")),
            (slurm(&["--worker-listen", "127.0.0.1:0"]), true, false, Some("fixed port")),
            (slurm(&["--worker-listen", "127.0.0.1:7402"]), false, false, None),
            (slurm(&["--worker-listen", "10.0.0.5:7402"]), false, false, Some("--tls-cert")),
            (slurm(&["--worker-listen", "10.0.0.5:7402"]), false, true, None),
            (slurm(&["--worker-listen", "10.0.0.5:7402"]), true, false, None),
            (slurm(&["--worker-listen", "0.0.0.0:7402"]), true, false, Some("--worker-url")),
            (slurm(&["--worker-listen", "0.0.0.0:7402", "--worker-url", "https://lab:7402"]), true, false, None),
            (slurm(&["--worker-listen", "10.0.0.5:7402", "--worker-url", "http://lab"]), true, false, Some("https://")),
            (slurm(&["--worker-listen", "127.0.0.1:7402", "--worker-url", "lab"]), false, false, Some("http://")),
            (slurm(&["--worker-listen", "127.0.0.1:7402", "--slurm-cache-dir", "a"]), false, false, Some("absolute")),
            (slurm(&["--worker-listen", "127.0.0.1:7402", "--slurm-cache-dir", "/a"]), false, false, None),
        ] {
            let problem = config.validate(encrypted, insecure).err();
            assert_eq!(problem.is_some(), expected.is_some(), "{config:?}: {problem:?}");
            if let (Some(problem), Some(expected)) = (problem, expected) {
                assert!(problem.contains(expected), "{problem}");
            }
        }
        assert_eq!(slurm(&["--worker-listen", "10.0.0.5:7402"]).url(true).as_deref(), Some("https://10.0.0.5:7402"));
    }

    #[test]
    fn options_of_sbatch_are_taken_as_text_for_each_kind() {
        let config =
            flags(&["--slurm-options", "--partition=gpu -t 10", "--slurm-train-options", "--gres=gpu:1"]).slurm;
        assert_eq!(config.slurm_options, "--partition=gpu -t 10");
        assert_eq!(config.options_of(JobKind::Train), ("--slurm-train-options", "--gres=gpu:1"));
        assert!(JobKind::ALL.iter().all(|&kind| kind == JobKind::Train || config.options_of(kind).1.is_empty()));
    }
}
