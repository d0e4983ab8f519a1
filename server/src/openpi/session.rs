//! One client's episodes: each observation is answered before the next is read, and a `reset` begins a new session.
//!
//! Must not know HTTP.

use std::time::Instant;

use futures::SinkExt as _;
use gleaner_edge::Call;
use gleaner_openpi::{Metadata, Reply, Request};
use tokio::{
    io::{AsyncRead, AsyncWrite},
    sync::mpsc,
};
use tokio_stream::wrappers::ReceiverStream;
use tokio_tungstenite::{
    WebSocketStream,
    tungstenite::{
        Message,
        protocol::{CloseFrame, frame::coding::CloseCode},
    },
};

use super::{
    READ_WITHIN,
    keepalive::{self, Counted},
};
use crate::{
    access::{self, Caller},
    domain::{
        access::AuditEntry,
        episode::Outcome,
        observation::{Observation, SessionInput, SessionOutput, SessionSettings},
        task::Task,
        time::Millis,
    },
    error::{Error, Result},
    service::Services,
};

/// The deployment that a connection asks for, with its task.
pub(super) struct Wanted {
    pub(super) deployment: String,
    pub(super) task: Task,
    pub(super) caller: Caller,
    /// Counts as a call of the client until it is dropped.
    pub(super) _counted: Call,
    pub(super) peer: String,
}

/// Serves a client until it leaves. A failure is one text message before the close, as by openpi's own server.
pub(super) async fn run<S>(mut socket: WebSocketStream<Counted<S>>, wanted: Wanted, services: &Services)
where
    S: AsyncRead + AsyncWrite + Unpin,
{
    let ended = serve(&mut socket, &wanted, services).await;
    let outcome = ended.as_ref().map_or_else(|error| format!("{:?}", error.kind()), |()| "ok".to_owned());
    audit(&wanted, services, outcome).await;
    let Err(error) = ended else { return };
    tracing::debug!(%error, deployment.name = wanted.deployment, "a session of openpi ended");
    let frame = CloseFrame { code: CloseCode::Error, reason: "error".into() };
    // The client may be gone.
    let _ = send(&mut socket, Message::text(error.message())).await;
    let _ = tokio::time::timeout(READ_WITHIN, socket.close(Some(frame))).await;
}

async fn serve<S>(socket: &mut WebSocketStream<Counted<S>>, wanted: &Wanted, services: &Services) -> Result<()>
where
    S: AsyncRead + AsyncWrite + Unpin,
{
    // Each episode draws other actions than the one before it; a connection that repeats its episodes draws the same.
    let mut seed = 0;
    let mut episode = Episode::open(wanted, seed, services).await?;
    let metadata =
        Metadata { deployment: &wanted.deployment, policy_id: episode.policy_id.as_str(), task: &wanted.task.spec };
    send(socket, Message::binary(gleaner_openpi::metadata(&metadata))).await?;
    let mut token_end = wanted.caller.token_end();
    let limit = services.config.connections.limits().keepalive_timeout;
    let mut previous_ms = None;
    loop {
        let message = tokio::select! {
            message = keepalive::next(socket, limit) => message?,
            () = ended(&mut token_end) => return Err(Error::unauthenticated("the token was revoked or has expired")),
            output = episode.outputs.recv() => match output {
                // Not an answer: the server is about to stop, and the episode goes on until then.
                Some(Ok(_)) => continue,
                Some(Err(error)) => return Err(error),
                None => return Ok(()),
            },
        };
        let begun = Instant::now();
        let message = match message {
            Some(Message::Binary(message)) => message,
            Some(Message::Text(_)) => {
                return Err(Error::invalid("message", "is text; send msgpack as a binary message"));
            }
            Some(Message::Ping(_) | Message::Pong(_) | Message::Frame(_)) => continue,
            Some(Message::Close(_)) | None => return episode.close().await,
        };
        let Request { reset, cameras, proprioception } = gleaner_openpi::request(&message, &wanted.task.spec)?;
        if reset && episode.steps > 0 {
            episode.close().await?;
            seed += 1;
            episode = Episode::open(wanted, seed, services).await?;
        }
        let reply = episode.act(begun, previous_ms, (cameras, proprioception)).await?;
        send(socket, Message::binary(reply)).await?;
        previous_ms = Some(milliseconds(begun));
    }
}

/// A session of the server.
struct Episode {
    inputs: mpsc::Sender<Result<SessionInput>>,
    outputs: mpsc::Receiver<Result<SessionOutput>>,
    policy_id: String,
    /// Observations sent.
    steps: i64,
    period_ns: f64,
}

