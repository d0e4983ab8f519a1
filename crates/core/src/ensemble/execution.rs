//! How the chunks of a policy become actions: by their mean, or one after the other. Plain data.

/// The execution of a policy's chunks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Execution {
    /// A chunk is predicted at every step, and an action is the mean of all predictions for its time.
    #[default]
    Ensembled,
    /// This many actions of a chunk are executed before the next chunk is predicted (receding horizon), and the newest
    /// chunk alone counts: the mean of two samples may be an action that the policy never draws.
    Horizon(u32),
}

impl Execution {
    /// The number of actions executed of each chunk; 0 for ensembling.
    #[must_use]
    pub fn horizon(self) -> u32 {
        match self {
            Self::Ensembled => 0,
            Self::Horizon(actions) => actions,
        }
    }

    /// The inverse of [`Execution::horizon`].
    #[must_use]
    pub fn of_horizon(actions: u32) -> Self {
        if actions == 0 { Self::Ensembled } else { Self::Horizon(actions) }
    }
}
