//! The machine of the server, and what it has beside it.

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
    /// Nodes of a cluster with as many processors each, among which score runs are divided; 0: they run on the server.
    pub nodes: u32,
    /// Whether recordings are in a bucket, so that the disk holds the cache and the database. Copies of recordings in use
    /// are not counted.
    pub bucket: bool,
}

impl Machine {
    /// Processors that score: those of the nodes, which are taken to share a run without loss, or of the server where there
    /// is no node.
    pub(crate) fn scoring_processors(&self) -> f64 {
        f64::from(self.processors) * f64::from(self.nodes.max(1))
    }
}
