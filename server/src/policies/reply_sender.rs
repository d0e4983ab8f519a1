//! The sending end of a session's output. A robot that stops reading blocks its own session for a while, then loses it.

use std::time::Duration;

use tokio::sync::mpsc;

use crate::{
    domain::observation::SessionOutput,
    error::{Error, Result},
};

/// Outputs of one session that may wait for its robot to read them.
const UNREAD: usize = 16;

/// The receiving end of a session's output.
pub(super) type Answers = mpsc::Receiver<Result<SessionOutput>>;

/// The sending end of a session's output.
pub(super) struct ReplySender {
    outputs: mpsc::Sender<Result<SessionOutput>>,
    /// How long an output may wait for a place in the channel.
    patience: Duration,
    /// A reserved place for the error that ends the session.
    last: Option<mpsc::OwnedPermit<Result<SessionOutput>>>,
}

impl ReplySender {
    /// The two ends of a session's output.
    pub(super) fn new(patience: Duration) -> (Self, Answers) {
        let (outputs, answers) = mpsc::channel(UNREAD + 1);
        let last = outputs.clone().try_reserve_owned().ok();
        (Self { outputs, patience, last }, answers)
    }

    /// Sends an output; waits for a place in the channel.
    ///
    /// # Errors
    /// Cancelled when the robot is gone; Late when it has read nothing for too long.
    pub(super) async fn send(&self, output: SessionOutput) -> Result<()> {
        match self.outputs.send_timeout(Ok(output), self.patience).await {
            Ok(()) => Ok(()),
            Err(mpsc::error::SendTimeoutError::Closed(_)) => Err(Self::gone()),
            Err(mpsc::error::SendTimeoutError::Timeout(_)) => Err(Error::late(format!(
                "{UNREAD} answers were not read for {} s; open the session again and read them",
                self.patience.as_secs()
            ))),
        }
    }

    /// Sends the error that ends the session.
    pub(super) fn fail(self, error: Error) {
        if let Some(last) = self.last {
            last.send(Err(error));
        }
    }

    /// Completes when the robot stops reading permanently.
    pub(super) async fn closed(&self) {
        self.outputs.closed().await;
    }

    /// The error of a session whose robot is gone.
    pub(super) fn gone() -> Error {
        Error::cancelled("the robot closed the connection")
    }
}
