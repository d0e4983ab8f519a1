//! The ways in: a session of gleaner's own protocol, or a WebSocket. Each on a connection of its own, as each robot
//! has one.

mod websocket;

use std::time::{Duration, Instant};

use gleaner_client::{Client, Session};
use gleaner_proto::v1::{Observation, Timings};

use self::websocket::WebSocket;
use crate::Result;

/// Where a server listens, and how it is spoken to.
#[derive(Debug, Clone)]
pub enum Address {
    Session { url: String, deployment: String },
    WebSocket { url: String },
}

/// One robot's connection.
pub struct Door {
    line: Line,
    /// The next observation's.
    stamp_ns: i64,
}

enum Line {
    Session { session: Box<Session>, _client: Client },
    WebSocket(Box<WebSocket>),
}

/// What came back.
pub struct Answer {
    pub action: Vec<f32>,
    pub round_trip: Duration,
    /// Where the server says the time went; peers do not say.
    pub timings: Option<Timings>,
}

impl Door {
    pub async fn open(address: &Address) -> Result<Self> {
        let line = match address {
            Address::Session { url, deployment } => {
                let client = Client::connect(url, None).await?;
                let session = Box::new(Session::open(&client, deployment).await?);
                Line::Session { session, _client: client }
            }
            Address::WebSocket { url } => Line::WebSocket(Box::new(WebSocket::connect(url).await?)),
        };
        Ok(Self { line, stamp_ns: 0 })
    }

    pub async fn open_many(address: &Address, count: usize) -> Result<Vec<Self>> {
        let mut doors = Vec::with_capacity(count);
        for _ in 0..count {
            doors.push(Self::open(address).await?);
        }
        Ok(doors)
    }

    /// Sends an observation and waits for its answer; timed from before it is put into bytes until its action is there.
    pub async fn act(&mut self, observation: &Observation) -> Result<Answer> {
        self.stamp_ns += 1;
        let observation = Observation { stamp_ns: self.stamp_ns, ..observation.clone() };
        let begun = Instant::now();
        let (action, timings) = match &mut self.line {
            Line::Session { session, .. } => {
                let answer = session.act(observation).await?;
                (answer.actions.into_iter().next().map(|step| step.values), answer.timings)
            }
            Line::WebSocket(socket) => (Some(socket.act(observation).await?), None),
        };
        let round_trip = begun.elapsed();
        Ok(Answer { action: action.ok_or("an answer without an action")?, round_trip, timings })
    }
}
