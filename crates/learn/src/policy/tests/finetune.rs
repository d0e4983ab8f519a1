//! The properties of `finetune` alone, and the inputs that every policy rejects.

use super::*;
use crate::batch::{Batch, Segments};
use crate::checkpoint;
use crate::model::Network;
use crate::shape::TaskShape;

fn finetune(encoder: &[u8], kept: &[WeightedSegments], spec: &TrainSpec) -> (Vec<u8>, Recorder) {
    let mut monitor = Recorder::default();
    let bytes =
        train_policy(&toy::shape(), Pretrained::encoder(encoder), &toy::experts(4, 12), kept, spec, None, &mut monitor);
    (bytes.unwrap(), monitor)
}

#[test]
fn kept_segments_of_no_weight_leave_plain_behaviour_cloning() {
    let encoder = encoder(2);
    let weights = |bytes: &[u8]| {
        let (_, named) = checkpoint::read(bytes, checkpoint::CheckpointKind::Policy).unwrap();
        let all = named.values().flat_map(crate::batch::values);
        all.collect::<Vec<f32>>()
    };
    let spec = toy::train_spec(3);
    let no_lambda = TrainSpec { weighting: weighting("quality", 0.0), ..spec.clone() };
    let plain = weights(&finetune(&encoder, &[], &spec).0);
    assert_eq!(plain, weights(&finetune(&encoder, &kept(0.0), &spec).0));
    assert_eq!(plain, weights(&finetune(&encoder, &kept(1.0), &no_lambda).0));
    assert_ne!(plain, weights(&finetune(&encoder, &kept(1.0), &spec).0));
}

#[test]
fn the_loss_is_the_expert_mean_plus_lambda_times_the_weighted_kept_mean() {
    let encoder = encoder(1);
    let first = |weight, lambda| {
        let spec = TrainSpec { weighting: weighting("quality", lambda), ..toy::train_spec(1) };
        finetune(&encoder, &kept(weight), &spec).1.losses[0].1
    };
    let (base, full) = (first(0.0, 1.0), first(1.0, 1.0));
    assert!(full > base + 0.1);
    assert!((first(0.5, 1.0) - (base + 0.5 * (full - base))).abs() < 1e-5);
    assert!((first(1.0, 0.1) - (base + 0.1 * (full - base))).abs() < 1e-5);
    let alike = TrainSpec { weighting: weighting("uniform", 1.0), ..toy::train_spec(1) };
    assert!((finetune(&encoder, &kept(0.5), &alike).1.losses[0].1 - full).abs() < 1e-5);
}

fn weighting(name: &str, lambda: f64) -> gleaner_core::Chosen {
    let chosen = gleaner_core::Chosen::new(Family::Weighting, name).unwrap();
    chosen.with(Family::Weighting, "lambda", lambda).unwrap()
}

#[test]
fn a_session_with_cached_embeddings_acts_like_the_full_window() {
    let (bytes, _) = finetune(&encoder(2), &[], &toy::train_spec(2));
    let policy = Policy::load(&bytes).unwrap();
    let (_, named) = checkpoint::read(&bytes, checkpoint::CheckpointKind::Policy).unwrap();
    let network = Network::from_named(&toy::shape(), toy::pretrain_spec(1).model, &named, tch::Device::Cpu);
    let network = network.unwrap();
    let data = toy::episode("session", 77, 9, true);
    let segments = Segments::every(&[&data]);
    let batch = Batch::collect(&network.shape, &[&data], &segments.all(), 4, tch::Device::Cpu).unwrap();
    let full = network.actions(&network.batch_steps(&batch), &batch.proprioception, &batch.windows, None, 1);
    let full = crate::batch::values(&network.statistics.action.invert(&full));

    let mut history = History::new(policy.segment_length());
    let mut snapshots = Vec::new();
    for (t, expected) in full.chunks(2).enumerate() {
        let embedding = policy.embed(&[&data.frame(t)]).unwrap().remove(0);
        let numbers = data.numbers(t..t + 1).unwrap();
        history.push(embedding, numbers.proprioception).unwrap();
        let action = policy.act(&[&history]).unwrap().remove(0).remove(0);
        assert!((action[0] - expected[0]).hypot(action[1] - expected[1]) < 1e-5);
        snapshots.push(history.clone());
        history.set_executed(numbers.action).unwrap();
    }
    // Sessions of all lengths in one pass.
    let all = policy.act(&snapshots.iter().collect::<Vec<_>>()).unwrap().concat().concat();
    assert!(all.iter().zip(&full).all(|(a, b)| (a - b).abs() < 1e-5));
}

