//! Actions that do not belong to their observations: corrupted copies of an expert's. Independent of features and
//! votes.

use rand::seq::SliceRandom as _;
use rand_chacha::ChaCha8Rng;

use crate::batch::{rows, values};
use crate::error::LearnError;
use crate::model::Network;
use crate::random::normal;
use crate::trajectory::Trajectory;

/// Ways to corrupt.
pub(super) const WAYS: usize = 3;

/// Copies of `expert` with the actions of one way each: with `noise` standard deviations of noise, within the task's
/// ranges; shuffled in time; and those of `other`, stretched to the same length.
pub(super) fn copies(
    network: &Network,
    expert: &Trajectory,
    other: &Trajectory,
    noise: f64,
    rng: &mut ChaCha8Rng,
) -> Result<[Trajectory; WAYS], LearnError> {
    let (width, own, others) = (network.shape.action, expert.actions()?, other.actions()?);
    let actions = [noisy(network, &own, noise, rng), shuffled(&own, width, rng), stretched(&own, &others, width)];
    Ok(actions.map(|action| expert.with_actions(action)))
}

fn noisy(network: &Network, actions: &[f32], noise: f64, rng: &mut ChaCha8Rng) -> Vec<f32> {
    let (width, standard) = (network.shape.action, &network.statistics.action);
    let as_rows = |values: &[f32]| rows(values, width, network.device());
    let drawn = as_rows(&normal(rng, actions.len())) * noise * standard.varies();
    let mut noisy = values(&standard.invert(&(standard.apply(&as_rows(actions)) + drawn)));
    noisy.chunks_mut(width).for_each(|action| network.shape.ranges.apply(action));
    noisy
}

fn shuffled(actions: &[f32], width: usize, rng: &mut ChaCha8Rng) -> Vec<f32> {
    let mut steps: Vec<&[f32]> = actions.chunks(width).collect();
    steps.shuffle(rng);
    steps.concat()
}

fn stretched(actions: &[f32], others: &[f32], width: usize) -> Vec<f32> {
    let (steps, available) = (actions.len() / width, others.len() / width);
    let place = |step: usize| &others[step * available / steps * width..][..width];
    (0..steps).flat_map(place).copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checkpoint::{self, CheckpointKind};
    use crate::random::{Purpose, generator};
    use crate::score::tests::encoder;
    use crate::steps::Arrays;
    use crate::toy;
    use gleaner_core::action::{ActionRange, ActionRanges};

    fn network() -> Network {
        let (info, named) = checkpoint::read(&encoder(), CheckpointKind::Encoder).unwrap();
        Network::from_named(&info.shape, info.model, &named, tch::Device::Cpu).unwrap()
    }

    #[test]
    fn only_actions_are_corrupted_each_way_in_its_own() {
        let network = network();
        let (expert, other) = (toy::episode("e", 1, 4, true), toy::episode("o", 2, 8, true));
        let copies = copies(&network, &expert, &other, 0.5, &mut generator(1, Purpose::Corruption, 0)).unwrap();
        let copies = copies.map(|copy| copy.arrays());
        let (expert, other) = (expert.arrays(), other.arrays());
        for copy in &copies {
            assert_eq!((&copy.proprioception, copy.action.len()), (&expert.proprioception, expert.action.len()));
            assert_ne!(copy.action, expert.action);
        }
        let sorted = |episode: &Arrays| {
            let mut steps: Vec<Vec<u32>> =
                episode.action.chunks(2).map(|step| step.iter().map(|x| x.to_bits()).collect()).collect();
            steps.sort();
            steps
        };
        assert_eq!(sorted(&copies[1]), sorted(&expert), "the same actions in another order");
        let every_second: Vec<f32> =
            [0, 2, 4, 6].iter().flat_map(|step| &other.action[2 * step..2 * step + 2]).copied().collect();
        assert_eq!(copies[2].action, every_second);
    }

    #[test]
    fn noise_has_its_strength_and_stays_within_the_ranges() {
        let mut network = network();
        let actions = toy::episode("e", 1, 3000, true).actions().unwrap();
        let noisy = |network: &Network| super::noisy(network, &actions, 0.5, &mut generator(1, Purpose::Corruption, 0));
        let standard = |values: &[f32]| network.statistics.action.apply(&rows(values, 2, tch::Device::Cpu));
        let difference = values(&(standard(&noisy(&network)) - standard(&actions)));
        let square = difference.iter().map(|x| f64::from(x * x)).sum::<f64>() / 6000.0;
        assert!((square.sqrt() - 0.5).abs() < 0.02, "{square}");
        network.shape.ranges =
            [ActionRange::Binary(-1.0, 1.0), ActionRange::Within(-0.01, 0.01)].into_iter().collect::<ActionRanges>();
        assert!(noisy(&network).chunks(2).all(|step| step[0].abs() == 1.0 && step[1].abs() <= 0.01));
    }
}