impl Episode {
    async fn open(wanted: &Wanted, seed: u64, services: &Services) -> Result<Self> {
        let (inputs, received) = mpsc::channel(1);
        let outputs = services.policies.session(ReceiverStream::new(received), services.stopping.clone());
        let period_ns = 1e9 / wanted.task.spec.rate_hz;
        let mut episode = Self { inputs, outputs, policy_id: String::new(), steps: 0, period_ns };
        let settings = SessionSettings {
            deployment: wanted.deployment.clone(),
            control_rate_hz: None,
            deadline: None,
            record: None,
            seed,
            // A client executes as many actions of each answer as it likes, and does not send how many.
            new_chunks: true,
        };
        episode.send(SessionInput::Open(settings)).await;
        let SessionOutput::Opened { policy_id, .. } = episode.output().await? else {
            return Err(Error::internal("opening a session of openpi", "it began with another message"));
        };
        episode.policy_id = policy_id.to_string();
        Ok(episode)
    }

    async fn act(
        &mut self,
        begun: Instant,
        previous_ms: Option<f64>,
        (cameras, proprioception): (Vec<crate::domain::observation::CameraFrame>, Vec<f32>),
    ) -> Result<Vec<u8>> {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_precision_loss,
            reason = "an episode's length in ns fits"
        )]
        let stamp_ns = (self.steps as f64 * self.period_ns) as i64;
        self.steps += 1;
        let observation = Observation {
            stamp_ns,
            cameras,
            proprioception,
            executed_action: Vec::new(),
            deadline: None,
            skipped_steps: 0,
        };
        self.send(SessionInput::Observation(observation)).await;
        loop {
            match self.output().await? {
                SessionOutput::Action { acted, score, .. } => {
                    #[expect(clippy::cast_precision_loss, reason = "a model takes far less than 2^52 µs")]
                    let policy_ms = acted.timings.model_us as f64 / 1e3;
                    return Ok(gleaner_openpi::reply(&Reply {
                        actions: &acted.actions,
                        infer_ms: milliseconds(begun),
                        policy_ms,
                        previous_ms,
                        score: score.map(|score| (score.q, score.w)),
                    }));
                }
                SessionOutput::Draining { .. } => {}
                other
                @ (SessionOutput::Opened { .. } | SessionOutput::Missed { .. } | SessionOutput::Closed { .. }) => {
                    return Err(Error::internal("answering a client of openpi", format!("the session sent {other:?}")));
                }
            }
        }
    }

    async fn close(&mut self) -> Result<()> {
        self.send(SessionInput::Close { outcome: Outcome::Unknown }).await;
        while !matches!(self.output().await?, SessionOutput::Closed { .. }) {}
        Ok(())
    }

    /// Sends an input; a session that has ended says why in its outputs.
    async fn send(&self, input: SessionInput) {
        let _ = self.inputs.send(Ok(input)).await;
    }

    async fn output(&mut self) -> Result<SessionOutput> {
        self.outputs.recv().await.unwrap_or_else(|| Err(Error::unavailable("the session has ended; connect again")))
    }
}

async fn send<S>(socket: &mut WebSocketStream<S>, message: Message) -> Result<()>
where
    S: AsyncRead + AsyncWrite + Unpin,
{
    match tokio::time::timeout(READ_WITHIN, socket.send(message)).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(error)) => Err(Error::cancelled(error.to_string())),
        Err(_) => Err(Error::late(format!("the client read nothing for {} s", READ_WITHIN.as_secs()))),
    }
}

async fn ended(token: &mut Option<impl Future<Output = ()> + Unpin>) {
    match token {
        Some(token) => token.await,
        None => std::future::pending().await,
    }
}

fn milliseconds(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}

/// The audit entry of a connection, as a session by gRPC has one.
async fn audit(wanted: &Wanted, services: &Services, outcome: String) {
    let entry = AuditEntry {
        at: Millis::now(),
        token_id: wanted.caller.token_id(),
        caller: wanted.caller.name().to_owned(),
        peer: wanted.peer.clone(),
        rpc: "openpi/Session".to_owned(),
        subjects: vec![format!("deployment={}", wanted.deployment)],
        outcome,
    };
    access::write_audit(services.store.clone(), entry).await;
}

#[cfg(test)]
mod tests {
    use tokio_tungstenite::tungstenite::protocol::Role;

    use super::*;
    use crate::error::Kind;

    #[tokio::test(start_paused = true)]
    async fn a_client_that_never_reads_is_left_after_the_limit() {
        let (ours, _theirs) = tokio::io::duplex(64);
        let mut socket = WebSocketStream::from_raw_socket(ours, Role::Server, None).await;
        let begun = tokio::time::Instant::now();
        let error = send(&mut socket, Message::binary(vec![0; 4096])).await.unwrap_err();
        assert_eq!((error.kind(), begun.elapsed()), (Kind::Late, READ_WITHIN), "{error}");
        assert!(error.to_string().contains("the client read nothing for 30 s"), "{error}");
    }
}
