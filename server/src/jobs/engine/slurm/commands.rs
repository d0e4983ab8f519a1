//! Slurm's commands: sbatch, squeue and scancel, each with a limit on its time, and the meaning of their output. Must not
//! depend on attempts.

use std::{ffi::OsString, io::ErrorKind, path::PathBuf, process::Stdio, time::Duration};

use tokio::{io::AsyncWriteExt as _, process::Command};

/// Longest time of one command. Slurm's own commands retry for about 10 s while the controller does not answer.
const LIMIT: Duration = Duration::from_secs(60);
/// Longest part of a command's errors in a message, in characters.
const LONGEST: usize = 400;

/// What to check where a command does not act as Slurm's do.
const PROGRAM: &str = "check --slurm-bin, the folder of Slurm's commands";
/// What to check where they get no answer.
const CONTROLLER: &str = "check that slurmctld runs and that munged does, and that SLURM_CONF, or this machine's own configuration, names it";
/// What to check where Slurm refuses to cancel a job.
const OWNER: &str =
    "check that gleaner-server runs as the user of that job, and that --slurm-bin and SLURM_CONF are of its cluster";
/// Parts of the words of Slurm's commands for a controller that does not answer, in small letters.
const AWAY: [&str; 8] = [
    "slurm controller",
    "socket timed out",
    "connection refused",
    "communication connection failure",
    "configuration source",
    "zero bytes were transmitted",
    "munge",
    "authentication",
];

/// Why a command has no result, in words that name the setting, but for that of a refusal.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Problem {
    /// Slurm refused it, in its own words.
    Refused(String),
    /// The command or the controller gave no answer, or not one of Slurm's.
    NoAnswer(String),
}

impl std::fmt::Display for Problem {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Refused(words) | Self::NoAnswer(words) => f.write_str(words),
        }
    }
}

/// A Slurm job, as squeue lists it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Entry {
    pub(super) name: String,
    pub(super) id: String,
    /// Slurm's word, such as RUNNING.
    pub(super) state: String,
    pub(super) node: String,
    /// Slurm's reason for the state, or empty.
    pub(super) reason: String,
}

/// An answer of squeue.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Listing {
    pub(super) entries: Vec<Entry>,
    /// The lines that are not jobs. Each may stand for one job, of which the answer then reports nothing.
    pub(super) malformed: Vec<String>,
}

