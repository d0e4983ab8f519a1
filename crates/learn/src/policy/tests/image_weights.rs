//! Policies and encoders that begin with given weights of their image encoder.

use std::collections::BTreeMap;

use tch::Tensor;

use super::*;
use crate::batch::values;
use crate::checkpoint;
use crate::model::image_weights::made::{self, Tensors};
use gleaner_core::{ImageEncoder, ModelSpec, PretrainSpec};

fn given() -> Tensors {
    made::tensors(ImageEncoder::Resnet18)
}

/// The settings of a short training with a ResNet.
fn with_resnet(kind: &str, steps: u64) -> TrainSpec {
    let mut spec = spec(kind, steps);
    (spec.optim.batch, spec.optim.stretch, spec.run.checkpoint_every) = (4, 2, 1);
    TrainSpec { policy: spec.policy.with(Family::Policy, "image_encoder", "resnet18").unwrap(), ..spec }
}

fn train(spec: &TrainSpec, file: &[u8], resume: Option<&[u8]>) -> (Vec<u8>, Recorder) {
    let mut monitor = Recorder::default();
    let pretrained = Pretrained { image_weights: Some(file), ..Pretrained::default() };
    let bytes = train_policy(&toy::shape(), pretrained, &toy::experts(2, 6), &[], spec, resume, &mut monitor);
    (bytes.unwrap(), monitor)
}

/// The tensors of the ResNet in a checkpoint, by torchvision's names.
fn of_resnet(bytes: &[u8], kind: CheckpointKind) -> BTreeMap<String, Tensor> {
    let (_, named) = checkpoint::read(bytes, kind).unwrap();
    let own = |(name, tensor): (String, Tensor)| {
        let short = name.strip_prefix("policy.").or(name.strip_prefix("model."))?;
        Some((short.strip_prefix("image.camera.0.resnet.")?.to_owned(), tensor))
    };
    named.into_iter().filter_map(own).collect()
}

/// The largest difference between the tensors of a checkpoint and the given ones, for norms and for kernels.
fn moved(found: &BTreeMap<String, Tensor>, given: &Tensors) -> [f32; 2] {
    assert_eq!(found.len(), given.len());
    let mut moved = [0f32; 2];
    for (name, (size, expected)) in given {
        let own = if name == "conv1.weight" { found[name].narrow(1, 0, 3).contiguous() } else { found[name].copy() };
        let differences = values(&own).into_iter().zip(expected).map(|(found, expected)| (found - expected).abs());
        let most = &mut moved[usize::from(size.len() == 4)];
        *most = differences.fold(*most, f32::max);
    }
    moved
}

#[test]
fn a_run_with_given_weights_resumes_exactly_and_trains_kernels_but_no_norms() {
    let (given, spec) = (given(), with_resnet("bc", 2));
    let (result, straight) = train(&spec, &made::file(&given), None);
    // The file is not read again.
    assert_eq!(train(&spec, b"", Some(&straight.checkpoints[0].1)).0, result);
    let after = moved(&of_resnet(&result, CheckpointKind::Policy), &given);
    assert!(after[0] == 0.0 && after[1] > 1e-4, "{after:?}");
    assert!(Policy::load(&result).is_ok());
}

#[test]
fn a_policy_begins_with_exactly_the_given_weights() {
    let mut given = given();
    let run = |kind, given: &Tensors| {
        let mut spec = with_resnet(kind, 1);
        spec.optim.image_rate_factor = 0.0;
        train(&spec, &made::file(given), None).0
    };
    for kind in ["bc", "tf_bc"] {
        let bytes = run(kind, &given);
        assert_eq!(moved(&of_resnet(&bytes, CheckpointKind::Policy), &given), [0.0, 0.0], "{kind}");
        given.get_mut("layer4.1.bn2.bias").unwrap().1[0] += 1.0;
        assert_ne!(run(kind, &given), bytes, "{kind}: other weights make another policy");
    }
}

#[test]
fn an_encoder_begins_with_given_weights_and_policies_begin_from_it() {
    let (given, shape, data) = (given(), toy::shape(), toy::experts(2, 6));
    let file = made::file(&given);
    let mut spec = toy::every(1, toy::pretrain_spec(2));
    spec.model = ModelSpec { image_encoder: ImageEncoder::Resnet18, ..spec.model };
    (spec.optim.batch, spec.optim.stretch, spec.optim.image_rate_factor) = (4, 2, 0.0);
    let mut straight = Recorder::default();
    let mut run = |spec: &PretrainSpec, resume: Option<&[u8]>| {
        pretrain(&shape, &data, spec, Some(&file), resume, &mut straight).unwrap()
    };
    let encoder = run(&spec, None);
    assert_eq!(moved(&of_resnet(&encoder, CheckpointKind::Encoder), &given), [0.0, 0.0]);
    let half = straight.checkpoints[0].1.clone();
    assert_eq!(pretrain(&shape, &data, &spec, None, Some(&half), &mut Silent).unwrap(), encoder);
    let missing = pretrain(&shape, &data, &spec, None, None, &mut Silent).unwrap_err().to_string();
    assert!(missing.starts_with("image_weights: is missing"), "{missing}");
    let spec_of = |kind| match kind {
        "bc" => {
            let spec = with_resnet(kind, 1);
            TrainSpec { policy: spec.policy.with(Family::Policy, "initial_weights", "encoder").unwrap(), ..spec }
        }
        _ => super::spec(kind, 1),
    };
    for kind in ["finetune", "bc"] {
        let mut spec = spec_of(kind);
        spec.policy = spec.policy.with(Family::Policy, "fresh_share", 0.5).unwrap();
        spec.optim.image_rate_factor = 0.0;
        let pretrained = Pretrained::encoder(&encoder);
        let policy = train_policy(&shape, pretrained, &data, &[], &spec, None, &mut Silent).unwrap();
        assert_eq!(moved(&of_resnet(&policy, CheckpointKind::Policy), &given), [0.0, 0.0], "{kind}");
    }
}
