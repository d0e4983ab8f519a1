//! The input of a worker: the episodes of its job's snapshot by role, the kept segments, and the blobs to begin from.

use std::collections::HashMap;

use super::{Jobs, kinds};
use crate::{
    blobs,
    domain::{
        dataset::KeptEpisode,
        episode::Episode,
        id::{BlobId, DatasetId, EpisodeId, SnapshotId},
        job::Job,
        snapshot::Role,
        work::{InputEpisode, Inputs, KeptInput},
    },
    error::{Error, Result},
};

impl Jobs {
    /// The complete input of a running job.
    ///
    /// # Errors
    /// When the database cannot be read, or a required input is missing.
    pub(crate) async fn inputs(&self, job: &Job) -> Result<Inputs> {
        let task = self.0.store.task_by_id(&job.task_id).await?;
        let mut inputs = Inputs {
            task: task.spec,
            experts: Vec::new(),
            imperfect: Vec::new(),
            kept: Vec::new(),
            encoder: None,
            checkpoint: self.whole_checkpoint(job).await?,
            segment_length: 0,
            policy: None,
            base: None,
        };
        kinds::add_inputs(self, &job.spec, &mut inputs).await?;
        Ok(inputs)
    }

    /// The checkpoint to resume from. A missing or damaged checkpoint is never used: it is removed together with the
    /// reports up to it, and the job starts again with the same result.
    async fn whole_checkpoint(&self, job: &Job) -> Result<Option<BlobId>> {
        let Some(blob) = &job.checkpoint else { return Ok(None) };
        let path = self.0.blobs.path(blob);
        let found = tokio::task::spawn_blocking(move || path.exists().then(|| blobs::digest(&path)).transpose()).await;
        let found = found.map_err(|error| Error::internal("looking at a checkpoint", error))??;
        if found.as_ref() == Some(blob) {
            return Ok(job.checkpoint.clone());
        }
        let damage = if found.is_some() { "is damaged" } else { "is gone" };
        tracing::error!(job.id = %job.id, blob.id = %blob, damage, "a job's checkpoint cannot be used: the job starts from the beginning");
        self.0.store.drop_checkpoint(&job.id).await?;
        self.0.forget(blob.clone()).await;
        Ok(None)
    }

    pub(super) async fn by_role(&self, snapshot: &SnapshotId) -> Result<(Vec<InputEpisode>, Vec<InputEpisode>)> {
        let recordings = self.0.store.recordings(snapshot).await?;
        let (experts, imperfect): (Vec<_>, Vec<_>) =
            recordings.into_iter().partition(|(_, role)| *role == Role::Expert);
        let input = |(episode, _): (Episode, Role)| InputEpisode {
            id: episode.id,
            recording: episode.recording,
            steps: episode.steps,
            file_name: episode.file_name,
        };
        Ok((experts.into_iter().map(input).collect(), imperfect.into_iter().map(input).collect()))
    }

    pub(super) async fn kept(&self, dataset: &DatasetId, imperfect: Vec<InputEpisode>) -> Result<Vec<KeptInput>> {
        join(self.0.store.dataset_contents(dataset).await?.kept, imperfect)
    }
}

/// The kept episodes of a dataset, each with its recording.
pub(super) fn join(kept: Vec<KeptEpisode>, imperfect: Vec<InputEpisode>) -> Result<Vec<KeptInput>> {
    let mut by_id: HashMap<EpisodeId, InputEpisode> =
        imperfect.into_iter().map(|episode| (episode.id.clone(), episode)).collect();
    kept.into_iter()
        .map(|KeptEpisode { episode_id, segments }| match by_id.remove(&episode_id) {
            Some(episode) => Ok(KeptInput { episode, segments, similarities: Vec::new(), qualities: Vec::new() }),
            None => Err(Error::internal(
                "gathering a job's input",
                format!("the dataset keeps steps of {episode_id}, which is not imperfect in its snapshot"),
            )),
        })
        .collect()
}
