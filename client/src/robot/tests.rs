//! The control loop against a server with injected delay and loss and a robot that logs its calls. Time is tokio's,
//! paused: it advances only when every task waits, so that every moment below is exact.

mod late;
mod lost;
mod rate;
mod unsafe_ends;

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use futures::FutureExt as _;
use futures::StreamExt as _;
use gleaner_proto::v1::session_request::Message as Request;
use gleaner_proto::v1::session_response::Message as Response;
use gleaner_proto::v1::{
    ActionStep, Observation, SessionAction, SessionClosed, SessionDraining, SessionMissed, SessionOpen, SessionOpened,
};
use tokio::sync::mpsc;
use tokio::time::{Instant, advance, sleep};
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;

use super::*;
use crate::error::{ClientError, Result};

/// 10 Hz, three periods of holding.
fn plan() -> ControlPlan {
    ControlPlan { hold_for: Duration::from_millis(300), ..ControlPlan::new("pick@prod", 10.0).unwrap() }
}

/// The server's reaction to an observation. It handles one at a time.
enum Reply {
    /// Answers after this many milliseconds, with a chunk of one-value actions.
    After(u64, Vec<f32>),
    /// Reports the deadline missed.
    Missed,
    /// Does not answer.
    Nothing,
    /// Stops reading and answering.
    Hang,
    /// Announces its stop, then breaks the stream.
    Drain,
    /// Breaks the stream.
    Break(Status),
}

type Script = Box<dyn FnMut(usize, usize) -> Reply + Send>;

/// A server: its reaction to the n-th observation of the s-th session, and what it has received.
#[derive(Clone)]
struct Server {
    script: Arc<Mutex<Script>>,
    /// Errors of opening before it succeeds, once the first session is open.
    refusals: Arc<Mutex<VecDeque<ClientError>>>,
    opened: Arc<Mutex<Vec<SessionOpen>>>,
    seen: Arc<Mutex<Vec<Observation>>>,
    closed: Arc<Mutex<usize>>,
}

impl Server {
    fn new(script: impl FnMut(usize, usize) -> Reply + Send + 'static) -> Self {
        Self {
            script: Arc::new(Mutex::new(Box::new(script))),
            refusals: Arc::default(),
            opened: Arc::default(),
            seen: Arc::default(),
            closed: Arc::default(),
        }
    }

    /// Refuses to open this many times, as an unreachable server does.
    fn away(self, times: usize) -> Self {
        let refusal = || ClientError::Rejected(Box::new(Status::unavailable("unreachable")));
        self.refusals.lock().unwrap().extend(std::iter::repeat_with(refusal).take(times));
        self
    }

    fn sessions(&self) -> usize {
        self.opened.lock().unwrap().len()
    }

    async fn serve(
        self,
        session: usize,
        mut requests: mpsc::Receiver<Request>,
        responses_to: mpsc::Sender<Result<Response>>,
    ) {
        let mut nth = 0;
        while let Some(request) = requests.recv().await {
            let observation = match request {
                Request::Observation(observation) => observation,
                Request::Close(_) => {
                    *self.closed.lock().unwrap() += 1;
                    let _ = responses_to.send(Ok(Response::Closed(SessionClosed::default()))).await;
                    return;
                }
                Request::Open(_) => panic!("opened twice"),
            };
            let stamp = observation.stamp_ns;
            self.seen.lock().unwrap().push(observation);
            let reply = (self.script.lock().unwrap())(session, nth);
            nth += 1;
            let message = match reply {
                Reply::After(ms, chunk) => {
                    sleep(Duration::from_millis(ms)).await;
                    let actions = chunk.into_iter().map(|value| ActionStep { values: vec![value] }).collect();
                    let action = SessionAction { observation_stamp_ns: stamp, actions, ..SessionAction::default() };
                    Ok(Response::Action(action))
                }
                Reply::Missed => {
                    Ok(Response::Missed(SessionMissed { observation_stamp_ns: stamp, ..SessionMissed::default() }))
                }
                Reply::Nothing => continue,
                Reply::Hang => std::future::pending().await,
                Reply::Drain => {
                    let _ = responses_to.send(Ok(Response::Draining(SessionDraining::default()))).await;
                    Err(Status::unavailable("the server has stopped").into())
                }
                Reply::Break(status) => Err(status.into()),
            };
            let broken = message.is_err();
            let _ = responses_to.send(message).await;
            if broken {
                return;
            }
        }
    }
}

