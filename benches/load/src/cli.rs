//! The command line.

use std::path::PathBuf;
use std::time::Duration;

use clap::Parser;
use serde::Serialize;

/// Loads a server with well-behaved and hostile clients and checks the targets.
#[derive(Debug, Clone, Parser, Serialize)]
pub struct Options {
    /// The gleaner-server to load.
    #[arg(long, default_value = "target/release/gleaner-server")]
    pub server_bin: PathBuf,
    /// Duration of the load in seconds. Hostile clients run for a quarter of it in addition, held connections for a tenth,
    /// but at least for ten seconds.
    #[arg(long, default_value_t = 600)]
    pub seconds: u64,
    /// Clients that upload.
    #[arg(long, default_value_t = 40)]
    pub uploaders: u32,
    /// Clients that query.
    #[arg(long, default_value_t = 140)]
    pub queriers: u32,
    /// Robots with a session.
    #[arg(long, default_value_t = 20)]
    pub robots: u32,
    /// Seconds between two uploads of a client.
    #[arg(long, default_value_t = 20.0)]
    pub upload_every: f64,
    /// Seconds between two queries of a client.
    #[arg(long, default_value_t = 0.5)]
    pub query_every: f64,
    /// Seconds between two observations of a robot.
    #[arg(long, default_value_t = 0.2)]
    pub observe_every: f64,
    /// Silent connections, and as many that send half a greeting.
    #[arg(long, default_value_t = 1000)]
    pub silent: u32,
    /// Uploads below the minimum rate.
    #[arg(long, default_value_t = 200)]
    pub slow_uploads: u32,
    /// Further flags of the server.
    #[arg(long = "server-flag", value_name = "FLAG", allow_hyphen_values = true)]
    pub server_flags: Vec<String>,
    /// Write the results to this file as JSON.
    #[arg(long)]
    pub out: Option<PathBuf>,
}

impl Options {
    /// The duration of the load.
    pub(crate) fn duration(&self) -> Duration {
        Duration::from_secs(self.seconds)
    }

    /// The duration of each phase with, and of each phase without, a hostile client.
    pub(crate) fn phase(&self) -> Duration {
        self.duration() / 16
    }

    /// The duration of the phases with one robot, alone and beside held connections.
    pub(crate) fn alone(&self) -> Duration {
        (self.duration() / 10).max(Duration::from_secs(10).min(self.duration()))
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
