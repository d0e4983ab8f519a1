//! Orders and pipelines on the wire, with what is left out filled in; complete specs back.

use gleaner_learn::{Device, LearnError, ModelSpec, OptimSpec, Preset, PretrainSpec, ScoreSpec, TrainSpec};
use gleaner_proto::v1;

use super::{field, score, snapshot};
use crate::{
    domain::{
        id::{DatasetId, EncoderId, SnapshotId},
        job::JobSpec,
        order::{JobOrder, TrainData},
        schedule::PipelineSpec,
        snapshot::RoleRule,
    },
    error::{Error, Result},
};

/// Reads what a job is to do.
///
/// # Errors
/// Invalid names the field, such as `spec.pretrain.optim.steps`, and the mend.
pub(crate) fn order(spec: Option<v1::JobSpec>) -> Result<JobOrder> {
    let v1::JobSpec { spec } = field::required("spec", spec)?;
    match field::required("spec", spec)? {
        v1::job_spec::Spec::Pretrain(spec) => {
            let (snapshot_id, rule, spec) = pretrain("spec.pretrain", spec)?;
            Ok(JobOrder::Pretrain { snapshot_id, rule, spec })
        }
        v1::job_spec::Spec::Score(v1::ScoreSpec { encoder_id, snapshot_id, device }) => Ok(JobOrder::Score {
            encoder_id: EncoderId::parse("spec.score.encoder_id", &encoder_id)?,
            snapshot_id: optional_snapshot("spec.score", &snapshot_id)?,
            spec: ScoreSpec { device: device_from("spec.score.device", device)?, ..ScoreSpec::default() },
        }),
        v1::job_spec::Spec::Train(spec) => {
            let (data, spec) = train("spec.train", spec)?;
            let data = field::required("spec.train.data", data).map_err(|_| {
                Error::invalid("spec.train.data", "must be set: a dataset_id, or experts_of an encoder")
            })?;
            Ok(JobOrder::Train { data: train_data(data)?, spec })
        }
        v1::job_spec::Spec::Export(v1::ExportSpec { dataset_id, format }) => {
            match v1::ExportFormat::try_from(format) {
                Ok(v1::ExportFormat::Unspecified | v1::ExportFormat::Mcap) => {}
                Err(_) => return Err(Error::invalid("spec.export.format", "is none that this server knows; use MCAP")),
            }
            Ok(JobOrder::Export { dataset_id: DatasetId::parse("spec.export.dataset_id", &dataset_id)? })
        }
    }
}

/// Reads a pipeline.
///
/// # Errors
/// Invalid names the field, such as `pipeline.train.lambda`, and the mend.
pub(crate) fn pipeline(pipeline: Option<v1::PipelineSpec>) -> Result<PipelineSpec> {
    let v1::PipelineSpec { pretrain: first, score: scores, beta, train: last } = field::required("pipeline", pipeline)?;
    let (snapshot_id, rule, first) = pretrain("pipeline.pretrain", field::required("pipeline.pretrain", first)?)?;
    let beta = beta.map(|beta| score::beta("pipeline.beta", beta)).transpose()?;
    if beta.is_some() && !scores {
        return Err(Error::invalid("pipeline.beta", "needs scores; set pipeline.score, or leave beta out"));
    }
    if last.is_some() && beta.is_none() {
        return Err(Error::invalid("pipeline.train", "needs a dataset; set pipeline.beta, or leave train out"));
    }
    let last = last.map(|spec| match train("pipeline.train", spec)? {
        (None, spec) => Ok(spec),
        (Some(_), _) => Err(Error::invalid("pipeline.train.data", "must be left out: the pipeline fills it in")),
    });
    Ok(PipelineSpec { snapshot_id, rule, pretrain: first, score: scores, beta, train: last.transpose()? })
}

