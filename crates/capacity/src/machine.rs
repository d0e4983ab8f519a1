//! The machine of the server.

use serde::Serialize;

/// What the server has.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Machine {
    /// Processors.
    pub processors: u32,
    /// Memory in GiB.
    pub memory_gib: f64,
    /// Disk in TB.
    pub disk_tb: f64,
    /// Network towards the robots in Mbit/s.
    pub network_mbit: f64,
}
