//! `snapshot`: create, list, show.

use clap::{Args, Subcommand};
use gleaner_proto::v1::{CreateSnapshotRequest, GetSnapshotResponse, RoleRule, Snapshot, SnapshotEpisode};

use super::plan::RuleArgs;
use crate::context::Context;
use crate::failure::{Result, present};
use crate::table::Column::{Left, Right};
use crate::table::table;
use crate::{json, words};

#[derive(Debug, Subcommand)]
pub(crate) enum SnapshotCommand {
    /// Create a snapshot of the task's present episodes and labels.
    Create(CreateArgs),
    /// List a task's snapshots, newest first.
    List {
        /// Name or id of the task. Default: the only task of the server.
        #[arg(long)]
        task: Option<String>,
    },
    /// Show a snapshot's episodes and their roles.
    Show {
        /// Id of the snapshot.
        id: String,
    },
}

#[derive(Args, Debug)]
pub(crate) struct CreateArgs {
    /// Name or id of the task. Default: the only task of the server.
    #[arg(long)]
    task: Option<String>,
    #[command(flatten)]
    rule: RuleArgs,
}

impl SnapshotCommand {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        match self {
            Self::Create(args) => create(context, args).await,
            Self::List { task } => list(context, task).await,
            Self::Show { id } => show(context, id).await,
        }
    }
}

async fn create(context: &Context, args: CreateArgs) -> Result<()> {
    let client = context.client().await?;
    let task = context.task(&client, args.task.as_deref()).await?;
    let request = CreateSnapshotRequest { task: task.clone(), rule: Some(args.rule.rule()) };
    let reply = client.snapshots().create_snapshot(request).await?.into_inner();
    let snapshot = present(reply.snapshot.as_ref(), "a snapshot")?;
    context.output.result(|| json::value(&reply), || listing(std::slice::from_ref(snapshot)))?;
    context.output.next(format_args!("gleaner pretrain --task {task} --snapshot {} --wait", snapshot.id));
    Ok(())
}

async fn list(context: &Context, task: Option<String>) -> Result<()> {
    let client = context.client().await?;
    let reply = client.every_snapshot(&context.task(&client, task.as_deref()).await?).await?;
    context.output.result(|| json::value(&reply), || listing(&reply.snapshots))?;
    match reply.snapshots.first() {
        Some(snapshot) => context.output.next(format_args!("gleaner snapshot show {}", snapshot.id)),
        None => context.output.next("gleaner snapshot create"),
    }
    Ok(())
}

fn listing(snapshots: &[Snapshot]) -> String {
    let columns = [Left("ID"), Right("EXPERTS"), Right("IMPERFECT"), Left("RULE"), Left("CREATED")];
    let row = |snapshot: &Snapshot| {
        [
            snapshot.id.clone(),
            snapshot.expert_episodes.to_string(),
            snapshot.imperfect_episodes.to_string(),
            rule(snapshot.rule.as_ref()),
            words::moment(snapshot.create_time.as_ref()),
        ]
    };
    table(columns, snapshots.iter().map(row))
}

fn rule(rule: Option<&RoleRule>) -> String {
    let rule = rule.cloned().unwrap_or_default();
    let mut parts = Vec::new();
    if rule.expert_cohorts.is_empty() && rule.imperfect_cohorts.is_empty() {
        parts.push("by outcome".into());
    } else {
        let named = |cohorts: &[String], all: &str| if cohorts.is_empty() { all.to_owned() } else { cohorts.join(" ") };
        parts.push(format!("experts: {}", named(&rule.expert_cohorts, "every success")));
        parts.push(format!("imperfect: {}", named(&rule.imperfect_cohorts, "every failure")));
    }
    if rule.max_experts > 0 {
        parts.push(format!("at most {} experts", rule.max_experts));
    }
    if rule.imperfect_per_expert > 0.0 {
        parts.push(format!("at most {} imperfect each", rule.imperfect_per_expert));
    }
    parts.join("; ")
}

async fn show(context: &Context, id: String) -> Result<()> {
    let client = context.client().await?;
    let snapshot = client.snapshot(&id).await?;
    let reply = GetSnapshotResponse { episodes: client.snapshot_episodes(&id).await?, snapshot: Some(snapshot) };
    let columns = [Left("EPISODE"), Left("ROLE"), Left("OUTCOME"), Left("COHORT"), Right("STEPS")];
    let row = |episode: &SnapshotEpisode| {
        [
            episode.episode_id.clone(),
            words::role(episode.role()),
            words::outcome(episode.outcome()),
            episode.cohort.clone(),
            episode.steps.to_string(),
        ]
    };
    context.output.result(|| json::value(&reply), || table(columns, reply.episodes.iter().map(row)))?;
    context.output.next(format_args!("gleaner pretrain --snapshot {id} --wait"));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rule_is_described_with_its_limits() {
        assert_eq!(rule(None), "by outcome");
        let limited = RoleRule {
            expert_cohorts: vec!["a".into()],
            imperfect_cohorts: vec!["b".into(), "c".into()],
            max_experts: 20,
            imperfect_per_expert: 3.0,
            seed: 0,
        };
        assert_eq!(rule(Some(&limited)), "experts: a; imperfect: b c; at most 20 experts; at most 3 imperfect each");
    }
}
