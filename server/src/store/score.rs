//! Score runs and their scores: one row for each episode, arrays packed.

use super::{
    Store, fault,
    page::newest_first,
    row::{self, Column, Record, column, record},
    sql::{self, QueryBuilder, Row, Transaction},
};
use crate::{
    domain::{
        id::{EpisodeId, ScoreRunId, TaskId},
        job::{JobKind, JobSpec},
        page::Page,
        score::{EpisodeScores, Origin, RunCounts, ScoreRun},
        snapshot::Role,
    },
    error::{Error, Result},
};

const RUN: &str = "score run";
/// Most episodes of one insertion, and the number of steps with which one is complete: a few MiB.
const BATCH_EPISODES: usize = 100;
const BATCH_STEPS: usize = 50_000;

record! { ScoreRun: id, task_id, snapshot_id, lo, hi, quantiles, extends, expert_ids, created_at; origin }
record! { RunCounts: imperfect_episodes, imperfect_segments, expert_segments }
record! { EpisodeScores: episode_id, role, w, q, match_episode, match_step, distances }

impl Record for Origin {
    fn decode(row: &Row) -> sqlx::Result<Self> {
        match column(row, "job_id")? {
            Some(job_id) => {
                Ok(Self::Job { job_id, encoder_id: column(row, "encoder_id")?, spec: column(row, "settings")? })
            }
            None => Ok(Self::Import { encoder_id: column(row, "encoder_id")?, source: column(row, "source")? }),
        }
    }
}

/// Adds a finished score run with its scores, in the snapshot's order. `digest` identifies an import.
pub(super) async fn insert_run(
    tx: &mut Transaction,
    run: &ScoreRun,
    digest: Option<&str>,
    scores: &[EpisodeScores],
) -> Result<()> {
    let (spec, source) = match &run.origin {
        Origin::Job { spec, .. } => (Some(spec), None),
        Origin::Import { source, .. } => (None, Some(source)),
    };
    let imperfect = || scores.iter().filter(|episode| episode.role == Role::Imperfect);
    let (episodes, segments) = (imperfect().count(), imperfect().map(|episode| episode.q.len()).sum::<usize>());
    sql::query(
        "insert into score_runs (id, task_id, job_id, encoder_id, snapshot_id, settings, source, digest, lo, hi, \
         expert_ids, created_at, extends, quantiles, imperfect_episodes, imperfect_segments) \
         values ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14, $15, $16)",
    )
    .bind(run.id.param())
    .bind(run.task_id.param())
    .bind(run.origin.job_id().map(Column::param))
    .bind(run.origin.encoder_id().map(Column::param))
    .bind(run.snapshot_id.param())
    .bind(spec.map(Column::param))
    .bind(source)
    .bind(digest)
    .bind(run.lo)
    .bind(run.hi)
    .bind(run.expert_ids.param())
    .bind(run.created_at.param())
    .bind(run.extends.param())
    .bind(run.quantiles.param())
    .bind((episodes as u64).param())
    .bind((segments as u64).param())
    .execute(&mut *tx)
    .await
    .map_err(fault("adding a score run"))?;
    let mut position = 0;
    let mut rest = scores;
    while !rest.is_empty() {
        let (batch, after) = rest.split_at(batch_size(rest));
        position = insert_scores(tx, &run.id, position, batch).await?;
        rest = after;
    }
    Ok(())
}

/// The number of the first episodes that one statement adds, at least 1: a round trip for each of 100,000 would keep other
/// writers waiting.
fn batch_size(scores: &[EpisodeScores]) -> usize {
    let steps_before = scores.iter().scan(0, |steps, episode| {
        let before = *steps;
        *steps += episode.q.len();
        Some(before)
    });
    steps_before.take(BATCH_EPISODES).take_while(|before| *before < BATCH_STEPS).count()
}

/// Adds the scores of some episodes from this position on; returns the next position.
async fn insert_scores(
    tx: &mut Transaction,
    run: &ScoreRunId,
    mut position: i64,
    scores: &[EpisodeScores],
) -> Result<i64> {
    let mut query = QueryBuilder::new(
        "insert into episode_scores (score_run_id, position, episode_id, role, w, q, match_episode, match_step, \
         distances) values ",
    );
    for (place, episode) in scores.iter().enumerate() {
        if !episode.fit() {
            return Err(Error::invalid(
                "scores",
                format!("the lists of {} differ in length; give one entry a step", episode.episode_id),
            ));
        }
        query.push(if place == 0 { "(" } else { ", (" });
        query.push_bind(run.param()).push(", ").push_bind(position).push(", ");
        query.push_bind(episode.episode_id.param()).push(", ").push_bind(episode.role.param()).push(", ");
        query.push_bind(episode.w.param()).push(", ").push_bind(episode.q.param()).push(", ");
        query.push_bind(episode.match_episode.param()).push(", ").push_bind(episode.match_step.param()).push(", ");
        query.push_bind(episode.distances.param()).push(")");
        position += 1;
    }
    query.build().execute(&mut *tx).await.map_err(fault("adding episodes' scores"))?;
    Ok(position)
}

