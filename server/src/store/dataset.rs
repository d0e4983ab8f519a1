//! Datasets: selections of score runs, and their contents.

use futures::TryStreamExt as _;
use sqlx::{Sqlite, Transaction, sqlite::SqliteRow};

use super::{
    Store, fault,
    row::{self, Column as _, Record, column, record, unreadable},
};
use crate::{
    domain::{
        dataset::{Dataset, DatasetContents, DatasetCounts, KeptEpisode, KeptSegment, Nearest},
        id::{DatasetId, EpisodeId, ScoreRunId, TaskId},
        job::JobKind,
        score::ScoreRun,
        selection::{Filter, Selection, ranked},
        time::Millis,
    },
    error::{Error, Result},
};

record! { Dataset: id, task_id, score_run_id, created_at; selection }

impl Record for Selection {
    fn decode(row: &SqliteRow) -> sqlx::Result<Self> {
        let (beta, top_fraction): (Option<f64>, Option<f64>) = (column(row, "beta")?, column(row, "top_fraction")?);
        let selection = beta.map(Self::Beta).or(top_fraction.map(Self::TopFraction));
        selection.ok_or_else(|| unreadable("beta", "the dataset has neither β nor a top fraction"))
    }
}

struct Scores {
    episode_id: EpisodeId,
    w: Vec<f64>,
    q: Vec<f32>,
    match_episode: Vec<u32>,
    match_step: Vec<u32>,
}

record! { Scores: episode_id, w, q, match_episode, match_step }

impl Scores {
    /// The segments that the filter keeps; `None` when it keeps none.
    fn kept(self, filter: Filter, experts: &[EpisodeId]) -> Result<Option<KeptEpisode>> {
        // Without matches both lists are empty.
        let nearest = |step: usize| match (self.match_episode.get(step), self.match_step.get(step)) {
            (Some(&episode), Some(&end_step)) => {
                let expert = usize::try_from(episode).ok().and_then(|index| experts.get(index)).cloned();
                let unknown = || Error::internal("reading a match", format!("the run has no expert {episode}"));
                let episode_id = expert.ok_or_else(unknown)?;
                Ok(Some(Nearest { episode_id, end_step }))
            }
            (None, _) | (_, None) => Ok(None),
        };
        let mut segments = Vec::new();
        for ((end_step, step), (w, weight)) in (0..).zip(0..).zip(self.w.into_iter().zip(self.q)) {
            if filter.keeps(w, weight) {
                segments.push(KeptSegment { end_step, weight, nearest: nearest(step)? });
            }
        }
        if segments.is_empty() {
            return Ok(None);
        }
        Ok(Some(KeptEpisode { episode_id: self.episode_id, segments }))
    }
}

/// The two columns of a selection: β, top fraction.
fn columns(selection: Selection) -> (Option<f64>, Option<f64>) {
    match selection {
        Selection::Beta(beta) => (Some(beta), None),
        Selection::TopFraction(fraction) => (None, Some(fraction)),
    }
}

/// Adds a dataset; the job that makes its run must exist.
pub(super) async fn insert(tx: &mut Transaction<'_, Sqlite>, dataset: &Dataset) -> Result<()> {
    let (beta, top_fraction) = columns(dataset.selection);
    sqlx::query(
        "insert into datasets (id, task_id, score_run_id, beta, top_fraction, created_at) values (?, ?, ?, ?, ?, ?)",
    )
    .bind(dataset.id.param())
    .bind(dataset.task_id.param())
    .bind(dataset.score_run_id.param())
    .bind(beta)
    .bind(top_fraction)
    .bind(dataset.created_at.param())
    .execute(&mut **tx)
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
            task_id: self.maker(JobKind::Score, "score run", run.as_str()).await?.task_id,
            score_run_id: run.clone(),
            selection,
            created_at: Millis::now(),
        };
        let mut tx = self.write().await?;
        let (beta, top_fraction) = columns(selection);
        let same = sqlx::query(
            "select * from datasets where score_run_id = ? and beta is ? and top_fraction is ? order by id limit 1",
        )
        .bind(run.param())
        .bind(beta)
        .bind(top_fraction)
        .try_map(row::read)
        .fetch_optional(&mut *tx)
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
        sqlx::query("select * from datasets where id = ?")
            .bind(id.param())
            .try_map(row::read)
            .fetch_optional(self.read())
            .await
            .map_err(fault("reading a dataset"))?
            .ok_or_else(|| Error::not_found("dataset", id))
    }

    /// A task's datasets, newest first.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn datasets(&self, task: &TaskId) -> Result<Vec<Dataset>> {
        sqlx::query("select * from datasets where task_id = ? order by id desc")
            .bind(task.param())
            .try_map(row::read)
            .fetch_all(self.read())
            .await
            .map_err(fault("reading datasets"))
    }

    /// The datasets of a score run, newest first.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn datasets_of_run(&self, run: &ScoreRunId) -> Result<Vec<Dataset>> {
        sqlx::query("select * from datasets where score_run_id = ? order by id desc")
            .bind(run.param())
            .try_map(row::read)
            .fetch_all(self.read())
            .await
            .map_err(fault("reading a run's datasets"))
    }

    /// The counts of each dataset, in order; `None` while its score run is not finished. Reads each run once for all
    /// thresholds.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn dataset_counts(&self, datasets: &[Dataset]) -> Result<Vec<Option<DatasetCounts>>> {
        let mut counts = vec![None; datasets.len()];
        let mut places: Vec<usize> = (0..datasets.len()).collect();
        places.sort_by_key(|&place| &datasets[place].score_run_id);
        for places in places.chunk_by(|&a, &b| datasets[a].score_run_id == datasets[b].score_run_id) {
            let run = match self.score_run(&datasets[places[0]].score_run_id).await {
                Ok(run) => run,
                Err(error) if error.kind() == crate::error::Kind::Precondition => continue,
                Err(error) => return Err(error),
            };
            let selections: Vec<Selection> = places.iter().map(|&place| datasets[place].selection).collect();
            let kept = self.count_kept(&run.id, selections).await?;
            let expert_segments = self.run_counts(&run).await?.expert_segments;
            for (&place, kept) in places.iter().zip(kept) {
                let (kept_segments, kept_episodes) = (kept.total.segments, kept.total.episodes);
                counts[place] = Some(DatasetCounts { kept_segments, kept_episodes, expert_segments });
            }
        }
        Ok(counts)
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
            encoder_id: run.encoder_id.clone(),
            experts: run.expert_ids.clone(),
            kept,
            dataset,
            run,
        })
    }

    /// Every imperfect episode with its kept segments, if any; rows are read one by one.
    async fn kept(&self, run: &ScoreRun, selection: Selection) -> Result<Vec<KeptEpisode>> {
        let candidates = match selection {
            Selection::Beta(_) => Vec::new(),
            Selection::TopFraction(_) => self.candidates(&run.id).await?,
        };
        let ranked = ranked(&candidates);
        let filter = Filter::new(selection, &ranked);
        let mut rows = sqlx::query(
            "select episode_id, w, q, match_episode, match_step from episode_scores \
             where score_run_id = ? and role = 'imperfect' order by position",
        )
        .bind(run.id.param())
        .try_map(row::read::<Scores>)
        .fetch(self.read());
        let mut kept = Vec::new();
        while let Some(found) = rows.try_next().await.map_err(fault("reading a dataset's segments"))? {
            kept.extend(found.kept(filter, &run.expert_ids)?);
        }
        Ok(kept)
    }
}

#[cfg(test)]
mod tests;
