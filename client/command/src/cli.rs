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
    /// Delete deployments with their history.
    Undeploy(policies::UndeployArgs),
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
            Self::Undeploy(args) => args.run(context).await,
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
mod tests;
