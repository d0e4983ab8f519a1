//! The processes that share a training, a score run or an evaluation.

use clap::Args;

use crate::domain::job::JobSpec;

/// The processes of one job.
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
    /// Processes that each score a part of the episodes of a score job, 1 to 64, placed as those of a pretrain job. More of
    /// them shorten long score runs, and the scores are the same bytes for any number. Every process holds the features of
    /// all experts in memory. Jobs whose scorer judges all episodes together run in one process. The exchange is not
    /// encrypted.
    #[arg(long, env = "GLEANER_SCORE_RANKS", default_value_t = 1, value_name = "N",
          value_parser = clap::value_parser!(u32).range(1..=64))]
    pub score_ranks: u32,
    /// Processes that each run a part of the attempts of an evaluate job, 1 to 64, placed as those of a pretrain job. More of
    /// them shorten evaluations of many attempts, and the results are the same for any number. Attempts are divided in
    /// blocks of up to 64 of one seed; a job has no more processes than blocks.
    #[arg(long, env = "GLEANER_EVALUATE_RANKS", default_value_t = 1, value_name = "N",
          value_parser = clap::value_parser!(u32).range(1..=64))]
    pub evaluate_ranks: u32,
    /// End an attempt with several processes when one of them has not joined, or not delivered its gradients or progress,
    /// for this many seconds, 1 to 3600. It must be longer than the largest difference between their reading of episodes,
    /// and than scoring the longest episode. A process that ends is noticed at once.
    #[arg(long, env = "GLEANER_RANK_TIMEOUT_SECONDS", default_value_t = 120, value_name = "SECONDS",
          value_parser = clap::value_parser!(u64).range(1..=3600))]
    pub rank_timeout_seconds: u64,
}

impl RanksConfig {
    /// The processes of an attempt of a job.
    pub(crate) fn of(&self, spec: &JobSpec) -> u32 {
        match spec {
            JobSpec::Pretrain { .. } => self.pretrain_ranks,
            JobSpec::Train { .. } => self.train_ranks,
            JobSpec::Score { spec, .. } if spec.needs_all_episodes() => 1,
            JobSpec::Score { .. } => self.score_ranks,
            JobSpec::Evaluate { spec, .. } => {
                self.evaluate_ranks.min(u32::try_from(spec.blocks().len()).unwrap_or(u32::MAX))
            }
            JobSpec::Export { .. } => 1,
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::domain::id::{EncoderId, PolicyId, SnapshotId};

    #[derive(Parser)]
    struct Flags {
        #[command(flatten)]
        ranks: RanksConfig,
    }

    fn score(scorer: &str) -> JobSpec {
        let values = [("scorer".to_owned(), scorer.into())].into_iter().collect();
        let spec = gleaner_core::ScoreSpec::from_values(&values).unwrap();
        JobSpec::Score { encoder_id: EncoderId::new(), snapshot_id: SnapshotId::new(), extends: None, spec }
    }

    #[test]
    fn jobs_have_the_ranks_of_their_kind_and_one_by_default() {
        let flags = |flags: &[&str]| Flags::try_parse_from([&["serve"], flags].concat()).map(|flags| flags.ranks);
        let spec = gleaner_core::PretrainSpec::default();
        let evaluate = |episodes| JobSpec::Evaluate {
            policy_id: PolicyId::new(),
            spec: gleaner_core::EvaluateSpec { episodes, ..gleaner_core::EvaluateSpec::default() },
        };
        let pretrain = JobSpec::Pretrain { snapshot_id: SnapshotId::new(), spec };
        let jobs = [pretrain, score("raw"), score("vote"), evaluate(1000), evaluate(100)];
        let ranks = |config: &RanksConfig| jobs.each_ref().map(|job| config.of(job));
        assert_eq!(ranks(&flags(&[]).unwrap()), [1; 5]);
        let several = ["--pretrain-ranks", "2", "--train-ranks", "3", "--score-ranks", "4", "--evaluate-ranks", "5"];
        let several = ranks(&flags(&several).unwrap());
        assert_eq!(several[..3], [2, 4, 1], "every score of vote depends on all episodes");
        assert_eq!(several[3..], [5, 2], "100 attempts are two blocks");
        for wrong in [
            ["--pretrain-ranks", "0"],
            ["--train-ranks", "65"],
            ["--score-ranks", "0"],
            ["--evaluate-ranks", "65"],
            ["--rank-timeout-seconds", "0"],
        ] {
            assert!(flags(&wrong).is_err(), "{wrong:?}");
        }
    }
}
