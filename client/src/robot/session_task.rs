//! The session task: sends observations to the policy, receives its answers, and reopens the session when it is lost.
//! The loop never waits for it.

use std::sync::Arc;
use std::time::Duration;

use futures::StreamExt as _;
use gleaner_proto::v1::session_request::Message as Request;
use gleaner_proto::v1::session_response::Message as Response;
use gleaner_proto::v1::{
    Observation, Outcome, SessionAction, SessionClose, SessionClosed, SessionMissed, SessionOpen, SessionOpened,
};
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep, sleep_until, timeout};
use tonic::Code;

use super::latest::Latest;
use super::plan::ControlPlan;
use super::{Link, SessionChannel};
use crate::error::{ClientError, Result};
use crate::retry::Backoff;

// A server may first have to load the policy.
const OPEN_WITHIN: Duration = Duration::from_secs(30);
// The robot rests already; only the server's bookkeeping waits for this.
const CLOSE_WITHIN: Duration = Duration::from_secs(1);
// The server inspects and stores the recording before it answers.
const STORE_WITHIN: Duration = Duration::from_secs(60);
// More than can arrive in a period; a server that sends more has to wait.
const EVENTS: usize = 64;

/// An event of the session.
#[derive(Debug)]
pub(super) enum Event {
    Opened(SessionOpened),
    Action(SessionAction),
    Missed(SessionMissed),
    Draining,
    /// The session is lost, or could not be opened; the task retries.
    Lost,
    /// The task has ended with this error.
    Ended(ClientError),
}

/// The loop's handle to the task. Dropping it closes the session.
pub(super) struct SessionTask {
    latest: Arc<Latest>,
    events: mpsc::Receiver<Event>,
    closing: oneshot::Sender<Outcome>,
    task: JoinHandle<Option<SessionClosed>>,
}

impl SessionTask {
    /// Starts the task, which opens a session.
    pub(super) fn start<L: Link>(link: L, plan: &ControlPlan) -> Self {
        let latest = Arc::new(Latest::default());
        let (sender, events) = mpsc::channel(EVENTS);
        let (closing, closed) = oneshot::channel();
        let (open, lost_after, give_up_after) = (plan.open(), plan.lost_after, plan.give_up_after);
        let worker = Worker {
            link,
            open,
            latest: Arc::clone(&latest),
            events: sender,
            lost_after,
            give_up_after,
            channel: None,
        };
        Self { latest, events, closing, task: tokio::spawn(worker.run(closed)) }
    }

    /// Leaves an observation to be sent; true when it replaces one that was not sent.
    pub(super) fn offer(&self, observation: Observation) -> bool {
        self.latest.put(observation)
    }

    /// An event that has arrived already.
    pub(super) fn here(&mut self) -> Option<Event> {
        self.events.try_recv().ok()
    }

    /// Waits for the next event.
    pub(super) async fn next(&mut self) -> Event {
        let ended = || Event::Ended(ClientError::SessionLost("its background task ended early".into()));
        self.events.recv().await.unwrap_or_else(ended)
    }

    /// Closes the session with this outcome and waits briefly for the server's answer.
    pub(super) async fn close(self, outcome: Outcome) -> Option<SessionClosed> {
        // Fails when the task has ended.
        let _ = self.closing.send(outcome);
        drop(self.events);
        // A panic of the task has been reported; it has no answer then.
        self.task.await.ok().flatten()
    }
}

struct Worker<L> {
    link: L,
    open: SessionOpen,
    latest: Arc<Latest>,
    events: mpsc::Sender<Event>,
    lost_after: Duration,
    give_up_after: Duration,
    channel: Option<SessionChannel>,
}

impl<L: Link> Worker<L> {
    async fn run(mut self, closed: oneshot::Receiver<Outcome>) -> Option<SessionClosed> {
        let outcome = tokio::select! {
            biased;
            // Dropped by the loop: the outcome is unknown.
            outcome = closed => outcome.unwrap_or(Outcome::Unknown),
            () = self.keep_open() => Outcome::Unknown,
        };
        let channel = self.channel.take()?;
        let within = if self.open.record { STORE_WITHIN } else { CLOSE_WITHIN };
        // A server that does not read the close in time finds the stream ended.
        timeout(within, close(channel, outcome)).await.ok().flatten()
    }

