//! Imports of scores made elsewhere: the stream of ScoreService that stores a score run.

use futures::StreamExt as _;
use gleaner_proto::v1;
use tonic::Streaming;

use super::{Services, scoring::patient};
use crate::{access::AuditDraft, error::Result, imports::Import, wire};

impl Services {
    /// Receives scores and stores them as a run.
    pub(super) async fn import_scores(
        &self,
        audit: AuditDraft,
        requests: Streaming<v1::ImportScoresRequest>,
    ) -> Result<v1::ImportScoresResponse> {
        let mut requests = patient(requests, self.scoring_terms());
        let first = requests.next().await.transpose()?;
        if let Some(first) = &first {
            audit.about(first);
        }
        let mut import = Import::begin(&self.store, &self.blobs, wire::import::open(first)?).await?;
        while let Some(request) = requests.next().await.transpose()? {
            wire::import::batch(request)?.into_iter().try_for_each(|episode| import.add(episode))?;
        }
        let run = import.finish(&self.store).await?;
        tracing::info!(score_run.id = %run.id, snapshot.id = %run.snapshot_id, "scores imported");
        // The next calls count what selections of this run keep; its scores are then in memory.
        if let Err(error) = self.curation.load(&run.id).await {
            tracing::warn!(score_run.id = %run.id, %error, "loading imported scores failed");
        }
        let counts = self.store.run_counts(&run).await?;
        Ok(v1::ImportScoresResponse { score_run: Some(wire::score::score_run(run, counts)) })
    }
}
