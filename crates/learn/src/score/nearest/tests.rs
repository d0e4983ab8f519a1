//! The search against a brute-force reference, where products are at their worst.

use rand::RngExt;

use super::*;
use crate::random::{Purpose, generator};
use crate::score::similarity::Kind;

const WIDTHS: [usize; 3] = [24, 7, 33];
const ONES: Metric = Metric { kind: Kind::Euclidean, scale: [1.0; 3] };
const METRICS: [Metric; 4] = [
    ONES,
    Metric { kind: Kind::Angular, scale: [1.0; 3] },
    Metric { kind: Kind::Euclidean, scale: [0.5, 0.0, 3.0] },
    Metric { kind: Kind::Angular, scale: [0.0, 2.0, 0.1] },
];
const VIEWS: [View; 2] = [View::Along, View::Whole];
const TILES: [Tiles; 4] = [
    Tiles { queries: 128, experts: 512 },
    Tiles { queries: 1, experts: 1 },
    Tiles { queries: 7, experts: 33 },
    Tiles { queries: 50, experts: 5 },
];

/// Rows of size about `norm` around a far-off common point.
fn features(seed: u64, count: usize, norm: f32) -> Features {
    let mut rng = generator(seed, Purpose::Mask, 9);
    let values =
        WIDTHS.map(|width| (0..count * width).map(|_| norm / 5.0 * (1.0 + rng.random_range(-0.5f32..0.5))).collect());
    Features::new(values, WIDTHS).unwrap()
}

/// `features` with row `at` changed by `change`, per modality.
fn with_row(features: &Features, at: usize, change: impl Fn(usize, &mut [f32])) -> Features {
    let values = [0, 1, 2].map(|modality| {
        let mut values = features.values(modality).to_vec();
        change(modality, &mut values[at * WIDTHS[modality]..(at + 1) * WIDTHS[modality]]);
        values
    });
    Features::new(values, WIDTHS).unwrap()
}

