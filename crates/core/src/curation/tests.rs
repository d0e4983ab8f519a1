//! The order of a table.

use proptest::prelude::*;

use super::*;
use crate::id::{BlobId, TaskId};

fn row(steps: u64, created_at: i64, outcome: Outcome) -> TableRow {
    let episode = Episode {
        id: EpisodeId::new(),
        task_id: TaskId::new(),
        file_name: String::new(),
        recording: BlobId::from(blake3::hash(b"")),
        size_bytes: 0,
        steps,
        duration_s: 0.0,
        mapping: String::new(),
        warnings: 0,
        outcome,
        cohort: String::new(),
        created_at: Millis(created_at),
        deleted_at: None,
    };
    TableRow { episode, label_version: 1, labelled_by: String::new(), labelled_at: Millis(0) }
}

/// An episode's mean q: its steps as a number; `None` for 0 steps.
fn mean_q(rows: &[TableRow]) -> impl Fn(&EpisodeId) -> Option<f64> {
    let all: std::collections::HashMap<_, _> =
        rows.iter().map(|row| (row.episode.id.clone(), f64::from(u32::try_from(row.episode.steps).unwrap()))).collect();
    move |id| all.get(id).copied().filter(|q| *q > 0.0)
}

#[test]
fn rows_without_a_mean_q_are_last_in_both_orders() {
    let rows = [2, 0, 3, 1, 0].map(|steps| row(steps, 0, Outcome::Unknown));
    for (descending, expected) in [(false, [3, 0, 2, 1, 4]), (true, [2, 0, 3, 1, 4])] {
        let mut sorted = rows.to_vec();
        sort(&mut sorted, SortKey::MeanQ, descending, mean_q(&rows));
        let ids = |rows: &[TableRow]| rows.iter().map(|row| row.episode.id.clone()).collect::<Vec<_>>();
        assert_eq!(ids(&sorted), expected.map(|place| rows[place].episode.id.clone()), "{descending}");
    }
}

#[test]
fn ids_are_sorted_as_their_rows_are() {
    let mut rows = [2, 0, 3, 1, 0, 3].map(|steps| row(steps, 0, Outcome::Unknown)).to_vec();
    for (key, descending) in
        [(SortKey::MeanQ, false), (SortKey::MeanQ, true), (SortKey::Date, false), (SortKey::Date, true)]
    {
        let all = rows.clone();
        let q = mean_q(&all);
        let mut keyed: Vec<_> = rows.iter().map(|row| (q(&row.episode.id), row.episode.id.clone())).collect();
        sort_ids(&mut keyed, key == SortKey::MeanQ, descending);
        // Ids are in the order of time.
        rows.sort_by(|a, b| a.episode.id.cmp(&b.episode.id));
        rows.iter_mut().zip(0..).for_each(|(row, at)| row.episode.created_at = Millis(at));
        sort(&mut rows, key, descending, q);
        assert!(keyed.iter().map(|(_, id)| id).eq(rows.iter().map(|row| &row.episode.id)), "{key:?} {descending}");
    }
}

#[test]
fn every_key_has_a_word() {
    for key in SortKey::ALL {
        assert_eq!(SortKey::from_word(key.as_str()), Some(key));
    }
    assert_eq!(SortKey::from_word("q"), None);
}

proptest! {
    /// The order does not depend on the order of input; descending order is the reverse, except for ties, which stay
    /// ordered by id.
    #[test]
    fn rows_have_a_total_order(values in proptest::collection::vec((0..4_u64, 0..3_i64, 0..3_usize), 0..20), key in 0..SortKey::ALL.len()) {
        let outcomes = [Outcome::Success, Outcome::Failure, Outcome::Unknown];
        let rows: Vec<_> = values.into_iter().map(|(steps, at, outcome)| row(steps, at, outcomes[outcome])).collect();
        let (key, mean_q) = (SortKey::ALL[key], mean_q(&rows));
        for descending in [false, true] {
            let (mut one, mut other) = (rows.clone(), rows.iter().rev().cloned().collect::<Vec<_>>());
            sort(&mut one, key, descending, &mean_q);
            sort(&mut other, key, descending, &mean_q);
            let ids = |rows: &[TableRow]| rows.iter().map(|row| row.episode.id.clone()).collect::<Vec<_>>();
            prop_assert_eq!(ids(&one), ids(&other));
            for pair in one.windows(2) {
                let (a, b) = (&pair[0].episode, &pair[1].episode);
                let tie = match key {
                    SortKey::MeanQ | SortKey::Steps => a.steps == b.steps,
                    SortKey::Date => a.created_at == b.created_at,
                    SortKey::Outcome => a.outcome == b.outcome,
                    SortKey::Cohort => a.cohort == b.cohort,
                    SortKey::Findings => a.warnings == b.warnings,
                };
                prop_assert!(!tie || a.id < b.id);
            }
        }
    }
}
