//! The state of a session with a policy that another server runs: its episode there, and the chunks that are executed.
//!
//! Must not know engines or protocols.

use std::sync::Arc;

use gleaner_core::ensemble::{Execution, StepChunks};
use gleaner_learn::TaskShape;
use gleaner_remote::{Episode, Remote, Step};

use crate::error::{Error, Result};

/// The state of a session. Clones share the episode on the other server.
#[derive(Debug, Clone)]
pub(super) struct RemoteHistory {
    episode: Arc<tokio::sync::Mutex<Episode>>,
    chunks: StepChunks,
}

impl RemoteHistory {
    /// The state before the first step.
    pub(super) fn new(remote: &Arc<Remote>, shape: &TaskShape, execution: Execution) -> Self {
        let chunks = StepChunks::new(shape.ranges.clone(), execution);
        Self { episode: Arc::new(tokio::sync::Mutex::new(remote.episode())), chunks }
    }

    /// The actions from a step on, which is `steps` after the one before, within the task's ranges. The other server is
    /// called unless a chunk of it is not executed yet.
    ///
    /// # Errors
    /// Those of the call; the state is then as before.
    pub(super) async fn advance(&mut self, shape: &TaskShape, steps: u64, newest: &Step<'_>) -> Result<Vec<Vec<f32>>> {
        let mut chunks = self.chunks.clone();
        chunks.skip(steps);
        if let Some(actions) = chunks.remaining() {
            self.chunks = chunks;
            return Ok(actions);
        }
        let mut actions = self.episode.lock().await.infer(newest).await?;
        for action in &mut actions {
            shape.ranges.apply(action);
        }
        let actions = chunks.push(actions).map_err(|problem| Error::internal("executing a chunk", problem))?;
        self.chunks = chunks;
        Ok(actions)
    }
}
