//! The commands: each file holds a family, its arguments beside what it does with them.

pub(crate) mod dataset;
pub(crate) mod drive;
pub(crate) mod episodes;
pub(crate) mod evaluate;
pub(crate) mod evaluations;
pub(crate) mod export;
pub(crate) mod follow;
pub(crate) mod jobs;
pub(crate) mod kinds;
pub(crate) mod label;
pub(crate) mod pipeline;
mod plan;
pub(crate) mod policies;
pub(crate) mod push;
pub(crate) mod record;
pub(crate) mod schedule;
pub(crate) mod score_recording;
pub(crate) mod scores;
pub(crate) mod snapshot;
pub(crate) mod submit;
pub(crate) mod task;
pub(crate) mod trash;
pub(crate) mod what_if;

use crate::cli::Command;
use crate::context::Context;
use crate::failure::Result;

pub(crate) async fn run(command: Command, context: &Context) -> Result<()> {
    match command {
        Command::Task(command) => command.run(context).await,
        Command::Push(args) => args.run(context).await,
        Command::Episodes(args) => args.run(context).await,
        Command::Episode(args) => args.run(context).await,
        Command::Download(args) => args.run(context).await,
        Command::Label(args) => args.run(context).await,
        Command::Labels(args) => args.run(context).await,
        Command::Delete(args) => args.run(context).await,
        Command::Restore(args) => args.run(context).await,
        Command::Snapshot(command) => command.run(context).await,
        Command::Pretrain(command) => command.run(context).await,
        Command::Score(command) => command.run(context).await,
        Command::Train(command) => command.run(context).await,
        Command::Evaluate(command) => command.run(context).await,
        Command::Evaluations(args) => args.run(context).await,
        Command::Evaluation(args) => args.run(context).await,
        Command::ReportEvaluation(args) => args.run(context).await,
        Command::Pipeline(command) => command.run(context).await,
        Command::Kinds(args) => args.run(context).await,
        Command::Jobs(args) => args.run(context).await,
        Command::Job(args) => args.run(context).await,
        Command::Watch(args) => args.run(context).await,
        Command::Cancel(args) => args.run(context).await,
        Command::Runs(args) => args.run(context).await,
        Command::Scores(args) => args.run(context).await,
        Command::ScoreRecording(args) => args.run(context).await,
        Command::Histogram(args) => args.run(context).await,
        Command::WhatIf(args) => args.run(context).await,
        Command::Dataset(command) => command.run(context).await,
        Command::Export(args) => args.run(context).await,
        Command::Policies(args) => args.run(context).await,
        Command::Deploy(args) => args.run(context).await,
        Command::Rollback(args) => args.run(context).await,
        Command::Deployments(args) => args.run(context).await,
        Command::Drive(args) => args.run(context).await,
        Command::Schedule(command) => command.run(context).await,
        Command::Record(args) => args.run(context).await,
        Command::Demo(args) => args.run(context).await,
        Command::Experiment(args) => args.run(context).await,
    }
}
