//! Score runs that extend an earlier one: their preconditions and settings.

use std::collections::HashSet;

use gleaner_core::{Chosen, ScoreSpec, kinds::Family};
use serde_json::Value;

use crate::{
    domain::{
        id::{EncoderId, EpisodeId, ScoreRunId, SnapshotId, TaskId},
        job::JobSpec,
        score::ScoreRun,
        snapshot::Role,
    },
    error::{Error, Result},
    jobs::{Jobs, lookup::same_task},
};

/// A scoring that extends a finished run, with that run's encoder and settings.
///
/// # Errors
/// NotFound; Precondition when the run is not finished or was imported, or the snapshot lacks one of its experts; Invalid
/// when the order's settings differ from the run's.
pub(super) async fn extension(
    jobs: &Jobs,
    task: &TaskId,
    run: &ScoreRunId,
    (encoder, snapshot): (Option<EncoderId>, Option<SnapshotId>),
    requested: ScoreSpec,
) -> Result<JobSpec> {
    let base = jobs.0.store.score_run(run).await?;
    same_task("spec.score.extends", run.as_str(), &base.task_id, task)?;
    let (job, scored_with, _) = base.origin.job(run, "cannot score more episodes")?;
    if let Some(encoder) = encoder.filter(|encoder| encoder != scored_with) {
        return Err(Error::invalid(
            "spec.score.encoder_id",
            format!("is {encoder}, but {run} was scored with {scored_with}; leave it out"),
        ));
    }
    let JobSpec::Score { spec: frozen, .. } = jobs.0.store.job(job).await?.spec else {
        return Err(Error::internal("reading a run's spec", "its job is not a score job"));
    };
    let spec = settings(&requested, frozen)?;
    let snapshot_id = jobs.scored_snapshot(task, snapshot, &base.snapshot_id).await?;
    has_every_expert(jobs, &base, &snapshot_id).await?;
    Ok(JobSpec::Score { encoder_id: scored_with.clone(), snapshot_id, extends: Some(run.clone()), spec })
}

async fn has_every_expert(jobs: &Jobs, base: &ScoreRun, snapshot: &SnapshotId) -> Result<()> {
    let (_, members) = jobs.0.store.snapshot(snapshot).await?;
    let experts: HashSet<&EpisodeId> =
        members.iter().filter(|member| member.role == Role::Expert).map(|member| &member.episode_id).collect();
    match base.expert_ids.iter().find(|id| !experts.contains(id)) {
        None => Ok(()),
        Some(lacking) => Err(Error::precondition(format!(
            "{snapshot} has no expert {lacking}, which {} was scored with; create a snapshot with it, or score without \
             extends",
            base.id
        ))),
    }
}

/// The run's settings with the order's device and threads. A setting at its default takes the run's value.
fn settings(requested: &ScoreSpec, frozen: ScoreSpec) -> Result<ScoreSpec> {
    if let Some(spec) = [requested, &frozen].into_iter().find(|spec| spec.needs_all_episodes()) {
        return Err(Error::invalid(
            "spec.score.extends",
            format!(
                "does not fit the scorer {}, which learns from all episodes at once; score without extends",
                spec.scorer.name
            ),
        ));
    }
    // Those of the requested scorer, whose settings may have other defaults than the first scorer's.
    let usual = Chosen::new(Family::Scorer, &requested.scorer.name).unwrap_or_else(|_| requested.scorer.clone());
    let mut default = ScoreSpec { scorer: usual, ..ScoreSpec::default() }.values();
    default.insert(Family::Scorer.as_str().to_owned(), Family::Scorer.default_name().into());
    let fixed = frozen.values();
    let differs = |name: &str, value: &Value| default.get(name) != Some(value) && fixed.get(name) != Some(value);
    let free = |name: &str| name == "device";
    if let Some((name, _)) = requested.values().iter().find(|(name, value)| !free(name) && differs(name, value)) {
        return Err(Error::invalid(
            &format!("spec.score.settings.{name}"),
            "differs from that of the run to extend, which is frozen; leave it out",
        ));
    }
    Ok(ScoreSpec { device: requested.device, threads: requested.threads, ..frozen })
}