/// The commands of one cluster.
#[derive(Debug, Clone)]
pub(super) struct Commands {
    /// Their folder; `None`: those in PATH.
    folder: Option<PathBuf>,
    environment: Vec<(&'static str, OsString)>,
    limit: Duration,
}

impl Commands {
    pub(super) fn new(folder: Option<PathBuf>, environment: Vec<(&'static str, OsString)>) -> Self {
        Self { folder, environment, limit: LIMIT }
    }

    /// The same commands with another limit on their time.
    #[cfg(test)]
    pub(super) fn within(self, limit: Duration) -> Self {
        Self { limit, ..self }
    }

    /// Submits a script, with these arguments and variables; returns the id of the job.
    ///
    /// # Errors
    /// The job may exist nevertheless, unless Slurm refused it.
    pub(super) async fn submit(
        &self,
        arguments: &[OsString],
        variables: &[(&'static str, String)],
        script: &str,
    ) -> Result<String, Problem> {
        let mut command = self.command("sbatch");
        command.arg("--parsable").args(arguments).envs(variables.iter().cloned());
        let answer = self.run("sbatch", command, Some(script)).await?;
        // With several clusters the name of one follows.
        let id = answer.trim().split(';').next().unwrap_or_default();
        if id.is_empty() || !id.bytes().all(|byte| byte.is_ascii_digit()) {
            let answer = shortened(&answer);
            return Err(Problem::NoAnswer(format!("sbatch printed {answer:?} instead of the id of a job; {PROGRAM}")));
        }
        Ok(id.to_owned())
    }

    /// Every job of this user, running, waiting or ended a short time ago.
    ///
    /// # Errors
    /// A failure is no statement about any job. An answer with lines of which none is a job is a failure.
    pub(super) async fn list(&self) -> Result<Listing, Problem> {
        let mut command = self.command("squeue");
        let user = rustix::process::getuid().as_raw();
        command.args(["--noheader", "--states=all", "--format=%j|%i|%T|%N|%r"]).arg(format!("--user={user}"));
        let answer = self.run("squeue", command, None).await.map_err(|problem| match problem {
            // It asks for nothing that depends on a setting of a job.
            Problem::Refused(words) => Problem::NoAnswer(format!("{words}; {CONTROLLER}")),
            Problem::NoAnswer(words) => Problem::NoAnswer(words),
        })?;
        listing(&answer)
    }

    /// Cancels a job.
    ///
    /// # Errors
    /// The job may run on.
    pub(super) async fn cancel(&self, id: &str) -> Result<(), Problem> {
        let mut command = self.command("scancel");
        command.args(["--quiet", id]);
        let answer = self.run("scancel", command, None).await.map_err(|problem| match problem {
            Problem::Refused(words) => Problem::NoAnswer(format!("{words}; {OWNER}")),
            Problem::NoAnswer(words) => Problem::NoAnswer(words),
        })?;
        if answer.trim().is_empty() {
            return Ok(());
        }
        let answer = shortened(&answer);
        Err(Problem::NoAnswer(format!("scancel printed {answer:?}, and Slurm's own prints no text; {PROGRAM}")))
    }

    fn command(&self, name: &str) -> Command {
        let mut command = match &self.folder {
            Some(folder) => Command::new(folder.join(name)),
            None => Command::new(name),
        };
        command.env_clear().envs(self.environment.iter().cloned());
        command
    }

    async fn run(&self, name: &str, mut command: Command, input: Option<&str>) -> Result<String, Problem> {
        command.stdout(Stdio::piped()).stderr(Stdio::piped()).kill_on_drop(true);
        command.stdin(if input.is_some() { Stdio::piped() } else { Stdio::null() });
        let work = async {
            let mut child = command.spawn().map_err(|error| {
                if error.kind() == ErrorKind::NotFound {
                    format!(
                        "{name} is not installed here: install the commands of Slurm, or set --slurm-bin to their folder"
                    )
                } else {
                    format!("{name} cannot be started: {error}; {PROGRAM}")
                }
            })?;
            if let (Some(input), Some(mut pipe)) = (input, child.stdin.take()) {
                // A command that ends early has its own reason, which follows.
                let _ = pipe.write_all(input.as_bytes()).await;
            }
            child.wait_with_output().await.map_err(|error| format!("{name} was lost: {error}"))
        };
        let output = match tokio::time::timeout(self.limit, work).await {
            Ok(output) => output.map_err(Problem::NoAnswer)?,
            Err(_) => {
                let seconds = self.limit.as_secs();
                let words =
                    format!("{name} did not end within {seconds} s and was stopped; {CONTROLLER}, or {PROGRAM}");
                return Err(Problem::NoAnswer(words));
            }
        };
        if output.status.success() {
            return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
        }
        let errors = String::from_utf8_lossy(&output.stderr);
        let errors: Vec<&str> = errors.lines().map(|line| strip(name, line)).filter(|line| !line.is_empty()).collect();
        if errors.is_empty() {
            return Err(Problem::NoAnswer(format!("{name}: {}; {PROGRAM}", output.status)));
        }
        let errors = errors.join("; ");
        let words = format!("{name}: {}", shortened(&errors));
        let small = errors.to_lowercase();
        if AWAY.iter().any(|part| small.contains(part)) {
            return Err(Problem::NoAnswer(format!("{words}; {CONTROLLER}")));
        }
        Err(Problem::Refused(words))
    }
}

/// A line of errors without the name of its command.
fn strip<'a>(name: &str, line: &'a str) -> &'a str {
    let line = line.trim();
    let line = line.strip_prefix(name).and_then(|line| line.strip_prefix(':')).unwrap_or(line).trim();
    line.strip_prefix("error:").unwrap_or(line).trim()
}

fn shortened(text: &str) -> String {
    let text = text.trim();
    match text.char_indices().nth(LONGEST) {
        Some((at, _)) => format!("{}…", &text[..at]),
        None => text.to_owned(),
    }
}

/// The jobs of an answer of squeue. Lines that are not jobs stay lines, beside at least one that is.
fn listing(answer: &str) -> Result<Listing, Problem> {
    let mut listing = Listing::default();
    for line in answer.lines().filter(|line| !line.trim().is_empty()) {
        match entry(line) {
            Some(entry) => listing.entries.push(entry),
            None => listing.malformed.push(line.to_owned()),
        }
    }
    match listing.malformed.first() {
        Some(line) if listing.entries.is_empty() => Err(Problem::NoAnswer(not_a_job(line))),
        Some(_) | None => Ok(listing),
    }
}

/// The problem of a malformed line, for people.
pub(super) fn not_a_job(line: &str) -> String {
    format!("squeue printed {:?} instead of a job and its state; {PROGRAM}", shortened(line))
}

/// The job of a line of squeue; `None`: the line has other fields.
fn entry(line: &str) -> Option<Entry> {
    // From the right: other jobs of this user may have a bar in their names.
    let fields: Vec<&str> = line.rsplitn(5, '|').map(str::trim).collect();
    let [reason, node, state, id, name] = fields[..] else { return None };
    let word = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_uppercase() || byte == b'_');
    if !word(state) {
        return None;
    }
    let reason = if reason == "None" { "" } else { reason };
    Some(Entry {
        name: name.to_owned(),
        id: id.to_owned(),
        state: state.to_owned(),
        node: node.to_owned(),
        reason: reason.to_owned(),
    })
}