fn pretrain(at: &str, spec: v1::PretrainSpec) -> Result<(Option<SnapshotId>, RoleRule, PretrainSpec)> {
    let v1::PretrainSpec { snapshot_id, rule, preset, segment_length, optim, seed, device, checkpoint_every } = spec;
    let preset = match v1::Preset::try_from(preset) {
        Ok(v1::Preset::Unspecified | v1::Preset::Tiny) => Preset::Tiny,
        Ok(v1::Preset::Small) => Preset::Small,
        Ok(v1::Preset::Base) => Preset::Base,
        Err(_) => return Err(unknown(at, "preset")),
    };
    let default = PretrainSpec::default();
    let spec = PretrainSpec {
        model: ModelSpec { preset, segment_length: segment_length.unwrap_or(default.model.segment_length) },
        optim: optim_from(optim),
        seed,
        device: device_from(&format!("{at}.device"), device)?,
        checkpoint_every: checkpoint_every.unwrap_or(default.checkpoint_every),
        ..default
    };
    spec.validate().map_err(|error| refused(at, error))?;
    let rule = snapshot::rule_from_proto(&format!("{at}.rule"), rule)?;
    Ok((optional_snapshot(at, &snapshot_id)?, rule, spec))
}

fn train(at: &str, spec: v1::TrainSpec) -> Result<(Option<v1::train_spec::Data>, TrainSpec)> {
    let v1::TrainSpec { data, optim, lambda, seed, device, checkpoint_every } = spec;
    let default = TrainSpec::default();
    let spec = TrainSpec {
        optim: optim_from(optim),
        lambda: lambda.unwrap_or(default.lambda),
        seed,
        device: device_from(&format!("{at}.device"), device)?,
        checkpoint_every: checkpoint_every.unwrap_or(default.checkpoint_every),
        ..default
    };
    spec.validate().map_err(|error| refused(at, error))?;
    Ok((data, spec))
}

fn train_data(data: v1::train_spec::Data) -> Result<TrainData> {
    match data {
        v1::train_spec::Data::DatasetId(id) => DatasetId::parse("spec.train.dataset_id", &id).map(TrainData::Dataset),
        v1::train_spec::Data::ExpertsOf(id) => EncoderId::parse("spec.train.experts_of", &id).map(TrainData::ExpertsOf),
    }
}

fn optim_from(optim: Option<v1::OptimSpec>) -> OptimSpec {
    let v1::OptimSpec { steps, batch, learning_rate, weight_decay, warmup_steps, clip_norm } =
        optim.unwrap_or_default();
    let default = OptimSpec::default();
    OptimSpec {
        steps: steps.map_or(default.steps, u64::from),
        batch: batch.unwrap_or(default.batch),
        learning_rate: learning_rate.unwrap_or(default.learning_rate),
        weight_decay: weight_decay.unwrap_or(default.weight_decay),
        warmup_steps: warmup_steps.map_or(default.warmup_steps, u64::from),
        clip_norm: clip_norm.unwrap_or(default.clip_norm),
        ..default
    }
}

fn optional_snapshot(at: &str, id: &str) -> Result<Option<SnapshotId>> {
    if id.is_empty() { Ok(None) } else { SnapshotId::parse(&format!("{at}.snapshot_id"), id).map(Some) }
}

fn device_from(at: &str, device: i32) -> Result<Device> {
    match v1::Device::try_from(device) {
        Ok(v1::Device::Unspecified | v1::Device::Cpu) => Ok(Device::Cpu),
        Ok(v1::Device::Cuda) => Ok(Device::Cuda),
        Err(_) => Err(Error::invalid(at, "is none that this server knows")),
    }
}

fn unknown(at: &str, name: &str) -> Error {
    Error::invalid(&format!("{at}.{name}"), "is none that this server knows")
}

/// What the learning crate says of a spec, under the field's path in the request. Its `model` is flat there.
fn refused(at: &str, error: LearnError) -> Error {
    match error {
        LearnError::Invalid { field, message } => {
            let field = field.strip_prefix("model.").unwrap_or(&field);
            Error::invalid(&format!("{at}.{field}"), message)
        }
        error @ (LearnError::Checkpoint(_)
        | LearnError::Version { .. }
        | LearnError::Cancelled
        | LearnError::Diverged { .. }
        | LearnError::Monitor { .. }
        | LearnError::Torch(_)) => Error::invalid(at, error),
    }
}

