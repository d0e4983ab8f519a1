//! Training on the wire.

use gleaner_learn::{ActSpec, ModelSpec, PolicyKind, PretrainSpec, TrainSpec};
use gleaner_proto::v1;

use super::settings::{
    augmentation_from, augmentation_to, device_from, device_to, optim_from, optim_to, preset_from, preset_to, refused,
    unknown,
};
use crate::{
    domain::{
        id::{DatasetId, EncoderId, SnapshotId},
        order::{JobOrder, TrainData},
    },
    error::{Error, Result},
};

pub(super) fn order(at: &str, spec: v1::TrainSpec) -> Result<JobOrder> {
    let (data, spec) = from_proto(at, spec)?;
    let data = match data {
        Some(v1::train_spec::Data::DatasetId(id)) => {
            TrainData::Dataset(DatasetId::parse(&format!("{at}.dataset_id"), &id)?)
        }
        Some(v1::train_spec::Data::ExpertsOf(id)) => {
            TrainData::ExpertsOf(EncoderId::parse(&format!("{at}.experts_of"), &id)?)
        }
        Some(v1::train_spec::Data::ExpertsIn(id)) => {
            TrainData::ExpertsIn(SnapshotId::parse(&format!("{at}.experts_in"), &id)?)
        }
        None => {
            return Err(Error::invalid(
                &format!("{at}.data"),
                "must be set: a dataset_id, experts_of an encoder, or experts_in a snapshot",
            ));
        }
    };
    if matches!(data, TrainData::ExpertsIn(_)) && spec.policy == PolicyKind::Finetune {
        return Err(Error::invalid(
            &format!("{at}.experts_in"),
            "names no encoder for finetune to begin from; use experts_of, or a policy that starts from scratch",
        ));
    }
    Ok(JobOrder::Train { data, spec })
}

pub(super) fn from_proto(at: &str, spec: v1::TrainSpec) -> Result<(Option<v1::train_spec::Data>, TrainSpec)> {
    let v1::TrainSpec {
        data,
        optim,
        lambda,
        seed,
        device,
        checkpoint_every,
        policy,
        act,
        augmentation,
        preset,
        segment_length,
        history_dropout,
    } = spec;
    let policy = match v1::PolicyKind::try_from(policy) {
        Ok(v1::PolicyKind::Unspecified | v1::PolicyKind::Finetune) => PolicyKind::Finetune,
        Ok(v1::PolicyKind::TfBc) => PolicyKind::TfBc,
        Ok(v1::PolicyKind::Bc) => PolicyKind::Bc,
        Ok(v1::PolicyKind::Act) => PolicyKind::Act,
        Err(_) => return Err(unknown(at, "policy")),
    };
    if history_dropout.is_some() && !has_history(policy) {
        let detail = format!("is for policies with a history; leave it out for {}", policy.as_str());
        return Err(Error::invalid(&format!("{at}.history_dropout"), detail));
    }
    let default = TrainSpec::default();
    let spec = TrainSpec {
        policy,
        model: model_from(at, policy, preset, segment_length)?,
        act: act_from(at, policy, act)?,
        augmentation: augmentation_from(augmentation),
        optim: optim_from(optim),
        history_dropout: history_dropout.unwrap_or(default.history_dropout),
        lambda: lambda.unwrap_or(default.lambda),
        seed,
        device: device_from(at, device)?,
        checkpoint_every: checkpoint_every.unwrap_or(default.checkpoint_every),
        ..default
    };
    spec.validate().map_err(|error| refused(at, error))?;
    Ok((data, spec))
}

/// A pipeline's training, whose encoder comes from this pretraining: finetune may repeat the encoder's size.
pub(super) fn without_repeats(spec: v1::TrainSpec, pretrain: &PretrainSpec) -> v1::TrainSpec {
    let finetune = [v1::PolicyKind::Unspecified, v1::PolicyKind::Finetune].map(i32::from).contains(&spec.policy);
    let ModelSpec { preset, segment_length } = pretrain.model;
    v1::TrainSpec {
        preset: if finetune && spec.preset == preset_to(preset) { 0 } else { spec.preset },
        segment_length: spec.segment_length.filter(|&length| !finetune || length != segment_length),
        ..spec
    }
}

fn model_from(at: &str, policy: PolicyKind, preset: i32, segment_length: Option<u32>) -> Result<ModelSpec> {
    let default = ModelSpec::default();
    let model = ModelSpec {
        preset: preset_from(at, preset)?,
        segment_length: segment_length.unwrap_or(default.segment_length),
    };
    let given = [("preset", preset != v1::Preset::Unspecified as i32), ("segment_length", segment_length.is_some())];
    if let Some((name, _)) = given.iter().find(|(_, given)| *given && policy == PolicyKind::Finetune) {
        return Err(Error::invalid(
            &format!("{at}.{name}"),
            "is the encoder's for finetune; leave it out, or choose a policy that starts from scratch",
        ));
    }
    if !has_history(policy) && model.segment_length != default.segment_length {
        let detail = format!("is for policies with a history; leave it out for {}", policy.as_str());
        return Err(Error::invalid(&format!("{at}.segment_length"), detail));
    }
    Ok(model)
}

fn act_from(at: &str, policy: PolicyKind, act: Option<v1::ActSpec>) -> Result<ActSpec> {
    let default = ActSpec::default();
    let Some(v1::ActSpec { chunk_length, kl_weight, latent_size }) = act else { return Ok(default) };
    if policy != PolicyKind::Act {
        return Err(Error::invalid(
            &format!("{at}.act"),
            format!("is for the policy ACT, not for {}; leave it out", policy.as_str()),
        ));
    }
    Ok(ActSpec {
        chunk_length: chunk_length.unwrap_or(default.chunk_length),
        kl_weight: kl_weight.unwrap_or(default.kl_weight),
        latent_size: latent_size.unwrap_or(default.latent_size),
    })
}

fn has_history(policy: PolicyKind) -> bool {
    match policy {
        PolicyKind::Finetune | PolicyKind::TfBc => true,
        PolicyKind::Bc | PolicyKind::Act => false,
    }
}

pub(super) fn to_proto(spec: TrainSpec, data: Option<v1::train_spec::Data>) -> v1::TrainSpec {
    let TrainSpec {
        policy,
        model,
        act,
        augmentation,
        history_dropout,
        optim,
        lambda,
        seed,
        checkpoint_every,
        device,
        threads: _,
    } = spec;
    let kind = match policy {
        PolicyKind::Finetune => v1::PolicyKind::Finetune,
        PolicyKind::TfBc => v1::PolicyKind::TfBc,
        PolicyKind::Bc => v1::PolicyKind::Bc,
        PolicyKind::Act => v1::PolicyKind::Act,
    };
    let scratch = policy != PolicyKind::Finetune;
    let ActSpec { chunk_length, kl_weight, latent_size } = act;
    let act =
        v1::ActSpec { chunk_length: Some(chunk_length), kl_weight: Some(kl_weight), latent_size: Some(latent_size) };
    v1::TrainSpec {
        data,
        optim: Some(optim_to(optim)),
        lambda: Some(lambda),
        seed,
        device: device_to(device),
        checkpoint_every: Some(checkpoint_every),
        policy: kind.into(),
        act: (policy == PolicyKind::Act).then_some(act),
        augmentation: Some(augmentation_to(augmentation)),
        preset: if scratch { preset_to(model.preset) } else { v1::Preset::Unspecified.into() },
        segment_length: (scratch && has_history(policy)).then_some(model.segment_length),
        history_dropout: has_history(policy).then_some(history_dropout),
    }
}
