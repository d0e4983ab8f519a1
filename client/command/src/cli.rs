//! Definition of the command line: global options and the list of commands. Arguments and work of each are in its file.

use clap::{Parser, Subcommand};

use crate::cmd::{
    dataset, drive, episodes, evaluate, evaluations, export, histogram, import_scores, inspect, jobs, kinds, label,
    metrics, open, pipeline, policies, push, record, register_policy, schedule, score_recording, scores, snapshot,
    submit, task, trash, what_if,
};
use crate::connection::{ConnectionArgs, GLOBAL};
use crate::context::Context;
use crate::experiment;
use crate::experiment::{compare, demo};
use crate::failure::Result;

/// Finds the good steps in failed robot demonstrations: a client of gleaner-server.
#[derive(Debug, Parser)]
#[command(name = "gleaner", version, propagate_version = true, max_term_width = 100)]
pub(crate) struct Cli {
    #[command(flatten)]
    pub(crate) connection: ConnectionArgs,

    /// Print JSON instead of text: one document, or for streams one per line.
    #[arg(long, global = true, help_heading = GLOBAL)]
    pub(crate) json: bool,

    #[command(subcommand)]
    pub(crate) command: Command,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Show what recordings hold: topics, rates, fields with their ranges, cameras. Needs no server.
    Inspect(inspect::InspectArgs),
    /// Draft, check, create, list and show tasks.
    #[command(subcommand, after_long_help = task::KEYS)]
    Task(task::TaskCommand),
    /// Upload recordings with their labels.
    Push(push::PushArgs),
    /// List a task's episodes.
    Episodes(episodes::EpisodesArgs),
    /// Show one episode and the findings of its inspection.
    Episode(episodes::EpisodeArgs),
    /// Download an episode's recording.
    Download(episodes::DownloadArgs),
    /// Set the outcome and cohort of episodes.
    Label(label::LabelArgs),
    /// Show the history of an episode's labels.
    Labels(label::LabelsArgs),
    /// Move episodes to the trash; the server removes them after `--trash-days`.
    Delete(trash::DeleteArgs),
    /// Restore episodes from the trash.
    Restore(trash::RestoreArgs),
    /// Create, list and show snapshots of a task's episodes.
    #[command(subcommand)]
    Snapshot(snapshot::SnapshotCommand),
    /// Pretrain an encoder on experts and imperfect episodes, for policies and scorers that read one.
    Pretrain(submit::PretrainCommand),
    /// Score every imperfect segment. The encoder that it names is not read by the default scorer.
    Score(submit::ScoreCommand),
    /// Train a policy on a dataset, or on experts alone.
    Train(submit::TrainCommand),
    /// Evaluate a policy in the simulator, as a job of the server.
    Evaluate(evaluate::EvaluateCommand),
    /// List a policy's evaluations.
    Evaluations(evaluations::EvaluationsArgs),
    /// Show one evaluation, seed by seed.
    Evaluation(evaluations::EvaluationArgs),
    /// Store the result of an evaluation that ran elsewhere.
    ReportEvaluation(evaluations::ReportArgs),
    /// Submit a chain of jobs: pretrain, score, filter, train, evaluate.
    Pipeline(pipeline::PipelineCommand),
    /// List policies, weightings, objectives and scorers, and the settings of each job.
    Kinds(kinds::KindsArgs),
    /// List jobs, or export them as JSON lines.
    Jobs(jobs::JobsArgs),
    /// Show one job.
    Job(jobs::JobArgs),
    /// Show the curves of a job, or write them for TensorBoard.
    Metrics(metrics::MetricsArgs),
    /// Follow a job until it ends.
    Watch(jobs::WatchArgs),
    /// Cancel a job and the jobs that depend on it.
    Cancel(jobs::CancelArgs),
    /// List a task's finished score runs.
    Runs(scores::RunsArgs),
    /// Chart the quality of one episode, step by step.
    Scores(scores::ScoresArgs),
    /// Score a recording without storing it.
    ScoreRecording(score_recording::ScoreRecordingArgs),
    /// Compare scorers on one snapshot: agreement, AUROC, length, stability, and policies trained on their best parts.
    CompareScorers(compare::CompareArgs),
    /// Store scores made elsewhere as a score run.
    ImportScores(import_scores::ImportScoresArgs),
    /// Show the distribution of quality and the number of segments above each threshold.
    Histogram(histogram::HistogramArgs),
    /// Count the segments of possible datasets, per cohort and episode, without creating any.
    WhatIf(what_if::WhatIfArgs),
    /// Create, list, show and stream datasets.
    #[command(subcommand)]
    Dataset(dataset::DatasetCommand),
    /// Write the kept segments of a dataset as files, or one episode with its scores.
    Export(export::ExportArgs),
    /// Open one episode with its scores in Rerun or Foxglove.
    Open(open::OpenArgs),
    /// List a task's policies.
    Policies(policies::PoliciesArgs),
    /// Register a policy that another server runs, such as a PyTorch model behind Triton or openpi's server.
    RegisterPolicy(register_policy::RegisterPolicyArgs),
    /// Assign a policy to a deployment.
    Deploy(policies::DeployArgs),
    /// Return a deployment to its previous policy.
    Rollback(policies::RollbackArgs),
    /// List deployments and their history.
    Deployments(policies::DeploymentsArgs),
    /// Evaluate a deployment in the simulator, over the endpoint that robots use.
    Drive(drive::DriveArgs),
    /// Run pipelines by time or after new labels.
    #[command(subcommand)]
    Schedule(schedule::ScheduleCommand),
    /// Record demonstrations in the simulator.
    Record(record::RecordArgs),
    /// Run every stage once on a temporary server: record, push, pretrain, score, train, evaluate.
    Demo(demo::DemoArgs),
    /// Run a grid of settings from a file and write a report; a second run resumes the first.
    Experiment(experiment::ExperimentArgs),
}

