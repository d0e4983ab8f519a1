//! What a job made, checked against what it was to make, as the rows to keep.

use std::collections::HashMap;

use crate::{
    domain::{
        evaluation::{Evaluation, SeedResult},
        id::{BlobId, EncoderId, EpisodeId, EvaluationId, ExportId, PolicyId, ScoreRunId, SnapshotId},
        job::{Job, JobSpec},
        policy::Policy,
        score::{Encoder, EpisodeScores, ScoreRun},
        snapshot::{Role, SnapshotEpisode},
        time::Millis,
        work::Made,
    },
    error::{Error, Result},
    store::{Store, finish::JobResult},
};

/// Every blob that the result names.
pub(super) fn blobs(made: &Made) -> Vec<&BlobId> {
    match made {
        Made::Encoder { checkpoint } | Made::Policy { checkpoint, .. } => vec![checkpoint],
        Made::Scores { .. } | Made::Trials(_) => Vec::new(),
        Made::Files(files) => files.iter().map(|file| &file.blob).collect(),
    }
}

/// The rows of a result.
///
/// # Errors
/// Invalid when the result does not fit the job.
pub(super) async fn of(store: &Store, job: &Job, made: Made) -> Result<JobResult> {
    let (task_id, job_id, created_at) = (job.task_id.clone(), job.id.clone(), Millis::now());
    match (&job.spec, made) {
        (JobSpec::Pretrain { snapshot_id, .. }, Made::Encoder { checkpoint }) => Ok(JobResult::Encoder(Encoder {
            id: result_id(job, EncoderId::try_from)?,
            task_id,
            job_id,
            snapshot_id: snapshot_id.clone(),
            checkpoint,
            created_at,
        })),
        (
            JobSpec::Score { encoder_id, snapshot_id, extends, spec },
            Made::Scores { lo, hi, quantiles, expert_ids, mut episodes },
        ) => {
            check_scores(store, snapshot_id, &expert_ids, &mut episodes).await?;
            let run = ScoreRun {
                id: result_id(job, ScoreRunId::try_from)?,
                task_id,
                job_id,
                encoder_id: encoder_id.clone(),
                snapshot_id: snapshot_id.clone(),
                spec: spec.clone(),
                lo,
                hi,
                quantiles,
                extends: extends.clone(),
                expert_ids,
                created_at,
            };
            Ok(JobResult::Scores(Box::new(run), episodes))
        }
        (JobSpec::Train { encoder_id, dataset_id, .. }, Made::Policy { checkpoint, kind }) => {
            Ok(JobResult::Policy(Policy {
                id: result_id(job, PolicyId::try_from)?,
                task_id,
                job_id,
                kind,
                encoder_id: encoder_id.clone(),
                dataset_id: dataset_id.clone(),
                checkpoint,
                created_at,
            }))
        }
        (JobSpec::Export { dataset_id }, Made::Files(files)) => {
            Ok(JobResult::Export(result_id(job, ExportId::try_from)?, dataset_id.clone(), files))
        }
        (JobSpec::Evaluate { policy_id, spec }, Made::Trials(seeds)) => {
            let told = |result: &SeedResult| (result.seed, result.episodes);
            if !seeds.iter().map(told).eq(spec.seeds.iter().map(|&seed| (seed, spec.episodes))) {
                return Err(Error::invalid("message.evaluation.seeds", "are not the seeds and episodes of the job"));
            }
            Ok(JobResult::Evaluation(Evaluation {
                id: result_id(job, EvaluationId::try_from)?,
                policy_id: policy_id.clone(),
                job_id: Some(job_id),
                simulation: spec.simulation.clone(),
                seeds,
                created_at,
            }))
        }
        (
            JobSpec::Pretrain { .. }
            | JobSpec::Score { .. }
            | JobSpec::Train { .. }
            | JobSpec::Export { .. }
            | JobSpec::Evaluate { .. },
            _,
        ) => Err(Error::invalid("message", format!("does not fit a job of kind {}", job.spec.kind().as_str()))),
    }
}

fn result_id<T>(job: &Job, read: impl FnOnce(String) -> std::result::Result<T, String>) -> Result<T> {
    read(job.result_id.clone()).map_err(|problem| Error::internal("reading a job's result id", problem))
}

/// Checks every list of scores against its episode, and puts them in the snapshot's order.
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
        return Err(Error::invalid("episode_scores", "an episode comes twice"));
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
        Some(expert) => Err(Error::invalid(field, format!("match_episode {expert} is out of {experts} expert_ids"))),
        None => Ok(()),
    }
}