impl Store {
    /// Stores an imported run with its scores, or returns the run that the same import stored before.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn insert_import(
        &self,
        run: &ScoreRun,
        digest: &str,
        scores: &[EpisodeScores],
    ) -> Result<ScoreRun> {
        let mut tx = self.write().await?;
        let same = sql::query("select * from score_runs where digest = $1")
            .bind(digest)
            .try_map(row::read)
            .fetch_optional(&mut tx)
            .await
            .map_err(fault("looking for an import"))?;
        if let Some(same) = same {
            return Ok(same);
        }
        insert_run(&mut tx, run, Some(digest), scores).await?;
        crate::fail_point::pass("import.rows_written");
        self.commit_generation(tx).await?;
        crate::fail_point::pass("import.committed");
        Ok(run.clone())
    }

    /// The task of a run that is finished or may still be made.
    ///
    /// # Errors
    /// NotFound; Precondition when its job failed.
    pub(super) async fn task_of_run(&self, id: &ScoreRunId) -> Result<TaskId> {
        match self.imported(id).await? {
            Some(run) => Ok(run.task_id),
            None => Ok(self.maker(JobKind::Score, RUN, id.as_str()).await?.task_id),
        }
    }

    /// The default threshold β on the q of a run, finished or not.
    ///
    /// # Errors
    /// NotFound; Precondition when its job failed.
    pub(crate) async fn default_beta(&self, id: &ScoreRunId) -> Result<f64> {
        if let Some(run) = self.imported(id).await? {
            return Ok(run.origin.default_beta());
        }
        match self.maker(JobKind::Score, RUN, id.as_str()).await?.spec {
            JobSpec::Score { spec, .. } => Ok(spec.normaliser.default_beta()),
            JobSpec::Pretrain { .. } | JobSpec::Train { .. } | JobSpec::Export { .. } | JobSpec::Evaluate { .. } => {
                Err(Error::not_found(RUN, id))
            }
        }
    }

    /// An imported run; `None` for another id.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn imported(&self, id: &ScoreRunId) -> Result<Option<ScoreRun>> {
        sql::query("select * from score_runs where id = $1 and job_id is null")
            .bind(id.param())
            .try_map(row::read)
            .fetch_optional(self.read())
            .await
            .map_err(fault("reading an imported score run"))
    }

    /// A finished score run.
    ///
    /// # Errors
    /// NotFound, or Precondition naming its job when that has not succeeded.
    pub(crate) async fn score_run(&self, id: &ScoreRunId) -> Result<ScoreRun> {
        let found = sql::query("select * from score_runs where id = $1")
            .bind(id.param())
            .try_map(row::read)
            .fetch_optional(self.read())
            .await
            .map_err(fault("reading a score run"))?;
        match found {
            Some(found) => Ok(found),
            None => Err(self.missing(JobKind::Score, RUN, id.as_str()).await),
        }
    }

    /// A task's finished score runs, newest first.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn score_runs(&self, task: &TaskId) -> Result<Vec<ScoreRun>> {
        Ok(self.score_runs_page(task, &Page::whole()).await?.0)
    }

    /// A page of a task's finished score runs, newest first, and the run that the next one follows.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn score_runs_page(
        &self,
        task: &TaskId,
        page: &Page<ScoreRunId>,
    ) -> Result<(Vec<ScoreRun>, Option<ScoreRunId>)> {
        let mut query = QueryBuilder::new("select * from score_runs where task_id = ");
        query.push_bind(task.param());
        let found = newest_first(self.read(), query, page, |run: &ScoreRun| run.id.clone()).await;
        found.map_err(fault("reading score runs"))
    }

    /// The newest finished score run of all tasks.
    pub(crate) async fn newest_run(&self) -> Result<Option<ScoreRunId>> {
        sql::query("select id from score_runs order by created_at desc, id desc limit 1")
            .try_map(row::read)
            .fetch_optional(self.read())
            .await
            .map_err(fault("looking for the newest score run"))
    }

    /// The extent of a finished run.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn run_counts(&self, run: &ScoreRun) -> Result<RunCounts> {
        // Segments of experts are those of the snapshot: a single expert has no scores, because an episode never matches
        // itself.
        sql::query(
            "select imperfect_episodes, imperfect_segments, expert_steps as expert_segments \
             from score_runs join snapshots on snapshots.id = snapshot_id where score_runs.id = $1",
        )
        .bind(run.id.param())
        .try_map(row::read)
        .fetch_one(self.read())
        .await
        .map_err(fault("reading the counts of a run"))
    }

    /// One episode's scores.
    ///
    /// # Errors
    /// As for [`Store::score_run`]; NotFound when the run has no scores of the episode.
    pub(crate) async fn episode_scores(&self, run: &ScoreRunId, episode: &EpisodeId) -> Result<EpisodeScores> {
        let found = sql::query("select * from episode_scores where score_run_id = $1 and episode_id = $2")
            .bind(run.param())
            .bind(episode.param())
            .try_map(row::read::<EpisodeScores>)
            .fetch_optional(self.read())
            .await
            .map_err(fault("reading an episode's scores"))?;
        match found {
            Some(scores) if scores.fit() => Ok(scores),
            Some(_) => Err(Error::internal("reading episode_scores", "the arrays of one row differ in length")),
            None => {
                self.score_run(run).await?;
                Err(Error::not_found(&format!("scores in {run} of"), episode))
            }
        }
    }
}

#[cfg(test)]
mod tests;
