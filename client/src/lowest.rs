//! The lowest of a session's live scores: where a rollout departed most from the experts.

use gleaner_proto::v1::LiveScore;

/// The segment of a session that is least like the experts'.
#[derive(Clone, Debug, PartialEq)]
pub struct LowestScore {
    /// 0 to 1, against the score run's own segments.
    pub q: f64,
    /// The similarity to the nearest expert segment.
    pub w: f64,
    /// Seconds from the first observation to the segment's last.
    pub seconds: f64,
    /// The expert episode that is nearest.
    pub match_episode_id: String,
    /// The step at which its nearest segment ends.
    pub match_step: u32,
}

/// Follows the scores of one session.
#[derive(Clone, Debug, Default)]
pub(crate) struct Lowest {
    begin_ns: Option<i64>,
    found: Option<LowestScore>,
}

impl Lowest {
    /// An answer has come to the observation of this stamp, the first one being the session's first.
    pub(crate) fn record(&mut self, stamp_ns: i64, score: Option<&LiveScore>) {
        let begin_ns = *self.begin_ns.get_or_insert(stamp_ns);
        let Some(LiveScore { w, q, match_episode_id, match_step, observation_stamp_ns }) = score else { return };
        // w ranks segments whose q is clamped to 0.
        if self.found.as_ref().is_some_and(|found| (found.q, found.w) <= (*q, *w)) {
            return;
        }
        #[expect(clippy::cast_precision_loss, reason = "nanoseconds of an episode, for people to read")]
        let seconds = observation_stamp_ns.saturating_sub(begin_ns) as f64 / 1e9;
        self.found = Some(LowestScore {
            q: *q,
            w: *w,
            seconds,
            match_episode_id: match_episode_id.clone(),
            match_step: *match_step,
        });
    }

    pub(crate) fn found(self) -> Option<LowestScore> {
        self.found
    }
}

/// The lower of two.
pub(crate) fn lower(a: Option<LowestScore>, b: Option<LowestScore>) -> Option<LowestScore> {
    match (a, b) {
        (Some(a), Some(b)) => Some(if (b.q, b.w) < (a.q, a.w) { b } else { a }),
        (a, b) => a.or(b),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lowest_score_is_found_with_its_time() {
        let score =
            |q, w, stamp| LiveScore { q, w, observation_stamp_ns: stamp, match_step: 7, ..LiveScore::default() };
        let mut lowest = Lowest::default();
        lowest.record(1_000_000_000, None);
        assert_eq!(lowest.clone().found(), None);
        lowest.record(1_100_000_000, Some(&score(0.0, -3.0, 1_000_000_000)));
        lowest.record(1_600_000_000, Some(&score(0.0, -9.0, 1_500_000_000)));
        lowest.record(1_700_000_000, Some(&score(0.8, -1.0, 1_600_000_000)));
        let found = lowest.found().unwrap();
        assert_eq!((found.q, found.w, found.seconds, found.match_step), (0.0, -9.0, 0.5, 7));
        let other = LowestScore { q: 0.0, w: -10.0, ..found.clone() };
        assert_eq!(lower(Some(found.clone()), Some(other.clone())), Some(other));
        assert_eq!(lower(None, Some(found.clone())), Some(found));
    }
}
