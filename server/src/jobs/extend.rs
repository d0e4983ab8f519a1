//! Score runs that go on from an earlier one: whether they may, and with which settings.

use std::collections::HashSet;

use gleaner_learn::{ScoreSpec, Scorer};

use super::{Jobs, resolve::same_task};
use crate::{
    domain::{
        id::{EncoderId, EpisodeId, ScoreRunId, SnapshotId, TaskId},
        job::JobSpec,
        score::ScoreRun,
        snapshot::Role,
    },
    error::{Error, Result},
};

impl Jobs {
    /// A scoring that goes on from a finished run, with that run's encoder and settings.
    ///
    /// # Errors
    /// NotFound; Precondition when the run is not finished or the snapshot lacks one of its experts; Invalid when
    /// what was asked for is not what the run has.
    pub(super) async fn extension(
        &self,
        task: &TaskId,
        run: &ScoreRunId,
        (encoder, snapshot): (Option<EncoderId>, Option<SnapshotId>),
        asked: ScoreSpec,
    ) -> Result<JobSpec> {
        let base = self.0.store.score_run(run).await?;
        same_task("spec.score.extends", run.as_str(), &base.task_id, task)?;
        if let Some(encoder) = encoder.filter(|encoder| *encoder != base.encoder_id) {
            return Err(Error::invalid(
                "spec.score.encoder_id",
                format!("is {encoder}, but {run} was scored with {}; leave it out", base.encoder_id),
            ));
        }
        let JobSpec::Score { spec: frozen, .. } = self.0.store.job(&base.job_id).await?.spec else {
            return Err(Error::internal("reading a run's spec", "its job is no scoring"));
        };
        let spec = settings(&asked, frozen)?;
        let (_, own) = self.encoder(task, "spec.score.encoder_id", &base.encoder_id).await?;
        let snapshot_id = self.scored(task, snapshot, own).await?;
        self.has_every_expert(&base, &snapshot_id).await?;
        Ok(JobSpec::Score { encoder_id: base.encoder_id, snapshot_id, extends: Some(run.clone()), spec })
    }

    async fn has_every_expert(&self, base: &ScoreRun, snapshot: &SnapshotId) -> Result<()> {
        let (_, members) = self.0.store.snapshot(snapshot).await?;
        let experts: HashSet<&EpisodeId> =
            members.iter().filter(|member| member.role == Role::Expert).map(|member| &member.episode_id).collect();
        match base.expert_ids.iter().find(|id| !experts.contains(id)) {
            None => Ok(()),
            Some(lacking) => Err(Error::precondition(format!(
                "{snapshot} has no expert {lacking}, which {} was scored with; make a snapshot that has it, or score \
                 without extends",
                base.id
            ))),
        }
    }
}

/// The run's settings, run where and with what was asked. A setting that is the default means the run's.
fn settings(asked: &ScoreSpec, frozen: ScoreSpec) -> Result<ScoreSpec> {
    if [asked.scorer, frozen.scorer].contains(&Scorer::Classifier) {
        return Err(Error::invalid(
            "spec.score.extends",
            "cannot be with the scorer classifier, which learns from all episodes at once; score without extends",
        ));
    }
    let default = ScoreSpec::default();
    for (name, differs) in [
        ("scorer", asked.scorer != default.scorer && asked.scorer != frozen.scorer),
        ("similarity", asked.similarity != default.similarity && asked.similarity != frozen.similarity),
        ("feature_scale", asked.feature_scale != default.feature_scale && asked.feature_scale != frozen.feature_scale),
        ("yardstick", asked.yardstick != default.yardstick && asked.yardstick != frozen.yardstick),
        ("normaliser", asked.normaliser != default.normaliser && asked.normaliser != frozen.normaliser),
        ("modality_scale", asked.modality_scale.is_some() && asked.modality_scale != frozen.modality_scale),
    ] {
        if differs {
            return Err(Error::invalid(
                &format!("spec.score.{name}"),
                "is another than that of the run to extend, which is frozen; leave it out",
            ));
        }
    }
    Ok(ScoreSpec { device: asked.device, seed: asked.seed, threads: asked.threads, ..frozen })
}
