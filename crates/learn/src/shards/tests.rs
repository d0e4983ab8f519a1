//! How items are divided.

use super::*;

#[test]
fn parts_have_every_item_once_and_about_equal_sizes() {
    let sizes = [90, 10, 10, 10, 60, 0, 0, 30];
    for ranks in 1..6 {
        let parts = divide(&sizes, ranks);
        let mut all = parts.concat();
        all.sort_unstable();
        assert_eq!((parts.len(), all), (ranks, (0..sizes.len()).collect()));
        assert!(parts.iter().all(|part| part.is_sorted()));
    }
    let sum = |part: &Vec<usize>| part.iter().map(|item| sizes[*item]).sum::<usize>();
    assert_eq!(divide(&sizes, 2).iter().map(sum).collect::<Vec<_>>(), [120, 90]);
}
