//! Properties of every policy: it learns, resumes, survives its checkpoint, serves many histories at once.

use super::*;
use crate::checkpoint::{self, inspect};
use gleaner_core::Augmentation;

fn train(spec: &TrainSpec, resume: Option<&[u8]>) -> (Vec<u8>, Recorder) {
    let encoder = (spec.policy.name == "finetune").then(|| encoder(2));
    let mut monitor = Recorder::default();
    let (experts, kept) = (toy::experts(4, 12), kept(0.9));
    let bytes = train_policy(
        &toy::shape(),
        Pretrained { encoder: encoder.as_deref(), ..Pretrained::default() },
        &experts,
        &kept,
        spec,
        resume,
        &mut monitor,
    );
    (bytes.unwrap(), monitor)
}

/// Whether a policy reads images.
fn looks(form: &&str) -> bool {
    kind_of(form).needs.images
}

#[test]
fn a_resumed_run_equals_a_straight_one_bit_for_bit() {
    for kind in forms() {
        let augmentation = Augmentation { shift_pixels: 2, brightness: 0.1, contrast: 0.1, ..Augmentation::default() };
        let mut spec = TrainSpec { dropout: 0.2, ..spec(kind, 6).with_augmentation(augmentation) };
        spec.run.checkpoint_every = 2;
        let (result, straight) = train(&spec, None);
        let (again, resumed) = train(&spec, Some(&straight.checkpoints[0].1));
        assert_eq!(straight.losses[2..], resumed.losses, "{kind:?}");
        assert_eq!(straight.checkpoints[1], resumed.checkpoints[0], "{kind:?}");
        assert_eq!(result, again, "{kind:?}");
        assert_eq!(result, train(&spec, Some(&result)).0, "{kind:?}");
        let plain = train(&spec.with_augmentation(Augmentation::default()), None);
        let differs = plain.1.losses != straight.losses;
        assert_eq!(differs, looks(&kind), "{kind:?}: augmentation makes a difference where images are read");
    }
}

#[test]
fn a_checkpoint_describes_its_policy_and_its_round_trip_is_exact() {
    for kind in forms() {
        let (bytes, _) = train(&spec(kind, 2), None);
        let info = inspect(&bytes).unwrap();
        assert_eq!((info.policy.as_deref(), info.finished), (Some(kind_of(kind).name.as_str()), true));
        assert_eq!(info.settings, chosen(kind).settings);
        let policy = Policy::load(&bytes).unwrap();
        let (window, chunk) = match kind_of(kind).name.as_str() {
            "finetune" | "tf_bc" => (3, 1),
            "act" | "flow" | "diffusion" => (0, 4),
            _ => (0, 1),
        };
        assert_eq!(policy.kind(), kind_of(kind).name);
        assert_eq!((policy.segment_length(), policy.chunk_length()), (window, chunk), "{kind}");
        let (_, named) = checkpoint::read(&bytes, CheckpointKind::Policy).unwrap();
        let loaded: Box<dyn PolicyModel> = crate::train::Learner::from_named(&info, &named, Device::Cpu).unwrap();
        assert_eq!(checkpoint::write(&info, &crate::train::Learner::named(&loaded)).unwrap(), bytes, "{kind:?}");
    }
}

#[test]
fn a_checkpoint_of_another_policy_or_size_is_refused() {
    let (bytes, _) = train(&spec("bc", 1), None);
    let (info, named) = checkpoint::read(&bytes, CheckpointKind::Policy).unwrap();
    let named: Vec<_> = named.into_iter().collect();
    for policy in ["finetune", "tf_bc", "act"] {
        let lying = CheckpointInfo { policy: Some(policy.to_owned()), ..info.clone() };
        let error = Policy::load(&checkpoint::write(&lying, &named).unwrap()).unwrap_err();
        assert!(matches!(error, LearnError::Checkpoint(_)), "{error}");
    }
    let mut often = spec("act", 2);
    often.run.checkpoint_every = 1;
    let (bytes, straight) = train(&often, None);
    let policy = chosen("act").with(Family::Policy, "chunk_length", 5).unwrap();
    let longer = TrainSpec { policy, ..often };
    let unfinished = &straight.checkpoints[0].1;
    let error = train_policy(
        &toy::shape(),
        Pretrained::default(),
        &toy::experts(4, 12),
        &[],
        &longer,
        Some(unfinished),
        &mut Silent,
    );
    assert!(error.unwrap_err().to_string().starts_with("spec: "));
    assert!(Policy::load(&bytes).is_ok());
}

