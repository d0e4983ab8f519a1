//! The switches that policies share: initial weights random or of an encoder, the newest step or a history.

use std::collections::BTreeMap;

use tch::Tensor;

use super::*;
use crate::batch::values;
use crate::checkpoint;

/// Policies with these switches, as `every_policy_with_them_is_known` confirms.
const KINDS: [&str; 4] = ["bc", "act", "flow", "diffusion"];
/// Initial weights and steps of history; the encoder of the tests has a segment length of 3.
const SWITCHES: [(&str, u32); 4] = [("random", 0), ("random", 3), ("encoder", 0), ("encoder", 3)];

fn switched(kind: &str, (weights, history): (&str, u32), steps: u64) -> TrainSpec {
    let spec = spec(kind, steps);
    let policy = spec.policy.with(Family::Policy, "initial_weights", weights).unwrap();
    TrainSpec { policy: policy.with(Family::Policy, "history_steps", history).unwrap(), ..spec }
}

/// Every policy with every switch; a grid of image tokens is of the newest step alone.
fn all() -> impl Iterator<Item = (&'static str, (&'static str, u32))> {
    let grid = SWITCHES.into_iter().filter(|(_, history)| *history == 0).map(|switches| (GRID, switches));
    KINDS.into_iter().flat_map(|kind| SWITCHES.map(|switches| (kind, switches))).chain(grid)
}

fn train(spec: &TrainSpec, resume: Option<&[u8]>) -> (Vec<u8>, Recorder) {
    let encoder = encoder(2);
    let mut monitor = Recorder::default();
    let (experts, kept) = (toy::experts(4, 12), kept(0.9));
    let bytes = train_policy(&toy::shape(), Pretrained::encoder(&encoder), &experts, &kept, spec, resume, &mut monitor);
    (bytes.unwrap(), monitor)
}

fn tensors(bytes: &[u8]) -> BTreeMap<String, Tensor> {
    checkpoint::read(bytes, CheckpointKind::Policy).unwrap().1
}

#[test]
fn every_policy_with_them_is_known() {
    let with = |name: &str| {
        let has = move |kind: &&gleaner_core::kinds::Kind| kind.settings.iter().any(|setting| setting.name == name);
        Family::Policy.kinds().iter().filter(has).map(|kind| kind.name.as_str()).collect::<Vec<_>>()
    };
    assert_eq!((with("initial_weights"), with("history_steps")), (KINDS.to_vec(), KINDS.to_vec()));
}

#[test]
fn with_any_switch_a_run_resumes_exactly_and_its_checkpoint_round_trips() {
    for (kind, switches) in all() {
        let mut spec = switched(kind, switches, 3);
        spec.run.checkpoint_every = 2;
        let (result, straight) = train(&spec, None);
        assert_eq!(train(&spec, Some(&straight.checkpoints[0].1)).0, result, "{kind} {switches:?}");
        let policy = Policy::load(&result).unwrap();
        assert_eq!(policy.segment_length(), switches.1);
        let info = checkpoint::inspect(&result).unwrap();
        let loaded: Box<dyn PolicyModel> =
            crate::train::Learner::from_named(&info, &tensors(&result), Device::Cpu).unwrap();
        assert_eq!(checkpoint::write(&info, &crate::train::Learner::named(&loaded)).unwrap(), result);
    }
}

#[test]
fn a_run_whose_batches_hide_a_history_rarely_resumes_exactly() {
    let mut spec = spec("tf_bc", 10);
    spec.policy = spec.policy.with(Family::Policy, "history_dropout", 0.05).unwrap();
    spec.run.checkpoint_every = 1;
    let (result, straight) = train(&spec, None);
    for (step, unfinished) in &straight.checkpoints {
        assert!(train(&spec, Some(unfinished)).0 == result, "resumed from step {step}");
    }
}

