//! What a message of a stream holds, from its headers alone.

/// The part that a message plays in its stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// No picture begins in it: parameter sets alone, or the rest of a picture.
    None,
    /// A picture that can be decoded without any before it.
    Key,
    /// A picture of H.265 that is shown before the key frame it follows and may depend on pictures before that (RASL).
    Leading,
    /// A picture that depends on those before it.
    Follows,
}

/// What a message holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Glance {
    /// The part of its first picture.
    pub part: Part,
    /// The pictures that are shown. A message should have one; of several, the last counts.
    pub pictures: usize,
    /// Whether it has parameter sets (H.264, H.265) or a sequence header (AV1), on which pictures depend.
    pub parameters: bool,
}
