//! Who somebody is: by the token they show, or anybody where none is asked for. Calls and pages ask here.

use std::sync::Arc;

use super::{
    book::{Book, Held},
    caller::Caller,
};
use crate::error::{Error, Result};

/// Says who somebody is; clones share the book.
#[derive(Debug, Clone)]
pub(super) struct Reception {
    book: Book,
    /// Whether who shows no token is sent away.
    required: bool,
}

impl Reception {
    pub(super) fn new(book: Book, required: bool) -> Self {
        Self { book, required }
    }

    /// The token with this hash, if the book has it already: nothing is asked of the disk.
    pub(super) fn known(&self, hash: &str) -> Option<Arc<Held>> {
        self.book.known(hash)
    }

    /// Who it is that shows the token with the hash `shown`, which may be known already.
    ///
    /// # Errors
    /// Unauthenticated when a token is shown that is none of ours, or none where one is asked for.
    pub(super) async fn authenticate(&self, shown: Option<&str>, known: Option<Arc<Held>>) -> Result<Caller> {
        let Some(hash) = shown else {
            return if self.required { Err(no_token()) } else { Ok(Caller::Anyone) };
        };
        let held = match known {
            Some(held) => held,
            None => self.book.find(hash).await?.ok_or_else(unknown_token)?,
        };
        self.book.used(&held);
        Ok(Caller::Known(held))
    }
}

fn no_token() -> Error {
    Error::unauthenticated(
        "this server asks for a token: give one with --token or GLEANER_TOKEN; who runs the server makes one with \
         `gleaner-server token create`",
    )
}

/// What a caller hears whose token is none, or none any more. Which of the two it is, is not said.
pub(super) fn unknown_token() -> Error {
    Error::unauthenticated(
        "this token is not known, has expired or was revoked; who runs the server makes one with \
         `gleaner-server token create`",
    )
}
