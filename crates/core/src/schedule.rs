//! Schedules: pipelines that start automatically.

use crate::{EvaluateSpec, PretrainSpec, ScoreSpec, TrainSpec};
use croner::parser::{CronParser, Seconds, Year};

use super::{
    id::{ScheduleId, SnapshotId, TaskId},
    selection::{Rule, Selection, SelectionShape},
    snapshot::RoleRule,
    time::Millis,
};
use crate::error::{Error, Result};

/// A chain of jobs: pretrain, then score, then a dataset, then train, then evaluate. Later stages are optional.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PipelineSpec {
    /// The snapshot of the pipeline; `None` takes a new one at each start.
    pub snapshot_id: Option<SnapshotId>,
    /// The rule of a new snapshot's roles.
    pub rule: RoleRule,
    /// The first stage.
    pub pretrain: PretrainSpec,
    /// Whether to score.
    pub score: bool,
    /// Settings of the scoring; `None` takes the defaults on the device of pretraining.
    #[serde(default)]
    pub scoring: Option<ScoreSpec>,
    /// Makes a dataset of the segments with a higher q; needs `score`.
    pub beta: Option<f64>,
    /// Makes a dataset of this best part of the segments instead; needs `score`.
    #[serde(default)]
    pub top_fraction: Option<f64>,
    /// The shape of that dataset; off without one.
    #[serde(default)]
    pub shape: SelectionShape,
    /// Trains a policy on it; needs a dataset.
    pub train: Option<TrainSpec>,
    /// Evaluates that policy; needs `train`.
    #[serde(default)]
    pub evaluate: Option<EvaluateSpec>,
}

impl PipelineSpec {
    /// The default of [`SelectionShape::min_expert_auroc`] of a new pipeline, which trains before a user has seen how its
    /// scores rank the cohorts.
    pub const MIN_EXPERT_AUROC: f64 = 0.5;

    /// The selection of the dataset; `None` when none is made.
    pub fn selection(&self) -> Option<Selection> {
        let rule = self.beta.map(Rule::Beta).or(self.top_fraction.map(Rule::TopFraction))?;
        Some(Selection { rule, shape: self.shape })
    }
}

/// The trigger of a schedule.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Trigger {
    /// A cron expression of five fields, in UTC.
    Cron(String),
    /// Number of newly labelled episodes of the task.
    LabelledEpisodes(u32),
}

impl Trigger {
    /// The next start after `now`; `None` for triggers that do not depend on time.
    ///
    /// # Errors
    /// Invalid, under `field`, when the cron expression is wrong or no date matches it.
    pub fn next_run(&self, field: &str, now: Millis) -> Result<Option<Millis>> {
        match self {
            Self::LabelledEpisodes(_) => Ok(None),
            Self::Cron(expression) => next_by_cron(expression, now).map(Some).map_err(|problem| {
                Error::invalid(
                    field,
                    format!(
                        "{problem}; give minute, hour, day of month, month and day of week, such as 30 2 * * 1-5 (UTC)"
                    ),
                )
            }),
        }
    }
}

fn next_by_cron(expression: &str, now: Millis) -> std::result::Result<Millis, String> {
    let cron = CronParser::builder()
        .seconds(Seconds::Disallowed)
        .year(Year::Disallowed)
        .build()
        .parse(expression)
        .map_err(|error| error.to_string())?;
    let now = jiff::Timestamp::from_millisecond(now.0).map_err(|error| error.to_string())?;
    let next =
        cron.find_next_occurrence(&now.to_zoned(jiff::tz::TimeZone::UTC), false).map_err(|error| error.to_string())?;
    Ok(Millis(next.timestamp().as_millisecond()))
}

/// The state of a schedule after a start.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ScheduleStart {
    /// The schedule.
    pub id: ScheduleId,
    /// When it started.
    pub at: Millis,
    /// When cron starts it next.
    pub next_run_at: Option<Millis>,
    /// The newest label that is counted.
    pub label_mark: i64,
}

/// A pipeline with its trigger.
#[derive(Debug, Clone)]
pub struct Schedule {
    /// Its id.
    pub id: ScheduleId,
    /// Its task.
    pub task_id: TaskId,
    /// Its name, unique within the task.
    pub name: String,
    /// Its trigger.
    pub trigger: Trigger,
    /// The pipeline to start, or the reason why its row cannot be read.
    pub pipeline: std::result::Result<PipelineSpec, String>,
    /// Options that its jobs pass to their engine; empty for none.
    pub engine_options: String,
    /// Whether the schedule is paused.
    pub paused: bool,
    /// When cron starts it next.
    pub next_run_at: Option<Millis>,
    /// When it last started.
    pub last_run_at: Option<Millis>,
    /// The newest label that is already counted.
    pub label_mark: i64,
    /// Episodes labelled since then.
    pub labelled_since: u32,
    /// Reason why the last start failed; empty when it succeeded.
    pub last_error: String,
}

impl Schedule {
    /// The pipeline to start.
    ///
    /// # Errors
    /// Precondition when its row cannot be read.
    pub fn pipeline(&self) -> Result<&PipelineSpec> {
        self.pipeline.as_ref().map_err(|problem| {
            Error::precondition(format!(
                "the pipeline of {} cannot be read: {problem}; it is damaged or of a newer version: start that version, or \
                 delete the schedule and create another",
                self.id
            ))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(text: &str) -> Millis {
        Millis(text.parse::<jiff::Timestamp>().unwrap().as_millisecond())
    }

    fn next(expression: &str, now: &str) -> Millis {
        Trigger::Cron(expression.to_owned()).next_run("cron", at(now)).unwrap().unwrap()
    }

    #[test]
    fn cron_is_in_utc_and_never_now() {
        assert_eq!(next("30 2 * * *", "2026-03-01T02:29:59Z"), at("2026-03-01T02:30:00Z"));
        assert_eq!(next("30 2 * * *", "2026-03-01T02:30:00Z"), at("2026-03-02T02:30:00Z"));
        assert_eq!(next("0 0 29 2 *", "2026-03-01T00:00:00Z"), at("2028-02-29T00:00:00Z"));
        // Friday the 20th: the next working day is Monday.
        assert_eq!(next("15 9 * * 1-5", "2026-11-20T10:00:00Z"), at("2026-11-23T09:15:00Z"));
    }

    #[test]
    fn a_wrong_expression_is_named_with_the_fix() {
        for expression in ["", "every day", "61 * * * *", "* * * * * *", "0 0 30 2 *"] {
            let error = Trigger::Cron(expression.to_owned()).next_run("cron", at("2026-03-01T00:00:00Z")).unwrap_err();
            assert!(
                error.message().starts_with("cron: ") && error.message().contains("UTC"),
                "{expression:?}: {error}"
            );
        }
    }

    #[test]
    fn label_triggers_have_no_next_time() {
        assert_eq!(Trigger::LabelledEpisodes(3).next_run("cron", Millis::now()).unwrap(), None);
    }
}
