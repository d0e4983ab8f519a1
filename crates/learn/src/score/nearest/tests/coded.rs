//! Byte codes: their bounds, and the search where they tell little or nothing apart. Where the
//! processor does not multiply bytes the search does without them.

use super::super::codes::Queries;
use super::super::lanes::{self, Lanes, PANELS, QUERIES, WIDE};
use super::*;

/// `count` rows that differ by about `by`, and one as far off as `outlier`.
fn crowd(seed: u64, count: usize, (by, outlier): (f32, f32)) -> Features {
    let mut rng = generator(seed, Purpose::Mask, 12);
    let values = WIDTHS.map(|width| {
        let row = |at: usize| (0..width).map(move |_| if at == 5 { outlier } else { 3.0 }).collect::<Vec<f32>>();
        (0..count).flat_map(row).map(|x| x + by * rng.random_range(-1.0f32..1.0)).collect()
    });
    Features::new(values, WIDTHS).unwrap()
}

#[test]
fn bounds_are_below_distances_but_tight() {
    let (experts, queries) = (features(1, 203, 100.0), features(2, 50, 100.0));
    for metric in METRICS {
        let frame = Frame::new(&experts, metric.kind);
        let Some(codes) = Codes::new(&experts, &frame, &metric) else { return };
        let mut placed = Queries::new();
        placed.fill((&codes, &frame), &queries, (0, 50));
        assert_eq!(codes.panels(), 203usize.div_ceil(WIDE));
        let mut bounds = [[Lanes([0f32; WIDE]); PANELS]; QUERIES];
        for (query, panel) in (0..50).flat_map(|query| (0..codes.panels()).map(move |panel| (query, panel))) {
            let one = placed.get(query, &codes, 30.0);
            let open = lanes::bounds(&[one; QUERIES], &codes.some((panel, panel + 1)), &mut bounds);
            for (lane, bound) in bounds[0][0].0.into_iter().enumerate() {
                assert_eq!(open[3] >> lane & 1 == 1, bound <= 30.0);
                let expert = panel * WIDE + lane;
                if expert >= experts.count() {
                    assert!(bound > 1e9 || metric.scale.contains(&0.0));
                    continue;
                }
                let distance = metric.distance(metric.parts((&queries, query), (&experts, expert)));
                assert!(bound <= bound::limit(&metric, placed.moved[query], distance), "{bound} {distance}");
                assert!(f64::from(bound) > distance * 0.9, "{bound} {distance}");
            }
        }
    }
}

#[test]
fn queries_and_experts_of_any_number_are_compared() {
    for (experts, count) in [(1, 1), (15, 2), (16, 3), (17, 5), (65, 255), (70, 257), (130, 513)] {
        let episodes = [features(1, experts, 10.0), features(2, experts.min(20), 10.0)];
        let queries = features(3, count, 10.0);
        for metric in [METRICS[0], METRICS[3]] {
            for without in [None, Some(0), Some(1)] {
                let expected = brute_force(&episodes, &queries, metric, without);
                assert_eq!(found(&episodes, &queries, metric, (TILES[0], without)), expected);
            }
        }
    }
}

#[test]
fn what_codes_do_not_tell_apart_is_found_all_the_same() {
    // Beside the outlier all the rest has the same code; of so many queries the last are not coded.
    let episodes = [crowd(1, 150, (0.01, 1e6)), crowd(2, 80, (0.01, 3.0))];
    let queries = crowd(3, 800, (0.01, 3.0));
    for metric in [METRICS[0], METRICS[1]] {
        let expected = brute_force(&episodes, &queries, metric, None);
        assert_eq!(found(&episodes, &queries, metric, (TILES[0], None)), expected);
    }
    // Some queries only: those near the outlier are told apart.
    let queries = crowd(4, 30, (0.01, 1e6));
    let expected = brute_force(&episodes, &queries, ONES, None);
    assert_eq!(found(&episodes, &queries, ONES, (TILES[0], None)), expected);
    assert_eq!((expected[5].0, expected[5].1), (0, 5));
}

#[test]
fn of_many_equal_experts_the_first_wins() {
    let one = features(1, 1, 10.0);
    let mut same = Features::empty(WIDTHS);
    (0..200).for_each(|_| same.append(&one));
    let episodes = [features(2, 30, 10.0), same.clone(), same];
    for without in [None, Some(1)] {
        for (episode, step, distance) in found(&episodes, &one, ONES, (TILES[0], without)) {
            assert_eq!((episode, step, distance), (without.map_or(1, |_| 2), 0, 0.0));
        }
    }
}

#[test]
fn old_winners_stay_unless_something_is_nearer() {
    let (old, new) = (features(1, 90, 10.0), features(2, 40, 10.0));
    let queries = features(3, 70, 10.0);
    for metric in METRICS {
        let all = brute_force(&[old.clone(), new.clone()], &queries, metric, None);
        let mut matches: Vec<Option<Match>> =
            Reference::new(&[(0, &old)], metric).nearest(&queries, None).unwrap().into_iter().map(Some).collect();
        Reference::new(&[(1, &new)], metric).improve(&queries, None, &mut matches);
        let found: Vec<_> = matches.iter().flatten().map(|found| (found.episode, found.step, found.distance)).collect();
        assert_eq!(found, all);
        assert!(all.iter().any(|best| best.0 == 0) && all.iter().any(|best| best.0 == 1));
    }
}

#[test]
fn rows_too_wide_for_codes_are_searched_without() {
    let wide = |seed: u64, count: usize| {
        let mut rng = generator(seed, Purpose::Mask, 13);
        let values = [1100, 3, 2].map(|width| (0..count * width).map(|_| rng.random_range(-1.0f32..1.0)).collect());
        Features::new(values, [1100, 3, 2]).unwrap()
    };
    let episodes = [wide(1, 20), wide(2, 20)];
    let reference = Reference::new(&numbered(&episodes), ONES);
    assert!(reference.codes.is_none());
    assert_eq!(winners(&reference, &wide(3, 9), None), brute_force(&episodes, &wide(3, 9), ONES, None));
}
