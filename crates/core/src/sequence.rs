//! Sequences: running episodes of clients that ask one request at a time and name theirs in each.

/// What a client calls its sequence. A number and a text that looks like it are two.
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

/// Which sequence a request belongs to, and where in it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    /// The sequence.
    pub id: SequenceId,
    /// It begins here, with nothing remembered.
    pub start: bool,
    /// It is over after this request.
    pub end: bool,
}
