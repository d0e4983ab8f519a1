//! The worker's calls to its server, each with the attempt's token.

mod blobs;

use std::{error::Error as _, net::SocketAddr, time::Duration};

use futures::stream;
use gleaner_proto::v1::{self, worker_service_client::WorkerServiceClient};
use tokio::time::{Instant, sleep};
use tonic::{
    Code, Request, Status,
    metadata::{Ascii, MetadataValue},
    service::{Interceptor, interceptor::InterceptedService},
    transport::{Certificate, Channel, ClientTlsConfig, Endpoint},
};

pub(crate) use self::blobs::BlobCalls;
use crate::config::WorkerConfig;
use gleaner_core::{
    error::{Error, Result},
    id::{BlobId, JobId},
    order::JobOrder,
    proto,
    score::EpisodeScores,
    work::{InputPart, Inputs, Made, Progress},
};

const CONNECT_TIMEOUT: Duration = Duration::from_secs(10);
/// Interval of pings while a call is open: a call to a machine that is gone would otherwise wait for minutes.
const PING_EVERY: Duration = Duration::from_secs(30);
/// Time for which a worker retries a call that the server rejects for the moment.
pub(crate) const RETRY_FOR: Duration = Duration::from_secs(600);
const FIRST_PAUSE: Duration = Duration::from_millis(100);
pub(crate) const LONGEST_PAUSE: Duration = Duration::from_secs(5);

/// The metadata that identifies this process; the server accepts one process for each attempt.
const PROCESS: &str = "worker-process";
/// The metadata that names the node of a cluster where this process runs.
const NODE: &str = "worker-node";
/// The metadata with this process's number among those of its attempt.
const RANK: &str = "worker-rank";
/// The metadata of every error that the server itself returns.
const REQUEST_ID: &str = "request-id";

/// Adds the token, the process and its node to every call.
#[derive(Clone)]
struct Bearer {
    token: MetadataValue<Ascii>,
    process: MetadataValue<Ascii>,
    node: MetadataValue<Ascii>,
    rank: MetadataValue<Ascii>,
}

impl Interceptor for Bearer {
    fn call(&mut self, mut request: Request<()>) -> std::result::Result<Request<()>, Status> {
        request.metadata_mut().insert("authorization", self.token.clone());
        request.metadata_mut().insert(PROCESS, self.process.clone());
        request.metadata_mut().insert(NODE, self.node.clone());
        request.metadata_mut().insert(RANK, self.rank.clone());
        Ok(request)
    }
}

/// The client of one attempt of one job; clones share its connection.
#[derive(Clone)]
pub(crate) struct Client(WorkerServiceClient<InterceptedService<Channel, Bearer>>);

impl Client {
    /// Prepares the connection, which the first call opens.
    ///
    /// # Errors
    /// Invalid names the argument that cannot be used.
    pub(crate) fn new(config: &WorkerConfig) -> Result<Self> {
        let mut endpoint = Endpoint::from_shared(config.server.clone())
            .map_err(|error| Error::invalid("--server", error))?
            .connect_timeout(CONNECT_TIMEOUT)
            .http2_keep_alive_interval(PING_EVERY)
            .keep_alive_timeout(CONNECT_TIMEOUT)
            .tcp_nodelay(true);
        if config.server.starts_with("https://") {
            let tls = match &config.ca {
                Some(pem) => ClientTlsConfig::new().ca_certificate(Certificate::from_pem(pem)),
                None => ClientTlsConfig::new().with_native_roots(),
            };
            endpoint = endpoint.tls_config(tls).map_err(|error| Error::invalid("--ca", error))?;
        }
        let channel = endpoint.connect_lazy();
        let mut token: MetadataValue<Ascii> = format!("Bearer {}", config.token.reveal())
            .parse()
            .map_err(|_| Error::invalid("GLEANER_JOB_TOKEN", "is not a token"))?;
        token.set_sensitive(true);
        let process = process_name().parse().map_err(|error| Error::internal("naming this process", error))?;
        let node = config.node.parse().map_err(|error| Error::invalid("--node", error))?;
        let rank = config.rank.into();
        let client = WorkerServiceClient::with_interceptor(channel, Bearer { token, process, node, rank })
            .max_decoding_message_size(config.max_message_bytes)
            .max_encoding_message_size(config.max_message_bytes);
        Ok(Self(client))
    }