#[test]
fn a_history_that_is_always_hidden_explains_no_action() {
    let mut spec = spec("tf_bc", 2);
    spec.policy = spec.policy.with(Family::Policy, "history_dropout", 1.0).unwrap();
    let (result, straight) = train(&spec, None);
    assert_eq!(straight.metric("share_history"), [0.0]);
    let served = Policy::load(&result).unwrap().shares(&toy::experts(4, 12), spec.run.seed).unwrap();
    let served: BTreeMap<_, _> = served.into_iter().collect();
    assert_eq!(served["share_history"], 0.0);
    assert!(served["share_images"] > 0.0);
}

#[test]
fn with_a_residual_encoder_the_loss_falls_and_a_run_resumes_exactly() {
    for kind in ["bc", "tf_bc"] {
        let mut spec = spec(kind, 30);
        spec.policy = spec.policy.with(Family::Policy, "image_encoder", "residual").unwrap();
        spec.run.checkpoint_every = 20;
        let (result, straight) = train(&spec, None);
        assert_eq!(train(&spec, Some(&straight.checkpoints[0].1)).0, result, "{kind}");
        let losses = straight.metric("loss");
        let mean = |part: &[f64]| part.iter().sum::<f64>() / 5.0;
        assert!(mean(&losses[25..]) < 0.7 * mean(&losses[..5]), "{kind}: {losses:?}");
        assert!(tensors(&result).keys().any(|name| name.contains(".residual.stage.3.0.conv_0")), "{kind}");
    }
}

#[test]
fn a_policy_begins_with_the_encoder_s_weights_and_statistics() {
    let encoder = encoder(2);
    let (_, given) = checkpoint::read(&encoder, CheckpointKind::Encoder).unwrap();
    for (kind, (weights, history)) in all() {
        let mut spec = switched(kind, (weights, history), 1);
        // A rate this low changes no weight that has digits like these.
        spec.optim.learning_rate = 1e-12;
        let found = tensors(&train(&spec, None).0);
        let prefix = if history == 0 { "policy.image." } else { "model.transformer." };
        let mut compared = 0;
        for (name, tensor) in found.iter().filter(|(name, _)| name.starts_with(prefix)) {
            let theirs = &given[&name.replace("policy.image.", "model.image.")];
            let near = (tensor - theirs).abs().max().double_value(&[]) < 1e-5;
            // Norms and biases have the same first values in every model.
            if theirs.size().len() > 1 {
                assert_eq!(near, weights == "encoder", "{kind} {history} {name}");
                compared += 1;
            }
        }
        assert!(compared >= 2, "{kind} {history}");
        let mean = |named: &BTreeMap<String, Tensor>| values(&named["statistics.proprioception.mean"]);
        assert_eq!(mean(&found) == mean(&given), weights == "encoder", "{kind} {history}");
    }
}

/// w = (1 − f) w_pretrained + f w_first, whatever the seed of the training.
#[test]
fn a_share_of_fresh_weights_is_mixed_into_those_of_the_encoder() {
    let begun = |base: &TrainSpec, share: f64| {
        let policy = base.policy.clone().with(Family::Policy, "fresh_share", share).unwrap();
        let mut spec = TrainSpec { policy, ..base.clone() };
        assert_ne!(spec.run.seed, toy::pretrain_spec(1).run.seed);
        // A rate this low changes no weight that has digits like these.
        spec.optim.learning_rate = 1e-12;
        tensors(&train(&spec, None).0)
    };
    let near = |a: &Tensor, b: &Tensor| (a - b).abs().max().double_value(&[]) < 1e-5;
    let given = checkpoint::read(&encoder(2), CheckpointKind::Encoder).unwrap().1;
    let mut unmoved = toy::pretrain_spec(1);
    unmoved.optim.learning_rate = 1e-12;
    let first = pretrain(&toy::shape(), &toy::experts(4, 12), &unmoved, None, None, &mut Silent).unwrap();
    let first = checkpoint::read(&first, CheckpointKind::Encoder).unwrap().1;
    let cases = [
        (spec("finetune", 1), "model."),
        (switched("bc", ("encoder", 0), 1), "policy.image."),
        (switched("act", ("encoder", 3), 1), "model."),
    ];
    for (base, prefix) in cases {
        let [plain, mixed, fresh] = [0.0, 0.25, 1.0].map(|share| begun(&base, share));
        let mut compared = 0;
        for (name, plain) in plain.iter().filter(|(name, plain)| name.starts_with(prefix) && plain.size().len() > 1) {
            let of_encoder = name.replace("policy.image.", "model.image.");
            assert!(near(plain, &given[&of_encoder]) && near(&fresh[name], &first[&of_encoder]), "{name}");
            assert!(near(&mixed[name], &(plain * 0.75 + &fresh[name] * 0.25)) && !near(plain, &fresh[name]), "{name}");
            compared += 1;
        }
        assert!(compared >= 2, "{prefix}");
    }
}

