//! Options that one job passes to its engine: one line, in the words of sbatch. An option that the server itself sets, or
//! that would move the job out of the server's sight, is refused. Must not depend on engines.

use crate::error::{Error, Result};

/// Longest line, in bytes.
const LONGEST: usize = 1000;

/// Options that the server sets or needs, and those that read files, change the user or end sbatch.
const OWNED: [&str; 38] = [
    "array",
    "batch",
    "bb",
    "bbf",
    "chdir",
    "clusters",
    "comment",
    "container",
    "container-id",
    "error",
    "export",
    "export-file",
    "get-user-env",
    "gid",
    "help",
    "input",
    "job-name",
    "kill-on-bad-exit",
    "nodefile",
    "nodes",
    "no-requeue",
    "ntasks",
    "ntasks-per-core",
    "ntasks-per-gpu",
    "ntasks-per-node",
    "ntasks-per-socket",
    "open-mode",
    "output",
    "parsable",
    "quiet",
    "requeue",
    "spread-job",
    "test-only",
    "uid",
    "usage",
    "version",
    "wait",
    "wrap",
];

/// The short forms of the same.
const OWNED_SHORT: &str = "aeiJhnoDFMNQVW";
/// Short options without a value, which sbatch accepts in one word with others.
const SHORT_FLAGS: &str = "HkOsvI";

/// The options in `text`, which may be empty.
///
/// # Errors
/// Invalid names the field, the word and the remedy.
pub fn engine_options(field: &str, text: &str) -> Result<String> {
    let text = text.trim();
    if text.len() > LONGEST {
        return Err(Error::invalid(field, format!("must be at most {LONGEST} bytes")));
    }
    if !text.chars().all(|char| char == ' ' || char.is_ascii_graphic()) || text.contains(['"', '\'', '\\', '#']) {
        let rule = "must be one line of printable ASCII characters without quotes, backslashes and #";
        return Err(Error::invalid(field, rule));
    }
    let mut words = text.split(' ').filter(|word| !word.is_empty());
    match words.clone().next() {
        Some(first) if !first.starts_with('-') => {
            return Err(Error::invalid(
                field,
                format!("must begin with an option such as --partition=gpu, not {first}"),
            ));
        }
        Some(_) | None => {}
    }
    match words.find_map(|word| refusal(word).map(|reason| (word, reason))) {
        Some((word, reason)) => Err(Error::invalid(field, format!("{word}: {reason}; leave it out"))),
        None => Ok(text.to_owned()),
    }
}

/// Why a word cannot be passed on.
fn refusal(word: &str) -> Option<&'static str> {
    const SERVER: &str = "is set by the server or would hide the job from it";
    if let Some(long) = word.strip_prefix("--") {
        let name = long.split('=').next().unwrap_or_default();
        // sbatch completes a unique beginning of a name.
        let owned = OWNED.iter().any(|owned| owned.starts_with(name));
        return owned.then_some(SERVER);
    }
    let short = word.strip_prefix('-')?;
    let first = short.chars().next()?;
    if OWNED_SHORT.contains(first) {
        return Some(SERVER);
    }
    (SHORT_FLAGS.contains(first) && short.len() > 1).then_some("joins short options; write each as a word of its own")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(text: &str) -> String {
        engine_options("engine_options", text).unwrap_err().to_string()
    }

    #[test]
    fn options_of_resources_are_kept_as_they_are() {
        for text in [
            "",
            "--partition=gpu --gres=gpu:1",
            "-p gpu -t 1-00:00:00 --mem=16G -c4 -H",
            "--constraint=[rack1|rack2] --nodelist=node[1-3],node7 --no-kill",
            "--signal=B:TERM@60 --nice=100 --exclude node4 --time-min=5 --network=x",
        ] {
            assert_eq!(engine_options("engine_options", &format!("  {text} ")).unwrap(), text);
        }
    }

    #[test]
    fn options_of_the_server_are_refused_in_every_spelling() {
        for text in [
            "--job-name=x",
            "--partition=gpu --job=x",
            "-J x",
            "-Jx",
            "--output=/etc/x",
            "--ou=/etc/x",
            "-o/etc/x",
            "--export=NONE",
            "--requeue",
            "--no-requeue",
            "--nodes=2",
            "-N2",
            "--ntasks-per-node=2",
            "--array=0-9",
            "--wrap=ls",
            "--uid=0",
            "--",
            "--=x",
            "--container=/x",
            "--nodefile=/etc/shadow",
            "--nodef=/etc/shadow",
            "-F/etc/shadow",
        ] {
            assert!(refused(text).contains("is set by the server"), "{text}");
        }
        assert!(refused("-HJx").contains("joins short options"));
    }

    #[test]
    fn text_that_sbatch_reads_in_another_way_is_refused() {
        for text in ["-p a\n#SBATCH -J x", "-p a\0", "-p 'a b'", "-p \"a\"", "-p a\\ b", "-p a # -t 1", "-p ä", "-p\ta"]
        {
            assert!(refused(text).contains("one line of printable ASCII"), "{text:?}");
        }
        assert!(refused("gpu").contains("must begin with an option"));
        assert!(refused(&format!("-p {}", "x".repeat(1000))).contains("at most 1000 bytes"));
    }
}
