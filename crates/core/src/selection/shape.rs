//! The shape of a selection: the cohorts it leaves out, gaps, runs and context within an episode, and limits of one episode
//! and of one phase. Must not depend on the rule.

use std::fmt;

use super::Candidate;
use crate::{
    schema::{Problem, Setting, Values, complete, integer_in, number_in},
    settings::Group as _,
};

/// Steps that gaps, runs and context may have; no episode is longer.
const MOST_STEPS: u64 = 1_000_000;

crate::settings! {
    /// The shape of what a selection keeps; off by default. Cohorts are left out before the rule, and the rest is applied
    /// after it in the order of the settings. A run is a sequence of kept segments of one episode that end at consecutive
    /// steps.
    #[derive(Copy)]
    pub struct SelectionShape {
        /// Leave out a cohort if an expert's segment has the higher q in less than this share of pairs (ties count half; 0:
        /// off). Higher values leave out more kinds of failures, those that q does not tell from experts first.
        pub min_expert_auroc: f64 = 0.0, number_in(0.0, 1.0);
        /// Keep gaps between two runs too, up to this many steps (0: off). Higher values give longer runs, and keep
        /// segments that the rule rejects, with their low q as weight.
        pub close_gaps: u32 = 0, integer_in(0, MOST_STEPS);
        /// Drop runs shorter than this many steps, after gaps are closed (0: keep all). Higher values drop chance hits
        /// and short good moments alike.
        pub min_run: u32 = 0, integer_in(0, MOST_STEPS);
        /// Keep up to this many steps before each run too (0: off). Higher values keep the approach to good moments, and
        /// segments that the rule rejects.
        pub context_before: u32 = 0, integer_in(0, MOST_STEPS);
        /// Keep up to this many steps after each run too (0: off). Higher values keep the end of good moments, and
        /// segments that the rule rejects.
        pub context_after: u32 = 0, integer_in(0, MOST_STEPS);
        /// Keep at most this share of an episode's segments, those of highest q (1: off). Lower values spread a dataset
        /// over more episodes, and break runs.
        pub max_share_of_episode: f64 = 1.0, number_in(1e-6, 1.0);
        /// Equal parts of the task that `max_per_phase` limits. A segment's part is the one in which its nearest expert
        /// segment lies in the expert's episode, or, for scorers that match nothing, the segment in its own.
        pub phases: u32 = 10, integer_in(1, 1000);
        /// Keep at most this many segments of each phase, those of highest q (0: off). Lower values stop frequent phases
        /// from crowding out rare ones, and break runs.
        pub max_per_phase: u32 = 0, integer_in(0, 1_000_000_000);
    }
}

impl SelectionShape {
    /// Reads settings; those left out take their defaults.
    ///
    /// # Errors
    /// An unknown setting, or a value that its setting does not allow.
    pub fn from_values(values: &Values) -> Result<Self, Problem> {
        Self::read(&complete(&Self::schema(), values, |_| None)?).map(Self::plain)
    }

    /// The same shape, each value checked.
    ///
    /// # Errors
    /// A value that its setting does not allow.
    pub fn checked(self) -> Result<Self, Problem> {
        let mut values = Values::new();
        self.write(&mut values);
        for (setting, value) in Self::schema().iter().filter_map(|one: &Setting| Some((one, values.get(&one.name)?))) {
            setting.check(value)?;
        }
        Ok(self.plain())
    }

    /// The same shape in one form: settings without effect take their defaults, so that equal datasets are one.
    fn plain(self) -> Self {
        let off = Self::default();
        Self {
            min_run: if self.min_run == 1 { off.min_run } else { self.min_run },
            phases: if self.max_per_phase == 0 { off.phases } else { self.phases },
            ..self
        }
    }

    /// The settings that differ from their defaults: the stored form, and that of addresses.
    pub fn changed(&self) -> Values {
        let mut values = Values::new();
        self.write(&mut values);
        for setting in Self::schema() {
            if values.get(&setting.name) == Some(&setting.default) {
                values.remove(&setting.name);
            }
        }
        values
    }

    /// Whether it changes no setting.
    pub fn is_off(&self) -> bool {
        *self == Self::default()
    }

    /// Closes gaps, drops short runs, adds context and limits the episode.
    pub(super) fn apply(&self, candidate: &Candidate, kept: &mut [bool]) {
        let steps = |count: u32| usize::try_from(count).unwrap_or(usize::MAX);
        let (before, after) = (steps(self.context_before), steps(self.context_after));
        if self.close_gaps > 0 || self.min_run > 1 || before > 0 || after > 0 {
            let (mut runs, end) = (runs(kept), kept.len());
            runs.dedup_by(|next, run| {
                let near = next.0 - run.1 <= steps(self.close_gaps);
                if near {
                    run.1 = next.1;
                }
                near
            });
            runs.retain(|(from, to)| to - from >= steps(self.min_run));
            kept.fill(false);
            for (from, to) in runs {
                kept[from.saturating_sub(before)..to.saturating_add(after).min(end)].fill(true);
            }
        }
        if self.max_share_of_episode < 1.0 {
            limit(candidate, share(self.max_share_of_episode, kept.len()), kept);
        }
    }
}

impl fmt::Display for SelectionShape {
    /// The changed settings, such as `min_run 5, max_per_phase 200`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let changed = self.changed();
        let listed =
            Self::schema().into_iter().filter_map(|one| Some(format!("{} {}", one.name, changed.get(&one.name)?)));
        f.write_str(&listed.collect::<Vec<_>>().join(", "))
    }
}

/// The runs of kept segments: the first step of each, and the step after its last.
fn runs(kept: &[bool]) -> Vec<(usize, usize)> {
    let mut runs: Vec<(usize, usize)> = Vec::new();
    for step in (0..kept.len()).filter(|&step| kept[step]) {
        match runs.last_mut() {
            Some((_, end)) if *end == step => *end = step + 1,
            _ => runs.push((step, step + 1)),
        }
    }
    runs
}

/// Drops all but the best `most` kept segments of an episode.
fn limit(candidate: &Candidate, most: usize, kept: &mut [bool]) {
    let mut steps: Vec<usize> = (0..kept.len()).filter(|&step| kept[step]).collect();
    if steps.len() > most {
        steps.select_nth_unstable_by(most, |&a, &b| candidate.ranked(a).order(&candidate.ranked(b)));
        steps[most..].iter().for_each(|&step| kept[step] = false);
    }
}

/// ⌊share · N⌋, corrected for the rounding of the product: 29 % of 100 is 29.
#[expect(clippy::cast_precision_loss, reason = "far fewer than 2^52 segments")]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "between 0 and N")]
pub(super) fn share(share: f64, segments: usize) -> usize {
    (share * segments as f64 * (1.0 + 1e-12)).floor() as usize
}
