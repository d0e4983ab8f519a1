//! Training and running policies.

mod chunks;
mod every_kind;
mod finetune;
mod gradients;
mod identity;

use tch::Device;

use super::method::{Method, Start, entry};
use super::{Ensemble, Policy, train_policy};
use crate::History;
use crate::checkpoint::{CheckpointInfo, CheckpointKind, FORMAT_VERSION};
use crate::error::LearnError;
use crate::pretrain::pretrain;
use crate::spec::{ActSpec, PolicyKind, TrainSpec};
use crate::toy::{self, Recorder};
use crate::train::Silent;
use crate::trajectory::{Trajectory, WeightedSegments};

const KINDS: [PolicyKind; 4] = [PolicyKind::Finetune, PolicyKind::TfBc, PolicyKind::Bc, PolicyKind::Act];

fn encoder(steps: u64) -> Vec<u8> {
    let data = toy::experts(4, 12);
    let spec = toy::pretrain_spec(steps);
    pretrain(&toy::shape(), &data, &spec, None, &mut Silent).unwrap()
}

/// Segments 2 … 8 of a failure of ten steps.
fn kept(weight: f32) -> Vec<WeightedSegments> {
    vec![WeightedSegments {
        trajectory: toy::episode("failure", 40, 10, false),
        steps: (2..9).map(|step| (step, weight)).collect(),
    }]
}

fn spec(policy: PolicyKind, steps: u64) -> TrainSpec {
    let act = ActSpec { chunk_length: 4, latent_size: 4, ..ActSpec::default() };
    TrainSpec { policy, model: toy::pretrain_spec(1).model, act, ..toy::train_spec(steps) }
}

/// A policy of `kind` before its first step.
fn untrained(kind: PolicyKind, data: &[&Trajectory]) -> Box<dyn Method> {
    let (encoder, spec, shape) = (encoder(1), spec(kind, 1), toy::shape());
    let start = Start { shape: &shape, encoder: Some(&encoder), data, spec: &spec, device: Device::Cpu };
    let entry = entry(kind);
    let info = CheckpointInfo {
        format_version: FORMAT_VERSION,
        kind: CheckpointKind::Policy,
        step: 0,
        finished: false,
        shape: shape.clone(),
        model: (entry.model)(&start).unwrap(),
        policy: Some(kind),
        act: Some(spec.act),
        spec: String::new(),
    };
    (entry.begin)(&start, &info).unwrap()
}

/// Runs `policy` on an unseen square: how far the hand is from it after `steps`.
fn final_distance(policy: &Policy, square: [f32; 2], steps: u64) -> f32 {
    let mut hand = [0.5f32, 0.5];
    let mut history = History::new(policy.segment_length());
    let mut ensemble = Ensemble::new();
    let frame = toy::frame(square[0], square[1]);
    for step in 0..steps {
        let embedding = policy.embed(&[&frame]).unwrap().remove(0);
        history.push(embedding, vec![hand[0], hand[1], 5.0]).unwrap();
        let chunk = policy.act(&[&history]).unwrap().remove(0);
        assert_eq!(chunk.len(), policy.chunk_length() as usize);
        let action = ensemble.push(step, chunk).unwrap();
        hand = [hand[0] + action[0], hand[1] + action[1]];
        history.set_executed(action).unwrap();
    }
    (hand[0] - square[0]).hypot(hand[1] - square[1])
}
