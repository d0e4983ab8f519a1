//! Scores of unstored data: a whole recording, or an episode's steps while it happens.

use std::path::Path;
use std::sync::Arc;

use futures::StreamExt as _;
use gleaner_core::proto::recording::summary_to_proto;
use gleaner_proto::v1::score_recording_request::Message as Part;
use gleaner_proto::v1::score_steps_request::Message as Request;
use gleaner_proto::v1::score_steps_response::Message as Response;
use gleaner_proto::v1::{
    LiveScore, Observation, ScoreRecordingOpen, ScoreRecordingRequest, ScoreRecordingResponse, ScoreStep,
    ScoreStepsOpen, ScoreStepsRequest, ScoreStepsResponse,
};
use gleaner_recording::summarize;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Streaming;

use crate::connection::Client;
use crate::error::{ClientError, Result};
use crate::file::{name_to_send, off_runtime, open_regular};
use crate::retry::patiently;
use crate::upload::Progress;
use crate::upload::pieces::{Pieces, ReadFailure};

impl Client {
    /// Scores a recording (MCAP) as a finished score run scores its own; the server keeps nothing of it. `progress` is
    /// called with the bytes sent so far; the number falls back to 0 when the connection breaks and it is sent again.
    ///
    /// # Errors
    /// [`ClientError::Io`] when the file can't be read, [`ClientError::Rejected`] with the server's reason (the codes
    /// of `ScoreRecording`), or the last error once retries are exhausted.
    pub async fn score_recording(
        &self,
        run: &str,
        path: &Path,
        progress: impl Fn(u64) + Send + Sync + 'static,
    ) -> Result<ScoreRecordingResponse> {
        let size_bytes = tokio::fs::metadata(path).await.map_err(ClientError::io(path))?.len();
        let (file_name, file) = (name_to_send(path), path.to_owned());
        // The server finds damage of the summary.
        let summary = off_runtime(path.to_owned(), move || {
            open_regular(&file)?;
            Ok(summarize(&file).ok().flatten().map(summary_to_proto))
        });
        let summary = summary.await?;
        let open = ScoreRecordingOpen { score_run_id: run.to_owned(), file_name, size_bytes, summary };
        let progress: Progress = Arc::new(progress);
        // The server keeps nothing of a failed attempt, so it may be repeated.
        patiently(async || self.send_recording(&open, path, &progress).await).await
    }

    async fn send_recording(
        &self,
        open: &ScoreRecordingOpen,
        path: &Path,
        progress: &Progress,
    ) -> Result<ScoreRecordingResponse> {
        let failure = ReadFailure::default();
        let progress = Arc::clone(progress);
        let pieces = Pieces { offset: 0, end: open.size_bytes, progress, failure: failure.clone() };
        let parts = pieces.of(path.to_owned()).await?.map(|(_, data)| Part::Data(data));
        let parts = futures::stream::iter([Part::Open(open.clone())]).chain(parts);
        let requests = parts.map(|part| ScoreRecordingRequest { message: Some(part) });
        let reply = self.scores().score_recording(requests).await;
        if let Some(source) = failure.take() {
            return Err(ClientError::Io { path: path.to_owned(), source });
        }
        Ok(reply?.into_inner())
    }
}

/// An episode that is scored while it happens, in lock step: each step waits for its score. Nothing of it is kept; drop
/// it to end.
#[derive(Debug)]
pub struct StepScorer {
    requests: mpsc::Sender<Request>,
    responses: Streaming<ScoreStepsResponse>,
    draining: bool,
}

impl StepScorer {
    /// Begins an episode, to be scored by a finished score run. A run that cannot score it is rejected with the first step.
    ///
    /// # Errors
    /// [`ClientError::Rejected`] when the server does not answer.
    pub async fn open(client: &Client, run: &str) -> Result<Self> {
        let (requests, outgoing) = mpsc::channel(1);
        // Before the call: the server may wait for it before it answers. The channel has room.
        let _ = requests.send(Request::Open(ScoreStepsOpen { score_run_id: run.to_owned() })).await;
        let outgoing = ReceiverStream::new(outgoing).map(|message| ScoreStepsRequest { message: Some(message) });
        let responses = client.scores().score_steps(outgoing).await?.into_inner();
        Ok(Self { requests, responses, draining: false })
    }

    /// The score of the segment that ends with this step: what was seen, and what was done then.
    ///
    /// # Errors
    /// [`ClientError::Rejected`]: there is no such run, it cannot score what is not stored, or the step does not fit
    /// the task (the message names the field); [`ClientError::SessionLost`] when the stream has ended.
    pub async fn score(&mut self, observation: Observation, action: Vec<f32>) -> Result<LiveScore> {
        let step = ScoreStep { observation: Some(observation), action };
        // Fails when the server has ended the stream; the reason arrives with the next response.
        let _ = self.requests.send(Request::Step(step)).await;
        loop {
            let response = self.responses.message().await?;
            let response = response.ok_or_else(|| ClientError::SessionLost("the stream ended".into()))?;
            match response.message.ok_or(ClientError::Contract { missing: "a score" })? {
                Response::Score(score) => return Ok(score),
                Response::Draining(_) => self.draining = true,
            }
        }
    }

    /// Whether the server has announced that it is stopping; it scores steps for a little while yet.
    #[must_use]
    pub fn draining(&self) -> bool {
        self.draining
    }
}
