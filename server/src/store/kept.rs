//! The scores that selections read: q and w, with matches and recordings, row by row on the database's own thread, so
//! that a large run does not block the runtime.

use std::collections::HashMap;

use super::{
    Store, fault,
    row::{self, Column as _, Record, column, record},
    sql::{self, Row},
};
use crate::{
    domain::{
        id::{EpisodeId, ScoreRunId},
        score::{EpisodeScores, ScoreRun},
        selection::{Candidate, places},
        work::InputEpisode,
    },
    error::{Error, Result},
};
use futures::{Stream, StreamExt as _, TryStreamExt as _};

/// An imperfect episode with its matches, if the scorer gives any.
pub(super) struct Matched {
    pub(super) candidate: Candidate,
    pub(super) match_episode: Vec<u32>,
    pub(super) match_step: Vec<u32>,
}

/// The same with its recording.
pub(super) struct Recorded {
    pub(super) matched: Matched,
    pub(super) episode: InputEpisode,
}

record! { Matched: match_episode, match_step; candidate }

impl Record for Recorded {
    fn decode(row: &Row) -> sqlx::Result<Self> {
        Ok(Self { matched: Record::decode(row)?, episode: Record::decode(row)? })
    }
}

impl AsMut<Matched> for Matched {
    fn as_mut(&mut self) -> &mut Matched {
        self
    }
}

impl AsMut<Matched> for Recorded {
    fn as_mut(&mut self) -> &mut Matched {
        &mut self.matched
    }
}

impl Record for Candidate {
    /// Without places, which are computed from the matches.
    fn decode(row: &Row) -> sqlx::Result<Self> {
        let (episode_id, cohort) = (column(row, "episode_id")?, column(row, "cohort")?);
        Ok(Self { episode_id, cohort, w: column(row, "w")?, q: column(row, "q")?, places: Vec::new() })
    }
}

/// The query of a run's imperfect episodes in the snapshot's order, for its snapshot and the run.
macro_rules! imperfect {
    ($columns:literal $(, $joined:literal)?) => {
        concat!(
            "select episode_scores.episode_id, snapshot_episodes.cohort, w, q",
            $columns,
            " from episode_scores join snapshot_episodes \
             on snapshot_id = $1 and snapshot_episodes.episode_id = episode_scores.episode_id ",
            $($joined,)?
            " where score_run_id = $2 and episode_scores.role = 'imperfect' order by episode_scores.position"
        )
    };
}

impl Store {
    /// The q of each expert of a run, from its comparison with the other experts.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn expert_qualities(&self, run: &ScoreRunId) -> Result<Vec<Vec<f32>>> {
        sql::query("select q from episode_scores where score_run_id = $1 and role = 'expert' order by position")
            .bind(run.param())
            .try_map(row::read)
            .fetch_all(self.read())
            .await
            .map_err(fault("reading the experts' q"))
    }

    /// The values of a run's imperfect episodes that selections read, in the snapshot's order, with their cohorts in that
    /// snapshot. Only a selection that limits phases needs `places`, whose matches are two thirds more to read.
    ///
    /// # Errors
    /// As for [`Store::score_run`].
    pub(crate) async fn candidates(&self, run: &ScoreRunId, places: bool) -> Result<Vec<Candidate>> {
        let run = self.score_run(run).await?;
        if places {
            return self.matched(&run, true).await?.map_ok(|matched| matched.candidate).try_collect().await;
        }
        sql::query(imperfect!(""))
            .bind(run.snapshot_id.param())
            .bind(run.id.param())
            .try_map(row::read)
            .fetch_all(self.read())
            .await
            .map_err(fault("reading a run's scores"))
    }

    /// The same with matches, row by row.
    pub(super) async fn matched(
        &self,
        run: &ScoreRun,
        with_places: bool,
    ) -> Result<impl Stream<Item = Result<Matched>> + Unpin> {
        self.located(imperfect!(", match_episode, match_step"), run, with_places).await
    }

    /// The same with matches and recordings, row by row.
    pub(super) async fn recorded(
        &self,
        run: &ScoreRun,
        with_places: bool,
    ) -> Result<impl Stream<Item = Result<Recorded>> + Unpin> {
        let query = imperfect!(
            ", match_episode, match_step, recording, steps, file_name, snapshot_episodes.outcome",
            " join episodes on episodes.id = episode_scores.episode_id"
        );
        self.located(query, run, with_places).await
    }

    /// The rows of a query, their places computed if those are wanted.
    async fn located<T: Record + AsMut<Matched> + Send + Unpin + 'static>(
        &self,
        query: &'static str,
        run: &ScoreRun,
        with_places: bool,
    ) -> Result<impl Stream<Item = Result<T>> + Unpin> {
        let lengths = if with_places { Some(self.expert_lengths(run).await?) } else { None };
        let located = move |mut row: T| {
            let Matched { candidate, match_episode, match_step } = row.as_mut();
            if let Some(lengths) = &lengths {
                let unknown = || {
                    Error::internal("reading a match", format!("{} matches an unknown expert", candidate.episode_id))
                };
                candidate.places = places(match_episode, match_step, lengths).ok_or_else(unknown)?;
            }
            Ok(row)
        };
        let rows = sql::query(query)
            .bind(run.snapshot_id.param())
            .bind(run.id.param())
            .try_map(row::read::<T>)
            .fetch(self.read());
        Ok(rows.map(move |row| row.map_err(fault("reading a run's scores")).and_then(&located)))
    }

    /// The number of steps of each expert of a run.
    async fn expert_lengths(&self, run: &ScoreRun) -> Result<Vec<u64>> {
        let rows: Vec<(EpisodeId, u64)> = sql::query(
            "select episode_id, steps from snapshot_episodes join episodes on episodes.id = episode_id \
             where snapshot_id = $1 and role = 'expert'",
        )
        .bind(run.snapshot_id.param())
        .try_map(row::read)
        .fetch_all(self.read())
        .await
        .map_err(fault("reading the lengths of experts"))?;
        let steps: HashMap<EpisodeId, u64> = rows.into_iter().collect();
        let length = |id: &EpisodeId| {
            let unknown = || Error::internal("reading the lengths of experts", format!("{id} is not in the snapshot"));
            steps.get(id).copied().ok_or_else(unknown)
        };
        run.expert_ids.iter().map(length).collect()
    }

    /// The scores of up to `most` episodes of a run in the snapshot's order, from behind this position, with the position
    /// of the last one.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn scores_behind(
        &self,
        run: &ScoreRunId,
        position: i64,
        most: u32,
    ) -> Result<(Vec<EpisodeScores>, Option<i64>)> {
        let rows: Vec<(i64, EpisodeScores)> = sql::query(
            "select * from episode_scores where score_run_id = $1 and position > $2 order by position limit $3",
        )
        .bind(run.param())
        .bind(position)
        .bind(most)
        .try_map(|row| Ok((column(&row, "position")?, Record::decode(&row)?)))
        .fetch_all(self.read())
        .await
        .map_err(fault("reading a run's scores"))?;
        let last = rows.last().map(|(position, _)| *position);
        let scores: Vec<EpisodeScores> = rows.into_iter().map(|(_, scores)| scores).collect();
        if scores.iter().all(EpisodeScores::fit) {
            return Ok((scores, last));
        }
        Err(Error::internal("reading episode_scores", "the arrays of one row differ in length"))
    }
}