#[test]
fn a_hidden_past_has_no_influence_and_is_hidden_only_where_training_hid_it() {
    let policy = |dropout: f64| {
        let policy = chosen("finetune").with(Family::Policy, "history_dropout", dropout).unwrap();
        let (bytes, _) = finetune(&encoder(1), &[], &TrainSpec { policy, ..toy::train_spec(2) });
        Policy::load(&bytes).unwrap()
    };
    let act = |policy: &Policy, past: f32| {
        let mut history = History::new(policy.segment_length());
        for x in [past, 0.3] {
            history.push(policy.embed(&[&toy::frame(x, 0.5)]).unwrap().remove(0), vec![x, 0.0, 5.0]).unwrap();
            history.set_executed(vec![x, -x]).unwrap();
        }
        policy.act(&[&history]).unwrap()
    };
    let shown = policy(0.5);
    assert_ne!(act(&shown, 0.1), act(&shown, 0.9));
    let hidden = policy(0.5).hiding_history().unwrap();
    assert_eq!(act(&hidden, 0.1), act(&hidden, 0.9));
    assert_ne!(act(&hidden, 0.1), act(&shown, 0.1));
    assert!(policy(0.0).hiding_history().unwrap_err().to_string().starts_with("hide_history: "));
    // A policy that never saw a past is never shown one.
    let always = policy(1.0);
    assert_eq!(act(&always, 0.1), act(&always, 0.9));
}

#[test]
fn hidden_actions_have_no_influence_and_past_observations_keep_theirs() {
    let actions = chosen("finetune").with(Family::Policy, "hidden_history", "actions").unwrap();
    let (bytes, _) = finetune(&encoder(1), &[], &TrainSpec { policy: actions, ..toy::train_spec(2) });
    let load = || Policy::load(&bytes).unwrap();
    assert_ne!(acted(&load(), 0.1, 0.1), acted(&load(), 0.1, 0.9));
    let without = load().hiding_history().unwrap();
    assert_eq!(acted(&without, 0.1, 0.1), acted(&without, 0.1, 0.9));
    assert_ne!(acted(&without, 0.1, 0.1), acted(&without, 0.9, 0.1));
}

#[test]
fn a_policy_refuses_what_does_not_fit_it() {
    let (bytes, _) = finetune(&encoder(1), &[], &toy::train_spec(1));
    let policy = Policy::load(&bytes).unwrap();
    fn is_send<T: Send>(_: &T) {}
    is_send(&policy);
    let message = |error: LearnError| error.to_string();
    assert!(message(policy.embed(&[&[0u8; 5]]).unwrap_err()).starts_with("frames[0]: "));
    let empty = History::new(policy.segment_length());
    assert!(message(policy.act(&[&empty]).unwrap_err()).contains("empty"));
    let mut other = History::new(9);
    let frame = toy::frame(0.5, 0.5);
    let embedding = policy.embed(&[&frame]).unwrap().remove(0);
    other.push(embedding.clone(), vec![0.0; 3]).unwrap();
    assert!(message(policy.act(&[&other]).unwrap_err()).contains("needs 4"));
    for (m, problem) in [(vec![0.0; 2], "length 2"), (vec![f32::NAN; 3], "not finite")] {
        let mut history = History::new(policy.segment_length());
        history.push(embedding.clone(), m).unwrap();
        let message = message(policy.act(&[&history]).unwrap_err());
        assert!(message.contains("proprioception") && message.contains(problem), "{message}");
    }
    assert!(policy.act(&[]).unwrap().is_empty());
    assert!(Policy::load(&encoder(1)).is_err());
}

#[test]
fn bad_training_input_is_named() {
    let encoder = encoder(1);
    let experts = toy::experts(2, 6);
    let spec = toy::train_spec(1);
    let train = |experts: &[Trajectory], kept: &[WeightedSegments], shape: &TaskShape| {
        let result = train_policy(shape, Pretrained::encoder(&encoder), experts, kept, &spec, None, &mut Silent);
        result.unwrap_err().to_string()
    };
    let shape = toy::shape();
    assert!(train(&[], &[], &shape).starts_with("experts: "));
    let mut beyond = kept(1.0);
    beyond[0].steps.push((10, 1.0));
    assert!(train(&experts, &beyond, &shape).contains("step 10"));
    assert!(train(&experts, &kept(1.5), &shape).contains("weight 1.5"));
    let mut other = toy::shape();
    other.action = 1;
    let experts = experts.map_action(1);
    assert!(train(&experts, &[], &other).starts_with("shape: "));
    let none =
        train_policy(&shape, Pretrained::default(), &toy::experts(2, 6), &[], &spec, None, &mut Silent).unwrap_err();
    assert!(none.to_string().starts_with("encoder: "), "{none}");
}

trait MapAction {
    fn map_action(self, width: usize) -> Vec<Trajectory>;
}

impl MapAction for Vec<Trajectory> {
    /// The episodes with the first `width` action values of each step only.
    fn map_action(self, width: usize) -> Vec<Trajectory> {
        self.into_iter()
            .map(|trajectory| {
                trajectory.changed(|arrays| {
                    arrays.action = arrays.action.chunks(2).flat_map(|a| a[..width].to_vec()).collect();
                    arrays.widths.action = width;
                })
            })
            .collect()
    }
}