    /// The assignment: the job, its order and its inputs with their episodes.
    pub(crate) async fn assignment(&mut self) -> Result<(JobId, JobOrder, Inputs)> {
        let received = with_retries(async || {
            let assignment = self.0.get_assignment(v1::GetAssignmentRequest {}).await?.into_inner();
            self.episodes().await.map(|episodes| (assignment, episodes))
        });
        match received.await {
            Ok((assignment, episodes)) => {
                let (job, order, mut inputs) = proto::worker::assigned(assignment)?;
                episodes.into_iter().for_each(|part| inputs.add(part));
                Ok((job, order, inputs))
            }
            Err(status) => {
                if status.code() == Code::FailedPrecondition {
                    // Every attempt would get the same error.
                    self.fail(status.message().to_owned(), false).await?;
                }
                Err(refused(status))
            }
        }
    }

    /// The episodes of the inputs.
    async fn episodes(&mut self) -> tonic::Result<Vec<InputPart>> {
        let mut stream = self.0.stream_episodes(v1::StreamEpisodesRequest {}).await?.into_inner();
        let mut episodes = Vec::new();
        while let Some(response) = stream.message().await? {
            episodes.extend(proto::worker::episodes_from(response).map_err(malformed)?);
        }
        Ok(episodes)
    }

    /// The scores of the run that the job extends.
    pub(crate) async fn base_scores(&mut self) -> Result<Vec<EpisodeScores>> {
        let received = with_retries(async || {
            let mut stream = self.0.stream_base_scores(v1::StreamBaseScoresRequest {}).await?.into_inner();
            let mut scores = Vec::new();
            while let Some(response) = stream.message().await? {
                scores.push(proto::worker::base_scores_from(response).map_err(malformed)?);
            }
            Ok(scores)
        });
        received.await.map_err(refused)
    }

    /// Reports where this process, rank 0, waits for the others.
    pub(crate) async fn report_meeting(&mut self, address: SocketAddr) -> Result<()> {
        let request = v1::ReportMeetingRequest { address: address.to_string() };
        with_retries(async || self.0.report_meeting(request.clone()).await).await.map_err(refused)?;
        Ok(())
    }

    /// Where rank 0 waits.
    ///
    /// # Errors
    /// Unavailable when it does not report within `limit`.
    pub(crate) async fn meeting(&mut self, limit: Duration) -> Result<SocketAddr> {
        let begun = Instant::now();
        loop {
            let call = with_retries(async || self.0.get_meeting(v1::GetMeetingRequest {}).await);
            if let Some(address) = proto::worker::meeting(call.await.map_err(refused)?.into_inner())? {
                return Ok(address);
            }
            if begun.elapsed() >= limit {
                return Err(Error::unavailable(format!("rank 0 did not report within {} s", limit.as_secs())));
            }
        }
    }

    /// Reports progress; returns whether to stop.
    pub(crate) async fn report_progress(&mut self, progress: Progress) -> Result<bool> {
        let request = proto::worker::progress(progress);
        let response = with_retries(async || self.0.report_progress(request.clone()).await).await.map_err(refused)?;
        Ok(response.into_inner().cancel)
    }

    /// Names the blob to resume from. False when the blob is gone: another job had the same blob and removed it.
    pub(crate) async fn save_checkpoint(&mut self, step: u64, blob: BlobId) -> Result<bool> {
        let request = v1::SaveCheckpointRequest { step, blob: blob.into() };
        match with_retries(async || self.0.save_checkpoint(request.clone()).await).await {
            Ok(_) => Ok(true),
            Err(status) if status.code() == Code::NotFound => Ok(false),
            Err(status) => Err(refused(status)),
        }
    }

