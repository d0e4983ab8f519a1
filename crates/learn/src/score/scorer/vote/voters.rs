//! The vote: the share of good points among the nearest ones, weighted by their distance. Plain points in groups.
//! Independent of episodes and of how points are made.

use gleaner_search::PARTS;
use tch::{Device, Tensor};

use crate::batch::{int, rows, values};
use crate::score::features::Features;

/// Distances computed at a time, per part.
const DISTANCES: usize = 1 << 22;

/// Good and bad points in groups.
pub(super) struct Voters {
    /// Per part `[N, width]`.
    points: [Tensor; PARTS],
    /// Whether each point is good.
    good: Vec<bool>,
    /// First point of each group, and the number of points as the last entry.
    bounds: Vec<usize>,
}

impl Voters {
    /// The voters of `groups`, at least one, each with its (good, bad) points.
    pub(super) fn new(groups: &[(Features, Features)], device: Device) -> Self {
        let widths = groups.first().map_or([1; PARTS], |(good, _)| good.widths());
        let mut all = Features::empty(widths);
        let (mut is_good, mut bounds) = (Vec::new(), vec![0]);
        for (good, bad) in groups {
            for (points, label) in [(good, true), (bad, false)] {
                all.extend([0, 1, 2].map(|part| points.values(part)));
                is_good.resize(all.count(), label);
            }
            bounds.push(all.count());
        }
        let points = [0, 1, 2].map(|part| rows(all.values(part), widths[part], device));
        Self { points, good: is_good, bounds }
    }

    /// Queries that are compared with all points at a time.
    pub(super) fn chunk(&self) -> usize {
        (DISTANCES / self.good.len().max(1)).max(1)
    }

    /// The quality of each of `queries`, per part `[Q, width]`: the share of good among its `most` nearest points, or
    /// all if there are fewer, weighted by softmax(−distance / median distance). The points of group `own` do not
    /// vote.
    ///
    /// Distances are Euclidean, added over the parts, and computed for each pair alone in single precision, so a
    /// quality does not depend on the other queries.
    pub(super) fn qualities(&self, queries: &[Tensor; PARTS], own: Option<usize>, most: usize) -> Vec<f64> {
        let apart = |part: usize| Tensor::cdist(&queries[part], &self.points[part], 2.0, Some(2));
        let distances = apart(0) + apart(1) + apart(2);
        let mut count = self.good.len();
        if let Some(own) = own {
            let (begin, end) = (self.bounds[own], self.bounds[own + 1]);
            let _own = distances.narrow(1, int(begin), int(end - begin)).fill_(f64::INFINITY);
            count -= end - begin;
        }
        let most = most.min(count);
        let (distances, nearest) = distances.topk(int(most), 1, false, true);
        let nearest: Vec<i64> = Vec::try_from(nearest.to_device(Device::Cpu).flatten(0, -1)).unwrap_or_default();
        let distances = values(&distances);
        let is_good = |point: &i64| usize::try_from(*point).is_ok_and(|point| self.good[point]);
        let pairs = distances.chunks(most).zip(nearest.chunks(most));
        pairs.map(|(distances, nearest)| share(distances, nearest.iter().map(is_good))).collect()
    }
}

/// The weighted share of good among points at these distances, in rising order.
fn share(distances: &[f32], is_good: impl Iterator<Item = bool>) -> f64 {
    // Of equal points only, each has the weight 1.
    let median = f64::from(distances[distances.len() / 2]).max(f64::MIN_POSITIVE);
    let (mut good, mut all) = (0.0, 0.0);
    for (distance, is_good) in distances.iter().zip(is_good) {
        let weight = (-f64::from(*distance) / median).exp();
        all += weight;
        good += if is_good { weight } else { 0.0 };
    }
    good / all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, generator, normal};

    /// Points on a line, in the first part.
    fn line(places: &[f32]) -> Features {
        Features::new([places.to_vec(), vec![0.0; places.len()], vec![0.0; places.len()]], [1; PARTS]).unwrap()
    }

    fn tensors(points: &Features) -> [Tensor; PARTS] {
        [0, 1, 2].map(|part| rows(points.values(part), points.widths()[part], Device::Cpu))
    }

    fn vote(groups: &[(Features, Features)], at: f32, own: Option<usize>, most: usize) -> f64 {
        Voters::new(groups, Device::Cpu).qualities(&tensors(&line(&[at])), own, most)[0]
    }

    #[test]
    fn near_points_weigh_more_and_far_ones_have_no_vote() {
        let groups = [(line(&[1.0]), line(&[2.0, 3.0, 50.0]))];
        let weights = [1.0, 2.0, 3.0].map(|distance: f64| (-distance / 2.0).exp());
        let expected = weights[0] / weights.iter().sum::<f64>();
        assert!((vote(&groups, 0.0, None, 3) - expected).abs() < 1e-9);
        assert_eq!(vote(&groups, 0.0, None, 1), 1.0);
        assert!(vote(&groups, 0.0, None, 99) > 0.0, "all that there are");
    }

    #[test]
    fn the_points_of_the_own_group_have_no_vote() {
        let groups = [(line(&[0.0, 0.1]), line(&[9.0, 9.1])), (line(&[9.0]), line(&[0.0]))];
        assert_eq!(vote(&groups, 0.0, None, 2), 0.5);
        assert_eq!((vote(&groups, 0.0, Some(0), 1), vote(&groups, 9.0, Some(0), 1)), (0.0, 1.0));
        assert_eq!((vote(&groups, 0.0, Some(1), 2), vote(&groups, 9.0, Some(1), 2)), (1.0, 0.0));
    }

    #[test]
    fn equal_points_share_the_vote() {
        let groups = [(line(&[4.0]), line(&[4.0, 4.0, 4.0]))];
        assert_eq!(vote(&groups, 4.0, None, 64), 0.25);
    }

    /// The reference's check: 200 good and 200 bad points, 16 dimensions, deviation 0.5, centres 6 apart. A centre
    /// scores 1 or 0 and the point midway 0.494 on average, with a deviation of 0.058.
    #[test]
    fn clouds_vote_for_their_centres_and_are_undecided_midway() {
        let mut midway = Vec::new();
        for seed in 0..20 {
            let drawn = normal(&mut generator(seed, Purpose::Style, 0), 400 * 16);
            let cloud = |half: usize, centre: f32| {
                let points = drawn[half * 200 * 16..(half + 1) * 200 * 16].chunks(16);
                let moved =
                    points.flat_map(|point| (0..16).map(|i| 0.5 * point[i] + if i == 0 { centre } else { 0.0 }));
                Features::new([moved.collect(), vec![0.0; 200], vec![0.0; 200]], [16, 1, 1]).unwrap()
            };
            let voters = Voters::new(&[(cloud(0, 0.0), cloud(1, 6.0))], Device::Cpu);
            let mut queries = vec![0.0; 3 * 16];
            (queries[16], queries[32]) = (3.0, 6.0);
            let queries = Features::new([queries, vec![0.0; 3], vec![0.0; 3]], [16, 1, 1]).unwrap();
            let found = voters.qualities(&tensors(&queries), None, 64);
            assert_eq!((found[0], found[2]), (1.0, 0.0));
            midway.push(found[1]);
        }
        let mean = midway.iter().sum::<f64>() / 20.0;
        // The standard error of the mean is 0.013.
        assert!((mean - 0.494).abs() < 0.045, "{mean}");
        assert!(midway.iter().all(|share| (share - 0.494).abs() < 0.25), "{midway:?}");
    }
}
