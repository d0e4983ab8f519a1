//! Tests of the parent module.

mod gpu;

use super::*;
use crate::batch::values;

fn spec(weight_decay: f64, clip_norm: f64) -> OptimSpec {
    OptimSpec { weight_decay, clip_norm, ..OptimSpec::default() }
}

/// Steps `[x]` under the loss `slope * x`.
fn run(spec: &OptimSpec, slope: f64, steps: u64) -> (f32, f64) {
    let x = Tensor::from_slice(&[1.0f32]).view([1, 1]).set_requires_grad(true);
    let mut adam = AdamW::new(vec![("x".into(), x.shallow_clone())]);
    let mut norm = 0.0;
    for step in 0..steps {
        adam.zero_grad();
        (&x * slope).sum(Kind::Float).backward();
        norm = adam.step(step, 0.1, spec);
    }
    (values(&x)[0], norm)
}

#[test]
fn the_first_steps_are_those_of_the_formula() {
    // A constant gradient makes mean / sqrt(square) exactly 1 after bias correction.
    let (x, norm) = run(&spec(0.0, 100.0), 3.0, 2);
    assert!((f64::from(x) - 0.8).abs() < 1e-6, "{x}");
    assert!((norm - 3.0).abs() < 1e-12);
    let (x, _) = run(&spec(0.5, 100.0), 3.0, 1);
    assert!((f64::from(x) - (1.0 - 0.1 * 0.5 - 0.1)).abs() < 1e-6, "{x}");
}

#[test]
fn the_image_encoder_has_a_rate_of_its_own() {
    let parameter =
        |name: &str| (name.to_owned(), Tensor::ones([1, 1], (Kind::Float, tch::Device::Cpu)).set_requires_grad(true));
    let parameters = ["model.head.image.out.weight", "model.image.project.weight"].map(parameter);
    let mut adam = AdamW::new(parameters.iter().map(|(name, x)| (name.clone(), x.shallow_clone())).collect());
    parameters.iter().map(|(_, x)| x).sum::<Tensor>().backward();
    let norm = adam.step(0, 0.1, &OptimSpec { image_rate_factor: 0.0, ..spec(0.5, 100.0) });
    let after = parameters.map(|(_, x)| values(&x)[0]);
    assert!((after[0] - 0.85).abs() < 1e-6, "{after:?}");
    assert_eq!(after[1], 1.0, "neither moved nor decayed");
    assert!((norm - 1.0).abs() < 1e-9, "a frozen part does not count: {norm}");
}

#[test]
fn the_norm_reported_is_the_one_before_clipping_and_nothing_moves_on_nan() {
    assert!((run(&spec(0.0, 1.0), 1e6, 1).1 - 1e6).abs() < 1.0);
    let (x, norm) = run(&spec(0.0, 1.0), f64::NAN, 1);
    assert!(norm.is_nan() && x == 1.0);
}

/// Parameters of several sizes and rules, drawn alike each time.
fn network() -> Vec<(String, Tensor)> {
    let sizes: [(&str, &[i64]); 8] = [
        ("model.head.out.weight", &[5, 7]),
        ("model.head.out.bias", &[5]),
        ("model.unused.weight", &[3, 3]),
        ("model.image.0.weight", &[4, 3, 2, 2]),
        ("model.image.0.bias", &[4]),
        ("model.token.time_embedding", &[2, 3]),
        // More than a block on a processor takes, so that the one after it is of another block.
        ("model.wide.weight", &[300, 220]),
        ("model.zoom.weight", &[3, 2]),
    ];
    let draw = |(at, (name, size)): (usize, (&str, &[i64]))| {
        let values = (Tensor::arange(size.iter().product::<i64>(), (Kind::Float, tch::Device::Cpu)) + int(at)).sin();
        (name.to_owned(), values.view(size).set_requires_grad(true))
    };
    sizes.into_iter().enumerate().map(draw).collect()
}

/// One parameter after the other, as the formula reads.
fn one_by_one(slots: &mut [Slot], step: i32, rate: f64, spec: &OptimSpec) {
    let _no_grad = no_grad_guard();
    let gradients = slots.iter().map(|slot| slot.parameter.grad()).filter(Tensor::defined);
    let norm = gradients.map(|gradient| gradient.square().sum(Kind::Double).double_value(&[])).sum::<f64>().sqrt();
    let scale = (spec.clip_norm / norm).min(1.0);
    for slot in slots.iter_mut().filter(|slot| slot.parameter.grad().defined()) {
        let (rate, gradient) =
            (rate * if slot.of_images { spec.image_rate_factor } else { 1.0 }, slot.parameter.grad() * scale);
        slot.mean = &slot.mean * BETA[0] + &gradient * (1.0 - BETA[0]);
        slot.square = &slot.square * BETA[1] + gradient.square() * (1.0 - BETA[1]);
        let [mean, square] =
            [(&slot.mean, BETA[0]), (&slot.square, BETA[1])].map(|(x, beta)| x / (1.0 - beta.powi(step + 1)));
        let kept = if slot.decays { 1.0 - rate * spec.weight_decay } else { 1.0 };
        let moved = &slot.parameter * kept - mean * rate / (square.sqrt() + EPSILON);
        slot.parameter.copy_(&moved);
    }
}

#[test]
fn blocks_move_as_one_parameter_after_the_other_does() {
    let spec = OptimSpec { image_rate_factor: 0.5, ..spec(0.1, 0.5) };
    let (ours, theirs) = (network(), network());
    let copy = |parameters: &[(String, Tensor)]| -> Vec<(String, Tensor)> {
        parameters.iter().map(|(name, x)| (name.clone(), x.shallow_clone())).collect()
    };
    let (mut blocks, mut single) = (AdamW::new(copy(&ours)), AdamW::new(copy(&theirs)));
    for step in 0..6u8 {
        for (optimizer, parameters) in [(&mut blocks, &ours), (&mut single, &theirs)] {
            optimizer.zero_grad();
            // The embedding has a gradient from the third step on, and what is unused has none.
            let used = |name: &str| !name.contains("unused") && (step > 1 || !name.contains("embedding"));
            let loss: Tensor =
                parameters.iter().filter(|(name, _)| used(name)).map(|(_, x)| x.pow_tensor_scalar(4).sum(None)).sum();
            loss.backward();
        }
        let norm = blocks.step(step.into(), 0.01, &spec);
        one_by_one(&mut single.slots, step.into(), 0.01, &spec);
        assert!(norm > spec.clip_norm, "clipping is part of the test: {norm}");
    }
    for ((name, ours), (_, theirs)) in ours.iter().zip(&theirs) {
        let worst = (ours - theirs).abs().max().double_value(&[]);
        assert!(worst < 1e-6, "{name}: {worst}");
    }
    assert_eq!(blocks.blocks.iter().filter(|block| block.decays && !block.of_images).count(), 2);
    assert_eq!(values(&ours[2].1), values(&network()[2].1), "without a gradient nothing decays");
    // The state is that of the parameters, also after it moved into blocks.
    let named: BTreeMap<String, Tensor> = blocks.named().into_iter().collect();
    let mut resumed = AdamW::new(copy(&ours));
    resumed.load(&named).unwrap();
    assert!(resumed.named().iter().all(|(name, x)| x.equal(&named[name])));
}
