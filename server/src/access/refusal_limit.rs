//! Limits how many refusals by role the audit log records, so that a flood of them does not fill the disk.

use std::num::NonZeroU32;

use governor::{DefaultKeyedRateLimiter, Quota, RateLimiter};

use super::caller::Caller;
use crate::domain::id::TokenId;

/// Refusals of one token that are recorded in a burst; after that, one per second.
const BURST: u32 = 10;

/// Counts refusals by the token's id.
pub(super) struct RefusalLimit(DefaultKeyedRateLimiter<TokenId>);

impl RefusalLimit {
    pub(super) fn new() -> Self {
        let one = NonZeroU32::MIN;
        Self(RateLimiter::keyed(Quota::per_second(one).allow_burst(NonZeroU32::new(BURST).unwrap_or(one))))
    }

    /// Counts a refusal; returns whether it is recorded.
    pub(super) fn records(&self, caller: &Caller) -> bool {
        match caller {
            Caller::Known(live) => self.records_token(&live.token.id),
            Caller::Anyone => true,
        }
    }

    /// Counts a refusal of a token; returns whether it is recorded.
    pub(super) fn records_token(&self, token: &TokenId) -> bool {
        self.0.check_key(token).is_ok()
    }
}
