//! Which of a message's two times counts: its header stamp or the time it was logged.

use crate::align::Timeline;
use crate::tracks::{Stamp, Tracks};
use gleaner_core::{FindingCode, Report, Severity};
use gleaner_core::{Mapping, TaskSpec};

/// Header stamps and log times further apart than this, in nanoseconds, are two different clocks.
const MAX_CLOCK_SKEW: u64 = 1_000_000_000;

/// The choice for one recording.
pub(crate) struct Clocks {
    log_only: bool,
}

impl Clocks {
    /// Header stamps are preferred. Log times, the clock that all topics share, are used only if some topic has no header
    /// stamps and the stamps of the others are of another clock than the recorder's.
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
            return Self { log_only: false };
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
