//! Sequences: running episodes of clients that send single requests, each with the name of its sequence.

/// The client's name of a sequence. A number and a text with the same digits are different names.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum SequenceId {
    /// Never 0, which means none on the wire.
    Number(u64),
    /// Never empty.
    Text(String),
}

impl SequenceId {
    /// The seed of what a policy draws in the sequence, so that sequences draw other actions than each other, and one that
    /// is repeated under its name the same.
    #[must_use]
    pub fn seed(&self) -> u64 {
        match self {
            Self::Number(number) => *number,
            Self::Text(text) => {
                let hash = blake3::hash(text.as_bytes());
                hash.as_bytes().first_chunk().map_or(0, |first| u64::from_le_bytes(*first))
            }
        }
    }
}

impl std::fmt::Display for SequenceId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Number(number) => write!(f, "{number}"),
            Self::Text(text) => write!(f, "{text:?}"),
        }
    }
}

/// The sequence of a request, and the position in it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    /// The sequence.
    pub id: SequenceId,
    /// Whether the sequence starts with this request, without a history.
    pub start: bool,
    /// Whether the sequence ends after this request.
    pub end: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sequences_have_seeds_of_their_own() {
        let text = |text: &str| SequenceId::Text(text.into()).seed();
        assert_eq!(SequenceId::Number(7).seed(), 7);
        assert_eq!(text("arm 1"), text("arm 1"));
        assert_ne!(text("arm 1"), text("arm 2"));
    }
}
