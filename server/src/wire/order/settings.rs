//! Settings that several kinds of jobs share: optimiser, device, model size, augmentation.

use gleaner_learn::{Augmentation, Device, LearnError, OptimSpec, Preset};
use gleaner_proto::v1;

use crate::{
    domain::id::SnapshotId,
    error::{Error, Result},
};

pub(super) fn optim_from(optim: Option<v1::OptimSpec>) -> OptimSpec {
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

pub(super) fn optim_to(optim: OptimSpec) -> v1::OptimSpec {
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

pub(super) fn optional_snapshot(at: &str, id: &str) -> Result<Option<SnapshotId>> {
    if id.is_empty() { Ok(None) } else { SnapshotId::parse(&format!("{at}.snapshot_id"), id).map(Some) }
}

pub(super) fn device_from(at: &str, device: i32) -> Result<Device> {
    match v1::Device::try_from(device) {
        Ok(v1::Device::Unspecified | v1::Device::Cpu) => Ok(Device::Cpu),
        Ok(v1::Device::Cuda) => Ok(Device::Cuda),
        Err(_) => Err(unknown(at, "device")),
    }
}

pub(super) fn device_to(device: Device) -> i32 {
    match device {
        Device::Cpu => v1::Device::Cpu.into(),
        Device::Cuda => v1::Device::Cuda.into(),
    }
}

pub(super) fn preset_from(at: &str, preset: i32) -> Result<Preset> {
    match v1::Preset::try_from(preset) {
        Ok(v1::Preset::Unspecified | v1::Preset::Tiny) => Ok(Preset::Tiny),
        Ok(v1::Preset::Small) => Ok(Preset::Small),
        Ok(v1::Preset::Base) => Ok(Preset::Base),
        Err(_) => Err(unknown(at, "preset")),
    }
}

pub(super) fn preset_to(preset: Preset) -> i32 {
    match preset {
        Preset::Tiny => v1::Preset::Tiny.into(),
        Preset::Small => v1::Preset::Small.into(),
        Preset::Base => v1::Preset::Base.into(),
    }
}

pub(super) fn augmentation_from(augmentation: Option<v1::Augmentation>) -> Augmentation {
    let v1::Augmentation { shift_pixels, brightness, contrast } = augmentation.unwrap_or_default();
    Augmentation { shift_pixels, brightness, contrast }
}

pub(super) fn augmentation_to(augmentation: Augmentation) -> v1::Augmentation {
    let Augmentation { shift_pixels, brightness, contrast } = augmentation;
    v1::Augmentation { shift_pixels, brightness, contrast }
}

pub(super) fn unknown(at: &str, name: &str) -> Error {
    Error::invalid(&format!("{at}.{name}"), "is none that this server knows")
}

/// What the learning crate says of a spec, under the field's path in the request. Its `model` is flat there.
pub(super) fn refused(at: &str, error: LearnError) -> Error {
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
