//! The processes that share a training.

use clap::Args;

use crate::domain::job::JobKind;

/// The processes of a training.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Jobs")]
pub struct RanksConfig {
    /// Processes that share each batch of a pretrain job, 1 to 64: on this machine each with `--worker-threads`, on a cluster
    /// one on each of as many nodes. More of them shorten steps that take longer than exchanging the gradients; the
    /// result is reproducible for a fixed number. The exchange is not encrypted: use it on one machine or on a cluster's
    /// own network only.
    #[arg(long, env = "GLEANER_PRETRAIN_RANKS", default_value_t = 1, value_name = "N",
          value_parser = clap::value_parser!(u32).range(1..=64))]
    pub pretrain_ranks: u32,
    /// The same for train jobs.
    #[arg(long, env = "GLEANER_TRAIN_RANKS", default_value_t = 1, value_name = "N",
          value_parser = clap::value_parser!(u32).range(1..=64))]
    pub train_ranks: u32,
    /// End an attempt with several processes when one of them has not joined, or not delivered its gradients, for this
    /// many seconds, 1 to 3600. It must be longer than the largest difference between their reading of episodes, and than
    /// storing a checkpoint. A process that ends is noticed at once.
    #[arg(long, env = "GLEANER_RANK_TIMEOUT_SECONDS", default_value_t = 120, value_name = "SECONDS",
          value_parser = clap::value_parser!(u64).range(1..=3600))]
    pub rank_timeout_seconds: u64,
}

impl RanksConfig {
    /// The processes of an attempt of a kind of job.
    pub(crate) fn of(&self, kind: JobKind) -> u32 {
        match kind {
            JobKind::Pretrain => self.pretrain_ranks,
            JobKind::Train => self.train_ranks,
            JobKind::Score | JobKind::Export | JobKind::Evaluate => 1,
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Flags {
        #[command(flatten)]
        ranks: RanksConfig,
    }

    #[test]
    fn trainings_alone_have_ranks_and_one_by_default() {
        let flags = |flags: &[&str]| Flags::try_parse_from([&["serve"], flags].concat()).map(|flags| flags.ranks);
        assert!(JobKind::ALL.iter().all(|&kind| flags(&[]).unwrap().of(kind) == 1));
        let config = flags(&["--pretrain-ranks", "2", "--train-ranks", "3"]).unwrap();
        assert_eq!(JobKind::ALL.iter().map(|&kind| config.of(kind)).sum::<u32>(), 2 + 3 + 3);
        for wrong in [["--pretrain-ranks", "0"], ["--train-ranks", "65"], ["--rank-timeout-seconds", "0"]] {
            assert!(flags(&wrong).is_err(), "{wrong:?}");
        }
    }
}