impl Link for Server {
    async fn open(&mut self, open: &SessionOpen) -> Result<SessionChannel> {
        let session = self.sessions();
        let refusal = if session > 0 { self.refusals.lock().unwrap().pop_front() } else { None };
        if let Some(refusal) = refusal {
            return Err(refusal);
        }
        self.opened.lock().unwrap().push(open.clone());
        let (requests, received) = mpsc::channel(1);
        let (responses_to, responses) = mpsc::channel(1);
        tokio::spawn(self.clone().serve(session, received, responses_to));
        let opened = SessionOpened { policy_id: format!("pol_{session}"), ..SessionOpened::default() };
        Ok(SessionChannel { opened, requests, responses: ReceiverStream::new(responses).boxed() })
    }
}

#[derive(Debug, thiserror::Error)]
#[error("{0} failed")]
struct Broken(&'static str);

#[derive(Clone, Copy, Debug, PartialEq)]
enum Done {
    Command(f32),
    Stop,
}

/// A robot that logs its calls with the milliseconds since the beginning. It has `observations` observations.
struct Noting {
    begin: Instant,
    observations: usize,
    observed: Vec<u128>,
    done: Vec<(u128, Done)>,
    /// The faults at the n-th call of each method: how long observing takes, and which call fails.
    slow: fn(usize) -> u64,
    fails: fn(&'static str, usize) -> bool,
    stamp: fn(usize) -> i64,
    hold: Option<f32>,
}

impl Noting {
    fn new(observations: usize) -> Self {
        Self {
            begin: Instant::now(),
            observations,
            observed: Vec::new(),
            done: Vec::new(),
            slow: |_| 0,
            fails: |_, _| false,
            stamp: |_| 0,
            hold: None,
        }
    }

    fn note(&mut self, done: Done, what: &'static str) -> std::result::Result<(), Broken> {
        let nth = self.done.len();
        self.done.push((self.begin.elapsed().as_millis(), done));
        if (self.fails)(what, nth) { Err(Broken(what)) } else { Ok(()) }
    }

    fn stops(&self) -> usize {
        self.done.iter().filter(|(_, done)| *done == Done::Stop).count()
    }

    fn stopped_at_last(&self) -> bool {
        matches!(self.done.last(), Some((_, Done::Stop)))
    }
}

impl Robot for Noting {
    type Error = Broken;

    fn observe(&mut self) -> std::result::Result<Option<Observation>, Broken> {
        let nth = self.observed.len();
        if nth == self.observations {
            return Ok(None);
        }
        self.observed.push(self.begin.elapsed().as_millis());
        // Advances the paused clock as if this call had taken this long.
        advance(Duration::from_millis((self.slow)(nth))).now_or_never();
        if (self.fails)("observe", nth) {
            return Err(Broken("observe"));
        }
        Ok(Some(Observation { stamp_ns: (self.stamp)(nth), ..Observation::default() }))
    }

    fn command(&mut self, action: &[f32]) -> std::result::Result<(), Broken> {
        self.note(Done::Command(action[0]), "command")
    }

    fn stop(&mut self) -> std::result::Result<(), Broken> {
        self.note(Done::Stop, "stop")
    }

    fn hold_action(&self, last: &[f32]) -> Vec<f32> {
        self.hold.map_or_else(|| last.to_vec(), |hold| vec![hold])
    }
}

/// Runs to the robot's end.
async fn run(
    robot: &mut Noting,
    server: &Server,
    plan: &ControlPlan,
) -> std::result::Result<ControlReport, ControlError<Broken>> {
    control(robot, server.clone(), plan, std::future::pending()).await
}
