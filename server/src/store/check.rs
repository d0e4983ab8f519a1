//! Consistency checks of `check`: documents can be parsed, and rows agree with the rows they refer to. Only reads.

use futures::TryStreamExt as _;
use gleaner_core::ScoreSpec;
use gleaner_recording::{Report, TaskSpec};
use serde::de::DeserializeOwned;

use super::{Store, fault, row};
use crate::{
    domain::{
        evaluation::SeedResult, id::EpisodeId, job::JobSpec, order::JobOrder, remote::RemotePolicy,
        schedule::PipelineSpec, snapshot::RoleRule,
    },
    error::Result,
};

/// A JSON column: its contents, its place, and the error of an unreadable value.
type Document = (&'static str, &'static str, fn(&str) -> Option<String>);

/// Columns that hold JSON.
const DOCUMENTS: [Document; 10] = [
    ("its spec", "select id, spec from tasks", unreadable::<TaskSpec>),
    ("its report", "select id, report from episodes", unreadable::<Report>),
    ("its rule", "select id, rule from snapshots", unreadable::<RoleRule>),
    ("its spec", "select id, spec from jobs", unreadable::<JobSpec>),
    ("its order", "select id, ordered from jobs where ordered <> ''", unreadable::<JobOrder>),
    ("its experts", "select id, expert_ids from score_runs", unreadable::<Vec<EpisodeId>>),
    ("its settings", "select id, settings from score_runs where job_id is not null", unreadable::<ScoreSpec>),
    ("its pipeline", "select id, pipeline from schedules", unreadable::<PipelineSpec>),
    ("its server", "select id, remote from policies where remote is not null", unreadable::<RemotePolicy>),
    ("its trials", "select id, seeds from evaluations", unreadable::<Vec<SeedResult>>),
];

/// Rules beyond foreign keys. Each returns the row and the problem, read at one moment.
const RULES: [&str; 14] = [
    // The visible label of an episode is the newest of its history.
    "select id, 'its label is not the newest of its history' from episodes where not exists \
     (select 1 from labels where labels.id = (select max(id) from labels where episode_id = episodes.id) \
      and labels.outcome = episodes.outcome and labels.cohort = episodes.cohort)",
    "select id, 'more of it is committed than it has' from uploads where committed > size_bytes or committed < 0",
    "select id, 'it has no expert or no imperfect episode' from snapshots where \
     (select count(distinct role) from snapshot_episodes where snapshot_id = snapshots.id) < 2",
    // Counts are those of what they count.
    "select id, 'its counts are not those of its episodes' from snapshots where \
     experts <> (select count(*) from snapshot_episodes where snapshot_id = snapshots.id and role = 'expert') \
     or imperfect <> (select count(*) from snapshot_episodes where snapshot_id = snapshots.id and role = 'imperfect') \
     or expert_steps <> (select coalesce(sum(steps), 0) from snapshot_episodes join episodes on episodes.id = episode_id \
     where snapshot_id = snapshots.id and role = 'expert')",
    "select id, 'its counts are not those of its scores' from score_runs where \
     (imperfect_episodes, imperfect_segments) <> (select count(*), coalesce(sum(length(q)), 0) / 4 from episode_scores \
     where score_run_id = score_runs.id and role = 'imperfect')",
    // A job that succeeded has its result, and no other job has.
    "select id, 'it succeeded, and its ' || kind || ' result ' || result_id || ' is not there' from jobs \
     where state = 'succeeded' and not exists (select 1 from encoders where id = result_id) \
     and not exists (select 1 from score_runs where id = result_id) \
     and not exists (select 1 from policies where id = result_id) \
     and not exists (select 1 from exports where id = result_id) \
     and not exists (select 1 from evaluations where id = result_id)",
    "select id, 'its job ' || job_id || ' did not make it' from \
     (select id, job_id from encoders union all select id, job_id from score_runs where job_id is not null \
      union all select id, job_id from policies where job_id is not null \
      union all select id, job_id from exports union all select id, job_id from evaluations where job_id is not null) \
     as made where not exists (select 1 from jobs where jobs.id = job_id and result_id = made.id and state = 'succeeded')",
    "select id, 'it waits for a job that has no result' from jobs where state = 'queued' and exists \
     (select 1 from job_dependencies join jobs as needed on needed.id = needs \
      where job_id = jobs.id and needed.state in ('failed', 'cancelled'))",
    "select id, 'it has ended, and still has a checkpoint or a token' from jobs \
     where state in ('succeeded', 'failed', 'cancelled') and (checkpoint is not null or token_hash is not null)",
    "select id, 'its score run ' || score_run_id || ' does not exist, and no job makes it' from datasets \
     where not exists (select 1 from score_runs where score_runs.id = score_run_id) \
     and not exists (select 1 from jobs where result_id = score_run_id and kind = 'score')",
    // Scores: one entry for each step, and every imperfect episode of the snapshot.
    "select score_run_id, 'its scores of ' || episode_id || ' do not fit the steps' from episode_scores \
     join episodes on episodes.id = episode_id where length(w) <> 8 * steps or length(q) <> 4 * steps \
     or length(match_episode) not in (0, 4 * steps) or length(match_step) <> length(match_episode) \
     or length(distances) <> 3 * length(match_episode)",
    "select score_runs.id, 'it has no scores of ' || snapshot_episodes.episode_id from score_runs \
     join snapshot_episodes using (snapshot_id) where role = 'imperfect' and not exists (select 1 from episode_scores \
     where score_run_id = score_runs.id and episode_scores.episode_id = snapshot_episodes.episode_id)",
    "select score_runs.id, 'its expert ' || value || ' is not in its snapshot' from score_runs, json_each(expert_ids) \
     where json_valid(expert_ids) and not exists (select 1 from snapshot_episodes where \
     snapshot_episodes.snapshot_id = score_runs.snapshot_id and episode_id = value and role = 'expert')",
    "select name, 'it points at no policy' from deployments where not exists \
     (select 1 from deployment_changes where deployment_changes.name = deployments.name)",
];

impl Store {
    /// The problems of the rows: subject and detail.
    pub(crate) async fn wrong_rows(&self) -> Result<Vec<(String, String)>> {
        let mut wrong = Vec::new();
        for (what, query, unreadable) in DOCUMENTS {
            let mut rows = row::query_as::<(String, String)>(query).fetch(self.read());
            while let Some((id, json)) = rows.try_next().await.map_err(fault("checking documents"))? {
                wrong.extend(unreadable(&json).map(|error| (id, format!("{what} does not read: {error}"))));
            }
        }
        for rule in RULES {
            let found: Vec<(String, String)> =
                row::query_as(rule).fetch_all(self.read()).await.map_err(fault("checking rows"))?;
            wrong.extend(found);
        }
        Ok(wrong)
    }
}

fn unreadable<T: DeserializeOwned>(json: &str) -> Option<String> {
    serde_json::from_str::<T>(json).err().map(|error| error.to_string())
}
