//! The courier: a task that carries observations to the policy and its answers back, and opens the session anew when
//! it is lost. The loop never waits for it.

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

use super::plan::ControlPlan;
use super::slot::Slot;
use super::{Line, Link};
use crate::error::{ClientError, Result};
use crate::retry::Patience;

// A server may first have to load the policy.
const OPEN_WITHIN: Duration = Duration::from_secs(30);
// The robot rests already; nothing but the server's bookkeeping waits for this.
const CLOSE_WITHIN: Duration = Duration::from_secs(1);
// The recording is looked through and stored before the server says so.
const STORE_WITHIN: Duration = Duration::from_secs(60);
// More than can come in a period; a server that sends more has to wait.
const EVENTS: usize = 64;

/// What comes back.
#[derive(Debug)]
pub(super) enum Event {
    Opened(SessionOpened),
    Action(SessionAction),
    Missed(SessionMissed),
    Draining,
    /// The session is lost, or could not be opened; the courier tries again.
    Lost,
    /// The courier has given up, for this reason.
    Ended(ClientError),
}

/// The loop's end. Dropping it closes the session.
pub(super) struct Courier {
    slot: Arc<Slot>,
    events: mpsc::Receiver<Event>,
    closing: oneshot::Sender<Outcome>,
    task: JoinHandle<Option<SessionClosed>>,
}

impl Courier {
    /// Sets out to open a session.
    pub(super) fn start<L: Link>(link: L, plan: &ControlPlan) -> Self {
        let slot = Arc::new(Slot::default());
        let (tell, events) = mpsc::channel(EVENTS);
        let (closing, closed) = oneshot::channel();
        let (open, lost_after, give_up_after) = (plan.open(), plan.lost_after, plan.give_up_after);
        let carrier = Carrier { link, open, slot: Arc::clone(&slot), tell, lost_after, give_up_after, line: None };
        Self { slot, events, closing, task: tokio::spawn(carrier.run(closed)) }
    }

    /// Leaves an observation to be sent; true when one that waited is passed over for it.
    pub(super) fn offer(&self, observation: Observation) -> bool {
        self.slot.put(observation)
    }

    /// What has come already.
    pub(super) fn here(&mut self) -> Option<Event> {
        self.events.try_recv().ok()
    }

    /// Waits for what comes next.
    pub(super) async fn next(&mut self) -> Event {
        let ended = || Event::Ended(ClientError::SessionLost("its task has ended".into()));
        self.events.recv().await.unwrap_or_else(ended)
    }

    /// Closes the session with this outcome and waits a little for the server to know; gives what it said.
    pub(super) async fn close(self, outcome: Outcome) -> Option<SessionClosed> {
        // In vain when the task has ended.
        let _ = self.closing.send(outcome);
        drop(self.events);
        // It ends by itself, or by a panic that has been reported.
        self.task.await.ok().flatten()
    }
}

struct Carrier<L> {
    link: L,
    open: SessionOpen,
    slot: Arc<Slot>,
    tell: mpsc::Sender<Event>,
    lost_after: Duration,
    give_up_after: Duration,
    line: Option<Line>,
}

impl<L: Link> Carrier<L> {
    async fn run(mut self, closed: oneshot::Receiver<Outcome>) -> Option<SessionClosed> {
        let outcome = tokio::select! {
            biased;
            // The loop was dropped: nobody knows.
            outcome = closed => outcome.unwrap_or(Outcome::Unknown),
            () = self.keep_open() => Outcome::Unknown,
        };
        let line = self.line.take()?;
        let within = if self.open.record { STORE_WITHIN } else { CLOSE_WITHIN };
        // In vain or not: whoever does not hear of it in time finds the stream ended.
        timeout(within, close(line, outcome)).await.ok().flatten()
    }

