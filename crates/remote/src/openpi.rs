//! A server of openpi's protocol: a WebSocket for each session, one message for each observation.

use futures::{SinkExt as _, StreamExt as _};
use gleaner_core::{Error, Result};
use http::{HeaderValue, header::AUTHORIZATION};
use tokio::{
    io::{AsyncRead, AsyncWrite},
    net::TcpStream,
};
use tokio_rustls::{TlsConnector, rustls::pki_types::ServerName};
use tokio_tungstenite::{
    WebSocketStream, client_async_with_config,
    tungstenite::{self, Message, client::IntoClientRequest as _, protocol::WebSocketConfig},
};

use crate::{
    actions::Actions,
    address::Address,
    fault::{At, cause, shown},
    inputs::Value,
    outgoing::Outgoing,
};

/// The largest description that a server sends first.
const METADATA_BYTES: usize = 256 << 10;

trait Transport: AsyncRead + AsyncWrite + Unpin + Send {}

impl<T: AsyncRead + AsyncWrite + Unpin + Send> Transport for T {}

/// A connection: strictly one answer for each message.
pub(crate) struct Socket {
    stream: WebSocketStream<Box<dyn Transport>>,
    at: At,
}

impl std::fmt::Debug for Socket {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Socket").field("at", &self.at).finish_non_exhaustive()
    }
}

impl Socket {
    /// Connects, and reads the description that the server sends first.
    ///
    /// # Errors
    /// Unavailable when the server does not answer; Precondition when it refuses, or is another kind of server.
    pub(crate) async fn open(address: &Address, outgoing: &Outgoing, actions: &Actions) -> Result<Self> {
        let at = At(address.text.clone());
        let tcp = TcpStream::connect((address.host.as_str(), address.port)).await;
        let tcp = tcp.map_err(|error| at.silent(error))?;
        tcp.set_nodelay(true).map_err(|error| at.silent(error))?;
        let transport: Box<dyn Transport> = if address.encrypted {
            let connector = TlsConnector::from(std::sync::Arc::new(outgoing.tls().await?));
            let name = ServerName::try_from(address.host.clone()).map_err(|error| at.wrong(error))?;
            Box::new(connector.connect(name, tcp).await.map_err(|error| at.silent(cause(&error)))?)
        } else {
            Box::new(tcp)
        };
        let mut request = address.text.as_str().into_client_request().map_err(|error| at.wrong(error))?;
        if let Some(token) = outgoing.token(address).await? {
            let header = HeaderValue::try_from(format!("Api-Key {}", token.reveal()));
            let mut header = header.map_err(|_| at.wrong("its token is not a header"))?;
            header.set_sensitive(true);
            request.headers_mut().insert(AUTHORIZATION, header);
        }
        let most = actions.bytes().max(METADATA_BYTES);
        let limits = WebSocketConfig::default().max_message_size(Some(most)).max_frame_size(Some(most));
        let (stream, _) =
            client_async_with_config(request, transport, Some(limits)).await.map_err(|error| refused(&at, &error))?;
        let mut socket = Self { stream, at };
        let metadata = socket.receive().await?;
        gleaner_openpi::server_metadata(&metadata).map_err(|problem| socket.at.wrong(problem))?;
        Ok(socket)
    }

    /// The actions for an observation.
    ///
    /// # Errors
    /// As [`Self::open`]; Precondition when the answer is something else than actions.
    pub(crate) async fn infer(&mut self, values: &[(&str, Value<'_>)], actions: &Actions) -> Result<Vec<Vec<f32>>> {
        let values: Vec<_> = values.iter().map(|(name, value)| (*name, sent(value))).collect();
        let message = gleaner_openpi::observation(&values);
        self.stream.send(Message::binary(message)).await.map_err(|error| refused(&self.at, &error))?;
        let answer = self.receive().await?;
        let read = gleaner_openpi::actions(&answer, &actions.output)
            .map_err(|error| error.message().to_owned())
            .and_then(|(shape, values)| actions.chunk(&shape, &values));
        read.map_err(|problem| self.at.wrong(problem))
    }

    /// The next binary message.
    async fn receive(&mut self) -> Result<bytes::Bytes> {
        loop {
            match self.stream.next().await {
                Some(Ok(Message::Binary(message))) => return Ok(message),
                Some(Ok(Message::Text(text))) => {
                    // openpi's server sends a traceback, whose last line has the error.
                    let last = text.trim().lines().next_back().unwrap_or_default();
                    return Err(self.at.wrong(format!("it answered with an error: {}", shown(last))));
                }
                Some(Ok(Message::Ping(_) | Message::Pong(_) | Message::Frame(_))) => {}
                Some(Ok(Message::Close(frame))) => {
                    let reason =
                        frame.map_or_else(String::new, |frame| format!(": {} {}", frame.code, shown(&frame.reason)));
                    return Err(self.at.silent(format!("it closed the connection{reason}")));
                }
                Some(Err(error)) => return Err(refused(&self.at, &error)),
                None => return Err(self.at.silent("it closed the connection")),
            }
        }
    }
}

fn sent<'a>(value: &'a Value<'_>) -> gleaner_openpi::Value<'a> {
    match value {
        Value::Bytes(shape, data) => gleaner_openpi::Value::Bytes(shape, data),
        Value::Words(shape, data) => gleaner_openpi::Value::Words(shape, data),
        Value::Numbers(numbers) => gleaner_openpi::Value::Numbers(numbers),
        Value::Text(text) => gleaner_openpi::Value::Text(text),
    }
}

/// The error of a socket: a lost connection may come back, a refusal lasts.
fn refused(at: &At, error: &tungstenite::Error) -> Error {
    match error {
        tungstenite::Error::Http(response) if response.status().is_client_error() => {
            let body = response.body().as_deref().map(String::from_utf8_lossy).unwrap_or_default();
            at.wrong(format!("it refused the connection with {}: {}", response.status(), shown(&body)))
        }
        tungstenite::Error::Http(response) => at.silent(format!("it answered with {}", response.status())),
        tungstenite::Error::Capacity(problem) => at.wrong(format!("its answer is larger than actions are: {problem}")),
        tungstenite::Error::Utf8(_) | tungstenite::Error::AttackAttempt => at.wrong(error),
        tungstenite::Error::ConnectionClosed
        | tungstenite::Error::AlreadyClosed
        | tungstenite::Error::Io(_)
        | tungstenite::Error::Tls(_)
        | tungstenite::Error::Protocol(_)
        | tungstenite::Error::WriteBufferFull(_)
        | tungstenite::Error::Url(_)
        | tungstenite::Error::HttpFormat(_) => at.silent(cause(error)),
    }
}
