//! Errors of calls, in sentences that name the server and what to do.

use gleaner_core::{Error, printable};

/// The most characters of another server's text that are repeated.
const SHOWN: usize = 300;

/// A server, for errors.
#[derive(Debug, Clone)]
pub(crate) struct At(pub(crate) String);

impl At {
    /// The server does not answer: a later call may succeed.
    pub(crate) fn silent(&self, problem: impl std::fmt::Display) -> Error {
        Error::unavailable(format!(
            "the policy's server {} does not answer: {problem}; start it, or deploy another policy",
            self.0
        ))
    }

    /// The server answers with what cannot be used: a later call would not succeed.
    pub(crate) fn wrong(&self, problem: impl std::fmt::Display) -> Error {
        Error::precondition(format!(
            "the policy's server {}: {problem}; fix that server, or register the policy again with what it has",
            self.0
        ))
    }
}

/// A text of another server within an error: short, with unprintable characters escaped.
pub(crate) fn shown(text: &str) -> String {
    let short: String = text.trim().chars().take(SHOWN).collect();
    printable::field(&short).into_owned()
}

/// The cause at the bottom of an error's chain: a transport's own message is "transport error".
pub(crate) fn cause(error: &(dyn std::error::Error + 'static)) -> String {
    let mut cause = error;
    while let Some(next) = cause.source() {
        cause = next;
    }
    let cause = shown(&cause.to_string());
    if cause.contains("UnknownIssuer") {
        return format!("{cause}: name the authority that signed its certificate with --policy-server-ca");
    }
    cause
}
