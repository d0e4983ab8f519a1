//! Sequences: running episodes of clients that send single requests, each with the name of its sequence.

/// The client's name of a sequence. A number and a text with the same digits are different names.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum SequenceId {
    /// Never 0, which means none on the wire.
    Number(u64),
    /// Never empty.
    Text(String),
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
