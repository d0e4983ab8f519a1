//! A server of openpi's protocol: a WebSocket for each session, one message for each observation. Its pings are answered
//! between observations too, since a server ends a session that answers none.

use bytes::Bytes;
use futures::{SinkExt as _, StreamExt as _};
use gleaner_core::{Error, Result, error::Kind};
use http::{HeaderValue, header::AUTHORIZATION};
use tokio::{
    io::{AsyncRead, AsyncWrite},
    net::TcpStream,
    sync::mpsc,
    task::JoinHandle,
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

type Stream = WebSocketStream<Box<dyn Transport>>;

/// A connection: strictly one answer for each message.
#[derive(Debug)]
pub(crate) struct Socket {
    observations: mpsc::Sender<Message>,
    answers: mpsc::Receiver<Bytes>,
    /// Reads and writes the connection until its end, which it returns.
    exchange: JoinHandle<Error>,
    at: At,
}

impl Drop for Socket {
    fn drop(&mut self) {
        self.exchange.abort();
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
        let (mut stream, _) =
            client_async_with_config(request, transport, Some(limits)).await.map_err(|error| refused(&at, &error))?;
        let metadata = receive(&mut stream, &at).await?;
        gleaner_openpi::server_metadata(&metadata).map_err(|problem| at.wrong(problem))?;
        let (observations, waiting) = mpsc::channel(1);
        let (replies, answers) = mpsc::channel(1);
        let exchange = tokio::spawn(exchange(stream, at.clone(), waiting, replies));
        Ok(Self { observations, answers, exchange, at })
    }

    /// Whether the connection is lost. The server's state of the session ended with it.
    pub(crate) fn is_lost(&self) -> bool {
        self.exchange.is_finished()
    }

    /// The actions for an observation.
    ///
    /// # Errors
    /// As [`Self::open`]; Precondition when the answer is something else than actions.
    pub(crate) async fn infer(&mut self, values: &[(&str, Value<'_>)], actions: &Actions) -> Result<Vec<Vec<f32>>> {
        let values: Vec<_> = values.iter().map(|(name, value)| (*name, sent(value))).collect();
        let message = Message::binary(gleaner_openpi::observation(&values));
        let is_sent = self.observations.send(message).await.is_ok();
        let answer = if is_sent { self.answers.recv().await } else { None };
        let Some(answer) = answer else {
            return Err((&mut self.exchange).await.unwrap_or_else(|error| self.at.silent(error)));
        };
        let read = gleaner_openpi::actions(&answer, &actions.output)
            .map_err(|error| error.message().to_owned())
            .and_then(|(shape, values)| actions.chunk(&shape, &values));
        read.map_err(|problem| self.at.wrong(problem))
    }
}

/// Sends observations and returns their answers, and reads the connection in between. Returns its end.
async fn exchange(
    mut stream: Stream,
    at: At,
    mut observations: mpsc::Receiver<Message>,
    answers: mpsc::Sender<Bytes>,
) -> Error {
    loop {
        // In this order: a message that has arrived before an observation is not its answer.
        let observation = tokio::select! {
            biased;
            error = idle(&mut stream, &at) => {
                tracing::debug!(%error, server = at.0, "a session ended between observations");
                drop(stream);
                if error.kind() != Kind::Unavailable {
                    // A new connection would not be better: the next observation fails.
                    observations.recv().await;
                }
                return error;
            }
            observation = observations.recv() => observation,
        };
        let Some(observation) = observation else { return at.silent("the session has ended") };
        if let Err(error) = stream.send(observation).await {
            return refused(&at, &error);
        }
        match receive(&mut stream, &at).await {
            // A session that has ended receives no answer.
            Ok(answer) => drop(answers.send(answer).await),
            Err(error) => return error,
        }
    }
}

/// A message of a server, other than pings, which are answered as the connection is read.
enum Received {
    Binary(Bytes),
    /// An error: openpi's server sends a traceback, whose last line has it.
    Text(String),
}

/// The end of a connection on which no observation waits for its answer.
async fn idle(stream: &mut Stream, at: &At) -> Error {
    match next(stream, at).await {
        Ok(Received::Binary(_)) => at.wrong("it sent a message that answers no observation"),
        Ok(Received::Text(problem)) => at.silent(format!("it ended the session with an error: {problem}")),
        Err(error) => error,
    }
}

/// The next binary message.
async fn receive(stream: &mut Stream, at: &At) -> Result<Bytes> {
    match next(stream, at).await? {
        Received::Binary(message) => Ok(message),
        Received::Text(problem) => Err(at.wrong(format!("it answered with an error: {problem}"))),
    }
}

async fn next(stream: &mut Stream, at: &At) -> Result<Received> {
    loop {
        match stream.next().await {
            Some(Ok(Message::Binary(message))) => return Ok(Received::Binary(message)),
            Some(Ok(Message::Text(text))) => {
                return Ok(Received::Text(shown(text.trim().lines().next_back().unwrap_or_default())));
            }
            Some(Ok(Message::Ping(_) | Message::Pong(_) | Message::Frame(_))) => {}
            Some(Ok(Message::Close(frame))) => {
                let reason =
                    frame.map_or_else(String::new, |frame| format!(": {} {}", frame.code, shown(&frame.reason)));
                return Err(at.silent(format!("it closed the connection{reason}")));
            }
            Some(Err(error)) => return Err(refused(at, &error)),
            None => return Err(at.silent("it closed the connection")),
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

#[cfg(test)]
mod tests {
    use tokio_tungstenite::tungstenite::protocol::Role;

    use super::*;

    /// An observation that waits while `messages` have already arrived; returns the end of the connection.
    async fn end(messages: Vec<Message>) -> Error {
        let (ours, theirs) = tokio::io::duplex(1 << 10);
        let ours: Box<dyn Transport> = Box::new(ours);
        let ours = WebSocketStream::from_raw_socket(ours, Role::Client, None).await;
        let mut server = WebSocketStream::from_raw_socket(theirs, Role::Server, None).await;
        for message in messages {
            server.send(message).await.unwrap();
        }
        let (observations, waiting) = mpsc::channel(1);
        let (replies, _answers) = mpsc::channel(1);
        observations.send(Message::binary("seen")).await.unwrap();
        exchange(ours, At("ws://x".to_owned()), waiting, replies).await
    }

    #[tokio::test]
    async fn messages_before_an_observation_are_not_its_answer() {
        let error = end(vec![Message::text("Traceback\nno observation for 60 s"), Message::Close(None)]).await;
        assert_eq!(error.kind(), Kind::Unavailable, "{error}");
        assert!(error.message().contains("ended the session with an error: no observation for 60 s"), "{error}");
        let error = end(vec![Message::Close(None)]).await;
        assert_eq!(error.kind(), Kind::Unavailable, "{error}");
        let error = end(vec![Message::binary("more")]).await;
        assert_eq!(error.kind(), Kind::Precondition, "{error}");
        assert!(error.message().contains("answers no observation"), "{error}");
    }
}
