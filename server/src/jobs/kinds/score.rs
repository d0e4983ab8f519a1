//! Scoring: an encoder and a snapshot in, a score run out. A run may extend an earlier one.

use std::collections::HashMap;

use gleaner_core::{PretrainSpec, ScoreSpec};

use super::{Resolved, extend, result_id};
use crate::{
    domain::{
        id::{EncoderId, EpisodeId, ScoreRunId, SnapshotId, TaskId},
        job::{Job, JobSpec},
        score::{EpisodeScores, Origin, ScoreRun},
        snapshot::{Role, RoleRule, SnapshotEpisode},
        time::Millis,
        work::{FrozenRun, Inputs},
    },
    error::{Error, Result},
    jobs::Jobs,
    store::{Store, finish::JobResult},
};

const ENCODER: &str = "spec.score.encoder_id";

/// Without an encoder, the newest of the task is taken; without a snapshot, the task's present
/// episodes are scored under the rule of the encoder's own.
pub(super) async fn resolve(
    jobs: &Jobs,
    task: &TaskId,
    (encoder, snapshot): (Option<EncoderId>, Option<SnapshotId>),
    extends: Option<ScoreRunId>,
    spec: ScoreSpec,
) -> Result<Resolved> {
    if let Some(run) = extends {
        let spec = extend::extension(jobs, task, &run, (encoder, snapshot), spec).await?;
        return Ok(Resolved::new(spec, jobs.0.store.score_run(&run).await?.origin.job_id().cloned()));
    }
    let encoder = match encoder {
        Some(named) => Some(named),
        None => jobs.0.store.newest_encoder(task, spec.needs_encoder()).await?,
    };
    let Some(encoder_id) = encoder else { return untrained(jobs, task, snapshot, spec).await };
    let (maker, own) = jobs.encoder(task, ENCODER, &encoder_id).await?;
    let snapshot_id = jobs.scored_snapshot(task, snapshot, &own).await?;
    Ok(Resolved::new(JobSpec::Score { encoder_id, snapshot_id, extends: None, spec }, Some(maker)))
}

/// A scoring in a task without an encoder: a scorer that reads none gets an untrained one, for the statistics of the steps.
async fn untrained(jobs: &Jobs, task: &TaskId, snapshot: Option<SnapshotId>, spec: ScoreSpec) -> Result<Resolved> {
    if spec.needs_encoder() {
        let scorer = &spec.scorer.name;
        let message = format!(
            "must be set: the scorer {scorer} reads an encoder, and the task has no trained one; pretrain one first"
        );
        return Err(Error::invalid(ENCODER, message));
    }
    let snapshot_id = jobs.snapshot(task, "spec.score.snapshot_id", snapshot, &RoleRule::default()).await?;
    let pretrain = JobSpec::Pretrain { snapshot_id: snapshot_id.clone(), spec: PretrainSpec::untrained() };
    let first = Resolved::new(pretrain, None);
    let encoder_id = EncoderId::parse("result_id", &first.result_id)?;
    let score = Resolved::new(JobSpec::Score { encoder_id, snapshot_id, extends: None, spec }, None);
    Ok(Resolved { first: Some(Box::new(first)), ..score })
}

pub(super) async fn inputs(
    jobs: &Jobs,
    encoder: &EncoderId,
    extends: Option<&ScoreRunId>,
    inputs: &mut Inputs,
) -> Result<()> {
    inputs.encoder = Some(jobs.0.store.encoder(encoder).await?.checkpoint);
    if let Some(run) = extends {
        let ScoreRun { lo, hi, quantiles, expert_ids, .. } = jobs.0.store.score_run(run).await?;
        inputs.base = Some(FrozenRun { lo, hi, quantiles, expert_ids });
    }
    Ok(())
}