#[test]
fn with_a_history_a_policy_sees_past_actions_and_never_its_own() {
    let data = toy::episode("e", 1, 6, true);
    for kind in KINDS {
        let policy = untrained_with(&switched(kind, ("random", 3), 1), &[&data]);
        let moved = gradients::moved_by_actions(policy.as_ref(), &data).unwrap();
        assert!(moved[3] == 0.0 && moved[..3].iter().all(|gradient| *gradient > 1e-7), "{kind}: {moved:?}");
    }
}

#[test]
fn settings_that_the_encoder_does_not_have_and_a_missing_encoder_are_refused() {
    let message = |switches, encoder: Option<&[u8]>| {
        let spec = switched("bc", switches, 1);
        let experts = toy::experts(2, 8);
        train_policy(
            &toy::shape(),
            Pretrained { encoder, ..Pretrained::default() },
            &experts,
            &[],
            &spec,
            None,
            &mut Silent,
        )
        .unwrap_err()
        .to_string()
    };
    let encoder = encoder(1);
    let other = message(("encoder", 2), Some(&encoder));
    assert!(other.starts_with("history_steps: is 2, the encoder was pretrained with a segment_length of 3"), "{other}");
    let mut fresh = switched("bc", ("random", 0), 1);
    fresh.policy = fresh.policy.with(Family::Policy, "fresh_share", 0.5).unwrap();
    let refused =
        train_policy(&toy::shape(), Pretrained::default(), &toy::experts(2, 8), &[], &fresh, None, &mut Silent);
    let expected = "fresh_share: is 0.5, but initial_weights is random: all weights are; use 0, or encoder";
    assert_eq!(refused.unwrap_err().to_string(), expected);
    assert!(message(("encoder", 0), None).starts_with("encoder: is missing"));
    let spec = switched(GRID, ("random", 3), 1);
    let refused =
        train_policy(&toy::shape(), Pretrained::default(), &toy::experts(2, 8), &[], &spec, None, &mut Silent)
            .unwrap_err();
    let expected =
        "image_tokens: is grid, which shows the newest step alone, but history_steps is 3; use 0, or embedding";
    assert_eq!(refused.to_string(), expected);
    for (name, value) in [("preset", "large"), ("image_encoder", "residual")] {
        let mut spec = switched("bc", ("encoder", 0), 1);
        spec.policy = spec.policy.with(Family::Policy, name, value).unwrap();
        let experts = toy::experts(2, 8);
        let refused =
            train_policy(&toy::shape(), Pretrained::encoder(&encoder), &experts, &[], &spec, None, &mut Silent)
                .unwrap_err();
        assert!(refused.to_string().starts_with(&format!("{name}: is not the encoder's")), "{refused}");
    }
}

#[test]
fn hidden_actions_of_a_window_have_no_influence_on_any_policy() {
    for kind in KINDS {
        let mut spec = switched(kind, ("random", 3), 2);
        spec.policy = spec.policy.with(Family::Policy, "hidden_history", "actions").unwrap();
        let policy = Policy::load(&train(&spec, None).0).unwrap().hiding_history().unwrap();
        let acted = |seen: f32, executed: f32| acted(&policy, seen, executed);
        assert_eq!(acted(0.1, 0.1), acted(0.1, 0.9), "{kind}");
        assert_ne!(acted(0.1, 0.1), acted(0.9, 0.1), "{kind}");
    }
}
