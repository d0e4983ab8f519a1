//! Which of a message's two times counts: its header stamp or the time it was logged.

use std::collections::BTreeSet;

use crate::align::Timeline;
use crate::tracks::{MAX_CLOCK_SKEW, Stamp, Tracks};
use gleaner_core::{FindingCode, Report, Severity};
use gleaner_core::{Mapping, TaskSpec};

/// Topics that are recorded at the same time, with header stamps further apart than this, in nanoseconds, are stamped by two
/// clocks: no message is logged that late.
const MAX_LATENESS: i64 = 60_000_000_000;
/// Header stamps run at the pace of logging if their times differ by less than one over this.
const SAME_PACE: i64 = 10;

/// The choice for one recording.
pub(crate) struct Clocks {
    log_only: bool,
}

impl Clocks {
    /// Header stamps are preferred. Log times, the clock that all topics share, are used only if header stamps cannot be
    /// compared: some topic has none and the stamps of the others are of another clock than the recorder's, or the stamps of
    /// some topic are of another clock than those of the clock's topic.
    pub(crate) fn new(tracks: &Tracks, mapping: &Mapping, spec: &TaskSpec, report: &mut Report) -> Self {
        let topics = mapping.topics(spec);
        let headless = topics.iter().find(|&&topic| stamps(tracks, topic).iter().all(|stamp| stamp.header.is_none()));
        let skewed = topics.iter().find(|&&topic| {
            let mut skews: Vec<u64> =
                stamps(tracks, topic).iter().filter_map(|stamp| Some(stamp.header?.abs_diff(stamp.log))).collect();
            skews.sort_unstable();
            skews.get(skews.len() / 2).is_some_and(|&skew| skew > MAX_CLOCK_SKEW)
        });
        let (Some(headless), Some(skewed)) = (headless, skewed) else {
            let clock = mapping.clock_topic(spec).unwrap_or_default();
            return Self { log_only: are_foreign(tracks, &topics, clock, report) };
        };
        let detail = format!(
            "its header stamps are from another clock than the recorder's, and {headless} has no stamps, so log times \
             were used for all topics; stamp {headless} for a better alignment"
        );
        report.add(Severity::Note, FindingCode::MixedClocks, skewed, None, detail);
        Self { log_only: true }
    }

    pub(crate) fn time(&self, stamp: Stamp) -> i64 {
        stamp.header.filter(|_| !self.log_only).unwrap_or(stamp.log)
    }

    pub(crate) fn timeline(&self, tracks: &Tracks, topic: &str) -> Timeline {
        Timeline::new(stamps(tracks, topic).iter().map(|&stamp| self.time(stamp)))
    }

    /// The timeline of some messages of a topic.
    pub(crate) fn timeline_of(&self, tracks: &Tracks, topic: &str, messages: &[usize]) -> Timeline {
        let stamps = stamps(tracks, topic);
        Timeline::new(messages.iter().filter_map(|&at| stamps.get(at)).map(|&stamp| self.time(stamp)))
    }
}

fn stamps<'a>(tracks: &'a Tracks, topic: &str) -> &'a [Stamp] {
    tracks.tracks.get(topic).map(|track| track.stamps.as_slice()).unwrap_or_default()
}

/// Compares the header stamps of each topic with those of the clock's topic; returns whether some are of another clock.
/// Stamps that are seconds apart are a warning: the messages may be logged late.
fn are_foreign(tracks: &Tracks, topics: &BTreeSet<&str>, clock: &str, report: &mut Report) -> bool {
    let Some(reference) = Stretch::of(stamps(tracks, clock)).filter(|reference| reference.advances) else {
        return false;
    };
    let others = topics.iter().filter_map(|&topic| Some((topic, Stretch::of(stamps(tracks, topic))?)));
    let others: Vec<(&str, Stretch)> = others.collect();
    if let Some((topic, _)) = others.iter().find(|(_, other)| other.is_foreign_to(&reference)) {
        let detail = format!(
            "its header stamps are from another clock than those of {clock}, so log times were used for all topics; stamp \
             both by one clock for a better alignment"
        );
        report.add(Severity::Note, FindingCode::MixedClocks, topic, None, detail);
        return true;
    }
    let skews = others.iter().map(|(topic, other)| (other.skew(&reference), *topic));
    let worst = skews.max_by_key(|(skew, _)| skew.unsigned_abs());
    if let Some((skew, topic)) = worst.filter(|(skew, _)| skew.unsigned_abs() > MAX_CLOCK_SKEW) {
        let detail = format!(
            "its header stamps are {:.1} s {} those of {clock} at the same time of logging, and its messages were matched \
             by them. Synchronise the clocks of the machines, or ignore this if the messages are logged late",
            skew.unsigned_abs() as f64 / 1e9,
            if skew < 0 { "before" } else { "after" }
        );
        report.add(Severity::Warning, FindingCode::MixedClocks, topic, None, detail);
    }
    false
}

/// The times of a topic's messages that have header stamps.
struct Stretch {
    /// The first and the last.
    header: (i64, i64),
    log: (i64, i64),
    /// By how much header stamps are ahead of log times: the median.
    ahead: i64,
    /// Whether both times pass. A message that is held or sent again, such as a goal, may be old, and so may those from
    /// before an episode with which its file begins.
    advances: bool,
}

impl Stretch {
    /// `None` without header stamps.
    fn of(stamps: &[Stamp]) -> Option<Self> {
        let times = stamps.iter().filter_map(|stamp| Some((stamp.header?, stamp.log)));
        let mut ahead: Vec<i64> = times.clone().map(|(header, log)| header.saturating_sub(log)).collect();
        ahead.sort_unstable();
        let (header, log) = (range(times.clone().map(|(header, _)| header))?, range(times.map(|(_, log)| log))?);
        let ahead = *ahead.get(ahead.len() / 2)?;
        Some(Self { header, log, ahead, advances: header.0 < header.1 && log.0 < log.1 })
    }

    /// Whether its header stamps are far from those of the other, although both are recorded at the same time.
    fn is_foreign_to(&self, other: &Self) -> bool {
        let far = |earlier: (i64, i64), later: (i64, i64)| later.0.saturating_sub(earlier.1) > MAX_LATENESS;
        let overlap = self.log.0 <= other.log.1 && other.log.0 <= self.log.1;
        overlap && (far(other.header, self.header) || (self.advances && far(self.header, other.header)))
    }

    /// By how much its header stamps are after those of the other; 0 if log times are no measure of it, as in a recording
    /// that was converted or is of simulated time.
    fn skew(&self, other: &Self) -> i64 {
        if self.advances && self.is_live() && other.is_live() { self.ahead.saturating_sub(other.ahead) } else { 0 }
    }

    fn is_live(&self) -> bool {
        let length = |(first, last): (i64, i64)| last.saturating_sub(first);
        let (header, log) = (length(self.header), length(self.log));
        header.saturating_sub(log).saturating_abs() <= header.max(log) / SAME_PACE
    }
}

fn range(times: impl Iterator<Item = i64> + Clone) -> Option<(i64, i64)> {
    Some((times.clone().min()?, times.max()?))
}