impl Command {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        match self {
            Self::Inspect(args) => args.run(context).await,
            Self::Task(command) => command.run(context).await,
            Self::Push(args) => args.run(context).await,
            Self::Episodes(args) => args.run(context).await,
            Self::Episode(args) => args.run(context).await,
            Self::Download(args) => args.run(context).await,
            Self::Label(args) => args.run(context).await,
            Self::Labels(args) => args.run(context).await,
            Self::Delete(args) => args.run(context).await,
            Self::Restore(args) => args.run(context).await,
            Self::Snapshot(command) => command.run(context).await,
            Self::Pretrain(command) => command.run(context).await,
            Self::Score(command) => command.run(context).await,
            Self::Train(command) => command.run(context).await,
            Self::Evaluate(command) => command.run(context).await,
            Self::Evaluations(args) => args.run(context).await,
            Self::Evaluation(args) => args.run(context).await,
            Self::ReportEvaluation(args) => args.run(context).await,
            Self::Pipeline(command) => command.run(context).await,
            Self::Kinds(args) => args.run(context).await,
            Self::Jobs(args) => args.run(context).await,
            Self::Job(args) => args.run(context).await,
            Self::Metrics(args) => args.run(context).await,
            Self::Watch(args) => args.run(context).await,
            Self::Cancel(args) => args.run(context).await,
            Self::Runs(args) => args.run(context).await,
            Self::Scores(args) => args.run(context).await,
            Self::ScoreRecording(args) => args.run(context).await,
            Self::CompareScorers(args) => args.run(context).await,
            Self::ImportScores(args) => args.run(context).await,
            Self::Histogram(args) => args.run(context).await,
            Self::WhatIf(args) => args.run(context).await,
            Self::Dataset(command) => command.run(context).await,
            Self::Export(args) => args.run(context).await,
            Self::Open(args) => args.run(context).await,
            Self::Policies(args) => args.run(context).await,
            Self::RegisterPolicy(args) => args.run(context).await,
            Self::Deploy(args) => args.run(context).await,
            Self::Rollback(args) => args.run(context).await,
            Self::Deployments(args) => args.run(context).await,
            Self::Drive(args) => args.run(context).await,
            Self::Schedule(command) => command.run(context).await,
            Self::Record(args) => args.run(context).await,
            Self::Demo(args) => args.run(context).await,
            Self::Experiment(args) => args.run(context).await,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory as _;

    #[test]
    fn definition_is_valid() {
        Cli::command().debug_assert();
    }

    #[test]
    fn debug_hides_tokens() {
        let cli = Cli::try_parse_from(["gleaner", "--token", "secret123", "jobs"]).unwrap();
        assert!(!format!("{cli:?}").contains("secret123"));
    }

