//! Refusals by role that the audit log hears of: a flood of them must not fill it.

use std::num::NonZeroU32;

use governor::{DefaultKeyedRateLimiter, Quota, RateLimiter};

use super::caller::Caller;
use crate::domain::id::TokenId;

/// So many of one token at once, and then one a second.
const AT_ONCE: u32 = 10;

/// Counts refusals by the token's id.
pub(super) struct Refusals(DefaultKeyedRateLimiter<TokenId>);

impl Refusals {
    pub(super) fn new() -> Self {
        let one = NonZeroU32::MIN;
        Self(RateLimiter::keyed(Quota::per_second(one).allow_burst(NonZeroU32::new(AT_ONCE).unwrap_or(one))))
    }

    /// Whether the audit log hears of one more.
    pub(super) fn tell_of(&self, caller: &Caller) -> bool {
        match caller {
            Caller::Known(held) => self.audits(&held.token.id),
            Caller::Anyone => true,
        }
    }

    /// Whether the audit log records one more of this token.
    pub(super) fn audits(&self, token: &TokenId) -> bool {
        self.0.check_key(token).is_ok()
    }
}
