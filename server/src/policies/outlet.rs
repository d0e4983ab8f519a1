//! The way to one session's robot. A robot that does not read holds up its own session for a while, then loses it.

use std::time::Duration;

use tokio::sync::mpsc;

use crate::{
    domain::observation::SessionOutput,
    error::{Error, Result},
};

/// Answers of one session that may wait for its robot to read them.
const UNREAD: usize = 16;

/// What a robot reads from.
pub(super) type Answers = mpsc::Receiver<Result<SessionOutput>>;

/// Where a session's answers go.
pub(super) struct Outlet {
    outputs: mpsc::Sender<Result<SessionOutput>>,
    /// How long an answer may wait for a place.
    patience: Duration,
    /// Kept free for the error that ends the session.
    last: Option<mpsc::OwnedPermit<Result<SessionOutput>>>,
}

impl Outlet {
    /// A way to a robot, and the robot's end of it.
    pub(super) fn new(patience: Duration) -> (Self, Answers) {
        let (outputs, answers) = mpsc::channel(UNREAD + 1);
        let last = outputs.clone().try_reserve_owned().ok();
        (Self { outputs, patience, last }, answers)
    }

    /// Says something to the robot, when it has read enough of what was said before.
    ///
    /// # Errors
    /// Cancelled when the robot has gone; Late when it has read nothing for too long.
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

    /// Says the last thing.
    pub(super) fn fail(self, error: Error) {
        if let Some(last) = self.last {
            last.send(Err(error));
        }
    }

    /// Ends when nobody will read any more.
    pub(super) async fn closed(&self) {
        self.outputs.closed().await;
    }

    /// The error of a session whose robot is not there any more.
    pub(super) fn gone() -> Error {
        Error::cancelled("the robot has gone")
    }
}