    #[test]
    fn valid_combinations_of_options_parse() {
        for line in [
            "gleaner train --dataset ds_1 --task t --policy act --chunk-length 4 --preset small --key mine",
            "gleaner score --extends run_1 --device cuda",
            "gleaner evaluate --policy pol_1 --task t --episodes 5 --trial-seeds 0,1",
            "gleaner what-if run_1 --top 0.1,0.2 --episodes",
            "gleaner report-evaluation pol_1 --simulation x --result 0:10:4 --result 1:10:5:30.5",
            "gleaner pretrain --objective mtp,aa --max-experts 5 --contrast 0.2",
            "gleaner experiment a.toml --out x --device cuda --plan",
            "gleaner experiment a.toml --report",
            "gleaner schedule create --name n --after-labels 50 --top 0.1 --until dataset",
            "gleaner score --encoder enc_1 --feature-scale plain --local-scale false",
            "gleaner rollback pick_cube@prod",
            "gleaner score",
            "gleaner train --policy bc",
            "gleaner dataset create --top 0.1",
            "gleaner register-policy --protocol openpi --address ws://gpu:8000 --input prompt=text:pick --chunk-length 10",
            "gleaner register-policy --protocol open-inference --address http://gpu:8001 --model arm --sequences",
            "gleaner deploy a@b --policy pol_1 --score-run run_1",
            "gleaner score-recording run_1 a.mcap --matches --beta 0.5",
            "gleaner import-scores snap_1 scores.csv --source oracle --encoder enc_1",
            "gleaner drive a@b --real-time --deadline-ms 40 --hold-ms 0",
            "gleaner drive a@b --episodes 5 --report",
            "gleaner pretrain --max-experts 20 --imperfect-per-expert 3 --rule-seed 1",
            "gleaner task create --sim pick_cube --image 64",
            "gleaner delete ep_1 ep_2 --force",
            "gleaner restore ep_1",
            "gleaner jobs export --task t",
            "gleaner metrics latest --tensorboard runs",
            "gleaner episodes --deleted",
            "gleaner export ds_1 --format lerobot --depth --out a",
            "gleaner export ds_1 --format lerobot --video --out a",
            "gleaner export --episode ep_1 --out a.mcap",
            "gleaner export --episode ep_1 --scores run_1 --beta 0.5 --out a.mcap",
            "gleaner open ep_1 --in rerun",
            "gleaner open latest --in foxglove --scores latest --beta 0.5 --out a.mcap",
            "gleaner compare-scorers snap_1 --seeds 2",
            "gleaner compare-scorers enc_1 enc_2 --scorer ssdf --scorer deminf --train bc --evaluations 5",
        ] {
            assert!(Cli::try_parse_from(line.split(' ')).is_ok(), "{line}");
        }
    }

    #[test]
    fn invalid_arguments_are_rejected() {
        for line in [
            "gleaner",
            "gleaner push",
            "gleaner train --dataset ds_1 --experts-of enc_1",
            "gleaner schedule create --task t --name n",
            "gleaner schedule create --task t --name n --after-labels 5 --cron x",
            "gleaner label ep_1",
            "gleaner label --outcome success",
            "gleaner push a.mcap --outcome great",
            "gleaner pipeline --until never",
            "gleaner train --dataset ds_1 --experts-in snap_1",
            "gleaner train --dataset ds_1 --policy gpt",
            "gleaner score --extends run_1 --similarity last_l2",
            "gleaner score --extends run_1 --lookahead 0.5",
            "gleaner evaluate --task t",
            "gleaner evaluate --policy pol_1 --deployment a@b",
            "gleaner dataset create --run run_1 --beta 0.5 --top 0.1",
            "gleaner report-evaluation pol_1 --simulation x",
            "gleaner experiment",
            "gleaner experiment a.toml --report --plan",
            "gleaner pipeline --beta 0.5 --top 0.1",
            "gleaner rollback",
            "gleaner register-policy --protocol http --address http://gpu:8001",
            "gleaner register-policy --protocol openpi --address ws://gpu:8000 --input x=y",
            "gleaner register-policy --protocol openpi --address ws://gpu:8000 --chunk-length 0",
            "gleaner delete",
            "gleaner restore",
            "gleaner score-recording run_1",
            "gleaner import-scores snap_1",
            "gleaner task create",
            "gleaner task create a.toml --sim pick_cube",
            "gleaner task create a.toml --image 64",
            "gleaner drive a@b --deadline-ms 40",
            "gleaner drive a@b --hold-ms 40",
            "gleaner drive a@b --real-time --deadline-ms 0",
            "gleaner drive a@b --real-time --rate 20",
            "gleaner export --out a",
            "gleaner export ds_1 --scores run_1 --out a",
            "gleaner export ds_1 --episode ep_1 --scores run_1 --out a",
            "gleaner export ds_1 --beta 0.5 --out a",
            "gleaner export ds_1 --format zarr --out a",
            "gleaner export --episode ep_1 --scores run_1 --engine-options=--mem=1G --out a",
            "gleaner export --episode ep_1 --scores run_1 --beta 7 --out a",
            "gleaner open ep_1 --in rerun --beta nan",
            "gleaner scores run_1 ep_1 --beta 3",
            "gleaner score-recording run_1 a.mcap --beta=-1",
            "gleaner open ep_1",
            "gleaner open ep_1 --in vlc",
            "gleaner compare-scorers",
            "gleaner compare-scorers enc_1 --evaluations 5",
            "gleaner compare-scorers enc_1 --seeds 0",
            "gleaner compare-scorers enc_1 --train bc --evaluations 0",
        ] {
            let refused = Cli::try_parse_from(line.split(' ')).unwrap_err();
            assert_eq!(refused.exit_code(), 2, "{line}");
        }
    }
}