#[test]
fn sessions_in_one_pass_get_what_each_gets_alone() {
    for kind in forms() {
        let policy = Policy::load(&train(&spec(kind, 2), None).0).unwrap();
        let data = toy::episode("session", 77, 6, true);
        let mut history = History::new(policy.segment_length());
        let (mut alone, mut snapshots) = (Vec::new(), Vec::new());
        for t in 0..6 {
            let embedding = policy.embed(&[&data.frame(t)]).unwrap().remove(0);
            let numbers = data.numbers(t..t + 1).unwrap();
            history.push(embedding, numbers.proprioception).unwrap();
            alone.extend(policy.act(&[&history]).unwrap());
            snapshots.push(history.clone());
            history.set_executed(numbers.action).unwrap();
        }
        let all = policy.act(&snapshots.iter().collect::<Vec<_>>()).unwrap();
        assert_eq!(all.len(), alone.len());
        let pairs = all.concat().concat().into_iter().zip(alone.concat().concat());
        assert!(pairs.into_iter().all(|(a, b)| (a - b).abs() < 1e-5), "{kind:?}");
    }
}

#[test]
fn every_policy_looks_at_the_image() {
    let (shape, experts) = (toy::shape(), toy::experts(300, 6));
    let encoder = pretrain(&shape, &experts[..80], &toy::pretrain_spec(40), None, None, &mut Silent).unwrap();
    for kind in forms().filter(looks) {
        // What removes noise has to learn it at every time, and a grid which of its places matter, from more of them.
        let (steps, learning_rate, experts) = match kind {
            "flow" | "diffusion" => (350, 2e-3, &experts[..80]),
            GRID => (350, 1e-3, &experts[..]),
            _ => (200, 2e-3, &experts[..80]),
        };
        let run = |steps| {
            let mut monitor = Recorder::default();
            // Steps with hidden proprioception cannot be predicted.
            let mut spec = spec(kind, steps).with_augmentation(Augmentation::default());
            spec.optim.learning_rate = learning_rate;
            let bytes =
                train_policy(&shape, Pretrained::encoder(&encoder), experts, &[], &spec, None, &mut monitor).unwrap();
            let policy = Policy::load(&bytes).unwrap();
            let squares = [[0.1, 0.8], [0.9, 0.2], [0.2, 0.2]];
            (squares.map(|square| final_distance(&policy, square, 12)), monitor.metrics)
        };
        let (untrained, _) = run(1);
        let (trained, metrics) = run(steps);
        let (first, last) = (&metrics[0], &metrics[metrics.len() - 1]);
        assert!(last["loss"] < 0.5 * first["loss"], "{kind:?}: {first:?} {last:?}");
        // Without looking the mean is 0.43 at best, at the point nearest to all three squares. With a grid one distance
        // alone differs too much between processors.
        let mean = trained.iter().sum::<f32>() / trained.len() as f32;
        let near = if kind == GRID { mean < 0.2 } else { trained.iter().all(|distance| *distance < 0.2) };
        assert!(near, "{kind:?}: {untrained:?} {trained:?}");
        // An encoder has learnt to act from AA before it is finetuned.
        let from_scratch = kind != "finetune";
        assert!(!from_scratch || untrained.iter().any(|distance| *distance > 0.25), "{kind:?}: {untrained:?}");
        if kind_of(kind).name == "act" {
            assert!(last["loss_kl"] < 0.2 * first["loss_kl"] && last["loss_l1"] < 0.5 * first["loss_l1"]);
        }
    }
}

/// A rejected step may hold any value, and neither its images nor its numbers may reach the policy.
#[test]
fn statistics_do_not_depend_on_rejected_steps() {
    for kind in forms() {
        let spec = spec(kind, 1);
        let encoder = (kind == "finetune").then(|| encoder(1));
        let trained = |change: f32| {
            let mut kept = kept(0.9);
            // Steps 0 and 1 are outside each window of 4 that ends at step 9 or 8; they are the rejected ones.
            kept[0].steps = vec![(8, 0.9), (9, 0.9)];
            kept[0].trajectory = kept[0].trajectory.changed(|arrays| {
                arrays.action[0] += change;
                arrays.proprioception[0] += change;
                if change > 0.0 {
                    arrays.frames[..toy::shape().frame_bytes()].fill(255);
                }
            });
            let encoder = encoder.as_deref();
            train_policy(
                &toy::shape(),
                Pretrained { encoder, ..Pretrained::default() },
                &toy::experts(4, 12),
                &kept,
                &spec,
                None,
                &mut Silent,
            )
            .unwrap()
        };
        assert!(trained(0.0) == trained(100.0), "{kind}");
    }
}

