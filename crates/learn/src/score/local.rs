//! The yardstick of a similarity: how near experts are to one another around the matched segment.
//!
//! Where experts differ widely (free reaching, each from elsewhere) even a good segment is far from
//! its match, and where they agree (all holding the cube) even a bad one is near. So w alone ranks
//! phases of a task, not the quality within them. q = norm(w / ρ(τ*)) does not: with τ* the match,
//! ρ(τ*) = the mean over the k expert segments nearest to τ* of their distance to the nearest
//! segment of another expert. w / ρ is about −1 wherever an expert is. Knows nothing of norm.

use tch::{Kind, Tensor};

use super::EpisodeScores;
use super::features::Features;
use super::similarity::{Kind as Distance, Metric, to_unit};
use crate::batch::{int, rows};
use crate::error::LearnError;

/// k: enough that one odd expert does not set the yardstick, few enough that it stays local.
const NEIGHBOURS: usize = 10;
/// A yardstick is at least this part of the mean one, so that experts recorded twice do not make
/// all else infinitely far.
const LEAST: f64 = 1e-3;

/// w of every segment of `episode`, relative to its match's yardstick, of which `local` has one per
/// expert, in the order that matches count in, and step; without, or without matches, w itself.
pub(super) fn relative(local: Option<&Vec<Vec<f64>>>, episode: &EpisodeScores) -> impl Iterator<Item = f64> {
    (0..episode.w.len()).map(move |at| match (local, episode.match_episode.get(at)) {
        (Some(local), Some(expert)) => episode.w[at] / local[*expert as usize][episode.match_step[at] as usize],
        _ => episode.w[at],
    })
}

/// The experts' segments, ready to look around each.
pub(super) struct Neighbourhoods {
    /// Per modality `[N, width]`, scaled so that distances need no factor.
    rows: [Tensor; 3],
    /// Per modality `[N]`.
    squares: [Tensor; 3],
    /// Where each episode's segments begin, and at last where all end.
    bounds: Vec<usize>,
    kind: Distance,
}

impl Neighbourhoods {
    /// Of `experts` under `metric`. In single precision: a mean over neighbours needs no exact ones.
    pub(super) fn new(experts: &[Features], metric: Metric) -> Self {
        let matrix = |modality: usize| {
            #[expect(clippy::cast_possible_truncation, reason = "single precision is enough here")]
            let scale = match metric.kind {
                Distance::Euclidean => metric.scale[modality],
                // A half of a square is what this distance is.
                Distance::Angular => (metric.scale[modality] / 2.0).sqrt(),
            } as f32;
            let all: Vec<f32> = experts.iter().flat_map(|features| features.values(modality)).copied().collect();
            let z = rows(&all, experts[0].widths()[modality], tch::Device::Cpu) * f64::from(scale);
            match metric.kind {
                Distance::Euclidean => z,
                Distance::Angular => {
                    let units = experts.iter().flat_map(|features| {
                        (0..features.count()).map(move |row| to_unit(features.row(modality, row)))
                    });
                    z * Tensor::from_slice(&units.collect::<Vec<f64>>()).to_kind(Kind::Float).unsqueeze(1)
                }
            }
        };
        let rows = [0, 1, 2].map(matrix);
        let squares = [0, 1, 2].map(|i: usize| rows[i].square().sum_dim_intlist([1i64].as_slice(), false, Kind::Float));
        let counts = experts.iter().scan(0, |total, features| {
            *total += features.count();
            Some(*total)
        });
        Self { squares, rows, bounds: std::iter::once(0).chain(counts).collect(), kind: metric.kind }
    }

