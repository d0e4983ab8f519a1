//! Imports of scores made elsewhere: episodes found by id, name or digest, and sent in batches.

use std::collections::{BTreeSet, HashMap, HashSet};

use futures::stream;
use gleaner_core::id::EpisodeId;
use gleaner_proto::v1::import_scores_request::Message;
use gleaner_proto::v1::{
    ImportScoresOpen, ImportScoresRequest, ImportedEpisode, ImportedEpisodes, ListEpisodesRequest, ScoreRun,
};

use crate::connection::Client;
use crate::error::{ClientError, Result};
use crate::retry::patiently;
use crate::score_table::ScoredEpisode;

/// The most values in one message of several episodes: 1 MiB.
const BATCH: usize = (1 << 20) / size_of::<f64>();

impl Client {
    /// Stores scores made elsewhere as a score run of the snapshot. `source` names what made them; policies that need an
    /// encoder, trained on a dataset of the run, start from `encoder` (empty: none). The same scores return the same run.
    ///
    /// # Errors
    /// [`ClientError::Invalid`] names an episode that is not in the snapshot, or whose name several episodes have;
    /// [`ClientError::Rejected`] with the server's reason (the codes of `ImportScores`), or the last error once retries
    /// are exhausted.
    pub async fn import_scores(
        &self,
        snapshot: &str,
        source: &str,
        encoder: &str,
        episodes: Vec<ScoredEpisode>,
    ) -> Result<ScoreRun> {
        let episodes = self.with_ids(snapshot, episodes).await?;
        let open = ImportScoresOpen {
            snapshot_id: snapshot.to_owned(),
            source: source.to_owned(),
            encoder_id: encoder.to_owned(),
        };
        let batches = batches(episodes).into_iter().map(|episodes| Message::Batch(ImportedEpisodes { episodes }));
        let messages: Vec<Message> = [Message::Open(open)].into_iter().chain(batches).collect();
        // A repeated import returns the run of the first.
        let reply = patiently(async || {
            let requests = messages.clone().into_iter().map(|message| ImportScoresRequest { message: Some(message) });
            Ok(self.scores().import_scores(stream::iter(requests)).await?)
        })
        .await?;
        reply.into_inner().score_run.ok_or(ClientError::Contract { missing: "a score run" })
    }

    /// The scores with the ids of their episodes.
    async fn with_ids(&self, snapshot: &str, episodes: Vec<ScoredEpisode>) -> Result<Vec<ImportedEpisode>> {
        let is_id = |name: &str| EpisodeId::try_from(name.to_owned()).is_ok();
        let names = if episodes.iter().all(|scored| is_id(&scored.episode)) {
            HashMap::new()
        } else {
            self.names(snapshot).await?
        };
        let found = |ScoredEpisode { episode, q }: ScoredEpisode| {
            if is_id(&episode) {
                return Ok(ImportedEpisode { episode_id: episode, q });
            }
            let ids = names.get(&episode);
            match ids.and_then(BTreeSet::first) {
                Some(id) if ids.is_some_and(|ids| ids.len() == 1) => Ok(ImportedEpisode { episode_id: id.clone(), q }),
                Some(_) => Err(ClientError::Invalid(format!(
                    "{episode}: several episodes of {snapshot} have this name; use their ids or digests"
                ))),
                None => Err(ClientError::Invalid(format!(
                    "{episode}: no episode of {snapshot} has this id, file name or digest"
                ))),
            }
        };
        episodes.into_iter().map(found).collect()
    }

    /// The ids of a snapshot's episodes by the file name and by the digest of their recordings.
    async fn names(&self, snapshot: &str) -> Result<HashMap<String, BTreeSet<String>>> {
        let task = self.snapshot(snapshot).await?.task_id;
        let members = self.snapshot_episodes(snapshot).await?;
        let members: HashSet<String> = members.into_iter().map(|episode| episode.episode_id).collect();
        let mut names: HashMap<String, BTreeSet<String>> = HashMap::new();
        // An episode of a snapshot may be in the trash.
        for deleted in [false, true] {
            let mut request =
                ListEpisodesRequest { task: task.clone(), page_size: 1000, deleted, ..ListEpisodesRequest::default() };
            loop {
                let page = self.episodes().list_episodes(request.clone()).await?.into_inner();
                for episode in page.episodes.into_iter().filter(|episode| members.contains(&episode.id)) {
                    names.entry(episode.file_name).or_default().insert(episode.id.clone());
                    names.entry(episode.blake3).or_default().insert(episode.id);
                }
                if page.next_page_token.is_empty() {
                    break;
                }
                request.page_token = page.next_page_token;
            }
        }
        Ok(names)
    }
}

/// Episodes in groups of at most [`BATCH`] values; a longer episode is a group of its own.
fn batches(episodes: Vec<ImportedEpisode>) -> Vec<Vec<ImportedEpisode>> {
    let mut batches: Vec<Vec<ImportedEpisode>> = Vec::new();
    let mut size = 0;
    for episode in episodes {
        size += episode.q.len();
        match batches.last_mut() {
            Some(batch) if size <= BATCH => batch.push(episode),
            Some(_) | None => {
                size = episode.q.len();
                batches.push(vec![episode]);
            }
        }
    }
    batches
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_has_a_bounded_number_of_values() {
        let episode = |steps| ImportedEpisode { episode_id: "ep_1".into(), q: vec![0.5; steps] };
        let sizes = |steps: &[usize]| {
            let episodes = steps.iter().map(|&steps| episode(steps)).collect();
            let length = |batch: &Vec<ImportedEpisode>| batch.iter().map(|episode| episode.q.len()).collect::<Vec<_>>();
            batches(episodes).iter().map(length).collect::<Vec<_>>()
        };
        assert_eq!(sizes(&[]), Vec::<Vec<usize>>::new());
        assert_eq!(sizes(&[3, BATCH - 3, 1]), [vec![3, BATCH - 3], vec![1]]);
        assert_eq!(sizes(&[1, BATCH + 1, 1, 2]), [vec![1], vec![BATCH + 1], vec![1, 2]]);
    }
}
