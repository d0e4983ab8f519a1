//! Damaged copies of a recording, each made from a seed: for tests, the fuzzer and the differential suite.
//!
//! Most mutants keep the container readable and break one of its rules. Test builds only; releases do not contain it.

mod kinds;
mod parts;

pub use kinds::KINDS;
#[cfg(test)]
pub(crate) use parts::{Part, inner, join, rebuilt, split};

/// Repeatable pseudo-random numbers (SplitMix64).
#[derive(Clone, Debug)]
pub struct Random(u64);

impl Random {
    /// Begins at a seed.
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// The next number.
    pub fn number(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    /// A number below `end`, which counts as 1 when it is 0.
    pub fn below(&mut self, end: usize) -> usize {
        usize::try_from(self.number() % (end.max(1) as u64)).unwrap_or_default()
    }

    /// Any byte.
    pub fn byte(&mut self) -> u8 {
        self.number().to_le_bytes()[0]
    }
}

/// A mutant of these bytes by the kind of that name; `None` if the kind does not apply to them or is not known.
pub fn mutant(bytes: &[u8], kind: &str, random: &mut Random) -> Option<Vec<u8>> {
    let (_, make) = KINDS.iter().find(|(name, _)| *name == kind)?;
    make(bytes, random)
}
