//! Schedules on the wire.

use gleaner_proto::v1;

use super::{field, order};
use crate::{
    engine_options,
    error::{Error, Result},
    id::{ScheduleId, TaskId},
    schedule::{PipelineSpec, Schedule, Trigger},
    time::Millis,
};

/// Reads a schedule's id.
pub fn schedule_id(text: &str) -> Result<ScheduleId> {
    ScheduleId::parse("schedule_id", text)
}

/// A schedule to be made, without its task.
#[derive(Debug)]
pub struct NewSchedule {
    name: String,
    trigger: Trigger,
    pipeline: PipelineSpec,
    engine_options: String,
    next_run_at: Option<Millis>,
}

impl NewSchedule {
    /// Options that its jobs pass to their engine; empty for none.
    pub fn engine_options(&self) -> &str {
        &self.engine_options
    }

    /// The schedule, for this task.
    pub fn of(self, task_id: TaskId) -> Schedule {
        let Self { name, trigger, pipeline, engine_options, next_run_at } = self;
        Schedule {
            id: ScheduleId::new(),
            task_id,
            name,
            trigger,
            pipeline: Ok(pipeline),
            engine_options,
            paused: false,
            next_run_at,
            last_run_at: None,
            label_mark: 0,
            labelled_since: 0,
            last_error: String::new(),
        }
    }
}

/// The task's name or id, and the schedule to create; cron counts from `now`.
///
/// # Errors
/// Invalid names the field and the remedy.
pub fn create_request(request: v1::CreateScheduleRequest, now: Millis) -> Result<(String, NewSchedule)> {
    let v1::CreateScheduleRequest { task, name, trigger, pipeline, engine_options } = request;
    let trigger = match trigger {
        Some(v1::create_schedule_request::Trigger::Cron(expression)) => Trigger::Cron(field::text("cron", expression)?),
        Some(v1::create_schedule_request::Trigger::LabelledEpisodes(0)) => {
            return Err(Error::invalid("labelled_episodes", "must be at least 1"));
        }
        Some(v1::create_schedule_request::Trigger::LabelledEpisodes(episodes)) => Trigger::LabelledEpisodes(episodes),
        None => return Err(Error::invalid("trigger", "must be set: cron, or labelled_episodes")),
    };
    let next_run_at = trigger.next_run("cron", now)?;
    let pipeline = order::pipeline(pipeline)?;
    if pipeline.snapshot_id.is_some() {
        return Err(Error::invalid(
            "pipeline.pretrain.snapshot_id",
            "must be left out: each start takes a new snapshot under the rule",
        ));
    }
    let engine_options = engine_options::engine_options("engine_options", &engine_options)?;
    let schedule = NewSchedule { name: field::text("name", name)?, trigger, pipeline, engine_options, next_run_at };
    Ok((field::text("task", task)?, schedule))
}

/// Page of a list of schedules.
#[derive(Debug)]
pub struct ListRequest {
    /// The task's name or id; empty: every task.
    pub task: String,
    /// Number of schedules on the page.
    pub size: u32,
    /// The newest schedule of the page before; `None` for the first page.
    pub after: Option<ScheduleId>,
}

/// Reads the page of a list of schedules.
///
/// # Errors
/// Invalid names the field.
pub fn list_request(request: v1::ListSchedulesRequest) -> Result<ListRequest> {
    let v1::ListSchedulesRequest { task, page_size, page_token } = request;
    let after = match page_token.as_str() {
        "" => None,
        token => Some(ScheduleId::parse("page_token", token).map_err(|_| field::foreign_page_token())?),
    };
    Ok(ListRequest { task, size: field::page_size(page_size)?, after })
}

