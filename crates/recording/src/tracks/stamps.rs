//! Header stamps of messages that lack them.

use super::{MAX_CLOCK_SKEW, Stamp};

/// Gives header stamps to the messages without one among those of another clock than the recorder's: the time of logging,
/// by the distance of the two clocks at the message before, or at the first message with a stamp. The time of logging itself
/// would move such a message, as the first one of simulated time is with its stamp of zero, years away from the others.
pub(super) fn complete(stamps: &mut [Stamp]) {
    let Some(mut ahead) = stamps.iter().copied().find_map(Stamp::ahead) else { return };
    for stamp in stamps {
        match stamp.ahead() {
            Some(found) => ahead = found,
            None if ahead.unsigned_abs() > MAX_CLOCK_SKEW => stamp.header = Some(stamp.log.saturating_add(ahead)),
            None => {}
        }
    }
}

impl Stamp {
    /// By how much the header stamp is ahead of the time of logging.
    fn ahead(self) -> Option<i64> {
        Some(self.header?.saturating_sub(self.log))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn completed(stamps: [(Option<i64>, i64); 5]) -> [Option<i64>; 5] {
        let mut stamps = stamps.map(|(header, log)| Stamp { header, log });
        complete(&mut stamps);
        stamps.map(|stamp| stamp.header)
    }

    #[test]
    fn stamps_of_another_clock_are_completed_from_the_nearest_before() {
        const FAR: i64 = 1 << 60;
        // The clock of the stamps has half of the pace of logging.
        let stamps = [(None, FAR), (Some(10), FAR + 20), (None, FAR + 24), (Some(30), FAR + 60), (None, FAR + 62)];
        assert_eq!(completed(stamps), [Some(-10), Some(10), Some(14), Some(30), Some(32)]);
    }

    #[test]
    fn stamps_of_the_recorders_clock_and_topics_without_any_stay() {
        let same = [(None, 100), (Some(105), 120), (None, 140), (Some(150), 160), (None, 180)];
        assert_eq!(completed(same), same.map(|(header, _)| header));
        assert_eq!(completed([(None, 5); 5]), [None; 5]);
    }
}
