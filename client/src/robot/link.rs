//! The way to a policy, as the control loop needs it. [`Client`] is one; tests have one with delay and loss.

use std::future::Future;

use futures::stream::BoxStream;
use gleaner_proto::v1::session_request::Message as Request;
use gleaner_proto::v1::session_response::Message as Response;
use gleaner_proto::v1::{SessionOpen, SessionOpened};
use tokio::sync::mpsc;

use crate::connection::Client;
use crate::error::Result;
use crate::session::Session;

/// Opens sessions on a deployment.
pub trait Link: Send + 'static {
    /// Opens a session. The loop opens another one when it is lost.
    ///
    /// # Errors
    /// Transient ones ([`ClientError::is_transient`](crate::ClientError::is_transient)) are tried again, others end
    /// the loop.
    fn open(&mut self, open: &SessionOpen) -> impl Future<Output = Result<Line>> + Send;
}

/// An open session.
pub struct Line {
    /// What the server said of it.
    pub opened: SessionOpened,
    /// Takes observations and the close; has little room, so that what waits for long waits in the loop, where the
    /// newest wins.
    pub requests: mpsc::Sender<Request>,
    /// Gives what the server says.
    pub responses: BoxStream<'static, Result<Response>>,
}

impl Link for Client {
    async fn open(&mut self, open: &SessionOpen) -> Result<Line> {
        Ok(Session::open_with(self, open.clone()).await?.into_line())
    }
}
