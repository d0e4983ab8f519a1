//! The rules of every connection of a listener, whatever the client. Must not depend on the accept loop or the layer,
//! which both apply them.

use tokio_util::sync::CancellationToken;

use crate::{
    config::{CallRules, EdgeConfig},
    permits::Permits,
};

/// The smallest upper limit of a response's piece.
const PIECE: usize = 16 << 10;

/// The rules of one listener.
pub(crate) struct Rules {
    pub(crate) config: EdgeConfig,
    pub(crate) call_rules: CallRules,
    pub(crate) permits: Permits,
    /// Cancelled when every connection must end now.
    pub(crate) cut: CancellationToken,
}

impl Rules {
    /// The largest piece of a response: as much as its peer reads at the minimum rate within the write timeout.
    pub(crate) fn piece(&self) -> usize {
        let rate = u64::from(self.config.min_bytes_per_second);
        let bytes = rate.saturating_mul(self.config.write_timeout.as_secs());
        usize::try_from(bytes).unwrap_or(usize::MAX).max(PIECE)
    }
}
