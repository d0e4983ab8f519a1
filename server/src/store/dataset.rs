//! Datasets: selections of score runs, and their contents.

mod list;

use futures::TryStreamExt as _;
use tokio::sync::mpsc;

use super::{
    Store, fault,
    kept::{Matched, Recorded},
    row::{self, Column as _, Record, column, record, unreadable},
    sql::{self, Row, Transaction},
};
use crate::{
    domain::{
        dataset::{Dataset, DatasetContents, DatasetCounts, KeptEpisode, KeptSegment, Nearest, WeightedSegment},
        id::{DatasetId, EpisodeId, ScoreRunId},
        score::ScoreRun,
        selection::{Candidate, ExpertRanking, Kept, Resolved, Rule, Selection, ranked},
        time::Millis,
        work::KeptInput,
    },
    error::{Error, Result},
};

record! { DatasetCounts: kept_segments, kept_episodes, expert_segments }
record! { Dataset: id, task_id, score_run_id, created_at; selection }

impl Record for Selection {
    fn decode(row: &Row) -> sqlx::Result<Self> {
        let (beta, top_fraction): (Option<f64>, Option<f64>) = (column(row, "beta")?, column(row, "top_fraction")?);
        let rule = beta.map(Rule::Beta).or(top_fraction.map(Rule::TopFraction));
        let rule = rule.ok_or_else(|| unreadable("beta", "the dataset has neither β nor a top fraction"))?;
        Ok(Self { rule, shape: column(row, "shape")? })
    }
}

/// What is read of the kept part of a dataset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum KeptDetail {
    /// The kept segments with their weights.
    Weights,
    /// The same with their matches and the scores of every step.
    Scores,
    /// The same, also of episodes without a kept segment.
    Whole,
}

/// The marked segments of an episode with their q, possibly none.
fn weighted<'a>(candidate: &'a Candidate, marked: &'a [bool]) -> impl Iterator<Item = WeightedSegment> + 'a {
    let segments = (0..).zip(&candidate.q).map(|(end_step, &weight)| WeightedSegment { end_step, weight });
    segments.zip(marked).filter_map(|(segment, &kept)| kept.then_some(segment))
}

impl Matched {
    /// The marked segments with their matches, possibly none.
    fn kept(self, marked: &[bool], experts: &[EpisodeId]) -> Result<Vec<KeptSegment>> {
        let Self { candidate, match_episode, match_step } = self;
        // Without matches both lists are empty.
        let nearest = |step: usize| match (match_episode.get(step), match_step.get(step)) {
            (Some(&episode), Some(&end_step)) => {
                let expert = usize::try_from(episode).ok().and_then(|index| experts.get(index)).cloned();
                let unknown = || Error::internal("reading a match", format!("the run has no expert {episode}"));
                let episode_id = expert.ok_or_else(unknown)?;
                Ok(Some(Nearest { episode_id, end_step }))
            }
            (None, _) | (_, None) => Ok(None),
        };
        let with_match = |WeightedSegment { end_step, weight }| {
            let nearest = usize::try_from(end_step).map_or(Ok(None), &nearest)?;
            Ok(KeptSegment { end_step, weight, nearest })
        };
        weighted(&candidate, marked).map(with_match).collect()
    }
}

/// The two columns of a rule: β, top fraction.
fn columns(rule: Rule) -> (Option<f64>, Option<f64>) {
    match rule {
        Rule::Beta(beta) => (Some(beta), None),
        Rule::TopFraction(fraction) => (None, Some(fraction)),
    }
}

/// Adds a dataset; its run, or the job that makes it, must exist.
pub(super) async fn insert(tx: &mut Transaction, dataset: &Dataset) -> Result<()> {
    let (beta, top_fraction) = columns(dataset.selection.rule);
    sql::query(
        "insert into datasets (id, task_id, score_run_id, beta, top_fraction, shape, created_at) \
         values ($1, $2, $3, $4, $5, $6, $7)",
    )
    .bind(dataset.id.param())
    .bind(dataset.task_id.param())
    .bind(dataset.score_run_id.param())
    .bind(beta)
    .bind(top_fraction)
    .bind(dataset.selection.shape.param())
    .bind(dataset.created_at.param())
    .execute(&mut *tx)
    .await
    .map_err(fault("adding a dataset"))?;
    Ok(())
}

impl Store {
    /// The dataset of this selection of an existing or pending score run; created if there is none.
    ///
    /// # Errors
    /// NotFound; Precondition when the run's job failed.
    pub(crate) async fn insert_dataset(&self, run: &ScoreRunId, selection: Selection) -> Result<Dataset> {
        let dataset = Dataset {
            id: DatasetId::new(),
            task_id: self.task_of_run(run).await?,
            score_run_id: run.clone(),
            selection,
            created_at: Millis::now(),
        };
        let mut tx = self.write().await?;
        let (beta, top_fraction) = columns(selection.rule);
        let same = sql::query(
            "select * from datasets where score_run_id = $1 and beta is not distinct from $2 \
             and top_fraction is not distinct from $3 and shape is not distinct from $4 \
             order by id limit 1",
        )
        .bind(run.param())
        .bind(beta)
        .bind(top_fraction)
        .bind(selection.shape.param())
        .try_map(row::read)
        .fetch_optional(&mut tx)
        .await
        .map_err(fault("looking for a dataset"))?;
        if let Some(same) = same {
            return Ok(same);
        }
        insert(&mut tx, &dataset).await?;
        crate::fail_point::pass("dataset.row_written");
        self.commit(tx).await?;
        crate::fail_point::pass("dataset.committed");
        Ok(dataset)
    }

