//! The command line.

use std::path::PathBuf;
use std::time::Duration;

use clap::Parser;
use serde::Serialize;

/// Loads a server with many clients, good and hostile, and says whether it holds.
#[derive(Debug, Clone, Parser, Serialize)]
pub struct Options {
    /// The gleaner-server to load.
    #[arg(long, default_value = "target/release/gleaner-server")]
    pub server_bin: PathBuf,
    /// Seconds for which all clients are at work. What hostile clients do is measured for a quarter of it, what holders
    /// of connections do for a tenth, but for ten seconds at least.
    #[arg(long, default_value_t = 600)]
    pub seconds: u64,
    /// Clients that upload.
    #[arg(long, default_value_t = 40)]
    pub uploaders: u32,
    /// Clients that ask.
    #[arg(long, default_value_t = 140)]
    pub askers: u32,
    /// Robots with a session.
    #[arg(long, default_value_t = 20)]
    pub robots: u32,
    /// Seconds from one upload of a client to its next.
    #[arg(long, default_value_t = 20.0)]
    pub upload_every: f64,
    /// Seconds from one question of a client to its next.
    #[arg(long, default_value_t = 0.5)]
    pub ask_every: f64,
    /// Seconds from one observation of a robot to its next.
    #[arg(long, default_value_t = 0.2)]
    pub observe_every: f64,
    /// Connections that say nothing, and as many that greet by half.
    #[arg(long, default_value_t = 1000)]
    pub silent: u32,
    /// Uploads that drip.
    #[arg(long, default_value_t = 200)]
    pub dripping: u32,
    /// Further flags of the server.
    #[arg(long = "server-flag", value_name = "FLAG", allow_hyphen_values = true)]
    pub server_flags: Vec<String>,
    /// Where to write everything as JSON.
    #[arg(long)]
    pub out: Option<PathBuf>,
}

impl Options {
    /// How long all clients are at work.
    pub(crate) fn crowded(&self) -> Duration {
        Duration::from_secs(self.seconds)
    }

    /// How long each of the times with a hostile client, and those without between them, lasts.
    pub(crate) fn turn(&self) -> Duration {
        self.crowded() / 16
    }

    /// How long one robot alone is looked at, and beside holders of connections.
    pub(crate) fn alone(&self) -> Duration {
        (self.crowded() / 10).max(Duration::from_secs(10).min(self.crowded()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory as _;

    #[test]
    fn the_definition_is_sound() {
        Options::command().debug_assert();
    }
}
