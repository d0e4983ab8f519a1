//! Groups that are divided: each half is searched alone, as by machines that share no memory, and the nearer match counts.

use super::*;

/// A match with every bit of its numbers.
fn bits(found: &Match) -> (u32, u32, u64, [u32; 3]) {
    (found.group, found.row, found.distance.to_bits(), found.parts.map(f32::to_bits))
}

#[test]
fn nearer_match_of_two_halves_is_the_match_of_all_bit_for_bit() {
    let (duplicates, queries) = near_duplicates();
    let (windows, _) = crate::testing::windows(&[40, 31, 52, 27, 45, 38, 33], WIDTHS, 4);
    for (groups, queries) in [(&duplicates[..], &queries), (&windows[..6], &windows[6])] {
        let all = numbered(groups);
        for (metric, without) in METRICS.into_iter().flat_map(|metric| [(metric, None), (metric, Some(2))]) {
            let nearest = |groups: &[(u32, &Points)]| {
                Index::new(groups, metric).unwrap().nearest(queries, without).unwrap().unwrap()
            };
            let whole: Vec<_> = nearest(&all).iter().map(bits).collect();
            for half in [[0, 1, 2], [1, 3, 5], [0, 2, 5]] {
                let (here, there): (Vec<_>, Vec<_>) =
                    all.iter().copied().partition(|(number, _)| half.contains(number));
                let (here, there) = (nearest(&here), nearest(&there));
                // The smaller distance; of equal ones, that of the earlier group.
                let order = |found: &Match| (found.distance, found.group);
                let pairs = here.iter().zip(&there);
                let nearer = pairs.map(|(here, there)| if order(there) < order(here) { there } else { here });
                assert_eq!(nearer.map(bits).collect::<Vec<_>>(), whole);
            }
        }
    }
}
