//! The local scale of a similarity: the distance between experts around the matched segment.
//!
//! Where experts differ widely (free reaching, each from elsewhere) even a good segment is far from
//! its match, and where they agree (all holding the cube) even a bad one is near. So w alone ranks
//! phases of a task, not the quality within them. q = norm(w / ρ(τ*)) does not: with τ* the match,
//! ρ(τ*) = the mean over the k expert segments nearest to τ* of their distance to the nearest
//! segment of another expert. w / ρ is about −1 wherever an expert is. Independent of norm.

use gleaner_search::{Metric, Neighbours};

use super::EpisodeScores;
use super::alike::Copies;
use super::features::Features;

/// k: enough that a single unusual expert does not set the scale, few enough that the scale stays local.
const NEIGHBOURS: usize = 10;
/// Lower bound of a local scale, as a part of the mean one: experts that share a stretch must not make all other distances
/// infinite.
const LEAST: f64 = 1e-3;
/// Lower bound where all experts have the same segments: w divided by it is finite.
const SMALLEST: f64 = 1e-12;

/// w of every segment of `episode`, relative to the local scale of its match. `local` has one scale for each expert, in
/// the given order, and step; without scales or matches the result is w itself.
pub(super) fn relative(local: Option<&Vec<Vec<f64>>>, episode: &EpisodeScores) -> impl Iterator<Item = f64> {
    (0..episode.w.len()).map(move |at| match (local, episode.match_episode.get(at)) {
        (Some(local), Some(expert)) => episode.w[at] / local[*expert as usize][episode.match_step[at] as usize],
        _ => episode.w[at],
    })
}

/// The spread of experts around each of their segments.
pub(super) struct Spread<'a> {
    /// Of each recording once: the copies of one are not other experts.
    neighbours: Neighbours,
    copies: &'a Copies,
    /// The distance of every segment of those to the nearest one of another expert.
    distances: Vec<f64>,
    least: f64,
}

