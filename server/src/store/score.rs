//! Score runs and their scores: one row for each episode, arrays packed.

use sqlx::{Sqlite, Transaction};

use super::{
    Store, fault,
    packed::{pack, unpack},
    row,
};
use crate::{
    domain::{
        id::{EpisodeId, ScoreRunId, TaskId},
        job::JobKind,
        score::{EpisodeScores, RunCounts, ScoreRun},
        snapshot::Role,
        time::Millis,
    },
    error::{Error, Result},
};

const RUN: &str = "score run";

#[derive(sqlx::FromRow)]
struct RunRow {
    id: String,
    task_id: String,
    job_id: String,
    encoder_id: String,
    snapshot_id: String,
    lo: f64,
    hi: f64,
    expert_ids: String,
    created_at: i64,
    extends: Option<String>,
    quantiles: Vec<u8>,
    settings: String,
}

impl RunRow {
    fn run(self) -> Result<ScoreRun> {
        Ok(ScoreRun {
            id: row::id("score_runs.id", self.id)?,
            task_id: row::id("score_runs.task_id", self.task_id)?,
            job_id: row::id("score_runs.job_id", self.job_id)?,
            encoder_id: row::id("score_runs.encoder_id", self.encoder_id)?,
            snapshot_id: row::id("score_runs.snapshot_id", self.snapshot_id)?,
            spec: row::json("score_runs.settings", &self.settings)?,
            lo: self.lo,
            hi: self.hi,
            quantiles: unpack("score_runs.quantiles", &self.quantiles)?.collect(),
            extends: self.extends.map(|id| row::id("score_runs.extends", id)).transpose()?,
            expert_ids: row::json("score_runs.expert_ids", &self.expert_ids)?,
            created_at: Millis(self.created_at),
        })
    }
}

#[derive(sqlx::FromRow)]
struct ScoresRow {
    episode_id: String,
    role: String,
    w: Vec<u8>,
    q: Vec<u8>,
    match_episode: Vec<u8>,
    match_step: Vec<u8>,
    distances: Vec<u8>,
}

impl ScoresRow {
    fn scores(self) -> Result<EpisodeScores> {
        let distances: Vec<f32> = unpack("episode_scores.distances", &self.distances)?.collect();
        let scores = EpisodeScores {
            episode_id: row::id("episode_scores.episode_id", self.episode_id)?,
            role: row::parsed("episode_scores.role", Role::from_word(&self.role))?,
            w: unpack("episode_scores.w", &self.w)?.collect(),
            q: unpack("episode_scores.q", &self.q)?.collect(),
            match_episode: unpack("episode_scores.match_episode", &self.match_episode)?.collect(),
            match_step: unpack("episode_scores.match_step", &self.match_step)?.collect(),
            distances: distances.as_chunks().0.to_vec(),
        };
        if scores.fit() {
            return Ok(scores);
        }
        Err(Error::internal("reading episode_scores", "the arrays of one row differ in length"))
    }
}

