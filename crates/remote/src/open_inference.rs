//! A server of the Open Inference Protocol: one connection for all sessions, one call for each observation.

mod message;
mod metadata;

use std::time::Duration;

use gleaner_core::{Error, Result, Secret, remote::RemotePolicy};
use gleaner_proto::inference::{
    ModelInferResponse, ModelMetadataRequest, grpc_inference_service_client::GrpcInferenceServiceClient,
};
use tonic::{
    Code, Request, Status,
    metadata::{Ascii, MetadataValue},
    transport::{Certificate, Channel, ClientTlsConfig, Endpoint},
};

use self::metadata::Tensors;
use crate::{
    actions::Actions,
    address::Address,
    fault::{At, cause, shown},
    inputs::Value,
    outgoing::Outgoing,
};

/// A dead server is noticed within twice this time.
const KEEPALIVE: Duration = Duration::from_secs(10);
/// The largest description of a model.
const METADATA_BYTES: usize = 256 << 10;
/// The most bytes of an answer's headers.
const HEADER_BYTES: u32 = 16 << 10;

/// The place of an observation in a session whose history the server keeps.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sequence {
    pub(crate) id: i64,
    pub(crate) start: bool,
    pub(crate) end: bool,
}

/// A connection to a server, with the description of the model. Clones share it.
#[derive(Debug, Clone)]
pub(crate) struct Connection {
    client: GrpcInferenceServiceClient<Channel>,
    authorization: Option<MetadataValue<Ascii>>,
    tensors: Tensors,
    at: At,
}

impl Connection {
    /// Connects, and reads the description of the model.
    ///
    /// # Errors
    /// Unavailable when the server does not answer; Precondition when it has no such model, or other tensors.
    pub(crate) async fn open(
        policy: &RemotePolicy,
        address: &Address,
        outgoing: &Outgoing,
        (names, actions): (&[(&str, Value<'_>)], &Actions),
    ) -> Result<Self> {
        let at = At(address.text.clone());
        let endpoint = endpoint(address, outgoing, &at).await?;
        let channel = endpoint.connect().await.map_err(|error| at.silent(cause(&error)))?;
        let authorization = outgoing.token(address).await?.map(|token| bearer(&token, &at)).transpose()?;
        let client = GrpcInferenceServiceClient::new(channel);
        let mut connection = Self { client, authorization, tensors: Tensors::default(), at };
        let request = ModelMetadataRequest { name: policy.model.clone(), version: policy.model_version.clone() };
        let request = connection.authorized(request);
        let mut client = connection.client.clone().max_decoding_message_size(METADATA_BYTES);
        connection.tensors = match client.model_metadata(request).await {
            Ok(response) => {
                let wrong = |problem| connection.at.wrong(problem);
                Tensors::read(response.into_inner(), names, actions).map_err(wrong)?
            }
            // Not every server describes its models.
            Err(status) if status.code() == Code::Unimplemented => Tensors::default(),
            Err(status) => return Err(connection.refused(&status)),
        };
        connection.client = connection.client.max_decoding_message_size(actions.bytes());
        Ok(connection)
    }

    /// The actions for an observation.
    ///
    /// # Errors
    /// Unavailable when the server does not answer; Precondition when it refuses or answers with something else.
    pub(crate) async fn infer(
        &self,
        policy: &RemotePolicy,
        values: Vec<(&str, Value<'_>)>,
        sequence: Option<Sequence>,
        actions: &Actions,
    ) -> Result<Vec<Vec<f32>>> {
        let request = self.authorized(message::request(policy, values, sequence, &self.tensors));
        let answer = self.client.clone().model_infer(request).await;
        let answer: ModelInferResponse = answer.map_err(|status| self.refused(&status))?.into_inner();
        let read = message::output(answer, &actions.output).and_then(|(shape, values)| actions.chunk(&shape, &values));
        read.map_err(|problem| self.at.wrong(problem))
    }

    fn authorized<T>(&self, message: T) -> Request<T> {
        let mut request = Request::new(message);
        if let Some(token) = &self.authorization {
            request.metadata_mut().insert("authorization", token.clone());
        }
        request
    }

    /// The error of a call: that of the request lasts, others may pass.
    fn refused(&self, status: &Status) -> Error {
        let message = match std::error::Error::source(status) {
            Some(source) => cause(source),
            None => shown(status.message()),
        };
        let problem = format!("{} ({:?})", message, status.code());
        match status.code() {
            Code::InvalidArgument
            | Code::NotFound
            | Code::FailedPrecondition
            | Code::OutOfRange
            | Code::Unimplemented
            | Code::PermissionDenied
            | Code::Unauthenticated => self.at.wrong(format!("it refused the call: {problem}")),
            Code::Ok
            | Code::Cancelled
            | Code::Unknown
            | Code::DeadlineExceeded
            | Code::AlreadyExists
            | Code::ResourceExhausted
            | Code::Aborted
            | Code::Internal
            | Code::Unavailable
            | Code::DataLoss => self.at.silent(problem),
        }
    }
}

async fn endpoint(address: &Address, outgoing: &Outgoing, at: &At) -> Result<Endpoint> {
    let wrong = |error: tonic::transport::Error| at.wrong(cause(&error));
    let endpoint = Endpoint::from_shared(address.text.clone())
        .and_then(|endpoint| endpoint.user_agent(concat!("gleaner/", env!("CARGO_PKG_VERSION"))))
        .map_err(wrong)?
        .tcp_nodelay(true)
        .http2_keep_alive_interval(KEEPALIVE)
        .keep_alive_timeout(KEEPALIVE)
        .http2_max_header_list_size(HEADER_BYTES);
    if !address.encrypted {
        return Ok(endpoint);
    }
    let tls = match outgoing.authorities().await? {
        Some(pem) => ClientTlsConfig::new().ca_certificate(Certificate::from_pem(pem)),
        None => ClientTlsConfig::new().with_native_roots(),
    };
    endpoint.tls_config(tls).map_err(wrong)
}

/// The token as a header, which HTTP/2 does not index.
fn bearer(token: &Secret, at: &At) -> Result<MetadataValue<Ascii>> {
    let header = format!("Bearer {}", token.reveal()).parse();
    let mut header: MetadataValue<Ascii> = header.map_err(|_| at.wrong("its token is not a header"))?;
    header.set_sensitive(true);
    Ok(header)
}
