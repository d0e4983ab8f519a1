//! Attempts of policies outside of the server: a command drives a deployment in a simulator of its own, or on a robot.
//!
//! Must not depend on a server.

use std::path::Path;
use std::process::Stdio;

use gleaner_client::ClientError;
use gleaner_proto::v1::SeedResult;
use serde::{Deserialize, Serialize};
use tokio::io::{AsyncBufReadExt as _, BufReader};
use tokio::process::Command;

use crate::connection::Reach;
use crate::failure::{Failure, Result, present};

/// What a word of the command may name.
const SERVER: &str = "{server}";
const DEPLOYMENT: &str = "{deployment}";
const SEED: &str = "{seed}";
const EPISODES: &str = "{episodes}";
/// The file of the commands' standard error.
pub(super) const LOG: &str = "attempts.log";

/// The table `[attempts]` of an experiment's file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Attempts {
    /// The name of the simulation in the server's evaluations.
    pub(super) simulation: String,
    /// A program and its arguments. Each line of its output that is a JSON object is an attempt:
    /// `{"success": true, "steps": 41}`; lines of other text have no effect, and its standard error goes to a log.
    command: Vec<String>,
}

/// An attempt, as the command prints it.
#[derive(Debug, Deserialize)]
struct Attempt {
    success: bool,
    steps: u32,
}

/// What one run of the command tries.
#[derive(Clone, Copy, Debug)]
pub(super) struct Trial<'a> {
    pub(super) attempts: &'a Attempts,
    pub(super) policy_id: &'a str,
    pub(super) hide_history: bool,
    pub(super) seed: u64,
    pub(super) episodes: u32,
}

impl Attempts {
    /// # Errors
    /// The setting, and what is wrong with it.
    pub(super) fn check(&self) -> std::result::Result<(), String> {
        if self.simulation.is_empty() {
            return Err("simulation: give the simulation a name, such as metaworld/push-v3".into());
        }
        for word in [SERVER, DEPLOYMENT, SEED, EPISODES] {
            if !self.command.iter().any(|argument| argument.contains(word)) {
                return Err(format!("command: has no argument {word}, which is replaced for each run"));
            }
        }
        Ok(())
    }

    /// The words of the command for one run.
    fn words(&self, server: &str, deployment: &str, trial: Trial<'_>) -> Vec<String> {
        let (seed, episodes) = (trial.seed.to_string(), trial.episodes.to_string());
        let named = [(SERVER, server), (DEPLOYMENT, deployment), (SEED, &seed), (EPISODES, &episodes)];
        let filled = |word: &String| named.iter().fold(word.clone(), |word, (name, value)| word.replace(name, value));
        self.command.iter().map(filled).collect()
    }
}

/// Runs the command to its end on a deployment of a server, and counts its attempts. Its standard error goes to a log.
pub(super) async fn run(server: &Reach, deployment: &str, log: &Path, trial: Trial<'_>) -> Result<SeedResult> {
    let words = trial.attempts.words(&server.url, deployment, trial);
    let failure = |problem: String| {
        let program = words.first().map_or("", String::as_str);
        Failure::message(format!("attempts.command: {program} {problem}; its standard error is in {}", log.display()))
    };
    let file = std::fs::OpenOptions::new().create(true).append(true).open(log).map_err(ClientError::io(log))?;
    let mut command = Command::new(words.first().map_or("", String::as_str));
    command.args(words.get(1..).unwrap_or_default()).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(file);
    server.apply(&mut command);
    let mut child = command.kill_on_drop(true).spawn().map_err(|error| failure(format!("did not start: {error}")))?;
    let output = present(child.stdout.take(), "the output of a command")?;
    let mut lines = BufReader::new(output).lines();
    let (mut episodes, mut successes, mut steps) = (0_u32, 0_u32, 0.0_f64);
    while let Some(line) = lines.next_line().await? {
        if !line.starts_with('{') {
            continue;
        }
        let attempt: Attempt =
            serde_json::from_str(&line).map_err(|error| failure(format!("printed {line:?}: {error}")))?;
        episodes += 1;
        successes += u32::from(attempt.success);
        steps += f64::from(attempt.steps);
    }
    let status = child.wait().await?;
    if !status.success() {
        return Err(failure(format!("ended with {status}")));
    }
    if episodes != trial.episodes {
        return Err(failure(format!("printed {episodes} attempts, not {}", trial.episodes)));
    }
    Ok(SeedResult { seed: trial.seed, episodes, successes, mean_steps: steps / f64::from(episodes.max(1)) })
}

#[cfg(test)]
mod tests;
