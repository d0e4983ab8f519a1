//! What sbatch receives for an attempt: its arguments, the script, and the variables of the worker. The token of the
//! attempt is in the variables alone, so that no list of processes and no listing of jobs has it.

use std::{
    ffi::OsString,
    os::unix::ffi::OsStringExt as _,
    path::{Path, PathBuf},
    sync::Arc,
};

use super::super::Launch;
use crate::{config::ServeConfig, domain::attempt::Attempt};

/// Characters of an attempt's hash in the name of its Slurm job.
const HASH: usize = 16;

/// The parts that all attempts share.
pub(super) struct Template {
    pub(super) config: Arc<ServeConfig>,
    /// The data folder, absolute.
    pub(super) data_dir: PathBuf,
    /// The program on the nodes.
    pub(super) worker: PathBuf,
    /// The address that workers call.
    pub(super) url: String,
    /// The authority that signed the server's certificate, in PEM form.
    pub(super) authority: Option<String>,
}

/// One submission.
pub(super) struct Submission {
    pub(super) arguments: Vec<OsString>,
    pub(super) variables: Vec<(&'static str, String)>,
    pub(super) script: String,
    /// Where the options come from: flags, and the job.
    pub(super) sources: String,
}

/// The name of an attempt's Slurm job, by which a lost one is found.
pub(super) fn name(attempt: &Attempt) -> String {
    format!("gleaner-{}-{}", attempt.job_id, attempt.token_hash.get(..HASH).unwrap_or(&attempt.token_hash))
}

impl Template {
    /// The file for the output of an attempt's worker.
    pub(super) fn output(&self, name: &str) -> PathBuf {
        gleaner_data_folder::logs(&self.data_dir).join(format!("{name}.out"))
    }

    pub(super) fn submission(&self, launch: &Launch<'_>) -> Submission {
        let (job, name) = (launch.job, name(launch.attempt));
        let slurm = &self.config.jobs.engine.slurm;
        let kind = job.spec.kind();
        let arguments = [
            // The server owns retries.
            "--no-requeue".into(),
            // Of the caller's environment, which is what this server chose.
            "--export=ALL".into(),
            format!("--job-name={name}").into(),
            format!("--comment=gleaner {} {}, attempt {}", kind.as_str(), job.id, job.attempt).into(),
            "--open-mode=append".into(),
            flag("--output=", &escaped(&self.output(&name))),
            flag("--chdir=", &self.data_dir),
        ];
        let (flag_of_kind, of_kind) = slurm.options_of(kind);
        let options = [slurm.slurm_options.as_str(), of_kind, job.engine_options.as_str()];
        let options = options.into_iter().flat_map(str::lines).map(str::trim).filter(|line| !line.is_empty());
        let mut script = "#!/bin/sh\n".to_owned();
        options.for_each(|line| script.extend(["#SBATCH ", line, "\n"]));
        let ranks = self.config.jobs.ranks.of(&job.spec);
        if ranks > 1 {
            script.extend([&format!("#SBATCH --nodes={ranks} --ntasks-per-node=1"), "\n"]);
        }
        script.extend([slurm.slurm_setup.as_str(), "\n", "exec", &self.command(ranks), "\n"]);
        let mut variables =
            vec![("GLEANER_JOB_TOKEN", launch.token.reveal().to_owned()), ("OMP_WAIT_POLICY", "PASSIVE".to_owned())];
        variables.extend(self.authority.clone().map(|pem| ("GLEANER_WORKER_CA", pem)));
        let own = if job.engine_options.is_empty() { "" } else { ", and the job's own options" };
        let sources = format!("--slurm-options and {flag_of_kind}{own}");
        Submission { arguments: arguments.into(), variables, script, sources }
    }

    /// The command of the worker, each word quoted; with several ranks, by srun on each node, which ends them all when one
    /// fails.
    fn command(&self, ranks: u32) -> String {
        let config = &self.config;
        let mut words = vec![self.worker.to_string_lossy().into_owned(), "--server".to_owned(), self.url.clone()];
        words.extend(["--data-dir".to_owned(), self.data_dir.to_string_lossy().into_owned()]);
        let mut option = |name: &str, value: String| words.extend([format!("--{name}"), value]);
        option("threads", config.jobs.worker_threads.to_string());
        option("max-message-bytes", config.limits.max_message_bytes.to_string());
        option("min-free-bytes", config.maintenance.min_free_bytes.to_string());
        if let Some(most) = config.maintenance.max_cache_bytes {
            option("max-cache-bytes", most.to_string());
        }
        if let Some(folder) = &config.jobs.engine.slurm.slurm_cache_dir {
            option("cache-dir", folder.to_string_lossy().into_owned());
        }
        if ranks > 1 {
            option("ranks", ranks.to_string());
            option("rank-timeout-seconds", config.jobs.ranks.rank_timeout_seconds.to_string());
        }
        // The shell of the batch script knows the names of the job's nodes.
        let words: String = words.iter().map(|word| format!(" '{}'", word.replace('\'', r"'\''"))).collect();
        let worker = format!("{words} --node \"$SLURM_JOB_NODELIST\"");
        if ranks < 2 {
            return worker;
        }
        format!(" srun --kill-on-bad-exit=1 --nodes={ranks} --ntasks={ranks} --ntasks-per-node=1{worker}")
    }
}

/// A path in which sbatch replaces nothing.
fn escaped(path: &Path) -> PathBuf {
    path.to_string_lossy().replace('\\', r"\\").replace('%', "%%").into()
}

fn flag(name: &str, value: &Path) -> OsString {
    let mut flag = OsString::from(name).into_vec();
    flag.extend(value.as_os_str().to_owned().into_vec());
    OsString::from_vec(flag)
}
