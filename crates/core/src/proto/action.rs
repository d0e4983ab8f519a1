//! The ranges of actions on the wire.

use gleaner_proto::v1;

use crate::action::{ActionRange, ActionRanges};

/// The ranges from their messages.
#[must_use]
pub fn ranges_from_proto(ranges: &[v1::ActionRange]) -> ActionRanges {
    ranges.iter().map(|range| ActionRange::new(range.minimum, range.maximum, range.binary)).collect()
}

/// The ranges as messages.
#[must_use]
pub fn ranges_to_proto(ranges: &ActionRanges) -> Vec<v1::ActionRange> {
    let message = |range: &ActionRange| {
        let (minimum, maximum, binary) = range.bounds();
        v1::ActionRange { minimum, maximum, binary }
    };
    ranges.each().iter().map(message).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_survive_the_wire() {
        use ActionRange::{AtLeast, AtMost, Binary, Free, Within};
        let ranges: ActionRanges =
            [Free, Within(-1.0, 2.0), AtLeast(0.0), AtMost(3.0), Binary(-1.0, 1.0)].into_iter().collect();
        assert_eq!(ranges_from_proto(&ranges_to_proto(&ranges)), ranges);
    }
}
