//! How many values one message may become.
//!
//! A few bytes can stand for many values: fields that are left out have defaults, and messages lie in messages. What
//! a message costs must follow its size, so the values are counted before they are made.

/// Most values of one message, arrays of plain numbers and bytes aside.
const MOST_VALUES: usize = 1 << 21;

/// What is left for one message.
pub(super) struct Budget(usize);

impl Budget {
    pub(super) fn new() -> Self {
        Self(MOST_VALUES)
    }

    /// Takes so many values.
    pub(super) fn take(&mut self, values: usize) -> Result<(), String> {
        self.0 = self
            .0
            .checked_sub(values)
            .ok_or_else(|| format!("it has more than {MOST_VALUES} fields; record it as arrays of numbers or bytes"))?;
        Ok(())
    }
}
