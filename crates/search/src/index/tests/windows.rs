//! Points that are windows of rows.

use super::*;
use crate::slide::Bounds;

#[test]
fn windows_are_found_as_points_with_the_same_values_are() {
    // Enough points, and wide enough, for directions.
    let (groups, plain) = crate::testing::windows(&[700, 3, 90, 4], [40, 24, 33], 4);
    let (queries, plain_queries) = (groups[2].clone(), plain[2].clone());
    assert_eq!(groups[1].count(), 0);
    for metric in METRICS {
        for without in [None, Some(2)] {
            let expected = brute_force(&plain, &plain_queries, metric, without);
            for tiles in [TILES[0], TILES[2]] {
                assert_eq!(found(&groups, &queries, metric, (tiles, without)), expected);
            }
        }
    }
    let levels = |metric| Index::with_views(&numbered(&groups), metric, TILES[0], &VIEWS).filter().levels().len();
    assert_eq!((levels(ONES), levels(METRICS[1])), (0, 2));
    let index = Index::new(&numbered(&groups), ONES).unwrap();
    assert_eq!(index.nearest(&plain_queries, None).unwrap_err().field, "queries");
    for mixed in [[&groups[2], &plain[2]], [&plain[2], &groups[2]]] {
        let problem = Index::new(&[(0, mixed[0]), (1, mixed[1])], ONES).err().unwrap();
        assert_eq!(problem.field, "groups");
    }
    let nothing = Index::new(&numbered(&groups[1..2]), ONES).unwrap();
    assert_eq!(nothing.nearest(&queries, None), Ok(None));
}

#[test]
fn near_and_exact_duplicates_of_windows_are_found_exactly() {
    // Rows far from 0 that differ little, so that products alone could not tell them apart.
    let (mut groups, _) = crate::testing::windows(&[40, 40], [24, 7, 33], 3);
    let far = |points: &Points, by: f32| {
        let of = |part: usize| points.values(part).iter().map(|x| 100.0 + x / 50.0 + by).collect::<Vec<f32>>();
        Points::new([of(0), of(1), of(2)], points.shape()).unwrap()
    };
    groups = groups.iter().map(|group| far(group, 0.0)).collect();
    // The windows of the second group, each exactly or next to it, in a third group and among the queries.
    groups.push(far(&groups[1], 0.0));
    let queries = groups[1].clone();
    for metric in [ONES, METRICS[2]] {
        for without in [None, Some(1)] {
            let expected = brute_force(&groups, &queries, metric, without);
            for tiles in TILES {
                assert_eq!(found(&groups, &queries, metric, (tiles, without)), expected);
            }
        }
    }
}

#[test]
fn bounds_of_windows_are_below_distances_but_tight_where_rows_are_far_apart() {
    let (groups, _) = crate::testing::windows(&[60, 45, 30], [40, 7, 33], 4);
    let queries = groups[2].clone();
    for metric in [ONES, METRICS[2]] {
        let corpus = Corpus::new(&numbered(&groups[..2]), metric, TILES[0]);
        let slides = [0, 1, 2].map(|part| Slide::new(&corpus, part));
        let block = (3, queries.count());
        let placed = slides.each_ref().map(|slide| slide.place(&corpus, &queries, block));
        let moved = [0, 1, 2].map(|part: usize| slides[part].moved + placed[part].moved);
        let (open, tile) = (vec![0, 5, 6, 20], (10, 99));
        assert_eq!(corpus.points.count(), 57 + 42);
        let mut bounds = Bounds::default();
        bounds.fill(&corpus, &slides, (&queries, &placed, block), (&open, tile));
        for (open, (row, lows)) in open.iter().zip(bounds.all.chunks(96).zip(bounds.lows.chunks(6))) {
            for (at, bound) in row.iter().enumerate() {
                assert!(lows[at % 6] <= *bound);
                if at >= 89 {
                    assert_eq!(*bound, f32::INFINITY);
                    continue;
                }
                let distance = metric.distance(metric.parts((&queries, 3 + open), (&corpus.points, 10 + at)));
                assert!(*bound <= limit(&corpus.relative, moved, distance / corpus.unit));
                assert!(f64::from(*bound) > distance / corpus.unit * 0.999, "{bound} {distance}");
            }
        }
        assert_eq!(bounds.lows.len(), 24);
    }
}
