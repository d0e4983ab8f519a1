//! How jobs are submitted: the options that submissions share, and the keys by which a call is one job.

use clap::Args;
use gleaner_client::ClientError;
use gleaner_core::id::unique;

use crate::context::Context;
use crate::failure::Result;

/// Options of every submission.
#[derive(Args, Debug)]
pub(crate) struct SubmitArgs {
    /// Wait for the end of the job and show its progress.
    #[arg(long)]
    pub(crate) wait: bool,
    /// Priority in the queue; jobs of higher priority run first.
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    pub(crate) priority: i32,
}

/// Options of a submission of one job.
#[derive(Args, Debug)]
pub(crate) struct JobArgs {
    /// Key that prevents duplicate jobs, chosen by the caller. An unfailed job with the same key is returned instead of
    /// a new one. Default: a key of this call, for its retries over a broken connection.
    #[arg(long, default_value_t = own_key(), hide_default_value = true)]
    pub(crate) key: String,
    #[command(flatten)]
    pub(crate) engine: EngineArgs,
}

/// The key of a call that names none.
pub(crate) fn own_key() -> String {
    format!("command/{}", unique())
}

/// What a submission returned. Once its retries are exhausted, a note names the key by which the same command finds what the
/// server may have queued.
pub(crate) fn queued<T>(context: &Context, key: &str, submitted: gleaner_client::Result<T>) -> Result<T> {
    if submitted.as_ref().is_err_and(ClientError::is_transient) {
        context.output.note(format_args!(
            "the server may have queued it; the same command with --key \"{key}\" returns that instead of queueing a second"
        ));
    }
    Ok(submitted?)
}

/// Options of the engine that runs the submitted jobs.
#[derive(Args, Debug)]
pub(crate) struct EngineArgs {
    /// Options of sbatch for what is submitted here, which win over the server's:
    /// `--engine-options="--partition=gpu --gres=gpu:1"`. Needs the role admin and a server with `--engine slurm`.
    #[arg(
        long = "engine-options",
        default_value = "",
        hide_default_value = true,
        value_name = "OPTIONS",
        allow_hyphen_values = true
    )]
    pub(crate) options: String,
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;

    #[derive(clap::Parser)]
    struct Line {
        #[command(flatten)]
        job: JobArgs,
    }

    #[test]
    fn a_call_has_a_key_of_its_own_unless_one_is_given() {
        let key = |words: &[&str]| Line::try_parse_from(["gleaner"].iter().chain(words)).unwrap().job.key;
        assert!(key(&[]).len() > "command/".len(), "{}", key(&[]));
        assert_ne!(own_key(), own_key(), "another call has another key");
        assert_eq!(key(&["--key", "mine"]), "mine");
    }
}
