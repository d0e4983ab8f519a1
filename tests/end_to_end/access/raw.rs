//! Any rpc by its path, with any bytes as its message: what no generated client would send.

use std::time::Duration;

use bytes::{Buf as _, BufMut as _};
use futures::Stream;
use tonic::{
    Code, Request, Status,
    client::Grpc,
    codec::{Codec, DecodeBuf, Decoder, EncodeBuf, Encoder},
    codegen::http::uri::PathAndQuery,
    transport::{Certificate, Channel, ClientTlsConfig},
};

use super::guarded::Guarded;

/// How long an answer may take; a stream that was let in and says nothing counts as answered.
const PATIENCE: Duration = Duration::from_secs(3);

/// Bytes as they are.
#[derive(Clone, Copy)]
struct Raw;

impl Codec for Raw {
    type Encode = Vec<u8>;
    type Decode = usize;
    type Encoder = Self;
    type Decoder = Self;

    fn encoder(&mut self) -> Self {
        *self
    }

    fn decoder(&mut self) -> Self {
        *self
    }
}

impl Encoder for Raw {
    type Item = Vec<u8>;
    type Error = Status;

    fn encode(&mut self, item: Vec<u8>, buffer: &mut EncodeBuf<'_>) -> Result<(), Status> {
        buffer.put_slice(&item);
        Ok(())
    }
}

impl Decoder for Raw {
    type Item = usize;
    type Error = Status;

    fn decode(&mut self, buffer: &mut DecodeBuf<'_>) -> Result<Option<usize>, Status> {
        let length = buffer.remaining();
        buffer.advance(length);
        Ok(Some(length))
    }
}

pub async fn connect(server: &Guarded) -> Channel {
    let tls = ClientTlsConfig::new().ca_certificate(Certificate::from_pem(&server.ca));
    Channel::from_shared(server.url.clone()).unwrap().tls_config(tls).unwrap().connect().await.unwrap()
}

/// Calls an rpc with one message; the status it ends with, `Ok` also when it is let in and then waits.
pub async fn call(channel: &Channel, path: &'static str, token: Option<&str>, message: Vec<u8>) -> Code {
    call_with(channel, path, token, tokio_stream::iter([message])).await
}

/// As `call`, with messages as they come.
pub async fn call_with(
    channel: &Channel,
    path: &'static str,
    token: Option<&str>,
    messages: impl Stream<Item = Vec<u8>> + Send + 'static,
) -> Code {
    let mut request = Request::new(messages);
    if let Some(token) = token {
        request.metadata_mut().insert("authorization", format!("Bearer {token}").parse().unwrap());
    }
    let mut grpc = Grpc::new(channel.clone());
    grpc.ready().await.unwrap();
    let calling = async {
        let mut answers = grpc.streaming(request, PathAndQuery::from_static(path), Raw).await?.into_inner();
        while answers.message().await?.is_some() {}
        Ok::<(), Status>(())
    };
    match tokio::time::timeout(PATIENCE, calling).await {
        Ok(Ok(())) | Err(_) => Code::Ok,
        Ok(Err(status)) => status.code(),
    }
}
