//! Parts of fake servers of openpi's protocol.

use rmpv::Value;
use tokio::net::{TcpListener, TcpStream};
use tokio_tungstenite::{WebSocketStream, tungstenite::Message};

pub(crate) type Socket = WebSocketStream<TcpStream>;

/// Listens, and has `serve` handle each connection.
pub(crate) async fn listen<F: Future<Output = ()> + Send + 'static>(
    serve: impl Fn(TcpStream) -> F + Send + 'static,
) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = format!("ws://{}/arm@prod", listener.local_addr().unwrap());
    tokio::spawn(async move {
        while let Ok((stream, _)) = listener.accept().await {
            tokio::spawn(serve(stream));
        }
    });
    address
}

pub(crate) fn packed(value: &Value) -> Vec<u8> {
    let mut bytes = Vec::new();
    rmpv::encode::write_value(&mut bytes, value).unwrap();
    bytes
}

/// An array as numpy's packers write it.
pub(crate) fn array(dtype: &str, shape: &[usize], data: Vec<u8>) -> Value {
    let key = |name: &str| Value::Binary(name.as_bytes().to_vec());
    Value::Map(vec![
        (key("__ndarray__"), Value::Boolean(true)),
        (key("data"), Value::Binary(data)),
        (key("dtype"), dtype.into()),
        (key("shape"), Value::Array(shape.iter().map(|size| (*size).into()).collect())),
    ])
}

pub(crate) fn actions(value: Value) -> Message {
    Message::binary(packed(&Value::Map(vec![("actions".into(), value)])))
}

pub(crate) fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// The state of a request, as the server received it.
pub(crate) fn state(request: &Value) -> Vec<u8> {
    let entry = |value: &Value, name: &str| {
        let found = value
            .as_map()
            .unwrap()
            .iter()
            .find(|(key, _)| key.as_str() == Some(name) || key.as_slice() == Some(name.as_bytes()));
        found.unwrap_or_else(|| panic!("{name} is missing in {value}")).1.clone()
    };
    entry(&entry(request, "observation/state"), "data").as_slice().unwrap().to_vec()
}