/// Adds a finished score run with its scores, in the snapshot's order.
pub(super) async fn insert_run(
    tx: &mut Transaction<'_, Sqlite>,
    run: &ScoreRun,
    scores: &[EpisodeScores],
) -> Result<()> {
    sqlx::query(
        "insert into score_runs (id, task_id, job_id, encoder_id, snapshot_id, settings, lo, hi, expert_ids, \
         created_at, extends, quantiles) values (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(run.id.as_str())
    .bind(run.task_id.as_str())
    .bind(run.job_id.as_str())
    .bind(run.encoder_id.as_str())
    .bind(run.snapshot_id.as_str())
    .bind(row::to_json(&run.spec)?)
    .bind(run.lo)
    .bind(run.hi)
    .bind(row::to_json(&run.expert_ids)?)
    .bind(run.created_at.0)
    .bind(run.extends.as_ref().map(|id| id.as_str()))
    .bind(pack(run.quantiles.iter().copied()))
    .execute(&mut **tx)
    .await
    .map_err(fault("adding a score run"))?;
    for (position, episode) in (0i64..).zip(scores) {
        insert_scores(tx, &run.id, position, episode).await?;
    }
    Ok(())
}

async fn insert_scores(
    tx: &mut Transaction<'_, Sqlite>,
    run: &ScoreRunId,
    position: i64,
    scores: &EpisodeScores,
) -> Result<()> {
    if !scores.fit() {
        return Err(Error::invalid(
            "scores",
            format!("the lists of {} differ in length; give one entry a step", scores.episode_id),
        ));
    }
    sqlx::query(
        "insert into episode_scores (score_run_id, position, episode_id, role, w, q, match_episode, match_step, \
         distances) values (?, ?, ?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(run.as_str())
    .bind(position)
    .bind(scores.episode_id.as_str())
    .bind(scores.role.as_str())
    .bind(pack(scores.w.iter().copied()))
    .bind(pack(scores.q.iter().copied()))
    .bind(pack(scores.match_episode.iter().copied()))
    .bind(pack(scores.match_step.iter().copied()))
    .bind(pack(scores.distances.iter().flatten().copied()))
    .execute(&mut **tx)
    .await
    .map_err(fault("adding an episode's scores"))?;
    Ok(())
}

impl Store {
    /// A finished score run.
    ///
    /// # Errors
    /// NotFound, or Precondition naming its job when that has not succeeded.
    pub(crate) async fn score_run(&self, id: &ScoreRunId) -> Result<ScoreRun> {
        let found: Option<RunRow> = sqlx::query_as("select * from score_runs where id = ?")
            .bind(id.as_str())
            .fetch_optional(self.read())
            .await
            .map_err(fault("reading a score run"))?;
        match found {
            Some(found) => found.run(),
            None => Err(self.missing(JobKind::Score, RUN, id.as_str()).await),
        }
    }

    /// A task's finished score runs, newest first.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn score_runs(&self, task: &TaskId) -> Result<Vec<ScoreRun>> {
        let rows: Vec<RunRow> = sqlx::query_as("select * from score_runs where task_id = ? order by id desc")
            .bind(task.as_str())
            .fetch_all(self.read())
            .await
            .map_err(fault("reading score runs"))?;
        rows.into_iter().map(RunRow::run).collect()
    }

    /// The newest finished score run of all tasks.
    pub(crate) async fn newest_run(&self) -> Result<Option<ScoreRunId>> {
        let newest: Option<String> =
            sqlx::query_scalar("select id from score_runs order by created_at desc, id desc limit 1")
                .fetch_optional(self.read())
                .await
                .map_err(fault("looking for the newest score run"))?;
        newest.map(|id| row::id("score_runs.id", id)).transpose()
    }

    /// The extent of a finished run.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn run_counts(&self, run: &ScoreRun) -> Result<RunCounts> {
        // The length of a blob is in its row's header, so no array is read.
        let (episodes, segments): (i64, i64) = sqlx::query_as(
            "select count(*), coalesce(sum(length(q)) / 4, 0) from episode_scores \
             where score_run_id = ? and role = 'imperfect'",
        )
        .bind(run.id.as_str())
        .fetch_one(self.read())
        .await
        .map_err(fault("counting a run's segments"))?;
        // Not counted from the scores: a single expert has none, because an episode never matches itself.
        let experts: i64 = sqlx::query_scalar(
            "select coalesce(sum(steps), 0) from snapshot_episodes join episodes on episodes.id = episode_id \
             where snapshot_id = ? and role = 'expert'",
        )
        .bind(run.snapshot_id.as_str())
        .fetch_one(self.read())
        .await
        .map_err(fault("counting a run's experts"))?;
        Ok(RunCounts {
            imperfect_episodes: row::count("count of episodes", episodes)?,
            imperfect_segments: row::count("count of segments", segments)?,
            expert_segments: row::count("count of segments", experts)?,
        })
    }

    /// One episode's scores.
    ///
    /// # Errors
    /// As for [`Store::score_run`]; NotFound when the run has no scores of the episode.
    pub(crate) async fn episode_scores(&self, run: &ScoreRunId, episode: &EpisodeId) -> Result<EpisodeScores> {
        let found: Option<ScoresRow> =
            sqlx::query_as("select * from episode_scores where score_run_id = ? and episode_id = ?")
                .bind(run.as_str())
                .bind(episode.as_str())
                .fetch_optional(self.read())
                .await
                .map_err(fault("reading an episode's scores"))?;
        match found {
            Some(found) => found.scores(),
            None => {
                self.score_run(run).await?;
                Err(Error::not_found(&format!("scores in {run} of"), episode))
            }
        }
    }
}

#[cfg(test)]
mod tests;
