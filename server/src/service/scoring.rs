//! Scores of recordings and steps that are not stored: the two streams of ScoreService.

use std::{sync::Arc, time::Duration};

use futures::{StreamExt as _, stream::BoxStream};
use gleaner_proto::v1;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Streaming;

use super::{
    Services,
    answer::{Responses, responses},
};
use crate::{
    domain::client::Client,
    error::Result,
    ingest::Passing,
    policies::observation,
    scorers::{DecodedObservation, Ready, Terms, score_steps},
    wire::{scoring, status::from_peer},
};

impl Services {
    /// Scores a recording of the client without storing it.
    pub(super) async fn score_recording(
        &self,
        client: &Client,
        requests: Streaming<v1::ScoreRecordingRequest>,
    ) -> Result<v1::ScoreRecordingResponse> {
        let mut requests = patient(requests, self.scoring_terms());
        let (run, declared) = scoring::recording_open(requests.next().await.transpose()?)?;
        let ready = self.scorers.load(&run).await?.held();
        let chunks = requests.map(|request| request.and_then(scoring::recording_data));
        let Passing { frames, report, room } = self.ingest.pass(client, &ready.task().spec, declared, chunks).await?;
        let scores = ready.score_recording(&frames, room).await?;
        Ok(scoring::recording_response(scores, ready.experts(), report))
    }

    /// Scores an episode's steps while it happens.
    pub(super) fn score_steps(&self, requests: Streaming<v1::ScoreStepsRequest>) -> Responses<v1::ScoreStepsResponse> {
        let (scorers, terms) = (self.scorers.clone(), self.scoring_terms());
        let mut requests = patient(requests, terms.clone());
        let start = move || async move {
            let run = scoring::steps_open(requests.next().await.transpose()?)?;
            let ready = scorers.load(&run).await?;
            let of = Arc::clone(&ready);
            Ok((ready, requests.then(move |request| decoded(Arc::clone(&of), request)).boxed()))
        };
        responses(ReceiverStream::new(score_steps(start, terms)).map(|scored| scored.map(scoring::steps_response)))
    }

    pub(super) fn scoring_terms(&self) -> Terms {
        Terms {
            idle: self.config.policies.session_idle(),
            drain: Duration::from_secs(self.config.drain_seconds),
            stopping: self.stopping.clone(),
        }
    }
}

/// The messages of a client; an error if it sends none for too long.
pub(super) fn patient<T: Send + 'static>(requests: Streaming<T>, terms: Terms) -> BoxStream<'static, Result<T>> {
    let next = |(mut requests, terms): (Streaming<T>, Terms)| async move {
        let next = match tokio::time::timeout(terms.idle, requests.next()).await {
            Ok(next) => next?.map_err(from_peer),
            Err(_) => Err(terms.silent()),
        };
        Some((next, (requests, terms)))
    };
    futures::stream::unfold((requests, terms), next).boxed()
}

/// One step, checked and decoded.
async fn decoded(ready: Arc<Ready>, request: Result<v1::ScoreStepsRequest>) -> Result<(DecodedObservation, Vec<f32>)> {
    let (sent, action) = scoring::step(request?)?;
    observation::vector("step.action", &action, ready.shape().action)?;
    let (stamp_ns, proprioception) = (sent.stamp_ns, sent.proprioception.clone());
    let frames = observation::frames(Arc::clone(ready.shape()), "step.observation", sent).await?.into();
    Ok((DecodedObservation { stamp_ns, frames, proprioception }, action))
}