/// A finished run without its scores.
pub(super) struct Finished<'a> {
    pub(super) encoder_id: &'a EncoderId,
    pub(super) snapshot_id: &'a SnapshotId,
    pub(super) extends: Option<&'a ScoreRunId>,
    pub(super) spec: &'a ScoreSpec,
    pub(super) lo: f64,
    pub(super) hi: f64,
    pub(super) quantiles: Vec<f64>,
}

impl Finished<'_> {
    pub(super) async fn accept(
        self,
        store: &Store,
        job: &Job,
        expert_ids: Vec<EpisodeId>,
        mut episodes: Vec<EpisodeScores>,
    ) -> Result<JobResult> {
        let Self { encoder_id, snapshot_id, extends, spec, lo, hi, quantiles } = self;
        check_scores(store, snapshot_id, &expert_ids, &mut episodes).await?;
        let run = ScoreRun {
            id: result_id(job, ScoreRunId::try_from)?,
            task_id: job.task_id.clone(),
            origin: Origin::Job { job_id: job.id.clone(), encoder_id: encoder_id.clone(), spec: spec.clone() },
            snapshot_id: snapshot_id.clone(),
            lo,
            hi,
            quantiles,
            extends: extends.cloned(),
            expert_ids,
            created_at: Millis::now(),
        };
        Ok(JobResult::Scores(Box::new(run), episodes))
    }
}

/// Checks every list of scores against its episode, and sorts the lists into the snapshot's order.
async fn check_scores(
    store: &Store,
    snapshot: &SnapshotId,
    expert_ids: &[EpisodeId],
    scores: &mut [EpisodeScores],
) -> Result<()> {
    let (_, episodes) = store.snapshot(snapshot).await?;
    let expected: HashMap<&EpisodeId, (usize, &SnapshotEpisode)> =
        episodes.iter().enumerate().map(|(place, episode)| (&episode.episode_id, (place, episode))).collect();
    for scores in scores.iter() {
        let field = format!("episode_scores of {}", scores.episode_id);
        let episode = expected
            .get(&scores.episode_id)
            .map(|(_, episode)| episode)
            .filter(|episode| episode.role == scores.role)
            .ok_or_else(|| Error::invalid(&field, "is not in the job's snapshot with this role"))?;
        fit(&field, scores, episode.steps, expert_ids.len())?;
    }
    let imperfect = |role: Role| role == Role::Imperfect;
    let scored = scores.iter().filter(|scores| imperfect(scores.role)).count();
    let all = episodes.iter().filter(|episode| imperfect(episode.role)).count();
    if scored != all {
        return Err(Error::invalid(
            "episode_scores",
            format!("are of {scored} imperfect episodes, the snapshot has {all}"),
        ));
    }
    scores.sort_by_key(|scores| expected.get(&scores.episode_id).map(|(place, _)| *place));
    if scores.windows(2).any(|pair| pair[0].episode_id == pair[1].episode_id) {
        return Err(Error::invalid("episode_scores", "lists an episode twice; list each episode once"));
    }
    Ok(())
}

fn fit(field: &str, scores: &EpisodeScores, steps: u64, experts: usize) -> Result<()> {
    let EpisodeScores { episode_id: _, role: _, w, q, match_episode, match_step: _, distances: _ } = scores;
    if !scores.fit() || u64::try_from(w.len()) != Ok(steps) {
        return Err(Error::invalid(
            field,
            format!("must have w and q of each of the {steps} steps, and a match of each or of none"),
        ));
    }
    if w.iter().any(|w| !w.is_finite()) || q.iter().any(|q| !(0.0..=1.0).contains(q)) {
        return Err(Error::invalid(field, "w must be finite and q between 0 and 1"));
    }
    match match_episode.iter().find(|&&expert| usize::try_from(expert).is_ok_and(|expert| expert >= experts)) {
        Some(expert) => Err(Error::invalid(
            field,
            format!("match_episode is {expert}, must be below {experts}, the number of expert_ids"),
        )),
        None => Ok(()),
    }
}
