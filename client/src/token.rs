//! The bearer token: a secret that no log, error or debug print can show.

use std::fmt;
use std::str::FromStr;

use tonic::metadata::{Ascii, MetadataValue};

/// What a token follows in its header.
const SCHEME: &str = "Bearer ";

/// An access token. `Debug` hides it and there is no `Display`.
#[derive(Clone)]
pub struct Token(MetadataValue<Ascii>);

impl Token {
    // The `authorization` header; marked sensitive, so that HTTP/2 does not index it.
    pub(crate) fn header(&self) -> MetadataValue<Ascii> {
        self.0.clone()
    }

    /// The word itself, for the environment of a process that connects as this one.
    #[must_use]
    pub fn word(&self) -> &str {
        self.0.to_str().ok().and_then(|header| header.strip_prefix(SCHEME)).unwrap_or_default()
    }
}

impl FromStr for Token {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let text = text.trim();
        if text.is_empty() || !text.chars().all(|c| c.is_ascii_graphic()) {
            return Err("a token is one word of visible ASCII characters; copy it again".into());
        }
        let mut header: MetadataValue<Ascii> =
            format!("{SCHEME}{text}").parse().map_err(|_| "not a token; copy it again".to_owned())?;
        header.set_sensitive(true);
        Ok(Self(header))
    }
}

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(hidden)")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_is_hidden_in_debug_output() {
        let token: Token = "secret123".parse().unwrap();
        assert!(!format!("{token:?}").contains("secret123"));
        assert!(!format!("{:?}", token.header()).contains("secret123"));
        assert_eq!(token.header().to_str().unwrap(), "Bearer secret123");
    }

    #[test]
    fn blank_and_broken_tokens_are_refused_without_repeating_them() {
        for text in ["", "  ", "two words", "näh"] {
            let problem = text.parse::<Token>().unwrap_err();
            assert!(text.trim().is_empty() || !problem.contains(text));
        }
    }
}