    /// Ends the job with its result. A result that the server rejects also ends the job.
    pub(crate) async fn complete(&mut self, made: Made) -> Result<()> {
        let messages = proto::worker::completion_messages(made);
        match with_retries(async || self.0.complete_job(stream::iter(messages.clone())).await).await {
            Ok(_) => Ok(()),
            Err(status) if status.code() == Code::Cancelled => Ok(()),
            Err(status) if matches!(status.code(), Code::InvalidArgument | Code::NotFound) => {
                // A missing blob can be made again; a result that does not fit would not fit the next time either.
                let again = status.code() == Code::NotFound;
                self.fail(format!("the server refused the result: {}", status.message()), again).await
            }
            Err(status) => Err(refused(status)),
        }
    }

    /// Ends the attempt with an error.
    pub(crate) async fn fail(&mut self, error: String, retry: bool) -> Result<()> {
        let request = v1::FailJobRequest { error, retry };
        with_retries(async || self.0.fail_job(request.clone()).await).await.map_err(refused)?;
        Ok(())
    }
}

/// Retries a call until the server accepts it, for up to [`RETRY_FOR`]: a full or slow disk, a restart of the server or a
/// failure of the network must not end a job. Each call also shows the server that the worker is alive.
async fn with_retries<T>(mut call: impl AsyncFnMut() -> tonic::Result<T>) -> tonic::Result<T> {
    let (begun, mut pause) = (Instant::now(), FIRST_PAUSE);
    loop {
        let status = match call().await {
            Err(status) if is_transient(&status) => status,
            answer => return answer,
        };
        if begun.elapsed() >= RETRY_FOR {
            return Err(status);
        }
        let reason = with_sources(&status);
        tracing::warn!(code = ?status.code(), reason, "the server did not accept a message; retrying");
        sleep(pause).await;
        pause = LONGEST_PAUSE.min(pause * 2);
    }
}

/// Whether a repetition may succeed: the server has no room or time, or a failure of the connection is the reason, whose
/// errors lack the server's id of the call.
fn is_transient(status: &Status) -> bool {
    let of_connection = || {
        matches!(status.code(), Code::Unknown | Code::Internal | Code::Cancelled | Code::DeadlineExceeded)
            && status.metadata().get(REQUEST_ID).is_none()
            && status.source().is_some()
    };
    matches!(status.code(), Code::ResourceExhausted | Code::Unavailable) || of_connection()
}

fn malformed(error: Error) -> Status {
    Status::data_loss(error.to_string())
}

fn refused(status: Status) -> Error {
    Error::unavailable(format!("the server answered {:?}: {}", status.code(), with_sources(&status)))
}

/// The message of a status with the errors behind it: a failed connection has its reason there.
fn with_sources(status: &Status) -> String {
    let mut message = status.message().to_owned();
    let mut source = status.source();
    while let Some(error) = source {
        let reason = error.to_string();
        if !message.contains(&reason) {
            message = format!("{message}: {reason}");
        }
        source = error.source();
    }
    message
}

/// Random characters that identify this process.
fn process_name() -> String {
    rand::random::<[u8; 16]>().iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn only_unavailable_and_exhausted_errors_are_retried() {
        for refused in [|| Status::resource_exhausted("no room"), || Status::unavailable("not now")] {
            let mut refusals = 5;
            let reply = with_retries(async || match refusals {
                0 => Ok("taken"),
                _ => {
                    refusals -= 1;
                    Err(refused())
                }
            });
            assert_eq!(reply.await.ok(), Some("taken"));
        }
        let (mut calls, begun) = (0, Instant::now());
        let answer: tonic::Result<()> = with_retries(async || {
            calls += 1;
            Err(Status::unavailable("never"))
        })
        .await;
        assert!(answer.is_err() && begun.elapsed() >= RETRY_FOR && calls > 100, "{calls} times");
        let mut calls = 0;
        let answer: tonic::Result<()> = with_retries(async || {
            calls += 1;
            Err(Status::invalid_argument("step: is wrong"))
        })
        .await;
        assert_eq!((answer.err().map(|status| status.code()), calls), (Some(Code::InvalidArgument), 1));
    }
}