/// A complete spec.
pub(crate) fn spec_to_proto(spec: JobSpec) -> v1::JobSpec {
    let spec = match spec {
        JobSpec::Pretrain { snapshot_id, spec } => {
            v1::job_spec::Spec::Pretrain(pretrain_to(spec, snapshot_id.into(), None))
        }
        JobSpec::Score { encoder_id, snapshot_id, spec } => v1::job_spec::Spec::Score(v1::ScoreSpec {
            encoder_id: encoder_id.into(),
            snapshot_id: snapshot_id.into(),
            device: device_to(spec.device),
        }),
        JobSpec::Train { encoder_id, snapshot_id: _, dataset_id, spec } => {
            let data = match dataset_id {
                Some(id) => v1::train_spec::Data::DatasetId(id.into()),
                None => v1::train_spec::Data::ExpertsOf(encoder_id.into()),
            };
            v1::job_spec::Spec::Train(train_to(spec, Some(data)))
        }
        JobSpec::Export { dataset_id } => v1::job_spec::Spec::Export(v1::ExportSpec {
            dataset_id: dataset_id.into(),
            format: v1::ExportFormat::Mcap.into(),
        }),
    };
    v1::JobSpec { spec: Some(spec) }
}

/// A pipeline, with defaults filled in.
pub(crate) fn pipeline_to_proto(pipeline: PipelineSpec) -> v1::PipelineSpec {
    let PipelineSpec { snapshot_id, rule, pretrain, score, beta, train } = pipeline;
    let snapshot_id = snapshot_id.map(String::from).unwrap_or_default();
    v1::PipelineSpec {
        pretrain: Some(pretrain_to(pretrain, snapshot_id, Some(rule))),
        score,
        beta,
        train: train.map(|spec| train_to(spec, None)),
    }
}

fn pretrain_to(spec: PretrainSpec, snapshot_id: String, rule: Option<RoleRule>) -> v1::PretrainSpec {
    let PretrainSpec { model, objectives: _, optim, seed, checkpoint_every, device, threads: _ } = spec;
    let preset = match model.preset {
        Preset::Tiny => v1::Preset::Tiny,
        Preset::Small => v1::Preset::Small,
        Preset::Base => v1::Preset::Base,
    };
    v1::PretrainSpec {
        snapshot_id,
        rule: rule.map(snapshot::rule_to_proto),
        preset: preset.into(),
        segment_length: Some(model.segment_length),
        optim: Some(optim_to(optim)),
        seed,
        device: device_to(device),
        checkpoint_every: Some(checkpoint_every),
    }
}

fn train_to(spec: TrainSpec, data: Option<v1::train_spec::Data>) -> v1::TrainSpec {
    let TrainSpec { policy: _, optim, lambda, seed, checkpoint_every, device, threads: _ } = spec;
    v1::TrainSpec {
        data,
        optim: Some(optim_to(optim)),
        lambda: Some(lambda),
        seed,
        device: device_to(device),
        checkpoint_every: Some(checkpoint_every),
    }
}

fn optim_to(optim: OptimSpec) -> v1::OptimSpec {
    let OptimSpec { steps, batch, stretch: _, learning_rate, weight_decay, warmup_steps, clip_norm } = optim;
    // Both came in as 32 bits.
    let narrow = |steps: u64| u32::try_from(steps).unwrap_or(u32::MAX);
    v1::OptimSpec {
        steps: Some(narrow(steps)),
        batch: Some(batch),
        learning_rate: Some(learning_rate),
        weight_decay: Some(weight_decay),
        warmup_steps: Some(narrow(warmup_steps)),
        clip_norm: Some(clip_norm),
    }
}

fn device_to(device: Device) -> i32 {
    match device {
        Device::Cpu => v1::Device::Cpu.into(),
        Device::Cuda => v1::Device::Cuda.into(),
    }
}

#[cfg(test)]
mod tests;
