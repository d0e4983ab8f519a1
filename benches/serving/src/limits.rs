//! The memory of idle sessions, and of a session that does not read.

use std::path::Path;
use std::time::{Duration, Instant};

use futures::StreamExt as _;
use gleaner_proto::v1::policy_service_client::PolicyServiceClient;
use gleaner_proto::v1::session_request::Message;
use gleaner_proto::v1::{Observation, SessionOpen, SessionRequest};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::Endpoint;
use tonic::{Code, Status};

use crate::Result;
use crate::cli::Options;
use crate::connection::{Address, Connection};
use crate::prepare::{self, Prepared, serve};
use crate::process::Program;
use crate::report::{Bound, Report, progress};
use crate::scene::{Images, observe};

const MEGABYTE: f64 = 1e6;
/// The largest memory of all idle sessions, in megabytes.
const IDLE: f64 = 100.0;
/// The largest memory of an unread session, in megabytes: a few observations within the windows of HTTP/2.
const UNREAD: f64 = 32.0;
/// The time after which the server closes a silent session, in seconds.
const TIMEOUT: u64 = 2;
/// The default of HTTP/2; with a larger window more replies are buffered on this side.
const WINDOW: u32 = 65_535;

/// Opens sessions on separate connections and leaves them idle, on a server of its own: one that had a load keeps memory,
/// which its allocator gives to the sessions without growth.
pub async fn idle(options: &Options, folder: &Path, prepared: &Prepared, report: &mut Report) -> Result<()> {
    let count = options.idle_sessions;
    let server = serve(options, folder, &[]).await?;
    let address = prepare::address(server.url());
    load_policy(&address, prepared).await?;
    let before = server.memory()?;
    let connections = Connection::open_many(&address, usize::try_from(count)?).await?;
    let grown = megabytes(server.memory()?, before);
    progress(&format!("{} idle sessions: {grown:.1} MB", connections.len()));
    report.target(Bound::at_most(&format!("MB of {count} idle sessions"), IDLE), grown);
    drop(connections);
    server.stop().await
}

/// Makes one action, which loads the policy; its memory is not that of sessions. Returns the observation.
async fn load_policy(address: &Address, prepared: &Prepared) -> Result<Observation> {
    let observation = observe(&prepared.spec, prepared.steps.first().ok_or("no step")?, Images::Raw)?;
    Connection::open(address).await?.act(&observation).await?;
    Ok(observation)
}

/// Sends observations and reads nothing, on a server with a short timeout.
pub async fn unread(options: &Options, folder: &Path, prepared: &Prepared, report: &mut Report) -> Result<()> {
    let server = serve(options, folder, &["--session-idle-seconds", &TIMEOUT.to_string()]).await?;
    let address = prepare::address(server.url());
    let observation = load_policy(&address, prepared).await?;
    let before = server.memory()?;
    let (ended, most) = flood(&address, &observation, &server).await?;
    let grown = megabytes(most, before);
    progress(&format!("an unread session held {grown:.1} MB at most and ended: {}", ended.message()));
    if ended.code() != Code::DeadlineExceeded {
        return Err(format!("the unread session ended as {:?}, not as DeadlineExceeded", ended.code()).into());
    }
    report.target(Bound::at_most("MB of a session that is not read", UNREAD), grown);
    server.stop().await
}

/// Sends observations until the server accepts no more, waits longer than its timeout, and then reads; returns the status
/// of the session and the largest memory of the server.
async fn flood(address: &Address, observation: &Observation, server: &Program) -> Result<(Status, u64)> {
    let Address::Session { url, deployment } = address else { return Err("not a session".into()) };
    let endpoint = Endpoint::from_shared(url.clone())?.initial_stream_window_size(WINDOW);
    let mut policies = PolicyServiceClient::new(endpoint.connect().await?);
    let (requests, outgoing) = mpsc::channel(1);
    let send = |message| requests.send(SessionRequest { message: Some(message) });
    send(Message::Open(SessionOpen { deployment: deployment.clone(), ..SessionOpen::default() })).await?;
    let mut answers = policies.session(ReceiverStream::new(outgoing)).await?.into_inner();
    let (mut most, mut looked, mut taken) = (0, Instant::now(), Instant::now());
    for stamp_ns in 1.. {
        if looked.elapsed() > Duration::from_millis(50) {
            (looked, most) = (Instant::now(), most.max(server.memory()?));
        }
        let next = send(Message::Observation(Observation { stamp_ns, ..observation.clone() }));
        match tokio::time::timeout(Duration::from_millis(100), next).await {
            Ok(Ok(())) => taken = Instant::now(),
            Ok(Err(_)) => break,
            Err(_) if taken.elapsed() > Duration::from_secs(2 * TIMEOUT) => break,
            Err(_) => {}
        }
    }
    loop {
        match answers.next().await {
            Some(Ok(_)) => {}
            Some(Err(status)) => return Ok((status, most)),
            None => return Err("the unread session ended as if it had been closed".into()),
        }
    }
}

#[expect(clippy::cast_precision_loss, reason = "far below 2^52 bytes")]
fn megabytes(after: u64, before: u64) -> f64 {
    after.saturating_sub(before) as f64 / MEGABYTE
}
