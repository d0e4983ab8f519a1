//! What a worker is given: the episodes of its job's snapshot by role, the kept segments, and the blobs to begin from.

use std::collections::HashMap;

use super::Jobs;
use crate::{
    blobs,
    domain::{
        dataset::KeptEpisode,
        episode::Episode,
        id::{BlobId, DatasetId, EncoderId, EpisodeId, ScoreRunId, SnapshotId},
        job::{Job, JobSpec},
        snapshot::Role,
        work::{FrozenRun, InputEpisode, Inputs, KeptInput},
    },
    error::{Error, Result},
};

impl Jobs {
    /// Everything a running job works on.
    ///
    /// # Errors
    /// When the database cannot be read, or an input that must be there is not.
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
        match &job.spec {
            JobSpec::Pretrain { snapshot_id, .. } => {
                (inputs.experts, inputs.imperfect) = self.by_role(snapshot_id).await?;
            }
            JobSpec::Score { encoder_id, snapshot_id, extends, .. } => {
                (inputs.experts, inputs.imperfect) = self.by_role(snapshot_id).await?;
                self.begin_from(&mut inputs, encoder_id).await?;
                if let Some(run) = extends {
                    inputs.base = Some(self.frozen(run).await?);
                }
            }
            JobSpec::Train { encoder_id, snapshot_id, dataset_id, .. } => {
                let (experts, imperfect) = self.by_role(snapshot_id).await?;
                inputs.experts = experts;
                if let Some(dataset) = dataset_id {
                    inputs.kept = self.kept(dataset, imperfect).await?;
                    // Training does not ask what a step is like, and it may be millions of them.
                    inputs.kept.iter_mut().flat_map(|kept| &mut kept.segments).for_each(|kept| kept.nearest = None);
                }
                if let Some(encoder) = encoder_id {
                    self.begin_from(&mut inputs, encoder).await?;
                }
            }
            JobSpec::Evaluate { policy_id, .. } => {
                inputs.policy = Some(self.0.store.policy(policy_id).await?.checkpoint);
            }
            JobSpec::Export { dataset_id } => {
                let contents = self.0.store.dataset_contents(dataset_id).await?;
                let (experts, imperfect) = self.by_role(&contents.snapshot_id).await?;
                inputs.experts = experts;
                inputs.kept = join(contents.kept, imperfect)?;
                for kept in &mut inputs.kept {
                    let scores = self.0.store.episode_scores(&contents.run.id, &kept.episode.id).await?;
                    (kept.similarities, kept.qualities) = (scores.w, scores.q);
                }
                inputs.segment_length = self.0.store.segment_length(&contents.encoder_id).await?;
            }
        }
        Ok(inputs)
    }

    /// The checkpoint to resume from. One that the disk has lost or spoilt is never resumed from: it goes, with what was
    /// reported up to it, and the job begins anew and ends as it would have.
    async fn whole_checkpoint(&self, job: &Job) -> Result<Option<BlobId>> {
        let Some(blob) = &job.checkpoint else { return Ok(None) };
        let path = self.0.blobs.path(blob);
        let found = tokio::task::spawn_blocking(move || path.exists().then(|| blobs::digest(&path)).transpose()).await;
        let found = found.map_err(|error| Error::internal("looking at a checkpoint", error))??;
        if found.as_ref() == Some(blob) {
            return Ok(job.checkpoint.clone());
        }
        let damage = if found.is_some() { "is damaged" } else { "is gone" };
        tracing::error!(job.id = %job.id, blob.id = %blob, damage, "a job's checkpoint cannot be used: the job begins anew");
        self.0.store.drop_checkpoint(&job.id).await?;
        self.0.forget(blob.clone()).await;
        Ok(None)
    }

    async fn by_role(&self, snapshot: &SnapshotId) -> Result<(Vec<InputEpisode>, Vec<InputEpisode>)> {
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

    async fn begin_from(&self, inputs: &mut Inputs, encoder: &EncoderId) -> Result<()> {
        inputs.encoder = Some(self.0.store.encoder(encoder).await?.checkpoint);
        Ok(())
    }

    async fn frozen(&self, run: &ScoreRunId) -> Result<FrozenRun> {
        let run = self.0.store.score_run(run).await?;
        Ok(FrozenRun { lo: run.lo, hi: run.hi, quantiles: run.quantiles, expert_ids: run.expert_ids })
    }

    async fn kept(&self, dataset: &DatasetId, imperfect: Vec<InputEpisode>) -> Result<Vec<KeptInput>> {
        join(self.0.store.dataset_contents(dataset).await?.kept, imperfect)
    }
}

/// The recordings of the episodes that a dataset keeps something of.
fn join(kept: Vec<KeptEpisode>, imperfect: Vec<InputEpisode>) -> Result<Vec<KeptInput>> {
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
