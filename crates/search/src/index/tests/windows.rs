//! Points that are windows of rows.

use super::*;

#[test]
fn windows_are_found_as_points_with_the_same_values_are() {
    // Enough points for directions.
    let (groups, plain) = crate::testing::windows(&[700, 3, 90, 4], [40, 7, 33], 4);
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
    let index = Index::with_views(&numbered(&groups), ONES, TILES[0], &VIEWS);
    assert_eq!(index.levels().len(), 1, "too narrow for directions");
    assert!(index.nearest(&plain_queries, None).is_err(), "of another shape");
}
