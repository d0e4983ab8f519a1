//! Observations over a WebSocket as msgpack maps of arrays, the protocol of openpi-style servers.

use futures::{SinkExt as _, StreamExt as _};
use gleaner_proto::v1::Observation;
use rmpv::Value;
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async_with_config};

use crate::Result;

/// A connection with one request at a time.
pub struct WebSocket(WebSocketStream<MaybeTlsStream<TcpStream>>);

impl WebSocket {
    /// Connects with TCP_NODELAY and receives the greeting of the server.
    pub(super) async fn connect(url: &str) -> Result<Self> {
        let (stream, _) = connect_async_with_config(url, None, true).await?;
        let mut socket = Self(stream);
        socket.receive().await?;
        Ok(socket)
    }

    /// Sends an observation with raw images; returns the action.
    pub(super) async fn act(&mut self, observation: Observation) -> Result<Vec<f32>> {
        let images = observation.cameras.into_iter().map(|frame| {
            let pixels = frame.color.map(|image| image.data.to_vec()).unwrap_or_default();
            (Value::from(format!("image/{}", frame.camera)), array("|u1", pixels))
        });
        let state: Vec<u8> = observation.proprioception.iter().flat_map(|value| value.to_le_bytes()).collect();
        let fields = images.chain([(Value::from("state"), array("<f4", state))]).collect();
        let mut bytes = Vec::new();
        rmpv::encode::write_value(&mut bytes, &Value::Map(fields))?;
        self.0.send(Message::Binary(bytes.into())).await?;
        let reply = self.receive().await?;
        let data = field(&reply, "actions").and_then(|actions| field(actions, "data")).and_then(Value::as_slice);
        let (floats, _) = data.ok_or("a reply without actions")?.as_chunks::<4>();
        Ok(floats.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect())
    }

    async fn receive(&mut self) -> Result<Value> {
        loop {
            match self.0.next().await.ok_or("the peer has closed the connection")?? {
                Message::Binary(bytes) => return Ok(rmpv::decode::read_value(&mut &bytes[..])?),
                Message::Text(text) => return Err(format!("the peer rejected the request: {text}").into()),
                Message::Close(_) => return Err("the peer has closed the connection".into()),
                Message::Ping(_) | Message::Pong(_) | Message::Frame(_) => {}
            }
        }
    }
}

/// An array: its bytes and their type. The task defines the shape.
fn array(kind: &str, data: Vec<u8>) -> Value {
    Value::Map(vec![("dtype".into(), kind.into()), ("data".into(), Value::Binary(data))])
}

fn field<'a>(map: &'a Value, name: &str) -> Option<&'a Value> {
    map.as_map()?.iter().find(|(key, _)| key.as_str() == Some(name)).map(|(_, value)| value)
}
