//! The control loop's connection to a policy. [`Client`] is one; tests have one with delay and loss.

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
    /// Transient errors ([`ClientError::is_transient`](crate::ClientError::is_transient)) are retried; others end the
    /// loop.
    fn open(&mut self, open: &SessionOpen) -> impl Future<Output = Result<SessionChannel>> + Send;
}

/// An open session.
pub struct SessionChannel {
    /// The server's answer to the opening.
    pub opened: SessionOpened,
    /// Takes observations and the close. Its capacity is small, so that observations wait in the loop, where the newest
    /// replaces older ones.
    pub requests: mpsc::Sender<Request>,
    /// The server's responses.
    pub responses: BoxStream<'static, Result<Response>>,
}

impl Link for Client {
    async fn open(&mut self, open: &SessionOpen) -> Result<SessionChannel> {
        let (opened, requests, responses) = Session::open_with(self, open.clone()).await?.into_parts();
        Ok(SessionChannel { opened, requests, responses })
    }
}