/// The distance as anyone would write it.
fn plain_distance(metric: &Metric, a: (&Features, usize), b: (&Features, usize)) -> f64 {
    let double = |row: &[f32]| row.iter().map(|x| f64::from(*x)).collect::<Vec<f64>>();
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    (0..3)
        .map(|i| {
            let (a, b) = (double(a.0.row(i, a.1)), double(b.0.row(i, b.1)));
            let part = match metric.kind {
                Kind::Euclidean => a.iter().zip(&b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt(),
                Kind::Angular => 1.0 - dot(&a, &b) / (dot(&a, &a) * dot(&b, &b)).sqrt(),
            };
            part * metric.scale[i]
        })
        .sum()
}

/// Direct comparison with every expert segment outside episode `without`, in order.
fn brute_force(
    episodes: &[Features],
    queries: &Features,
    metric: Metric,
    without: Option<u32>,
) -> Vec<(u32, u32, f64)> {
    (0..queries.count())
        .map(|query| {
            let mut best = (0, 0, f64::INFINITY);
            for (e, episode) in (0u32..).zip(episodes).filter(|(e, _)| Some(*e) != without) {
                for (t, at) in (0u32..).zip(0..episode.count()) {
                    let distance = metric.distance(metric.parts((queries, query), (episode, at)));
                    let plain = plain_distance(&metric, (queries, query), (episode, at));
                    assert!((distance - plain).abs() <= 1e-12 * (1.0 + plain), "{distance} {plain}");
                    if distance < best.2 {
                        best = (e, t, distance);
                    }
                }
            }
            best
        })
        .collect()
}

fn numbered(episodes: &[Features]) -> Vec<(u32, &Features)> {
    (0..).zip(episodes).collect()
}

fn found(
    episodes: &[Features],
    queries: &Features,
    metric: Metric,
    (tiles, without): (Tiles, Option<u32>),
) -> Vec<(u32, u32, f64)> {
    let found = winners(&Reference::with_tiles(&numbered(episodes), metric, tiles), queries, without);
    let uncoded = Reference::with_views(&numbered(episodes), metric, tiles, &VIEWS);
    assert_eq!(winners(&uncoded, queries, without), found);
    found
}

fn winners(reference: &Reference, queries: &Features, without: Option<u32>) -> Vec<(u32, u32, f64)> {
    let matches = reference.nearest(queries, without).unwrap();
    matches.iter().map(|found| (found.episode, found.step, found.distance)).collect()
}

/// Experts and queries, half of which have exact duplicates among the experts and half duplicates
/// a bit or two off.
fn near_duplicates() -> (Vec<Features>, Features) {
    let mut episodes: Vec<Features> = (0..6).map(|seed| features(seed, 40, 100.0)).collect();
    let queries = features(99, 60, 100.0);
    let copy = |from: usize, bits: usize| {
        let queries = queries.clone();
        move |modality: usize, row: &mut [f32]| {
            row.copy_from_slice(queries.row(modality, from));
            if modality == from % 3 {
                row[0] = (0..bits).fold(row[0], |x, _| x.next_up());
            }
        }
    };
    for query in 0..30 {
        // The same row in two episodes and twice in one: the first must win.
        for (episode, at) in [(1, query), (4, query), (4, (query + 1) % 40)] {
            episodes[episode] = with_row(&episodes[episode], at, copy(query, 0));
        }
    }
    for query in 30..60 {
        // A duplicate one last bit off in a single value, and one two bits off before it.
        for (episode, bits) in [(0, 2), (5, 1)] {
            episodes[episode] = with_row(&episodes[episode], query - 30, copy(query, bits));
        }
    }
    (episodes, queries)
}

mod coded;
mod filter;

#[test]
fn near_and_exact_duplicates_at_large_norms_are_found_exactly() {
    let (episodes, queries) = near_duplicates();
    for metric in METRICS {
        let expected = brute_force(&episodes, &queries, metric, None);
        for tiles in TILES {
            assert_eq!(found(&episodes, &queries, metric, (tiles, None)), expected);
        }
    }
    assert_eq!(found(&episodes, &queries, ONES, (TILES[0], None))[40].0, 5);
}

#[test]
fn threads_do_not_change_the_result() {
    // Enough pairs for three threads to be worth it.
    let episodes: Vec<Features> = (0..3).map(|seed| features(seed, 400, 10.0)).collect();
    let queries = features(7, 400, 10.0);
    let matches = |threads| {
        let before = tch::get_num_threads();
        tch::set_num_threads(threads);
        let reference = Reference::new(&numbered(&episodes), ONES);
        let matches = reference.nearest(&queries, None).unwrap();
        assert_eq!(tch::get_num_threads(), threads);
        tch::set_num_threads(before);
        matches
    };
    let alone = matches(1);
    assert_eq!(matches(3), alone);
    for (query, found) in alone.iter().enumerate().step_by(37) {
        let episode = &episodes[found.episode as usize];
        let plain = plain_distance(&ONES, (&queries, query), (episode, found.step as usize));
        assert!((found.distance - plain).abs() < 1e-9);
    }
}

#[test]
fn an_episode_left_out_is_never_matched() {
    let episodes: Vec<Features> = (0..4).map(|seed| features(seed, 30, 10.0)).collect();
    for metric in METRICS {
        for (at, queries) in (0u32..).zip(&episodes) {
            let expected = brute_force(&episodes, queries, metric, Some(at));
            assert!(expected.iter().all(|best| best.0 != at));
            for tiles in TILES {
                assert_eq!(found(&episodes, queries, metric, (tiles, Some(at))), expected);
            }
        }
    }
    let reference = Reference::new(&numbered(&episodes[..1]), ONES);
    assert!(reference.nearest(&episodes[1], Some(0)).is_none());
    assert!(reference.nearest(&episodes[1], Some(9)).is_some());
}

#[test]
fn searching_in_parts_is_searching_in_the_whole() {
    let (episodes, queries) = near_duplicates();
    let numbered = numbered(&episodes);
    for metric in METRICS {
        let whole = Reference::new(&numbered, metric).nearest(&queries, Some(2)).unwrap();
        for parts in [[0, 2, 4], [1, 3, 5]] {
            let (first, rest): (Vec<_>, Vec<_>) = numbered.iter().partition(|(number, _)| parts.contains(number));
            let mut matches: Vec<Option<Match>> = vec![None; queries.count()];
            for part in [rest, first] {
                Reference::new(&part, metric).improve(&queries, Some(2), &mut matches);
            }
            assert_eq!(matches.into_iter().flatten().collect::<Vec<_>>(), whole);
        }
    }
}

#[test]
fn tiny_zero_and_huge_values_are_compared_exactly() {
    for norm in [1e-22f32, 1e-12, 1e12] {
        let episodes: Vec<Features> = (0..2).map(|seed| features(seed, 20, norm)).collect();
        let zero = with_row(&episodes[1], 3, |_, row| row.fill(0.0));
        let (episodes, queries) = ([episodes[0].clone(), zero.clone()], with_row(&zero, 9, |_, row| row[0] = 0.0));
        for metric in METRICS {
            let reference = Reference::new(&numbered(&episodes), metric);
            let found = reference.nearest(&queries, None).unwrap();
            assert_eq!((found[3].episode, found[3].step, found[3].distance), (1, 3, 0.0));
            for (query, found) in found.iter().enumerate() {
                let every = episodes.iter().flat_map(|e| (0..e.count()).map(move |at| (e, at)));
                let distances = every.map(|expert| metric.distance(metric.parts((&queries, query), expert)));
                assert_eq!(found.distance, distances.fold(f64::INFINITY, f64::min));
            }
        }
    }
}

#[test]
fn every_view_by_itself_finds_the_same() {
    let (episodes, queries) = near_duplicates();
    for metric in METRICS {
        let expected = brute_force(&episodes, &queries, metric, Some(3));
        for view in VIEWS {
            let reference = Reference::with_views(&numbered(&episodes), metric, TILES[2], &[view, View::Whole]);
            assert_eq!(winners(&reference, &queries, Some(3)), expected);
        }
    }
}

/// Rows of `width` values around a far-off point that differ along a few directions, and a little
/// (`noise`) in all.
fn along_few_directions(seed: u64, count: usize, (width, noise): (usize, f32)) -> Features {
    let mut rng = generator(seed, Purpose::Mask, 10);
    let mut fixed = generator(1, Purpose::Mask, 11);
    let values = [0, 1, 2].map(|_| {
        let directions: Vec<f32> = (0..6 * width).map(|_| fixed.random_range(-1.0f32..1.0)).collect();
        let row = |_| {
            let place: Vec<f32> = (0..6).map(|_| rng.random_range(-1.0f32..1.0)).collect();
            let along = |value: usize| (0..6).map(|d| place[d] * directions[d * width + value]).sum::<f32>();
            (0..width).map(|value| 50.0 + along(value) + noise * rng.random_range(-1.0f32..1.0)).collect::<Vec<_>>()
        };
        (0..count).flat_map(row).collect()
    });
    Features::new(values, [width; 3]).unwrap()
}

#[test]
fn the_cheaper_level_rules_out_nothing_that_is_near() {
    // Noise beside nothing, a little noise, and nothing but noise: the last must fall back.
    for noise in [0.0, 0.05, 30.0] {
        let episodes = [along_few_directions(1, 300, (128, noise)), along_few_directions(2, 300, (128, noise))];
        let queries = along_few_directions(3, 40, (128, noise));
        let near = |modality: usize, row: &mut [f32]| row.copy_from_slice(episodes[1].row(modality, 17));
        let values = [0, 1, 2].map(|modality| {
            let mut values = queries.values(modality).to_vec();
            near(modality, &mut values[..128]);
            values
        });
        let queries = Features::new(values, [128; 3]).unwrap();
        for metric in [METRICS[0], METRICS[3]] {
            let expected = brute_force(&episodes, &queries, metric, None);
            assert_eq!((expected[0].0, expected[0].1), (1, 17));
            for (tiles, view) in VIEWS.into_iter().flat_map(|view| [(TILES[0], view), (TILES[2], view)]) {
                let views = [view, View::Whole];
                let reference = Reference::with_views(&numbered(&episodes), metric, tiles, &views);
                assert_eq!(reference.levels().len(), 2);
                assert_eq!(winners(&reference, &queries, None), expected);
            }
            assert_eq!(winners(&Reference::new(&numbered(&episodes), metric), &queries, None), expected);
        }
    }
}