#[test]
fn an_action_value_that_never_changed_in_training_is_returned_exactly() {
    for kind in forms() {
        // The encoder has seen it change.
        let encoder = (kind == "finetune").then(|| encoder(1));
        let mut experts = toy::experts(3, 8);
        for expert in &mut experts {
            *expert = expert.changed(|arrays| arrays.action.chunks_mut(2).for_each(|action| action[1] = 0.25));
        }
        let spec = spec(kind, 2);
        let bytes = train_policy(
            &toy::shape(),
            Pretrained { encoder: encoder.as_deref(), ..Pretrained::default() },
            &experts,
            &[],
            &spec,
            None,
            &mut Silent,
        )
        .unwrap();
        let policy = Policy::load(&bytes).unwrap();
        let mut history = History::new(policy.segment_length());
        let embedding = policy.embed(&[&toy::frame(0.2, 0.7)]).unwrap().remove(0);
        history.push(embedding, vec![0.4, 0.9, 5.0]).unwrap();
        let chunk = policy.act(&[&history]).unwrap().remove(0);
        assert!(chunk.iter().all(|action| action[0] != 0.25 && action[1] == 0.25), "{kind}: {chunk:?}");
    }
}

#[test]
fn actions_are_within_the_task_s_ranges() {
    use gleaner_core::action::ActionRange::{Binary, Within};
    for kind in forms() {
        let shape =
            crate::TaskShape { ranges: [Within(-0.01, 0.02), Binary(-1.0, 1.0)].into_iter().collect(), ..toy::shape() };
        let spec = TrainSpec { policy: chosen(kind), ..toy::train_spec(2) };
        let encoder = (kind == "finetune")
            .then(|| pretrain(&shape, &toy::experts(2, 8), &toy::pretrain_spec(1), None, None, &mut Silent).unwrap());
        let bytes = train_policy(
            &shape,
            Pretrained { encoder: encoder.as_deref(), ..Pretrained::default() },
            &toy::experts(3, 8),
            &[],
            &spec,
            None,
            &mut Silent,
        )
        .unwrap();
        let policy = Policy::load(&bytes).unwrap();
        let mut history = History::new(policy.segment_length());
        let embedding = policy.embed(&[&toy::frame(0.9, 0.1)]).unwrap().remove(0);
        history.push(embedding, vec![0.1, 0.9, 5.0]).unwrap();
        let chunk = policy.act(&[&history]).unwrap().remove(0);
        assert!(chunk.iter().all(|a| (-0.01..=0.02).contains(&a[0]) && a[1].abs() == 1.0), "{kind}: {chunk:?}");
    }
}

#[test]
fn the_loss_on_experts_that_are_held_out_is_reported_and_they_have_no_influence() {
    for kind in forms() {
        let encoder = (kind == "finetune").then(|| encoder(1));
        let spec = TrainSpec { validation_share: 0.25, ..spec(kind, 3) };
        let train = |experts: &[Trajectory]| {
            let mut monitor = Recorder::default();
            let bytes = train_policy(
                &toy::shape(),
                Pretrained { encoder: encoder.as_deref(), ..Pretrained::default() },
                experts,
                &[],
                &spec,
                None,
                &mut monitor,
            )
            .unwrap();
            (bytes, monitor.metrics)
        };
        let experts = toy::experts(4, 8);
        let (bytes, metrics) = train(&experts);
        assert!(metrics.iter().all(|step| step["loss_validation"] > 0.0), "{kind}: {metrics:?}");
        // One of the four is held out; another in its place changes its loss alone.
        let replaced = (0..4).filter(|place| {
            let mut changed = experts.clone();
            changed[*place] = toy::episode(&experts[*place].id, 90, 8, true);
            let (same, other) = train(&changed);
            same == bytes && other[0]["loss_validation"] != metrics[0]["loss_validation"]
        });
        assert_eq!(replaced.count(), 1, "{kind}");
    }
}

#[test]
fn a_frozen_image_encoder_keeps_its_weights_in_every_policy_that_looks() {
    for kind in forms().filter(looks) {
        let run = |factor: f64, steps: u64| {
            let optim = gleaner_core::OptimSpec { image_rate_factor: factor, ..toy::optim(steps) };
            let (bytes, _) = train(&TrainSpec { optim, ..spec(kind, steps) }, None);
            let (_, named) = checkpoint::read(&bytes, CheckpointKind::Policy).unwrap();
            let images = named.iter().filter(|(name, _)| name.split('.').nth(1) == Some(crate::model::IMAGES));
            images.flat_map(|(_, weights)| crate::batch::values(weights)).collect::<Vec<f32>>()
        };
        let (frozen, later, free) = (run(0.0, 1), run(0.0, 3), run(1.0, 3));
        assert!(!frozen.is_empty() && frozen == later && later != free, "{kind}");
    }
}
