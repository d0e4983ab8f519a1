//! The connection: one HTTP/2 channel with its limits, and a typed client for each service.
//!
//! Plain calls go through the generated clients that [`Client`] returns; calls that need a loop or a rule (upload, watch,
//! download, session) are methods of `Client` in the files of those names.

use std::time::Duration;

use gleaner_proto::v1::dataset_service_client::DatasetServiceClient;
use gleaner_proto::v1::episode_service_client::EpisodeServiceClient;
use gleaner_proto::v1::job_service_client::JobServiceClient;
use gleaner_proto::v1::policy_service_client::PolicyServiceClient;
use gleaner_proto::v1::schedule_service_client::ScheduleServiceClient;
use gleaner_proto::v1::score_service_client::ScoreServiceClient;
use gleaner_proto::v1::snapshot_service_client::SnapshotServiceClient;
use gleaner_proto::v1::task_service_client::TaskServiceClient;
use tonic::service::Interceptor;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::{Channel, Endpoint};

use crate::credentials::Credentials;
use crate::direct::Direct;
use crate::error::{ClientError, Result};
use crate::reason::reason;
use crate::token::Token;

// A segment of large raw frames is the biggest message the server sends.
const LARGEST_REPLY: usize = 256 << 20;
// 64 KiB, the protocol's default, would cap a distant link near 1 MB/s.
const WINDOW: u32 = 8 << 20;

// The limit on the test whether a server encrypts.
const PROBE: Duration = Duration::from_secs(3);

/// The transport of the service clients: the channel plus the token.
pub type Transport = InterceptedService<Channel, Authorize>;

/// Adds the token to each request.
#[derive(Clone, Debug)]
pub struct Authorize {
    token: Option<Token>,
}

impl Interceptor for Authorize {
    fn call(&mut self, mut request: tonic::Request<()>) -> std::result::Result<tonic::Request<()>, tonic::Status> {
        if let Some(token) = &self.token {
            request.metadata_mut().insert("authorization", token.header());
        }
        Ok(request)
    }
}

/// A connection to a gleaner server. Cheap to clone; clones share the connection, which is reopened when it breaks.
#[derive(Clone, Debug)]
pub struct Client {
    transport: Transport,
    direct: Direct,
}

impl Client {
    /// Connects to a server, for example `http://127.0.0.1:7400`; as `connect_with` with nothing but a token.
    ///
    /// # Errors
    /// [`ClientError::Invalid`] for a malformed address, [`ClientError::Connect`] when no server answers.
    pub async fn connect(url: &str, token: Option<Token>) -> Result<Self> {
        Self::connect_with(url, Credentials::of(token)).await
    }

    /// Connects to a server, encrypted when its address begins with `https://`.
    ///
    /// # Errors
    /// [`ClientError::Invalid`] for a malformed address or certificate, [`ClientError::Connect`] when no server answers
    /// or one side does not trust the other.
    pub async fn connect_with(url: &str, credentials: Credentials) -> Result<Self> {
        let tls = credentials.tls(url)?;
        let mut endpoint = Endpoint::from_shared(url.to_owned())
            .map_err(|error| ClientError::Invalid(format!("server address {url}: {error}")))?
            .user_agent(concat!("gleaner/", env!("CARGO_PKG_VERSION")))
            .map_err(|error| ClientError::Invalid(error.to_string()))?
            .connect_timeout(Duration::from_secs(10))
            .tcp_nodelay(true)
            .initial_stream_window_size(WINDOW)
            .initial_connection_window_size(2 * WINDOW)
            // A dead peer is detected in half a minute; a robot's session cannot be opened anew before that.
            .http2_keep_alive_interval(Duration::from_secs(10))
            .keep_alive_timeout(Duration::from_secs(20));
        if let Some(tls) = tls {
            endpoint = endpoint
                .tls_config(tls)
                .map_err(|error| ClientError::Invalid(format!("certificates: {}", reason(&error))))?;
        }
        let channel = endpoint
            .connect()
            .await
            .map_err(|error| ClientError::Connect { url: url.to_owned(), problem: reason(&error) })?;
        let Credentials { token, ca: _, identity: _ } = credentials;
        Ok(Self {
            transport: InterceptedService::new(channel, Authorize { token }),
            direct: Direct::new(url.starts_with("https://")),
        })
    }

