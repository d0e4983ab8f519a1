//! A robot: a session of which a test sends and receives each message, and observations of the simulator.

use gleaner_proto::v1::{session_request::Message as SessionMessage, session_response::Message as SessionReply, *};
use gleaner_sim::{Sim, Task as SimTask};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Status, Streaming};

use super::{api::Api, lab};

/// The simulator at the start of an episode.
pub fn start_sim() -> Sim {
    Sim::new(SimTask::PickCube, lab::sim_config(), 99)
}

/// The current observation of the simulator as a message.
pub fn observe(sim: &Sim) -> Observation {
    let seen = sim.observe();
    gleaner_client::observation(&lab::spec(), seen.stamp_ns, seen.frames, seen.proprioception).unwrap()
}

/// The robot's end of a session.
pub struct Robot {
    requests: mpsc::Sender<SessionRequest>,
    responses: Streaming<SessionResponse>,
    /// The first answer of the server.
    pub opened: SessionOpened,
}

impl Robot {
    /// Connects without the opening message.
    pub async fn connect(api: &mut Api) -> Self {
        let (requests, receiver) = mpsc::channel(8);
        let responses = api.policies.session(ReceiverStream::new(receiver)).await.unwrap().into_inner();
        Self { requests, responses, opened: SessionOpened::default() }
    }

    /// Opens a session on a deployment.
    pub async fn open(api: &mut Api, deployment: &str) -> Result<Self, Status> {
        Self::open_with(api, SessionOpen { deployment: deployment.into(), ..SessionOpen::default() }).await
    }

    /// Opens a session with these settings.
    pub async fn open_with(api: &mut Api, open: SessionOpen) -> Result<Self, Status> {
        let mut robot = Self::connect(api).await;
        robot.send(SessionMessage::Open(open)).await;
        match robot.receive().await? {
            SessionReply::Opened(opened) => Ok(Self { opened, ..robot }),
            other => panic!("{other:?}"),
        }
    }

    pub async fn send(&self, message: SessionMessage) {
        self.requests.send(SessionRequest { message: Some(message) }).await.unwrap();
    }

    pub async fn receive(&mut self) -> Result<SessionReply, Status> {
        Ok(self.responses.message().await?.expect("the session is open").message.unwrap())
    }

    /// Checks that the server has ended the session without an error.
    pub async fn expect_end(&mut self) {
        assert!(self.responses.message().await.unwrap().is_none());
    }

    /// Sends an observation and receives its action.
    pub async fn act(&mut self, observation: Observation) -> Result<SessionAction, Status> {
        self.send(SessionMessage::Observation(observation)).await;
        match self.receive().await? {
            SessionReply::Action(action) => Ok(action),
            other => panic!("{other:?}"),
        }
    }

    /// Closes the session.
    pub async fn close(&mut self) -> SessionClosed {
        self.send(SessionMessage::Close(SessionClose::default())).await;
        let SessionReply::Closed(closed) = self.receive().await.unwrap() else { panic!("not closed") };
        closed
    }
}

/// Whether actions are equal up to the last digits, which depend on the size of a batch.
pub fn close(a: &[f32], b: &[f32]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-4)
}

/// The values of actions, one after the other.
pub fn values(steps: &[ActionStep]) -> Vec<f32> {
    steps.iter().flat_map(|step| step.values.clone()).collect()
}
