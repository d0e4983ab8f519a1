//! The command line.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Parser, ValueEnum};
use gleaner_core::Preset;
use serde::Serialize;

/// Loads a server from this process and measures the cost of serving.
#[derive(Debug, Parser)]
pub struct Options {
    /// The gleaner-server to measure.
    #[arg(long, default_value = "target/release/gleaner-server")]
    pub server_bin: PathBuf,
    /// The parts to measure.
    #[arg(long, value_delimiter = ',', default_value = "load,training,limits")]
    pub parts: Vec<Part>,
    /// Size of the policy.
    #[arg(long, value_enum, default_value_t = Size::Tiny)]
    pub preset: Size,
    /// Kind of the policy.
    #[arg(long, value_enum, default_value_t = Kind::Finetune)]
    pub policy: Kind,
    /// Sessions at a time. Targets need 1 and 16.
    #[arg(long, value_delimiter = ',', default_value = "1,4,16,64")]
    pub sessions: Vec<usize>,
    /// Rounds of measurements; compared programs alternate.
    #[arg(long, default_value_t = 5)]
    pub rounds: u32,
    /// Seconds of one measurement, after a warm-up of a quarter of it.
    #[arg(long, default_value_t = 2.0)]
    seconds: f64,
    /// Number of idle sessions.
    #[arg(long, default_value_t = 1000)]
    pub idle_sessions: u32,
    /// Threads of the concurrent training job.
    #[arg(long, default_value_t = 2)]
    pub worker_threads: u32,
    /// Python interpreter with the packages of benches/peers/requirements.lock, for the peers.
    #[arg(long, default_value = "python3")]
    pub python: PathBuf,
    /// Folder of the programs of the peers.
    #[arg(long, default_value = "benches/peers")]
    pub peers: PathBuf,
    /// Folder of the Python code that is generated from the .proto files of the server.
    #[arg(long, default_value = "target/peers")]
    pub peers_generated: PathBuf,
    /// Write the results to this file as JSON.
    #[arg(long)]
    pub out: Option<PathBuf>,
}

/// A part of the bench.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Part {
    /// Sessions in a closed loop, JPEG and raw, and the model alone.
    Load,
    /// One session while a training job runs.
    Training,
    /// Idle sessions, and a client that does not read.
    Limits,
    /// The same network on other servers.
    Peers,
}

/// Sizes of the model.
#[derive(Debug, Clone, Copy, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Size {
    Tiny,
    Small,
    Base,
}

/// Kinds of policies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// A finetuned encoder with a history.
    Finetune,
    /// Flow matching: chunks of actions, half of each executed before the next.
    Flow,
    /// Diffusion Policy, executed alike.
    Diffusion,
}

impl Kind {
    /// Its name in settings.
    pub fn name(self) -> &'static str {
        match self {
            Self::Finetune => "finetune",
            Self::Flow => "flow",
            Self::Diffusion => "diffusion",
        }
    }
}

impl Options {
    pub fn has(&self, part: Part) -> bool {
        self.parts.contains(&part)
    }

    /// The duration of one measurement after its warm-up.
    pub fn slice(&self) -> Duration {
        Duration::try_from_secs_f64(self.seconds).unwrap_or(Duration::from_secs(1))
    }
}

impl From<Size> for Preset {
    fn from(size: Size) -> Self {
        match size {
            Size::Tiny => Self::Tiny,
            Size::Small => Self::Small,
            Size::Base => Self::Base,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory as _;

    #[test]
    fn command_line_is_valid() {
        Options::command().debug_assert();
    }
}
