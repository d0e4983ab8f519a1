//! Calls of any rpc by its path with any bytes as its messages, which no generated client can make.

use bytes::{Buf as _, BufMut as _};
use futures::Stream;
use tonic::{
    Code, Request, Status,
    client::Grpc,
    codec::{Codec, DecodeBuf, Decoder, EncodeBuf, Encoder},
    codegen::http::uri::PathAndQuery,
    transport::{Certificate, Channel, ClientTlsConfig},
};

use super::{secure::SecureServer, wait::within};

/// Passes bytes through.
#[derive(Clone, Copy)]
struct Bytes;

impl Codec for Bytes {
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

impl Encoder for Bytes {
    type Item = Vec<u8>;
    type Error = Status;

    fn encode(&mut self, item: Vec<u8>, buffer: &mut EncodeBuf<'_>) -> Result<(), Status> {
        buffer.put_slice(&item);
        Ok(())
    }
}

impl Decoder for Bytes {
    type Item = usize;
    type Error = Status;

    fn decode(&mut self, buffer: &mut DecodeBuf<'_>) -> Result<Option<usize>, Status> {
        let length = buffer.remaining();
        buffer.advance(length);
        Ok(Some(length))
    }
}

/// Opens a connection without a token.
pub async fn connect(server: &SecureServer) -> Channel {
    let tls = ClientTlsConfig::new().ca_certificate(Certificate::from_pem(&server.ca));
    Channel::from_shared(server.running.url.clone()).unwrap().tls_config(tls).unwrap().connect().await.unwrap()
}

/// Calls an rpc with one message; returns the code of its status.
pub async fn call(channel: &Channel, path: &'static str, token: Option<&str>, message: Vec<u8>) -> Code {
    call_with(channel, path, token, tokio_stream::iter([message])).await
}

/// Like [`call`], with a stream of messages.
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
        let mut responses = grpc.streaming(request, PathAndQuery::from_static(path), Bytes).await?.into_inner();
        while responses.message().await?.is_some() {}
        Ok::<(), Status>(())
    };
    match within("the call ends", calling).await {
        Ok(()) => Code::Ok,
        Err(status) => status.code(),
    }
}