    /// ρ of every segment of every expert. `alone` is w of each against the other experts; `go_on`
    /// is asked after each episode.
    pub(super) fn means(
        &self,
        alone: &[&[f64]],
        mut go_on: impl FnMut() -> Result<(), LearnError>,
    ) -> Result<Vec<Vec<f64>>, LearnError> {
        let distances: Vec<f64> = alone.iter().flat_map(|w| w.iter().map(|w| -w)).collect();
        #[expect(clippy::cast_precision_loss, reason = "far fewer segments than 2^52")]
        let least = (LEAST * distances.iter().sum::<f64>() / distances.len().max(1) as f64).max(f64::MIN_POSITIVE);
        let mut means = Vec::with_capacity(alone.len());
        for episode in 0..alone.len() {
            let nearest = self.nearest(episode);
            means.push(nearest.chunks(self.wanted(episode)).map(|near| mean(near, &distances).max(least)).collect());
            go_on()?;
        }
        Ok(means)
    }

    /// How many neighbours each segment of `episode` has.
    fn wanted(&self, episode: usize) -> usize {
        let own = self.bounds[episode + 1] - self.bounds[episode];
        NEIGHBOURS.min(self.bounds[self.bounds.len() - 1] - own).max(1)
    }

    /// Of each segment of `episode`, the nearest ones of other episodes.
    fn nearest(&self, episode: usize) -> Vec<i64> {
        let (begin, end) = (int(self.bounds[episode]), int(self.bounds[episode + 1]));
        let of = |modality: usize| {
            let (rows, squares) = (&self.rows[modality], &self.squares[modality]);
            let products = rows.narrow(0, begin, end - begin).matmul(&rows.tr());
            let square = squares.narrow(0, begin, end - begin).unsqueeze(1) + squares - products * 2.0;
            match self.kind {
                Distance::Euclidean => square.clamp_min(0.0).sqrt(),
                Distance::Angular => square,
            }
        };
        let distances = of(0) + of(1) + of(2);
        let _own = distances.narrow(1, begin, end - begin).fill_(f64::INFINITY);
        let (_, nearest) = distances.topk(int(self.wanted(episode)), 1, false, true);
        Vec::try_from(nearest.flatten(0, -1)).unwrap_or_default()
    }
}

/// The mean of `distances` at `places`, added in one order whatever theirs.
fn mean(places: &[i64], distances: &[f64]) -> f64 {
    let mut places: Vec<usize> = places.iter().filter_map(|place| usize::try_from(*place).ok()).collect();
    places.sort_unstable();
    #[expect(clippy::cast_precision_loss, reason = "a handful")]
    let count = places.len().max(1) as f64;
    places.iter().map(|place| distances[*place]).sum::<f64>() / count
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::score::comparison::Similarity;

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
    fn the_yardstick_is_short_where_experts_agree_and_long_where_they_do_not() {
        let experts = line();
        let alone = alone(&experts);
        let alone: Vec<&[f64]> = alone.iter().map(Vec::as_slice).collect();
        let means =
            Neighbourhoods::new(&experts, Metric::new(Similarity::LastL2, [1.0; 3])).means(&alone, || Ok(())).unwrap();
        for expert in &means {
            let (dense, sparse) = expert.split_at(8);
            let (longest, shortest) =
                (dense.iter().copied().fold(0.0, f64::max), sparse.iter().copied().fold(f64::INFINITY, f64::min));
            assert!(longest * 10.0 < shortest, "{longest} {shortest}");
        }
    }

    #[test]
    fn experts_recorded_twice_do_not_make_a_yardstick_of_nothing() {
        let twice = vec![line()[0].clone(), line()[0].clone(), line()[2].clone()];
        let alone = alone(&twice);
        let alone: Vec<&[f64]> = alone.iter().map(Vec::as_slice).collect();
        let means =
            Neighbourhoods::new(&twice, Metric::new(Similarity::LastL2, [1.0; 3])).means(&alone, || Ok(())).unwrap();
        assert!(means.iter().flatten().all(|mean| *mean > 0.0));
    }

    #[test]
    fn asking_to_stop_stops() {
        let experts = line();
        let alone = alone(&experts);
        let alone: Vec<&[f64]> = alone.iter().map(Vec::as_slice).collect();
        let stopped = Neighbourhoods::new(&experts, Metric::new(Similarity::LastL2, [1.0; 3]))
            .means(&alone, || Err(LearnError::Cancelled));
        assert!(matches!(stopped, Err(LearnError::Cancelled)));
    }
}