    /// Whether the server at an `http://` address encrypts, so that clients must write `https://`. The reply
    /// to a client without encryption depends on chance, so this opens a connection of its own, for 3 seconds at most.
    pub async fn encrypts(url: &str) -> bool {
        let Some(address) = url.strip_prefix("http://") else { return false };
        let encrypted = format!("https://{address}");
        let attempt = Self::connect_with(&encrypted, Credentials::default());
        match tokio::time::timeout(PROBE, attempt).await {
            Ok(Ok(_)) => true,
            Ok(Err(ClientError::Connect { problem, .. })) => {
                problem.contains("invalid peer certificate") || problem.contains("fatal alert")
            }
            Ok(Err(_)) | Err(_) => false,
        }
    }

    /// The way to the server's bucket.
    pub(crate) fn direct(&self) -> &Direct {
        &self.direct
    }

    /// Tasks.
    #[must_use]
    pub fn tasks(&self) -> TaskServiceClient<Transport> {
        TaskServiceClient::new(self.transport.clone())
    }

    /// Episodes and their labels.
    #[must_use]
    pub fn episodes(&self) -> EpisodeServiceClient<Transport> {
        EpisodeServiceClient::new(self.transport.clone())
    }

    /// Snapshots.
    #[must_use]
    pub fn snapshots(&self) -> SnapshotServiceClient<Transport> {
        SnapshotServiceClient::new(self.transport.clone())
    }

    /// Jobs and pipelines.
    #[must_use]
    pub fn jobs(&self) -> JobServiceClient<Transport> {
        JobServiceClient::new(self.transport.clone()).max_decoding_message_size(LARGEST_REPLY)
    }

    /// Schedules.
    #[must_use]
    pub fn schedules(&self) -> ScheduleServiceClient<Transport> {
        ScheduleServiceClient::new(self.transport.clone())
    }

    /// Score runs.
    #[must_use]
    pub fn scores(&self) -> ScoreServiceClient<Transport> {
        ScoreServiceClient::new(self.transport.clone()).max_decoding_message_size(LARGEST_REPLY)
    }

    /// Datasets and exports.
    #[must_use]
    pub fn datasets(&self) -> DatasetServiceClient<Transport> {
        DatasetServiceClient::new(self.transport.clone()).max_decoding_message_size(LARGEST_REPLY)
    }

    /// Policies, deployments and sessions.
    #[must_use]
    pub fn policies(&self) -> PolicyServiceClient<Transport> {
        PolicyServiceClient::new(self.transport.clone()).max_encoding_message_size(LARGEST_REPLY)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn malformed_addresses_are_rejected() {
        for url in ["127.0.0.1:7400", "ftp://lab.example", "http://a b", "https://a b"] {
            let error = Client::connect(url, None).await.unwrap_err();
            assert!(matches!(error, ClientError::Invalid(_)), "{url}: {error}");
        }
    }

    #[tokio::test]
    async fn an_unreachable_server_is_an_error_with_the_fix() {
        // Bound to the end of the test, so that no other process gets the port, and without a listener.
        let socket = tokio::net::TcpSocket::new_v4().unwrap();
        socket.bind(([127, 0, 0, 1], 0).into()).unwrap();
        let port = socket.local_addr().unwrap().port();
        let error = Client::connect(&format!("http://127.0.0.1:{port}"), None).await.unwrap_err();
        let message = error.to_string();
        assert!(message.contains("gleaner-server serve") && message.contains(&port.to_string()), "{message}");
        assert!(error.is_transient());
        drop(socket);
    }
}
