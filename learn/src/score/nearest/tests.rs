//! The search against a brute-force reference, where products are at their worst.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use rand::RngExt;

use super::*;
use crate::random::{Purpose, generator};

const WIDTH: usize = 24;
const ONES: LastL2 = LastL2 { scale: [1.0; 3] };

/// Rows of norm about `norm` around a far-off common point.
fn features(seed: u64, count: usize, norm: f32) -> Features {
    let mut rng = generator(seed, Purpose::Mask, 9);
    let mut values = |_| (0..count * WIDTH).map(|_| norm / 5.0 * (1.0 + rng.random_range(-0.5f32..0.5))).collect();
    Features { values: [values(0), values(1), values(2)], width: WIDTH }
}

fn copy_row(from: (&Features, usize), to: (&mut Features, usize)) {
    for modality in 0..3 {
        let row = from.0.row(modality, from.1).to_vec();
        to.0.values[modality][to.1 * WIDTH..(to.1 + 1) * WIDTH].copy_from_slice(&row);
    }
}

/// Direct comparison with every expert segment outside `without`, in order.
fn brute_force(
    episodes: &[Features],
    queries: &Features,
    similarity: LastL2,
    without: &Range<usize>,
) -> Vec<(u32, u32, f64)> {
    (0..queries.count())
        .map(|query| {
            let mut best = (0, 0, f64::INFINITY);
            for (e, episode) in (0u32..).zip(episodes) {
                if without.contains(&(e as usize)) {
                    continue;
                }
                for (t, at) in (0u32..).zip(0..episode.count()) {
                    let parts = LastL2::parts((queries, query), (episode, at));
                    let distance = similarity.distance(parts);
                    if distance < best.2 {
                        best = (e, t, distance);
                    }
                }
            }
            best
        })
        .collect()
}

fn found(
    episodes: &[Features],
    queries: &Features,
    similarity: LastL2,
    (tiles, without): (Tiles, Range<usize>),
) -> Vec<(u32, u32, f64)> {
    let mut reference = Reference::new(episodes, similarity, tiles);
    let matches = reference.nearest(queries, &without).unwrap();
    let describe = |found: &Match| {
        let (episode, step) = reference.place(found.expert);
        (episode, step, found.distance)
    };
    matches.iter().map(describe).collect()
}

const TILES: [Tiles; 4] = [
    Tiles { queries: 128, experts: 2048 },
    Tiles { queries: 1, experts: 1 },
    Tiles { queries: 7, experts: 33 },
    Tiles { queries: 50, experts: 5 },
];

#[test]
fn near_and_exact_duplicates_at_large_norms_are_found_exactly() {
    let mut episodes: Vec<Features> = (0..6).map(|seed| features(seed, 40, 100.0)).collect();
    let queries = features(99, 60, 100.0);
    for query in 0..30 {
        // The same row in two episodes and twice in one: the first must win.
        for place in [(1, query), (4, query), (4, (query + 1) % 40)] {
            copy_row((&queries, query), (&mut episodes[place.0], place.1));
        }
    }
    let last_bit = |x: f32| f32::from_bits(x.to_bits() + 1);
    for query in 30..60 {
        // A duplicate one last bit off in a single value, and one two bits off before it.
        for (episode, bits) in [(0, 2), (5, 1)] {
            copy_row((&queries, query), (&mut episodes[episode], query - 30));
            let value = &mut episodes[episode].values[query % 3][(query - 30) * WIDTH];
            *value = (0..bits).fold(*value, |x, _| last_bit(x));
        }
    }
    let expected = brute_force(&episodes, &queries, ONES, &(0..0));
    assert_eq!(expected[40].0, 5);
    for tiles in TILES {
        assert_eq!(found(&episodes, &queries, ONES, (tiles, 0..0)), expected);
    }
}

#[test]
fn an_episode_left_out_is_never_matched() {
    let episodes: Vec<Features> = (0..4).map(|seed| features(seed, 30, 10.0)).collect();
    let scaled = LastL2 { scale: [0.5, 0.0, 3.0] };
    for (at, queries) in episodes.iter().enumerate() {
        let without = at..at + 1;
        let expected = brute_force(&episodes, queries, scaled, &without);
        assert!(expected.iter().all(|best| best.0 as usize != at));
        for tiles in TILES {
            let found = found(&episodes, queries, scaled, (tiles, without.clone()));
            assert_eq!(found, expected);
        }
    }
    let only = &episodes[..1];
    let mut reference = Reference::new(only, ONES, Tiles::default());
    assert!(reference.nearest(&episodes[1], &(0..1)).is_none());
}

#[test]
fn the_bound_never_exceeds_the_distance_and_is_tight_when_far() {
    let episodes = [features(1, 200, 100.0)];
    let queries = features(2, 50, 100.0);
    let reference = Reference::new(&episodes, ONES, Tiles::default());
    let part = queries.values.each_ref().map(Vec::as_slice);
    let centred = Centred::new(part, &reference.centre);
    let tile = 0..200;
    let bounds = centred.lower_bounds(&reference.centred, &ONES.scale, &tile, &(0..0));
    let reach = centred.reach(&reference.centred, &ONES.scale, &tile);
    let bounds = values(&bounds);
    for query in 0..50 {
        for expert in 0..200 {
            let parts = LastL2::parts((&queries, query), (&episodes[0], expert));
            let distance = ONES.distance(parts);
            let bound = f64::from(bounds[query * 200 + expert]);
            assert!(bound <= limit(distance, reach[query]));
            assert!(bound > distance * 0.999, "{bound} {distance}");
        }
    }
}
