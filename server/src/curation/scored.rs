//! An episode's recording with the scores of a run beside its messages.

use gleaner_recording::WholeEpisode;

use super::Curation;
use crate::{
    domain::{client::Client, episode::Episode, id::ScoreRunId},
    error::Result,
    ingest::ScoredCopy,
};

impl Curation {
    /// Copies an episode's recording with the scores of a run. Steps with a q above `beta` are marked as kept.
    ///
    /// # Errors
    /// NotFound when the run did not score the episode; those of [`crate::ingest::Ingest::scored_copy`].
    pub(crate) async fn scored_copy(
        &self,
        client: &Client,
        episode: &Episode,
        run: &ScoreRunId,
        beta: f64,
    ) -> Result<ScoredCopy> {
        let (store, ingest) = (&self.0.store, &self.0.ingest);
        let experts = store.score_run(run).await?.expert_ids;
        let scores = store.episode_scores(run, &episode.id).await?;
        let task = store.task_by_id(&episode.task_id).await?;
        let whole = WholeEpisode {
            id: episode.id.as_str(),
            file_name: &episode.file_name,
            outcome: episode.outcome.as_str(),
            cohort: &episode.cohort,
            run: run.as_str(),
            beta,
            q: &scores.q,
            w: &scores.w,
        };
        // Scorers without matches, such as imports, have empty lists.
        let kept = whole.kept(|at| {
            let expert = experts.get(usize::try_from(*scores.match_episode.get(at)?).ok()?)?;
            Some((expert.to_string(), *scores.match_step.get(at)?))
        });
        ingest.scored_copy(client, &task.spec, episode, kept).await
    }
}