    /// Opens the session again whenever it is lost, with waits that grow until something is answered.
    async fn keep_open(&mut self) {
        let mut patience = Patience::endless();
        let mut alive = Instant::now();
        loop {
            let (error, answered) = match self.dial().await {
                Ok(line) => {
                    let line = self.line.insert(line);
                    carry(line, &self.slot, &self.tell, self.lost_after).await
                }
                Err(error) => (error, false),
            };
            self.line = None;
            if answered {
                patience.restore();
                alive = Instant::now();
            }
            if !may_open_again(&error) || alive.elapsed() >= self.give_up_after {
                return tell(&self.tell, Event::Ended(error)).await;
            }
            tell(&self.tell, Event::Lost).await;
            sleep(patience.next_wait().unwrap_or_default()).await;
        }
    }

    async fn dial(&mut self) -> Result<Line> {
        let late = || ClientError::SessionLost(format!("it was not opened within {} s", OPEN_WITHIN.as_secs()));
        let line = timeout(OPEN_WITHIN, self.link.open(&self.open)).await.map_err(|_| late())??;
        tell(&self.tell, Event::Opened(line.opened.clone())).await;
        Ok(line)
    }
}

/// Serves an open session until it is lost; says why, and whether anything was answered.
async fn carry(
    line: &mut Line,
    slot: &Slot,
    events: &mpsc::Sender<Event>,
    lost_after: Duration,
) -> (ClientError, bool) {
    let (mut answered, mut asked) = (false, None);
    loop {
        let silent = sleep_until(asked.unwrap_or_else(Instant::now) + lost_after);
        tokio::select! {
            biased;
            response = line.responses.next() => {
                let event = match response {
                    Some(Ok(response)) => event(response),
                    Some(Err(error)) => Err(error),
                    None => Err(ClientError::SessionLost("the stream ended".into())),
                };
                match event {
                    Ok(event) => {
                        answered |= matches!(event, Event::Action(_) | Event::Missed(_));
                        asked = None;
                        tell(events, event).await;
                    }
                    Err(error) => return (error, answered),
                }
            }
            () = silent, if asked.is_some() => {
                let problem = format!("the server has said nothing for {lost_after:?}");
                return (ClientError::SessionLost(problem), answered);
            }
            sent = send(&line.requests, slot), if !line.requests.is_closed() || asked.is_none() => {
                // One that found no taker was asked in vain: the reason comes as a response, or nothing does.
                let _ = sent;
                asked.get_or_insert_with(Instant::now);
            }
        }
    }
}

/// Sends the newest observation as soon as there is room for one. May be dropped at any time: nothing is lost.
async fn send(requests: &mpsc::Sender<Request>, slot: &Slot) -> std::result::Result<(), mpsc::error::SendError<()>> {
    // Room first, so that what waits for it is the newest.
    let room = requests.reserve().await?;
    room.send(Request::Observation(slot.take().await));
    Ok(())
}

/// Whether another session may go better: the server was lost or is full, or has closed this one for being silent.
fn may_open_again(error: &ClientError) -> bool {
    error.is_transient() || matches!(error.code(), Some(Code::DeadlineExceeded | Code::ResourceExhausted))
}

fn event(response: Response) -> Result<Event> {
    match response {
        Response::Action(action) => Ok(Event::Action(action)),
        Response::Missed(missed) => Ok(Event::Missed(missed)),
        // It is served until it is closed; then another is opened.
        Response::Draining(_) => Ok(Event::Draining),
        Response::Closed(_) => Err(ClientError::SessionLost("the server closed it".into())),
        Response::Opened(_) => Err(ClientError::Contract { missing: "an action" }),
    }
}

async fn tell(events: &mpsc::Sender<Event>, event: Event) {
    // Nobody is told when the loop has ended; the task is about to end as well.
    let _ = events.send(event).await;
}

async fn close(mut line: Line, outcome: Outcome) -> Option<SessionClosed> {
    let _ = line.requests.send(Request::Close(SessionClose { outcome: outcome.into() })).await;
    while let Some(Ok(response)) = line.responses.next().await {
        if let Response::Closed(closed) = response {
            return Some(closed);
        }
    }
    None
}
