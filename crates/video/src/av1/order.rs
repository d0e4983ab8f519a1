//! Finds pictures of AV1 that are missing, by the order hints of those that are shown.
//!
//! An order hint is the place of a frame in the order of presentation, so the hints of the pictures that are shown
//! increase by one, also when frames are decoded ahead and shown later. The specification does not demand it. A step of
//! two or more is therefore a gap only in a group of pictures whose hints have increased by one before; any other
//! sequence of hints ends the search up to the next key frame.

use super::frame::Frame;
use super::sequence::Syntax;

/// The hints since the last key frame.
#[derive(Debug, Default)]
pub(super) struct Order {
    /// The hint of the frame in each slot, and whether it is a key frame.
    slots: [(u32, bool); 8],
    /// The hint of the last picture that was shown; `None` if hints are not followed.
    last: Option<u32>,
    /// Whether hints have increased by one.
    steady: bool,
}

impl Order {
    /// Adds a frame; returns whether pictures before it are missing.
    pub(super) fn misses(&mut self, frame: Frame, syntax: &Syntax) -> bool {
        match frame {
            Frame::Again(slot) => {
                let Some(&(hint, key)) = self.slots.get(slot) else { return false };
                if key {
                    // A key frame that is shown late discards the others then.
                    self.slots = [(hint, key); 8];
                }
                self.show(hint, syntax)
            }
            Frame::New { key, shown, hint, slots } => {
                for (at, slot) in self.slots.iter_mut().enumerate() {
                    *slot = if slots >> at & 1 == 1 { (hint, key) } else { *slot };
                }
                if key && shown {
                    (self.last, self.steady) = (Some(hint), false);
                    return false;
                }
                shown && self.show(hint, syntax)
            }
        }
    }

    /// Adds a picture that is shown.
    fn show(&mut self, hint: u32, syntax: &Syntax) -> bool {
        let Some(last) = self.last else { return false };
        let step = hint.wrapping_sub(last) % (1 << syntax.hint_bits);
        let follows = step < 2 || self.steady;
        self.last = follows.then_some(hint);
        self.steady |= step == 1;
        follows && step > 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SYNTAX: Syntax = Syntax {
        hint_bits: 4,
        number_bits: 0,
        chooses_screen: true,
        screen: false,
        chooses_whole: true,
        time_bits: 0,
        removal_bits: None,
    };

    const NONE: [usize; 0] = [];

    /// Which of these frames are behind a gap.
    fn gaps(frames: &[Frame]) -> Vec<usize> {
        let mut order = Order::default();
        let found = frames.iter().enumerate().filter(|(_, frame)| order.misses(**frame, &SYNTAX));
        found.map(|(at, _)| at).collect()
    }

    fn key(hint: u32) -> Frame {
        Frame::New { key: true, shown: true, hint, slots: 0xff }
    }

    fn shown(hint: u32) -> Frame {
        Frame::New { key: false, shown: true, hint: hint % 16, slots: 1 }
    }

    fn hidden(key: bool, hint: u32, slot: u32) -> Frame {
        Frame::New { key, shown: false, hint, slots: 1 << slot }
    }

    #[test]
    fn a_step_of_two_is_a_gap_once_hints_have_increased_by_one() {
        assert_eq!(gaps(&[key(0), shown(1), shown(3), shown(4)]), [2]);
        let whole: Vec<Frame> = std::iter::once(key(0)).chain((1..40).map(shown)).collect();
        assert_eq!(gaps(&whole), NONE);
        assert_eq!(gaps(&[key(14), shown(15), shown(16), shown(18)]), [3]);
        assert_eq!(gaps(&[key(0), shown(1), shown(14)]), [2]);
    }

    #[test]
    fn frames_that_are_decoded_ahead_are_no_gap_where_they_are_shown() {
        let frames = [key(0), hidden(false, 4, 3), hidden(false, 2, 2), shown(1), Frame::Again(2), shown(3)];
        assert_eq!(gaps(&[&frames[..], &[Frame::Again(3), shown(5)]].concat()), NONE);
        // Without the message that shows 3, and without the one that holds 4, whose slot still has the key frame.
        assert_eq!(gaps(&[&frames[..5], &[Frame::Again(3)]].concat()), [5]);
        assert_eq!(gaps(&[key(0), hidden(false, 2, 2), shown(1), Frame::Again(2), shown(3), Frame::Again(3)]), [5]);
        // A picture that is shown twice.
        assert_eq!(gaps(&[key(0), shown(1), Frame::Again(0), shown(2)]), NONE);
    }

    #[test]
    fn a_key_frame_that_is_shown_late_fills_every_slot() {
        let frames = [key(0), hidden(true, 2, 5), shown(1), Frame::Again(5), Frame::Again(1), shown(3)];
        assert_eq!(gaps(&frames), NONE);
    }

    #[test]
    fn hints_that_do_not_count_pictures_are_not_followed() {
        let doubled: Vec<Frame> = std::iter::once(key(0)).chain((1..20).map(|at| shown(2 * at))).collect();
        assert_eq!(gaps(&doubled), NONE);
        assert_eq!(gaps(&[key(0), shown(3), shown(4), shown(9)]), NONE);
        assert_eq!(gaps(&[key(5), shown(4), shown(5), shown(9)]), NONE);
        assert_eq!(gaps(&[shown(1), shown(2), shown(5)]), NONE);
        // The next key frame begins again.
        assert_eq!(gaps(&[key(0), shown(3), key(0), shown(1), shown(3)]), [4]);
    }
}
