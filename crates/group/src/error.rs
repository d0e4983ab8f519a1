//! The failures of a group in words: libtorch's messages name files of its own source and no rank.

use std::time::Duration;

/// Reason why a group cannot work.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum GroupError {
    /// The place is outside the group.
    #[error("rank {rank} of {ranks}: a group of {ranks} has the ranks from 0 to one less than their number")]
    Place {
        /// The rank.
        rank: u32,
        /// The number of ranks.
        ranks: u32,
    },
    /// The meeting cannot be opened or found.
    #[error("the ranks cannot meet: {message}")]
    Meeting {
        /// The reason.
        message: String,
    },
    /// Not all ranks joined.
    #[error(
        "rank {rank} of {ranks}: not every rank joined within {seconds} s: {message}; see the logs of the others, and whether \
         the machines reach each other at every port"
    )]
    Join {
        /// This rank.
        rank: u32,
        /// The number of ranks.
        ranks: u32,
        /// The timeout in seconds.
        seconds: u64,
        /// libtorch's reason.
        message: String,
    },
    /// Another rank has ended, or its connection is lost.
    #[error("rank {rank} of {ranks}: another rank has ended: {message}")]
    Gone {
        /// This rank.
        rank: u32,
        /// The number of ranks.
        ranks: u32,
        /// libtorch's reason.
        message: String,
    },
    /// Another rank did not answer within the timeout.
    #[error("rank {rank} of {ranks}: another rank did not answer within {seconds} s")]
    Silent {
        /// This rank.
        rank: u32,
        /// The number of ranks.
        ranks: u32,
        /// The timeout in seconds.
        seconds: u64,
    },
}

impl GroupError {
    pub(crate) fn of_join(rank: u32, ranks: u32, timeout: Duration, message: &str) -> Self {
        Self::Join { rank, ranks, seconds: timeout.as_secs(), message: plain(message) }
    }

    pub(crate) fn of_operation(rank: u32, ranks: u32, timeout: Duration, message: &str) -> Self {
        let lower = message.to_lowercase();
        if lower.contains("timed out") || lower.contains("timeout") {
            Self::Silent { rank, ranks, seconds: timeout.as_secs() }
        } else {
            Self::Gone { rank, ranks, message: plain(message) }
        }
    }
}

/// A message without the place in libtorch's source before it.
fn plain(message: &str) -> String {
    let rest = message.strip_prefix('[').and_then(|rest| rest.split_once("] ")).map(|(_, rest)| rest);
    rest.unwrap_or(message).trim().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_are_of_ranks_and_not_of_source_files() {
        let of = |message: &str| GroupError::of_operation(1, 3, Duration::from_secs(5), message).to_string();
        let closed =
            "[/pytorch/third_party/gloo/gloo/transport/tcp/pair.cc:547] Connection closed by peer [127.0.0.1]:4";
        assert_eq!(of(closed), "rank 1 of 3: another rank has ended: Connection closed by peer [127.0.0.1]:4");
        let late = "[/x/unbound_buffer.cc:81] Timed out waiting 5000ms for recv operation to complete";
        assert_eq!(of(late), "rank 1 of 3: another rank did not answer within 5 s");
        let join = GroupError::of_join(0, 2, Duration::from_secs(5), "wait timeout after 5000ms, keys: /default/1");
        assert!(join.to_string().starts_with("rank 0 of 2: not every rank joined within 5 s: wait timeout"), "{join}");
    }
}
