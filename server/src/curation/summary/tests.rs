//! Summaries compared with a scan of every segment.

use proptest::prelude::*;

use super::*;

fn candidate(q: &[f32]) -> Candidate {
    let w = q.iter().map(|&q| f64::from(q) - 1.0).collect();
    Candidate { episode_id: EpisodeId::new(), cohort: String::new(), w, q: q.to_vec(), places: Vec::new() }
}

fn better(a: &(f32, f64), b: &(f32, f64)) -> Ordering {
    b.0.total_cmp(&a.0).then(b.1.total_cmp(&a.1))
}

fn steps(found: &[SegmentRef], of: &EpisodeId) -> Vec<u32> {
    found.iter().filter(|segment| segment.episode_id == *of).map(|segment| segment.end_step).collect()
}

#[test]
fn ties_go_to_the_older_episode_and_the_earlier_step() {
    let candidates = [candidate(&[0.5; 40]), candidate(&[0.5; 5]), candidate(&[])];
    let found = foremost(&candidates, 9, better);
    let expected = [(0, 0), (0, 10), (0, 20), (1, 0)];
    let expected = expected.map(|(place, end_step)| SegmentRef {
        episode_id: candidates[place].episode_id.clone(),
        end_step,
        q: 0.5,
    });
    assert_eq!(found, expected);
    let backwards: Vec<_> = candidates.iter().rev().cloned().collect();
    assert_eq!(foremost(&backwards, 9, better), expected, "whatever the snapshot's order");
    assert!(foremost(&[], 9, better).is_empty() && foremost(&candidates, 0, better).is_empty());
}

#[test]
fn of_equal_q_the_higher_w_comes_first() {
    let one = Candidate { w: vec![-2.0, -1.0], ..candidate(&[1.0, 1.0]) };
    let other = Candidate { w: vec![-0.5], ..candidate(&[1.0]) };
    let found = foremost(&[one.clone(), other.clone()], 2, better);
    assert_eq!((steps(&found, &one.episode_id), &found[0].episode_id), (vec![1], &other.episode_id));
}

#[test]
fn the_mean_is_that_of_the_steps() {
    assert_eq!(mean(&[0.0, 0.5, 1.0, 0.5]), Some(0.5));
    assert_eq!(mean(&[]), None);
}

proptest! {
    /// No omitted segment is better than a shown one of its episode, unless it is its neighbour or three are shown.
    #[test]
    fn the_best_are_found(q in proptest::collection::vec(proptest::collection::vec(0..5_u8, 0..40), 0..5), most in 0..12_usize) {
        let candidates: Vec<_> = q.iter().map(|q| candidate(&q.iter().map(|&q| f32::from(q) / 4.0).collect::<Vec<_>>())).collect();
        let found = foremost(&candidates, most, better);
        prop_assert!(found.len() <= most);
        prop_assert!(found.is_sorted_by(|a, b| a.q >= b.q));
        for one in &candidates {
            let shown = steps(&found, &one.episode_id);
            prop_assert!(shown.len() <= OF_ONE_EPISODE);
            for (place, a) in shown.iter().enumerate() {
                prop_assert!(shown[place + 1..].iter().all(|b| a.abs_diff(*b) >= 10));
            }
            let top = one.q.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            match shown.first() {
                Some(&first) => prop_assert_eq!(one.q[usize::try_from(first).unwrap()], top),
                None => prop_assert!(one.q.is_empty() || found.len() == most && found.iter().all(|other| other.q >= top)),
            }
        }
    }
}