impl<'a> Spread<'a> {
    /// The spread of `experts`, among which are `copies`, under `metric`. `alone` is w of each expert against the others.
    pub(super) fn new((experts, copies): (&[Features], &'a Copies), metric: Metric, alone: &[&[f64]]) -> Self {
        let distances: Vec<f64> = copies.distinct(alone).iter().flat_map(|(_, w)| w.iter().map(|w| -w)).collect();
        #[expect(clippy::cast_precision_loss, reason = "far fewer segments than 2^52")]
        let least = (LEAST * distances.iter().sum::<f64>() / distances.len().max(1) as f64).max(SMALLEST);
        let experts: Vec<&Features> = copies.distinct(experts).into_iter().map(|(_, features)| features).collect();
        Self { neighbours: Neighbours::new(&experts, metric), copies, distances, least }
    }

    /// ρ of every segment of the expert of this number.
    pub(super) fn around(&self, expert: usize) -> Vec<f64> {
        let nearest = self.neighbours.nearest(self.copies.place(expert), NEIGHBOURS);
        nearest.into_iter().map(|near| mean(near, &self.distances).max(self.least)).collect()
    }
}

/// The mean of `distances` at `places`, added in a fixed order, whatever the order of `places`.
fn mean(mut places: Vec<usize>, distances: &[f64]) -> f64 {
    places.sort_unstable();
    #[expect(clippy::cast_precision_loss, reason = "a handful")]
    let count = places.len().max(1) as f64;
    places.iter().map(|place| distances[*place]).sum::<f64>() / count
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::score::comparison::Similarity;
    use crate::score::similarity::metric;

    /// Experts on a line: dense near 0, sparse near 100.
    fn line() -> Vec<Features> {
        let episode = |offset: f32| {
            let dense = (0..8).map(|i| offset + i as f32 * 0.01);
            let o: Vec<f32> = dense.chain((0..8).map(|i| 100.0 + offset * 50.0 + i as f32 * 0.5)).collect();
            let zeros = vec![0.0; o.len()];
            Features::new([o, zeros.clone(), zeros], [1, 1, 1]).unwrap()
        };
        [0.0, 0.1, 0.2].map(episode).to_vec()
    }

    fn alone(experts: &[Features]) -> Vec<Vec<f64>> {
        let others = |own: usize, x: f32| {
            let rest = experts.iter().enumerate().filter(|(i, _)| *i != own).flat_map(|(_, e)| e.values(0));
            rest.map(|y| f64::from((x - y).abs())).fold(f64::INFINITY, f64::min)
        };
        (0..experts.len()).map(|i| experts[i].values(0).iter().map(|x| -others(i, *x)).collect()).collect()
    }

    #[test]
    fn the_local_scale_is_short_where_experts_agree_and_long_where_they_do_not() {
        let experts = line();
        let alone = alone(&experts);
        let alone: Vec<&[f64]> = alone.iter().map(Vec::as_slice).collect();
        let copies = Copies::among(&experts);
        let spread = Spread::new((&experts, &copies), metric(Similarity::LastL2, [1.0; 3]), &alone);
        let means: Vec<_> = (0..alone.len()).map(|expert| spread.around(expert)).collect();
        for expert in &means {
            let (dense, sparse) = expert.split_at(8);
            let (longest, shortest) =
                (dense.iter().copied().fold(0.0, f64::max), sparse.iter().copied().fold(f64::INFINITY, f64::min));
            assert!(longest * 10.0 < shortest, "{longest} {shortest}");
        }
    }

    /// Experts with the same segments, of which each has one of its own in addition.
    fn overlapping() -> Vec<Features> {
        let episode = |own: f32| {
            let o: Vec<f32> = (0..20).map(|i| i as f32).chain([own]).collect();
            let zeros = vec![0.0; o.len()];
            Features::new([o, zeros.clone(), zeros], [1, 1, 1]).unwrap()
        };
        [1000.0, 2000.0, 3000.0].map(episode).to_vec()
    }

    #[test]
    fn segments_that_experts_share_do_not_make_a_local_scale_of_zero() {
        let metric = metric(Similarity::LastL2, [1.0; 3]);
        let experts = overlapping();
        let alone = alone(&experts);
        assert_eq!(alone[0][..20], [0.0; 20]);
        let alone: Vec<&[f64]> = alone.iter().map(Vec::as_slice).collect();
        let copies = Copies::among(&experts);
        let spread = Spread::new((&experts, &copies), metric, &alone);
        assert!((0..alone.len()).flat_map(|expert| spread.around(expert)).all(|mean| mean > 0.0));
        let nowhere = vec![[0.0; 21].to_vec(); 3];
        let nowhere: Vec<&[f64]> = nowhere.iter().map(Vec::as_slice).collect();
        let far = -1000.0 / Spread::new((&experts, &copies), metric, &nowhere).around(0)[0];
        assert!(far.is_finite() && far < 0.0, "{far}");
    }

    #[test]
    fn a_copy_of_an_expert_leaves_the_local_scale_as_it_is() {
        let metric = metric(Similarity::LastL2, [1.0; 3]);
        let (experts, alone) = (line(), alone(&line()));
        let scales = |of: &[usize]| -> Vec<Vec<f64>> {
            let experts: Vec<Features> = of.iter().map(|at| experts[*at].clone()).collect();
            let alone: Vec<&[f64]> = of.iter().map(|at| alone[*at].as_slice()).collect();
            let copies = Copies::among(&experts);
            let spread = Spread::new((&experts, &copies), metric, &alone);
            (0..of.len()).map(|expert| spread.around(expert)).collect()
        };
        let [once, twice] = [scales(&[0, 1, 2]), scales(&[0, 1, 2, 1])];
        assert_eq!(twice, [once.clone(), vec![once[1].clone()]].concat());
    }
}