    /// A dataset, whether or not its score run is finished.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn dataset(&self, id: &DatasetId) -> Result<Dataset> {
        sql::query("select * from datasets where id = $1")
            .bind(id.param())
            .try_map(row::read)
            .fetch_optional(self.read())
            .await
            .map_err(fault("reading a dataset"))?
            .ok_or_else(|| Error::not_found("dataset", id))
    }

    /// The stored counts of a dataset; `None` until they were counted.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn dataset_counts(&self, id: &DatasetId) -> Result<Option<DatasetCounts>> {
        sql::query(
            "select kept_segments, kept_episodes, expert_steps as expert_segments from datasets \
             join score_runs on score_runs.id = score_run_id join snapshots on snapshots.id = snapshot_id \
             where datasets.id = $1 and kept_segments is not null",
        )
        .bind(id.param())
        .try_map(row::read)
        .fetch_optional(self.read())
        .await
        .map_err(fault("reading the counts of a dataset"))
    }

    /// Stores what a dataset keeps of its finished run, which never changes.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn keep_counts(&self, id: &DatasetId, kept: Kept) -> Result<()> {
        let mut tx = self.write().await?;
        sql::query("update datasets set kept_segments = $1, kept_episodes = $2 where id = $3")
            .bind(kept.segments.param())
            .bind(kept.episodes.param())
            .bind(id.param())
            .execute(&mut tx)
            .await
            .map_err(fault("storing the counts of a dataset"))?;
        self.commit(tx).await
    }

    /// The contents of a dataset, by reference.
    ///
    /// # Errors
    /// NotFound; Precondition when its score run is not finished.
    pub(crate) async fn dataset_contents(&self, id: &DatasetId) -> Result<DatasetContents> {
        let dataset = self.dataset(id).await?;
        let run = self.score_run(&dataset.score_run_id).await?;
        let kept = self.kept(&run, dataset.selection).await?;
        Ok(DatasetContents {
            snapshot_id: run.snapshot_id.clone(),
            experts: run.expert_ids.clone(),
            kept,
            dataset,
            run,
        })
    }

    /// Sends every imperfect episode of a run with its segments that a selection keeps, if any, and its recording; rows
    /// are read one by one. `detailed`: with the matches of segments and the scores of every step. Ends early once the
    /// receiver is gone. Only a top fraction and a limit of phases hold the scores of the whole run, until the end; leaving out
    /// cohorts reads them first.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn send_kept(
        &self,
        (run, selection): (&ScoreRun, Selection),
        detail: KeptDetail,
        out: &mpsc::Sender<KeptInput>,
    ) -> Result<()> {
        let (candidates, ranking) = self.to_resolve(run, selection).await?;
        let resolved = Resolved::new(selection, &ranked(&candidates), &candidates, &ranking);
        let mut rows = self.recorded(run, selection.limits_phases()).await?;
        let mut marked = Vec::new();
        while let Some(Recorded { mut matched, episode }) = rows.try_next().await? {
            resolved.mark(&matched.candidate, &mut marked);
            let (mut similarities, mut qualities) = (Vec::new(), Vec::new());
            match detail {
                KeptDetail::Weights => matched.match_episode.clear(),
                KeptDetail::Scores | KeptDetail::Whole => {
                    (similarities, qualities) = (matched.candidate.w.clone(), matched.candidate.q.clone());
                }
            }
            let segments = matched.kept(&marked, &run.expert_ids)?;
            if segments.is_empty() && detail != KeptDetail::Whole {
                continue;
            }
            if out.send(KeptInput { episode, segments, similarities, qualities }).await.is_err() {
                break;
            }
        }
        Ok(())
    }

    /// The candidates that resolving a selection needs, and how they rank beside experts where it needs that.
    async fn to_resolve(&self, run: &ScoreRun, selection: Selection) -> Result<(Vec<Candidate>, ExpertRanking)> {
        let (phases, ranks) = (selection.limits_phases(), selection.reads_ranking());
        let resolves = phases || matches!(selection.rule, Rule::TopFraction(_));
        let candidates = if resolves || ranks { self.candidates(&run.id, phases).await? } else { Vec::new() };
        if !ranks {
            return Ok((candidates, ExpertRanking::default()));
        }
        let experts = self.expert_qualities(&run.id).await?.concat();
        let comparing = move || {
            let ranking = ExpertRanking::of_candidates(&candidates, experts);
            (if resolves { candidates } else { Vec::new() }, ranking)
        };
        let compared = tokio::task::spawn_blocking(comparing).await;
        compared.map_err(|error| Error::internal("comparing experts", error))
    }

    /// The imperfect episodes with at least one kept segment; rows are read one by one.
    async fn kept(&self, run: &ScoreRun, selection: Selection) -> Result<Vec<KeptEpisode>> {
        let (candidates, ranking) = self.to_resolve(run, selection).await?;
        let ranked = ranked(&candidates);
        let resolved = Resolved::new(selection, &ranked, &candidates, &ranking);
        let mut rows = self.matched(run, selection.limits_phases()).await?;
        let (mut kept, mut marked) = (Vec::new(), Vec::new());
        while let Some(Matched { candidate, .. }) = rows.try_next().await? {
            resolved.mark(&candidate, &mut marked);
            let segments: Vec<WeightedSegment> = weighted(&candidate, &marked).collect();
            if !segments.is_empty() {
                kept.push(KeptEpisode { episode_id: candidate.episode_id, segments });
            }
        }
        Ok(kept)
    }
}

#[cfg(test)]
mod tests;
