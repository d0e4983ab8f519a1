//! Connections of robots: a session of gleaner's protocol, or a WebSocket.

mod websocket;

use std::time::{Duration, Instant};

use gleaner_client::{Client, Session};
use gleaner_proto::v1::{Observation, Timings};

use self::websocket::WebSocket;
use crate::Result;

/// The address of a server, with its protocol.
#[derive(Debug, Clone)]
pub enum Address {
    Session { url: String, deployment: String },
    WebSocket { url: String },
}

/// The connection of one robot.
pub struct Connection {
    transport: Transport,
    /// The stamp of the next observation.
    stamp_ns: i64,
}

enum Transport {
    Session { session: Box<Session>, _client: Client },
    WebSocket(Box<WebSocket>),
}

/// An action with its round trip.
pub struct Reply {
    pub action: Vec<f32>,
    pub round_trip: Duration,
    /// The timings of the server; peers have none.
    pub timings: Option<Timings>,
}

impl Connection {
    pub async fn open(address: &Address) -> Result<Self> {
        let transport = match address {
            Address::Session { url, deployment } => {
                let client = Client::connect(url, None).await?;
                let session = Box::new(Session::open(&client, deployment).await?);
                Transport::Session { session, _client: client }
            }
            Address::WebSocket { url } => Transport::WebSocket(Box::new(WebSocket::connect(url).await?)),
        };
        Ok(Self { transport, stamp_ns: 0 })
    }

    pub async fn open_many(address: &Address, count: usize) -> Result<Vec<Self>> {
        let mut connections = Vec::with_capacity(count);
        for _ in 0..count {
            connections.push(Self::open(address).await?);
        }
        Ok(connections)
    }

    /// Sends an observation and receives its reply. The time starts before serialisation and ends with the action.
    pub async fn act(&mut self, observation: &Observation) -> Result<Reply> {
        self.stamp_ns += 1;
        let observation = Observation { stamp_ns: self.stamp_ns, ..observation.clone() };
        let begun = Instant::now();
        let (action, timings) = match &mut self.transport {
            Transport::Session { session, .. } => {
                let reply = session.act(observation).await?;
                (reply.actions.into_iter().next().map(|step| step.values), reply.timings)
            }
            Transport::WebSocket(socket) => (Some(socket.act(observation).await?), None),
        };
        let round_trip = begun.elapsed();
        Ok(Reply { action: action.ok_or("a reply without an action")?, round_trip, timings })
    }
}
