//! The place where a job's newest attempt runs or ran.

/// The place of an attempt, for people; empty parts are unknown.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Placement {
    /// The engine: `local` or `slurm`.
    pub engine: String,
    /// The engine's own id: of a process, or of a Slurm job.
    pub engine_id: String,
    /// The machine; empty for the server's own.
    pub node: String,
    /// The reason for which the engine has not started the worker yet.
    pub waiting: String,
}

impl Placement {
    /// The engine whose workers are children of the server, and end with it.
    pub const LOCAL: &'static str = "local";

    /// Whether the workers of its engine end with their server.
    #[must_use]
    pub fn is_of_children(&self) -> bool {
        self.engine == Self::LOCAL
    }
}
