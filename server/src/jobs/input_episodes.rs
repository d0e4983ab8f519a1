//! The episodes that a worker receives: those of a snapshot by role, and those of which a dataset keeps segments.

use std::collections::HashMap;

use super::Jobs;
use crate::{
    domain::{
        dataset::KeptEpisode,
        episode::Episode,
        id::{DatasetId, EpisodeId, SnapshotId},
        snapshot::Role,
        work::{InputEpisode, KeptInput},
    },
    error::{Error, Result},
};

impl Jobs {
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
