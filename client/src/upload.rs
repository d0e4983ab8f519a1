//! Upload of one recording to the server: hashed, in pieces, resumed when the connection breaks.
//!
//! Handles one recording; `push` handles many.

use std::path::Path;
use std::sync::Arc;

use futures::StreamExt as _;
use gleaner_core::proto::recording::summary_to_proto;
use gleaner_proto::v1::episode_service_client::EpisodeServiceClient;
use gleaner_proto::v1::{
    Episode, FinishUploadRequest, GetUploadRequest, Outcome, Report, StartUploadRequest, WriteUploadRequest,
};
use tonic::Code;

use crate::connection::{Client, Transport};
use crate::error::{ClientError, Result};
use crate::retry::Backoff;
use crate::source::{Declared, Source};
use pieces::{Pieces, ReadFailure};

pub(crate) mod pieces;

/// The label of an uploaded episode.
#[derive(Clone, Debug)]
pub struct UploadLabel {
    /// The outcome of the attempt.
    pub outcome: Outcome,
    /// Free-form tag of the episode's origin; may be empty.
    pub cohort: String,
    /// The author of the label; may be empty.
    pub author: String,
}

/// A recording that the server now holds.
#[derive(Clone, Debug)]
pub struct Uploaded {
    /// The new or existing episode.
    pub episode: Episode,
    /// The inspection's report; `None` when the episode existed before.
    pub report: Option<Report>,
    /// The task already held this content under this label.
    pub existed: bool,
}

// Called with the bytes sent so far, from the file's beginning.
pub(crate) type Progress = Arc<dyn Fn(u64) + Send + Sync>;

impl Client {
    /// Uploads a recording (MCAP, or a folder of the parts of one) to a task (name or id) under a label. `progress` is
    /// called with the bytes sent so far; the number falls back when the connection breaks and the upload resumes.
    ///
    /// # Errors
    /// [`ClientError::Io`] when the file can't be read, [`ClientError::Rejected`] with the server's reason (the codes
    /// of `StartUpload` and `FinishUpload`), or the last error once retries are exhausted.
    pub async fn upload(
        &self,
        task: &str,
        path: &Path,
        label: &UploadLabel,
        progress: impl Fn(u64) + Send + Sync + 'static,
    ) -> Result<Uploaded> {
        self.upload_source(Source::of(path, &[])?, task, label, Arc::new(progress)).await
    }

    pub(crate) async fn upload_source(
        &self,
        source: Source,
        task: &str,
        label: &UploadLabel,
        progress: Progress,
    ) -> Result<Uploaded> {
        let start = start_request(task, source.declare().await?, label);
        let mut upload =
            Upload { service: self.episodes(), source, start, progress, stage: Stage::Unopened, restarts: 0 };
        upload.run().await
    }
}

/// The request that starts an upload.
pub(crate) fn start_request(task: &str, declared: Declared, label: &UploadLabel) -> StartUploadRequest {
    StartUploadRequest {
        task: task.to_owned(),
        file_name: declared.file_name,
        size_bytes: declared.digest.size_bytes,
        blake3: declared.digest.blake3,
        outcome: label.outcome.into(),
        cohort: label.cohort.clone(),
        author: label.author.clone(),
        summary: declared.summary.map(summary_to_proto),
        validate_only: false,
    }
}

#[derive(Clone, Debug)]
enum Stage {
    Unopened,
    // After a failure the size on the server's disk is unknown until the server returns it.
    Open { id: String, committed: Option<u64> },
}

enum Step {
    Done(Box<Uploaded>),
    Forward,
    // A failure; a retry from `stage` may succeed.
    Back(ClientError),
}

// How many times in a row a closed upload is restarted without a pause.
const RESTARTS: u32 = 3;

struct Upload {
    service: EpisodeServiceClient<Transport>,
    source: Source,
    start: StartUploadRequest,
    progress: Progress,
    stage: Stage,
    restarts: u32,
}

impl Upload {
    async fn run(&mut self) -> Result<Uploaded> {
        let mut backoff = Backoff::new();
        let mut furthest = 0;
        loop {
            match self.advance().await? {
                Step::Done(uploaded) => {
                    (self.progress)(self.start.size_bytes);
                    return Ok(*uploaded);
                }
                Step::Forward => {
                    if let Stage::Open { committed: Some(committed), .. } = self.stage
                        && committed > furthest
                    {
                        furthest = committed;
                        backoff.restore();
                    }
                }
                Step::Back(error) => match backoff.next_wait() {
                    Some(wait) => tokio::time::sleep(wait).await,
                    None => return Err(error),
                },
            }
        }
    }