    /// Reopens the session whenever it is lost, with pauses that grow until an observation is answered.
    async fn keep_open(&mut self) {
        let mut backoff = Backoff::endless();
        let mut alive = Instant::now();
        loop {
            let (error, answered) = match self.open_session().await {
                Ok(channel) => {
                    let channel = self.channel.insert(channel);
                    serve(channel, &self.latest, &self.events, self.lost_after).await
                }
                Err(error) => (error, false),
            };
            self.channel = None;
            if answered {
                backoff.restore();
                alive = Instant::now();
            }
            if !may_reopen(&error) || alive.elapsed() >= self.give_up_after {
                return send_event(&self.events, Event::Ended(error)).await;
            }
            send_event(&self.events, Event::Lost).await;
            sleep(backoff.next_wait().unwrap_or_default()).await;
        }
    }

    async fn open_session(&mut self) -> Result<SessionChannel> {
        let late =
            || ClientError::SessionLost(format!("the session was not opened within {} s", OPEN_WITHIN.as_secs()));
        let channel = timeout(OPEN_WITHIN, self.link.open(&self.open)).await.map_err(|_| late())??;
        send_event(&self.events, Event::Opened(channel.opened.clone())).await;
        Ok(channel)
    }
}

/// Serves an open session until it is lost; returns the error, and whether any observation was answered.
async fn serve(
    channel: &mut SessionChannel,
    latest: &Latest,
    events: &mpsc::Sender<Event>,
    lost_after: Duration,
) -> (ClientError, bool) {
    let (mut answered, mut pending_since) = (false, None);
    loop {
        let silent = sleep_until(pending_since.unwrap_or_else(Instant::now) + lost_after);
        tokio::select! {
            biased;
            response = channel.responses.next() => {
                let event = match response {
                    Some(Ok(response)) => event(response),
                    Some(Err(error)) => Err(error),
                    None => Err(ClientError::SessionLost("the stream ended".into())),
                };
                match event {
                    Ok(event) => {
                        answered |= matches!(event, Event::Action(_) | Event::Missed(_));
                        pending_since = None;
                        send_event(events, event).await;
                    }
                    Err(error) => return (error, answered),
                }
            }
            () = silent, if pending_since.is_some() => {
                let problem = format!("the server sent no response for {lost_after:?}");
                return (ClientError::SessionLost(problem), answered);
            }
            sent = send(&channel.requests, latest), if !channel.requests.is_closed() || pending_since.is_none() => {
                // A failed send needs no handling: the reason arrives as a response, or the silence is timed out.
                let _ = sent;
                pending_since.get_or_insert_with(Instant::now);
            }
        }
    }
}

/// Sends the newest observation as soon as the channel has room. Cancel-safe: dropping the future loses no observation.
async fn send(
    requests: &mpsc::Sender<Request>,
    latest: &Latest,
) -> std::result::Result<(), mpsc::error::SendError<()>> {
    // Room first, so that the observation taken is the newest.
    let room = requests.reserve().await?;
    room.send(Request::Observation(latest.take().await));
    Ok(())
}

/// Whether another session may succeed: the server was lost or is full, or closed this one for silence.
fn may_reopen(error: &ClientError) -> bool {
    error.is_transient() || matches!(error.code(), Some(Code::DeadlineExceeded | Code::ResourceExhausted))
}

fn event(response: Response) -> Result<Event> {
    match response {
        Response::Action(action) => Ok(Event::Action(action)),
        Response::Missed(missed) => Ok(Event::Missed(missed)),
        // This session is served until it is closed; then another is opened.
        Response::Draining(_) => Ok(Event::Draining),
        Response::Closed(_) => Err(ClientError::SessionLost("the server closed the session".into())),
        Response::Opened(_) => Err(ClientError::Contract { missing: "an action" }),
    }
}

async fn send_event(events: &mpsc::Sender<Event>, event: Event) {
    // The receiver is dropped when the loop has ended; the task is about to end as well.
    let _ = events.send(event).await;
}

async fn close(mut channel: SessionChannel, outcome: Outcome) -> Option<SessionClosed> {
    let _ = channel.requests.send(Request::Close(SessionClose { outcome: outcome.into() })).await;
    while let Some(Ok(response)) = channel.responses.next().await {
        if let Response::Closed(closed) = response {
            return Some(closed);
        }
    }
    None
}
