//! The search against a brute-force reference, on data where the errors of products are largest.

use rand::RngExt;

use super::*;
use crate::bound::{Frame, limit};
use crate::metric::Distance;
use crate::testing::generator;

const WIDTHS: [usize; 3] = [24, 7, 33];
const ONES: Metric = Metric { kind: Distance::Euclidean, scale: [1.0; 3] };
const METRICS: [Metric; 4] = [
    ONES,
    Metric { kind: Distance::Angular, scale: [1.0; 3] },
    Metric { kind: Distance::Euclidean, scale: [0.5, 0.0, 3.0] },
    Metric { kind: Distance::Angular, scale: [0.0, 2.0, 0.1] },
];
const VIEWS: [View; 2] = [View::Along, View::Whole];
const TILES: [Tiles; 4] = [
    Tiles { queries: 128, points: 512 },
    Tiles { queries: 1, points: 1 },
    Tiles { queries: 7, points: 33 },
    Tiles { queries: 50, points: 5 },
];

/// Rows of size about `norm` around a far-off common point.
fn features(seed: u64, count: usize, norm: f32) -> Points {
    let mut rng = generator(seed, 9);
    let values =
        WIDTHS.map(|width| (0..count * width).map(|_| norm / 5.0 * (1.0 + rng.random_range(-0.5f32..0.5))).collect());
    Points::new(values, WIDTHS).unwrap()
}

/// `features` with row `at` changed by `change`, per part.
fn with_row(features: &Points, at: usize, change: impl Fn(usize, &mut [f32])) -> Points {
    let values = [0, 1, 2].map(|part| {
        let mut values = features.values(part).to_vec();
        change(part, &mut values[at * WIDTHS[part]..(at + 1) * WIDTHS[part]]);
        values
    });
    Points::new(values, WIDTHS).unwrap()
}

