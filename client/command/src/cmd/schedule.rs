//! `schedule`: pipelines that the server starts by time or after new labels.

use clap::{Args, Subcommand};
use gleaner_proto::v1::create_schedule_request::Trigger as NewTrigger;
use gleaner_proto::v1::schedule::Trigger;
use gleaner_proto::v1::{CreateScheduleRequest, DeleteScheduleRequest, PauseScheduleRequest, Schedule};
use serde_json::json;

use super::pipeline::PipelineArgs;
use super::queueing::EngineArgs;
use crate::context::Context;
use crate::failure::{Result, present};
use crate::table::Column::Left;
use crate::table::table;
use crate::{json, words};

#[derive(Debug, Subcommand)]
pub(crate) enum ScheduleCommand {
    /// Create a schedule.
    Create(Box<CreateArgs>),
    /// List schedules with the next run of each.
    List {
        /// List only schedules of this task.
        #[arg(long, default_value = "", hide_default_value = true)]
        task: String,
    },
    /// Pause a schedule; running jobs continue.
    Pause {
        /// Id of the schedule.
        id: String,
    },
    /// Resume a paused schedule.
    Resume {
        /// Id of the schedule.
        id: String,
    },
    /// Delete a schedule; its jobs stay.
    Delete {
        /// Id of the schedule.
        id: String,
    },
}

#[derive(Args, Debug)]
#[group(id = "trigger", required = true, multiple = false, args = ["cron", "after_labels"])]
pub(crate) struct CreateArgs {
    /// Name or id of the task. Default: the only task of the server.
    #[arg(long)]
    task: Option<String>,
    /// Name of the schedule.
    #[arg(long)]
    name: String,
    /// Times of the runs: five cron fields in UTC, such as "0 2 * * *".
    #[arg(long)]
    cron: Option<String>,
    /// Run after this many newly labelled episodes, at least 1.
    #[arg(long, value_name = "N")]
    after_labels: Option<u32>,
    #[command(flatten)]
    pipeline: PipelineArgs,
    #[command(flatten)]
    engine: EngineArgs,
}

impl ScheduleCommand {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        match self {
            Self::Create(args) => args.run(context).await,
            Self::List { task } => list(context, &task).await,
            Self::Pause { id } => pause(context, id, true).await,
            Self::Resume { id } => pause(context, id, false).await,
            Self::Delete { id } => delete(context, id).await,
        }
    }
}

impl CreateArgs {
    async fn run(self, context: &Context) -> Result<()> {
        let client = context.client().await?;
        let trigger = match (self.cron, self.after_labels) {
            (Some(cron), _) => Some(NewTrigger::Cron(cron)),
            (None, count) => count.map(NewTrigger::LabelledEpisodes),
        };
        let request = CreateScheduleRequest {
            task: context.task(&client, self.task.as_deref()).await?,
            name: self.name,
            trigger,
            pipeline: Some(self.pipeline.spec()),
            engine_options: self.engine.options,
        };
        let reply = client.schedules().create_schedule(request).await?.into_inner();
        let schedule = present(reply.schedule.as_ref(), "a schedule")?;
        context.output.result(|| json::value(&reply), || listing(std::slice::from_ref(schedule)))?;
        context.output.next("gleaner schedule list");
        Ok(())
    }
}

async fn list(context: &Context, task: &str) -> Result<()> {
    let reply = context.client().await?.every_schedule(task).await?;
    context.output.result(|| json::value(&reply), || listing(&reply.schedules))?;
    match reply.schedules.first() {
        Some(schedule) if schedule.paused => {
            context.output.next(format_args!("gleaner schedule resume {}", schedule.id))
        }
        Some(schedule) => context.output.next(format_args!("gleaner schedule pause {}", schedule.id)),
        None => context.output.next("gleaner schedule create --name NAME --after-labels 20"),
    }
    Ok(())
}

async fn pause(context: &Context, schedule_id: String, paused: bool) -> Result<()> {
    let request = PauseScheduleRequest { schedule_id, paused };
    let reply = context.client().await?.schedules().pause_schedule(request).await?.into_inner();
    let schedule = present(reply.schedule.as_ref(), "a schedule")?;
    context.output.result(|| json::value(&reply), || listing(std::slice::from_ref(schedule)))?;
    context.output.next("gleaner schedule list");
    Ok(())
}

async fn delete(context: &Context, schedule_id: String) -> Result<()> {
    let request = DeleteScheduleRequest { schedule_id: schedule_id.clone() };
    context.client().await?.schedules().delete_schedule(request).await?;
    context.output.result(|| Ok(json!({ "deleted": schedule_id })), || format!("{schedule_id} deleted"))?;
    context.output.next("gleaner schedule list");
    Ok(())
}

fn listing(schedules: &[Schedule]) -> String {
    let columns = ["ID", "NAME", "RUNS", "ENGINE OPTIONS", "NEXT RUN", "LAST RUN", "STATE"].map(Left);
    let row = |schedule: &Schedule| {
        let (runs, next) = when(schedule);
        [
            schedule.id.clone(),
            schedule.name.clone(),
            runs,
            schedule.engine_options.clone(),
            if schedule.paused { "-".into() } else { next },
            words::moment(schedule.last_run_time.as_ref()),
            state(schedule),
        ]
    };
    table(columns, schedules.iter().map(row))
}

fn state(schedule: &Schedule) -> String {
    let (paused, error) = (schedule.paused, schedule.last_error.as_str());
    match &schedule.pipeline {
        None if paused => format!("paused; cannot start: {error}"),
        None => format!("cannot start: {error}"),
        Some(_) if paused => "paused".into(),
        Some(_) if error.is_empty() => "active".into(),
        Some(_) => format!("active; last run could not start: {error}"),
    }
}

fn when(schedule: &Schedule) -> (String, String) {
    match &schedule.trigger {
        Some(Trigger::Cron(cron)) => (cron.clone(), words::moment(schedule.next_run_time.as_ref())),
        Some(Trigger::LabelledEpisodes(count)) => {
            (format!("every {count} labels"), format!("after {} more", count.saturating_sub(schedule.labelled_since)))
        }
        None => ("-".into(), "-".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_of_a_schedule_that_cannot_start_is_shown() {
        use gleaner_proto::v1::PipelineSpec;

        let shown = |paused, last_error: &str, pipeline: Option<PipelineSpec>| {
            state(&Schedule { paused, last_error: last_error.into(), pipeline, ..Schedule::default() })
        };
        let pipeline = || Some(PipelineSpec::default());
        assert_eq!(shown(false, "", pipeline()), "active");
        assert_eq!(shown(false, "no expert", pipeline()), "active; last run could not start: no expert");
        assert_eq!(shown(true, "no expert", pipeline()), "paused");
        assert_eq!(shown(false, "damaged", None), "cannot start: damaged");
        assert_eq!(shown(true, "damaged", None), "paused; cannot start: damaged");
    }

    #[test]
    fn the_next_run_of_each_trigger_is_shown() {
        let by_labels =
            Schedule { trigger: Some(Trigger::LabelledEpisodes(20)), labelled_since: 15, ..Schedule::default() };
        assert_eq!(when(&by_labels), ("every 20 labels".into(), "after 5 more".into()));
        let by_clock = Schedule { trigger: Some(Trigger::Cron("0 2 * * *".into())), ..Schedule::default() };
        assert_eq!(when(&by_clock), ("0 2 * * *".into(), "-".into()));
    }
}
