//! The limit on the values of one message.
//!
//! A few bytes can stand for many values, because missing fields have defaults and messages are nested. The values are
//! counted before they are created, so that the cost of a message is bounded.

/// Most values of one message, arrays of plain numbers and bytes aside.
const MOST_VALUES: usize = 1 << 21;

/// The number of values that a message may still create.
pub(super) struct Budget(usize);

impl Budget {
    pub(super) fn new() -> Self {
        Self(MOST_VALUES)
    }

    /// Subtracts this number of values.
    pub(super) fn take(&mut self, values: usize) -> Result<(), String> {
        self.0 = self
            .0
            .checked_sub(values)
            .ok_or_else(|| format!("it has more than {MOST_VALUES} fields; record it as arrays of numbers or bytes"))?;
        Ok(())
    }
}
