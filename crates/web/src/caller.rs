//! The caller of a page. Must not know how tokens are stored.

use std::sync::Arc;

use gleaner_core::{Result, access::Token, id::TokenId};
use tokio_util::sync::CancellationToken;

use super::page::{Page, Rule};

/// The caller of a page.
#[derive(Debug, Clone)]
pub enum Caller {
    /// The holder of a token.
    Known {
        /// The token.
        token: Arc<Token>,
        /// Cancelled when the token expires or is revoked.
        ended: CancellationToken,
    },
    /// A caller without a token, where none is required.
    Anyone,
}

impl Caller {
    /// Checks that the caller may request a page.
    ///
    /// # Errors
    /// Forbidden, naming the required role.
    pub(super) fn permit(&self, page: Page) -> Result<()> {
        match (self, page.rule()) {
            (Self::Known { token, .. }, Rule::Reads(least) | Rule::Changes(least)) => token.permit(least),
            (Self::Known { .. }, Rule::Open) | (Self::Anyone, _) => Ok(()),
        }
    }

    /// The caller's name, for display.
    pub(super) fn name(&self) -> &str {
        match self {
            Self::Known { token, .. } => token.label(),
            Self::Anyone => "anyone",
        }
    }

    /// The id of the caller's token.
    pub fn token_id(&self) -> Option<&TokenId> {
        match self {
            Self::Known { token, .. } => Some(&token.id),
            Self::Anyone => None,
        }
    }
}