/// The distance by its definition.
fn plain_distance(metric: &Metric, a: (&Points, usize), b: (&Points, usize)) -> f64 {
    let double = |row: &[f32]| row.iter().map(|x| f64::from(*x)).collect::<Vec<f64>>();
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    (0..3)
        .map(|i| {
            let (a, b) = (double(a.0.row(i, a.1)), double(b.0.row(i, b.1)));
            let part = match metric.kind {
                Distance::Euclidean => a.iter().zip(&b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt(),
                Distance::Angular => 1.0 - dot(&a, &b) / (dot(&a, &a) * dot(&b, &b)).sqrt(),
            };
            part * metric.scale[i]
        })
        .sum()
}

/// Direct comparison with every point outside group `without`, in order.
fn brute_force(groups: &[Points], queries: &Points, metric: Metric, without: Option<u32>) -> Vec<(u32, u32, f64)> {
    (0..queries.count())
        .map(|query| {
            let mut best = (0, 0, f64::INFINITY);
            for (e, group) in (0u32..).zip(groups).filter(|(e, _)| Some(*e) != without) {
                for (t, at) in (0u32..).zip(0..group.count()) {
                    let distance = metric.distance(metric.parts((queries, query), (group, at)));
                    let plain = plain_distance(&metric, (queries, query), (group, at));
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

fn numbered(groups: &[Points]) -> Vec<(u32, &Points)> {
    (0..).zip(groups).collect()
}

fn found(
    groups: &[Points],
    queries: &Points,
    metric: Metric,
    (tiles, without): (Tiles, Option<u32>),
) -> Vec<(u32, u32, f64)> {
    let found = winners(&Index::with_tiles(&numbered(groups), metric, tiles), queries, without);
    let uncoded = Index::with_views(&numbered(groups), metric, tiles, &VIEWS);
    assert_eq!(winners(&uncoded, queries, without), found);
    found
}

fn winners(index: &Index, queries: &Points, without: Option<u32>) -> Vec<(u32, u32, f64)> {
    let matches = index.nearest(queries, without).unwrap().unwrap();
    matches.iter().map(|found| (found.group, found.row, found.distance)).collect()
}

/// Points and queries: half of the queries have exact duplicates among the points, and half have duplicates that differ
/// by a bit or two.
fn near_duplicates() -> (Vec<Points>, Points) {
    let mut groups: Vec<Points> = (0..6).map(|seed| features(seed, 40, 100.0)).collect();
    let queries = features(99, 60, 100.0);
    let copy = |from: usize, bits: usize| {
        let queries = queries.clone();
        move |part: usize, row: &mut [f32]| {
            row.copy_from_slice(queries.row(part, from));
            if part == from % 3 {
                row[0] = (0..bits).fold(row[0], |x, _| x.next_up());
            }
        }
    };
    for query in 0..30 {
        // The same row in two groups and twice in one: the first must win.
        for (group, at) in [(1, query), (4, query), (4, (query + 1) % 40)] {
            groups[group] = with_row(&groups[group], at, copy(query, 0));
        }
    }
    for query in 30..60 {
        // A duplicate that differs by one last bit of a single value, and before it one that differs by two.
        for (group, bits) in [(0, 2), (5, 1)] {
            groups[group] = with_row(&groups[group], query - 30, copy(query, bits));
        }
    }
    (groups, queries)
}

mod coded;
mod filter;
mod halves;
mod windows;

#[test]
fn near_and_exact_duplicates_at_large_norms_are_found_exactly() {
    let (groups, queries) = near_duplicates();
    for metric in METRICS {
        let expected = brute_force(&groups, &queries, metric, None);
        for tiles in TILES {
            assert_eq!(found(&groups, &queries, metric, (tiles, None)), expected);
        }
    }
    assert_eq!(found(&groups, &queries, ONES, (TILES[0], None))[40].0, 5);
}

#[test]
fn threads_do_not_change_the_result() {
    // Enough pairs for three threads.
    let groups: Vec<Points> = (0..3).map(|seed| features(seed, 400, 10.0)).collect();
    let queries = features(7, 400, 10.0);
    let windows = crate::testing::windows(&[400, 400, 403], WIDTHS, 4).0;
    let of = |groups: &[Points], queries: &Points, threads| {
        let before = tch::get_num_threads();
        tch::set_num_threads(threads);
        let index = Index::new(&numbered(groups), ONES).unwrap();
        let matches = index.nearest(queries, None).unwrap().unwrap();
        assert_eq!(tch::get_num_threads(), threads);
        tch::set_num_threads(before);
        matches
    };
    let alone = of(&groups, &queries, 1);
    assert_eq!(of(&groups, &queries, 3), alone);
    assert_eq!(of(&windows[..2], &windows[2], 3), of(&windows[..2], &windows[2], 1));
    for (query, found) in alone.iter().enumerate().step_by(37) {
        let group = &groups[found.group as usize];
        let plain = plain_distance(&ONES, (&queries, query), (group, found.row as usize));
        assert!((found.distance - plain).abs() < 1e-9);
    }
}

#[test]
fn a_group_left_out_is_never_matched() {
    let groups: Vec<Points> = (0..4).map(|seed| features(seed, 30, 10.0)).collect();
    for metric in METRICS {
        for (at, queries) in (0u32..).zip(&groups) {
            let expected = brute_force(&groups, queries, metric, Some(at));
            assert!(expected.iter().all(|best| best.0 != at));
            for tiles in TILES {
                assert_eq!(found(&groups, queries, metric, (tiles, Some(at))), expected);
            }
        }
    }
    let index = Index::new(&numbered(&groups[..1]), ONES).unwrap();
    assert!(index.nearest(&groups[1], Some(0)).unwrap().is_none());
    assert!(index.nearest(&groups[1], Some(9)).unwrap().is_some());
}

#[test]
fn searching_in_parts_is_searching_in_the_whole() {
    let (groups, queries) = near_duplicates();
    let numbered = numbered(&groups);
    for metric in METRICS {
        let whole = Index::new(&numbered, metric).unwrap().nearest(&queries, Some(2)).unwrap().unwrap();
        for parts in [[0, 2, 4], [1, 3, 5]] {
            let (first, rest): (Vec<_>, Vec<_>) = numbered.iter().partition(|(number, _)| parts.contains(number));
            let mut matches: Vec<Option<Match>> = vec![None; queries.count()];
            for part in [rest, first] {
                Index::new(&part, metric).unwrap().improve(&queries, Some(2), &mut matches).unwrap();
            }
            assert_eq!(matches.into_iter().flatten().collect::<Vec<_>>(), whole);
        }
    }
}

#[test]
fn tiny_zero_and_huge_values_are_compared_exactly() {
    for norm in [1e-22f32, 1e-12, 1e12] {
        let groups: Vec<Points> = (0..2).map(|seed| features(seed, 20, norm)).collect();
        let zero = with_row(&groups[1], 3, |_, row| row.fill(0.0));
        let (groups, queries) = ([groups[0].clone(), zero.clone()], with_row(&zero, 9, |_, row| row[0] = 0.0));
        for metric in METRICS {
            let index = Index::new(&numbered(&groups), metric).unwrap();
            let found = index.nearest(&queries, None).unwrap().unwrap();
            assert_eq!((found[3].group, found[3].row, found[3].distance), (1, 3, 0.0));
            for (query, found) in found.iter().enumerate() {
                let every = groups.iter().flat_map(|e| (0..e.count()).map(move |at| (e, at)));
                let distances = every.map(|point| metric.distance(metric.parts((&queries, query), point)));
                assert_eq!(found.distance, distances.fold(f64::INFINITY, f64::min));
            }
        }
    }
}

#[test]
fn every_view_alone_finds_the_same() {
    let (groups, queries) = near_duplicates();
    for metric in METRICS {
        let expected = brute_force(&groups, &queries, metric, Some(3));
        for view in VIEWS {
            let index = Index::with_views(&numbered(&groups), metric, TILES[2], &[view, View::Whole]);
            assert_eq!(winners(&index, &queries, Some(3)), expected);
        }
    }
}

/// Rows of `width` values around a far-off point that differ along a few directions, with a little `noise` along all.
fn along_few_directions(seed: u64, count: usize, (width, noise): (usize, f32)) -> Points {
    let mut rng = generator(seed, 10);
    let mut fixed = generator(1, 11);
    let values = [0, 1, 2].map(|_| {
        let directions: Vec<f32> = (0..6 * width).map(|_| fixed.random_range(-1.0f32..1.0)).collect();
        let row = |_| {
            let place: Vec<f32> = (0..6).map(|_| rng.random_range(-1.0f32..1.0)).collect();
            let along = |value: usize| (0..6).map(|d| place[d] * directions[d * width + value]).sum::<f32>();
            (0..width).map(|value| 50.0 + along(value) + noise * rng.random_range(-1.0f32..1.0)).collect::<Vec<_>>()
        };
        (0..count).flat_map(row).collect()
    });
    Points::new(values, [width; 3]).unwrap()
}

#[test]
fn the_cheaper_level_rules_out_nothing_that_is_near() {
    // No noise, a little noise, and nothing but noise: the last one must fall back.
    for noise in [0.0, 0.05, 30.0] {
        let groups = [along_few_directions(1, 300, (128, noise)), along_few_directions(2, 300, (128, noise))];
        let queries = along_few_directions(3, 40, (128, noise));
        let near = |part: usize, row: &mut [f32]| row.copy_from_slice(groups[1].row(part, 17));
        let values = [0, 1, 2].map(|part| {
            let mut values = queries.values(part).to_vec();
            near(part, &mut values[..128]);
            values
        });
        let queries = Points::new(values, [128; 3]).unwrap();
        for metric in [METRICS[0], METRICS[3]] {
            let expected = brute_force(&groups, &queries, metric, None);
            assert_eq!((expected[0].0, expected[0].1), (1, 17));
            for (tiles, view) in VIEWS.into_iter().flat_map(|view| [(TILES[0], view), (TILES[2], view)]) {
                let views = [view, View::Whole];
                let index = Index::with_views(&numbered(&groups), metric, tiles, &views);
                assert_eq!(index.filter().levels().len(), 2);
                assert_eq!(winners(&index, &queries, None), expected);
            }
            assert_eq!(winners(&Index::new(&numbered(&groups), metric).unwrap(), &queries, None), expected);
        }
    }
}

#[test]
fn input_of_another_shape_is_rejected() {
    let (group, other) = (features(1, 5, 1.0), Points::new([vec![0.0], vec![0.0], vec![0.0]], [1; 3]).unwrap());
    let field = |result: Result<(), SearchError>| result.unwrap_err().field;
    let new = |groups: &[(u32, &Points)]| Index::new(groups, ONES).map(|_| ());
    assert_eq!(field(new(&[(1, &group), (0, &group)])), "groups");
    assert_eq!(field(new(&[(1, &group), (1, &group)])), "groups");
    assert_eq!(field(new(&[(0, &group), (1, &other)])), "groups");
    let index = Index::new(&[(0, &group)], ONES).unwrap();
    assert_eq!(field(index.nearest(&other, None).map(|_| ())), "queries");
    assert_eq!(field(index.improve(&group, None, &mut [None; 4])), "matches");
}
