//! The table of a task's episodes: its filter, its rows and their order.

use std::cmp::Ordering;

use crate::{
    episode::{Episode, Outcome},
    id::EpisodeId,
    time::Millis,
};

/// Filter of a task's episode table; episodes in the trash are never part of it.
#[derive(Debug, Clone, Default)]
pub struct TableFilter {
    /// Only with this outcome.
    pub outcome: Option<Outcome>,
    /// Only of this cohort.
    pub cohort: Option<String>,
    /// Only those that became visible at this time or later.
    pub from: Option<Millis>,
    /// Only those that became visible before this time.
    pub before: Option<Millis>,
    /// Only those whose report has warnings, or only those whose report has none.
    pub warnings: Option<bool>,
    /// Only those with this text in their file name or id, ignoring the case of ASCII letters.
    pub text: Option<String>,
}

/// An episode with its newest label.
#[derive(Debug, Clone)]
pub struct TableRow {
    /// The episode.
    pub episode: Episode,
    /// Increases with each label of the episode; a caller that labels names the version it has read.
    pub label_version: i64,
    /// The author of the newest label.
    pub labelled_by: String,
    /// When the newest label was made.
    pub labelled_at: Millis,
}

/// Sort keys of a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SortKey {
    /// Mean q in a score run; episodes without one come last either way.
    MeanQ,
    /// Number of steps.
    Steps,
    /// When the episode became visible.
    Date,
    /// Failure, then success, then unknown.
    Outcome,
    /// The cohort, by name.
    Cohort,
    /// Number of warnings in the report.
    Findings,
}

impl SortKey {
    /// Every key.
    pub const ALL: [Self; 6] = [Self::MeanQ, Self::Steps, Self::Date, Self::Outcome, Self::Cohort, Self::Findings];

    /// The word for it in links.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::MeanQ => "mean_q",
            Self::Steps => "steps",
            Self::Date => "date",
            Self::Outcome => "outcome",
            Self::Cohort => "cohort",
            Self::Findings => "findings",
        }
    }

    /// Reads the word in links.
    pub fn from_word(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|key| key.as_str() == word)
    }
}

/// Sorts rows; equal ones by id, older first, so that pages of the same list meet.
pub fn sort(rows: &mut Vec<TableRow>, key: SortKey, descending: bool, mean_q: impl Fn(&EpisodeId) -> Option<f64>) {
    let directed = |order: Ordering| if descending { order.reverse() } else { order };
    let compare = |a: &Episode, b: &Episode| match key {
        SortKey::MeanQ => Ordering::Equal,
        SortKey::Steps => a.steps.cmp(&b.steps),
        SortKey::Date => a.created_at.cmp(&b.created_at),
        SortKey::Outcome => a.outcome.as_str().cmp(b.outcome.as_str()),
        SortKey::Cohort => a.cohort.cmp(&b.cohort),
        SortKey::Findings => a.warnings.cmp(&b.warnings),
    };
    // Looked up once for each row, not for each comparison.
    let q_of = |row: &TableRow| if key == SortKey::MeanQ { mean_q(&row.episode.id) } else { None };
    let mut keyed: Vec<(Option<f64>, TableRow)> = rows.drain(..).map(|row| (q_of(&row), row)).collect();
    keyed.sort_by(|(a_q, a), (b_q, b)| {
        let by_key = by_mean_q(*a_q, *b_q, descending).then_with(|| directed(compare(&a.episode, &b.episode)));
        by_key.then_with(|| a.episode.id.cmp(&b.episode.id))
    });
    rows.extend(keyed.into_iter().map(|(_, row)| row));
}

/// Sorts ids as [`sort`] sorts their rows: `by_q` by the mean q beside each, otherwise by date, which is the order of ids.
pub fn sort_ids(keyed: &mut [(Option<f64>, EpisodeId)], by_q: bool, descending: bool) {
    if by_q {
        keyed.sort_unstable_by(|(a_q, a), (b_q, b)| by_mean_q(*a_q, *b_q, descending).then_with(|| a.cmp(b)));
    } else {
        keyed.sort_unstable_by(|(_, a), (_, b)| if descending { b.cmp(a) } else { a.cmp(b) });
    }
}

/// Those without a mean q come last either way.
fn by_mean_q(a: Option<f64>, b: Option<f64>, descending: bool) -> Ordering {
    match (a, b) {
        (Some(a), Some(b)) if descending => b.total_cmp(&a),
        (Some(a), Some(b)) => a.total_cmp(&b),
        (a, b) => b.is_some().cmp(&a.is_some()),
    }
}
