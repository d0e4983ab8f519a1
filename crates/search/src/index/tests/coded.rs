//! Byte codes: their bounds, and the search where they distinguish few points or none. On processors that do not
//! multiply bytes the search runs without them.

use super::*;
use crate::codes::Queries;
use crate::lanes::{self, Lanes, PANELS, QUERIES, WIDE};

/// `count` rows that differ by about `by`, and one at the distance `outlier`.
fn crowd(seed: u64, count: usize, (by, outlier): (f32, f32)) -> Points {
    let mut rng = generator(seed, 12);
    let values = WIDTHS.map(|width| {
        let row = |at: usize| (0..width).map(move |_| if at == 5 { outlier } else { 3.0 }).collect::<Vec<f32>>();
        (0..count).flat_map(row).map(|x| x + by * rng.random_range(-1.0f32..1.0)).collect()
    });
    Points::new(values, WIDTHS).unwrap()
}

/// Rows of −1 and 1, whose codes are the largest.
fn extremes(seed: u64, count: usize, widths: [usize; 3]) -> Points {
    let mut rng = generator(seed, 13);
    let values = widths.map(|width| (0..count * width).map(|_| if rng.random() { 1.0 } else { -1.0 }).collect());
    Points::new(values, widths).unwrap()
}

fn assert_bounds(corpus: &Points, queries: &Points, metric: Metric, most: f32) {
    let frame = Frame::new(corpus, metric.kind);
    let Some(codes) = Codes::new(corpus, &frame, &metric) else { return };
    let mut placed = Queries::new();
    placed.fill((&codes, &frame), queries, (0, queries.count()));
    assert_eq!(codes.panels(), corpus.count().div_ceil(WIDE));
    let mut bounds = [[Lanes([0f32; WIDE]); PANELS]; QUERIES];
    for (query, panel) in (0..queries.count()).flat_map(|query| (0..codes.panels()).map(move |panel| (query, panel))) {
        let one = placed.get(query, &codes, most);
        let open = lanes::bounds(&[one; QUERIES], &codes.some((panel, panel + 1)), &mut bounds);
        for (lane, bound) in bounds[0][0].0.into_iter().enumerate() {
            assert_eq!(open[3] >> lane & 1 == 1, bound <= most);
            let point = panel * WIDE + lane;
            if point >= corpus.count() {
                assert!(bound > 1e9 || metric.scale.contains(&0.0));
                continue;
            }
            let distance = metric.distance(metric.parts((queries, query), (corpus, point)));
            assert!(bound <= limit(&metric, placed.moved[query], distance), "{bound} {distance}");
            assert!(f64::from(bound) > distance * 0.9, "{bound} {distance}");
        }
    }
}

#[test]
fn bounds_are_below_distances_but_tight() {
    for metric in METRICS {
        assert_bounds(&features(1, 203, 100.0), &features(2, 50, 100.0), metric, 30.0);
    }
    // The sums of these rows' codes are not exact in single precision.
    for metric in [METRICS[0], METRICS[1]] {
        let corpus = extremes(1, 19, [5000, 3, 1025]);
        assert_bounds(&corpus, &extremes(2, 6, [5000, 3, 1025]), metric, 30.0);
    }
    assert_bounds(&extremes(1, 3, [1 << 15, 1, 1]), &extremes(2, 2, [1 << 15, 1, 1]), ONES, 30.0);
}

#[test]
fn wide_rows_are_found_exactly() {
    let widths = [3600, 40, 1100];
    let groups = [extremes(1, 60, widths), extremes(2, 60, widths)];
    let mut queries = extremes(3, 10, widths);
    queries.append(&extremes(2, 5, widths));
    for metric in [METRICS[0], METRICS[1]] {
        let index = Index::new(&numbered(&groups), metric).unwrap();
        assert_eq!(index.codes.is_some(), lanes::fast());
        assert_eq!(winners(&index, &queries, None), brute_force(&groups, &queries, metric, None));
    }
}

#[test]
fn queries_and_points_of_any_number_are_compared() {
    for (corpus, count) in [(1, 1), (15, 2), (16, 3), (17, 5), (65, 255), (70, 257), (130, 513)] {
        let groups = [features(1, corpus, 10.0), features(2, corpus.min(20), 10.0)];
        let queries = features(3, count, 10.0);
        for metric in [METRICS[0], METRICS[3]] {
            for without in [None, Some(0), Some(1)] {
                let expected = brute_force(&groups, &queries, metric, without);
                assert_eq!(found(&groups, &queries, metric, (TILES[0], without)), expected);
            }
        }
    }
}

#[test]
fn points_with_equal_codes_are_found() {
    // Because of the outlier all other rows have the same code; with this many queries the last ones are not coded.
    let groups = [crowd(1, 150, (0.01, 1e6)), crowd(2, 80, (0.01, 3.0))];
    let queries = crowd(3, 800, (0.01, 3.0));
    for metric in [METRICS[0], METRICS[1]] {
        let expected = brute_force(&groups, &queries, metric, None);
        assert_eq!(found(&groups, &queries, metric, (TILES[0], None)), expected);
    }
    // Few queries: those near the outlier are distinguished.
    let queries = crowd(4, 30, (0.01, 1e6));
    let expected = brute_force(&groups, &queries, ONES, None);
    assert_eq!(found(&groups, &queries, ONES, (TILES[0], None)), expected);
    assert_eq!((expected[5].0, expected[5].1), (0, 5));
}

#[test]
fn of_many_equal_points_the_first_wins() {
    let one = features(1, 1, 10.0);
    let mut same = Points::empty(WIDTHS);
    (0..200).for_each(|_| same.append(&one));
    let groups = [features(2, 30, 10.0), same.clone(), same];
    for without in [None, Some(1)] {
        for (group, step, distance) in found(&groups, &one, ONES, (TILES[0], without)) {
            assert_eq!((group, step, distance), (without.map_or(1, |_| 2), 0, 0.0));
        }
    }
}

#[test]
fn old_winners_stay_unless_something_is_nearer() {
    let (old, new) = (features(1, 90, 10.0), features(2, 40, 10.0));
    let queries = features(3, 70, 10.0);
    for metric in METRICS {
        let all = brute_force(&[old.clone(), new.clone()], &queries, metric, None);
        let mut matches: Vec<Option<Match>> = Index::new(&[(0, &old)], metric)
            .unwrap()
            .nearest(&queries, None)
            .unwrap()
            .unwrap()
            .into_iter()
            .map(Some)
            .collect();
        Index::new(&[(1, &new)], metric).unwrap().improve(&queries, None, &mut matches).unwrap();
        let found: Vec<_> = matches.iter().flatten().map(|found| (found.group, found.row, found.distance)).collect();
        assert_eq!(found, all);
        assert!(all.iter().any(|best| best.0 == 0) && all.iter().any(|best| best.0 == 1));
    }
}

#[test]
fn rows_too_wide_for_codes_are_searched_without() {
    let wide = |seed: u64, count: usize| extremes(seed, count, [(1 << 15) + 1, 3, 2]);
    let groups = [wide(1, 8), wide(2, 8)];
    let index = Index::new(&numbered(&groups), ONES).unwrap();
    assert!(index.codes.is_none());
    assert_eq!(winners(&index, &wide(3, 5), None), brute_force(&groups, &wide(3, 5), ONES, None));
}
