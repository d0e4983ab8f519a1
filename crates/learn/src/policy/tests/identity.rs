//! The case in which the weighted loss is plain behaviour cloning.

use super::*;
use crate::batch::Segments;
use crate::policy::source::{Source, mean_loss};
use crate::random::{Purpose, generator};

/// With every imperfect segment kept (β = 0) at weight 1, and λ = |D_i| / |D_e|:
///
/// E_{D_e}[ℓ] + λ E_{D_i}[ℓ] = (1 + λ) E_{D_e ∪ D_i}[ℓ],
///
/// plain behaviour cloning on the union, up to the factor that a learning rate of AdamW ignores.
#[test]
fn weights_of_one_are_behaviour_cloning_on_the_union() {
    let experts = toy::experts(2, 7);
    let imperfect = [toy::episode("failure", 40, 10, false)];
    let union: Vec<&Trajectory> = experts.iter().chain(&imperfect).collect();
    let every = |data: &[&Trajectory]| Segments::every(data);
    let all = |steps: usize| (0..u32::try_from(steps).unwrap()).map(|step| (step, 1.0)).collect();
    let kept = [WeightedSegments { trajectory: imperfect[0].clone(), steps: all(10) }];
    let sources = [
        Source { segments: every(&union[..2]), data: union[..2].to_vec() },
        Source { segments: Segments::kept(&kept), data: vec![&kept[0].trajectory] },
        Source { segments: every(&union), data: union.clone() },
    ];
    for kind in forms() {
        let policy = untrained(kind, &union);
        // One generator for both batches and one for the union: the same noise, in the same order.
        let mut noises = [generator(3, Purpose::Style, 0), generator(3, Purpose::Style, 0)];
        let loss = |source: &Source<'_>, noise: &mut rand_chacha::ChaCha8Rng| {
            let (batch, wanted) = source.collect(&policy.info().form(), &source.segments.all()).unwrap();
            mean_loss(policy.as_ref(), batch, None, &wanted, noise).0.double_value(&[])
        };
        let lambda = 10.0 / 14.0;
        let weighted = loss(&sources[0], &mut noises[0]) + lambda * loss(&sources[1], &mut noises[0]);
        let plain = (1.0 + lambda) * loss(&sources[2], &mut noises[1]);
        assert!((weighted - plain).abs() < 1e-5 * plain, "{kind:?}: {weighted} {plain}");
    }
}