    async fn advance(&mut self) -> Result<Step> {
        let size = self.start.size_bytes;
        match self.stage.clone() {
            Stage::Unopened => self.open().await,
            Stage::Open { id, committed: None } => self.query_committed(id).await,
            Stage::Open { id, committed: Some(committed) } if committed < size => self.write(id, committed).await,
            Stage::Open { id, committed: Some(_) } => self.finish(id).await,
        }
    }

    async fn open(&mut self) -> Result<Step> {
        let reply = match self.service.start_upload(self.start.clone()).await {
            Ok(reply) => reply.into_inner(),
            Err(status) => return self.after(status, &[]),
        };
        if let Some(episode) = reply.existing {
            return Ok(Step::Done(Box::new(Uploaded { episode, report: None, existed: true })));
        }
        self.stage = Stage::Open { id: reply.upload_id, committed: Some(reply.committed_size) };
        Ok(Step::Forward)
    }

    async fn query_committed(&mut self, id: String) -> Result<Step> {
        match self.service.get_upload(GetUploadRequest { upload_id: id.clone() }).await {
            Ok(reply) => {
                self.stage = Stage::Open { id, committed: Some(reply.into_inner().committed_size) };
                Ok(Step::Forward)
            }
            Err(status) => self.after(status, &[Code::NotFound]),
        }
    }

    async fn write(&mut self, id: String, committed: u64) -> Result<Step> {
        let failure = ReadFailure::default();
        let pieces = Pieces {
            offset: committed,
            end: self.start.size_bytes,
            progress: Arc::clone(&self.progress),
            failure: failure.clone(),
        };
        let upload_id = id.clone();
        let message = move |(offset, data)| WriteUploadRequest { upload_id: upload_id.clone(), offset, data };
        let reply = self.service.write_upload(pieces.of_files(self.source.files.clone()).await?.map(message)).await;
        if let Some(source) = failure.take() {
            return Err(ClientError::Io { path: self.source.path.clone(), source });
        }
        match reply.map(|reply| reply.into_inner().committed_size) {
            Ok(now) if now > committed => {
                self.stage = Stage::Open { id, committed: Some(now) };
                Ok(Step::Forward)
            }
            Ok(_) => Err(ClientError::Invalid(format!(
                "{}: the file was truncated during the upload; push it again once it is complete",
                self.source.path.display()
            ))),
            // InvalidArgument: an older stream of this client was still being written when this one began.
            Err(status) => self.after(status, &[Code::NotFound, Code::InvalidArgument]),
        }
    }

    async fn finish(&mut self, id: String) -> Result<Step> {
        match self.service.finish_upload(FinishUploadRequest { upload_id: id }).await {
            Ok(reply) => {
                let reply = reply.into_inner();
                let episode = reply.episode.ok_or(ClientError::Contract { missing: "an episode" })?;
                Ok(Step::Done(Box::new(Uploaded { episode, report: reply.report, existed: false })))
            }
            // NotFound: an earlier finish succeeded but its answer was lost; reopening finds the episode.
            Err(status) => self.after(status, &[Code::NotFound]),
        }
    }

    // Maps a failed call to the upload's next step. `recoverable`: the codes that a retry can fix.
    fn after(&mut self, status: tonic::Status, recoverable: &[Code]) -> Result<Step> {
        let code = status.code();
        let error = ClientError::from(status);
        if !error.is_transient() && !recoverable.contains(&code) {
            return Err(error);
        }
        if code == Code::NotFound && self.restarts < RESTARTS {
            // It has ended or expired; reopening it finds out which, without a pause.
            self.restarts += 1;
            self.stage = Stage::Unopened;
            return Ok(Step::Forward);
        }
        self.stage = match std::mem::replace(&mut self.stage, Stage::Unopened) {
            Stage::Open { id, .. } if code != Code::NotFound => Stage::Open { id, committed: None },
            Stage::Open { .. } | Stage::Unopened => Stage::Unopened,
        };
        Ok(Step::Back(error))
    }
}

#[cfg(test)]
mod tests;