/// A schedule. The error of one that cannot be read is that of its next run.
pub fn schedule(schedule: Schedule) -> v1::Schedule {
    let unreadable = schedule.pipeline().err().map(|error| error.message().to_owned());
    let Schedule {
        id,
        task_id,
        name,
        trigger,
        pipeline,
        engine_options,
        paused,
        next_run_at,
        last_run_at,
        label_mark: _,
        labelled_since,
        last_error,
    } = schedule;
    let by_labels = matches!(trigger, Trigger::LabelledEpisodes(_));
    let trigger = match trigger {
        Trigger::Cron(expression) => v1::schedule::Trigger::Cron(expression),
        Trigger::LabelledEpisodes(episodes) => v1::schedule::Trigger::LabelledEpisodes(episodes),
    };
    v1::Schedule {
        id: id.into(),
        task_id: task_id.into(),
        name,
        trigger: Some(trigger),
        pipeline: pipeline.ok().map(order::pipeline_to_proto),
        paused,
        next_run_time: next_run_at.map(field::timestamp),
        last_run_time: last_run_at.map(field::timestamp),
        labelled_since: if by_labels { labelled_since } else { 0 },
        last_error: unreadable.unwrap_or(last_error),
        engine_options,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(trigger: Option<v1::create_schedule_request::Trigger>) -> v1::CreateScheduleRequest {
        let pipeline = v1::PipelineSpec { pretrain: Some(v1::PretrainSpec::default()), ..v1::PipelineSpec::default() };
        v1::CreateScheduleRequest {
            task: "reach".into(),
            name: "nightly".into(),
            trigger,
            pipeline: Some(pipeline),
            engine_options: String::new(),
        }
    }

    fn cron(expression: &str) -> Option<v1::create_schedule_request::Trigger> {
        Some(v1::create_schedule_request::Trigger::Cron(expression.into()))
    }

    #[test]
    fn a_schedule_round_trips() {
        let given = v1::CreateScheduleRequest { engine_options: " -p gpu ".into(), ..request(cron("30 2 * * *")) };
        let (task, made) = create_request(given, Millis(0)).unwrap();
        assert_eq!(task, "reach");
        let shown = schedule(made.of(TaskId::new()));
        assert_eq!(shown.trigger, Some(v1::schedule::Trigger::Cron("30 2 * * *".into())));
        assert_eq!(shown.next_run_time.unwrap().seconds, 9_000);
        assert_eq!((shown.name.as_str(), shown.paused, shown.labelled_since), ("nightly", false, 0));
        assert_eq!(shown.engine_options, "-p gpu");
    }

    #[test]
    fn a_schedule_that_cannot_be_read_is_shown_with_its_error() {
        let (_, made) = create_request(request(cron("30 2 * * *")), Millis(0)).unwrap();
        let stored = Schedule { pipeline: Err("missing field `rule`".into()), ..made.of(TaskId::new()) };
        let id = stored.id.to_string();
        let shown = schedule(stored);
        assert_eq!((shown.name.as_str(), shown.pipeline), ("nightly", None));
        assert!(shown.last_error.contains(&id) && shown.last_error.contains("`rule`"), "{}", shown.last_error);
    }

    #[test]
    fn a_malformed_page_of_schedules_is_rejected() {
        let request = |token: &str, page_size| v1::ListSchedulesRequest {
            task: String::new(),
            page_size,
            page_token: token.into(),
        };
        let id = ScheduleId::new();
        let page = list_request(request(id.as_str(), 0)).unwrap();
        assert_eq!((page.size, page.after), (100, Some(id)));
        assert_eq!(list_request(request("", 1000)).unwrap().after, None);
        for (token, size, field) in [("17", 5, "page_token: is not a page token"), ("", 1001, "page_size: ")] {
            let error = list_request(request(token, size)).unwrap_err();
            assert!(error.message().starts_with(field), "{error}");
        }
    }

    #[test]
    fn a_wrong_field_is_named() {
        let refusal = |request| create_request(request, Millis(0)).unwrap_err().message().to_owned();
        assert!(refusal(request(None)).starts_with("trigger: "));
        assert!(refusal(request(cron("61 * * * *"))).starts_with("cron: "));
        let none = v1::create_schedule_request::Trigger::LabelledEpisodes(0);
        assert!(refusal(request(Some(none))).starts_with("labelled_episodes: "));
        assert!(
            refusal(v1::CreateScheduleRequest { name: String::new(), ..request(cron("* * * * *")) })
                .starts_with("name: ")
        );
        let options = v1::CreateScheduleRequest { engine_options: "--wrap=ls".into(), ..request(cron("* * * * *")) };
        assert!(refusal(options).starts_with("engine_options: --wrap=ls: is set by the server"));
        let mut fixed = request(cron("* * * * *"));
        fixed.pipeline.as_mut().unwrap().pretrain.as_mut().unwrap().snapshot_id = crate::id::SnapshotId::new().into();
        assert!(refusal(fixed).starts_with("pipeline.pretrain.snapshot_id: "));
    }
}
