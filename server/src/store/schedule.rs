//! Rows of schedules, and the number of episodes labelled since each last started.

use super::{
    Store, fault, is_duplicate,
    row::{self, Column, Record, column, unreadable},
    sql::{self, Row, Transaction},
};
use crate::{
    domain::{
        id::{ScheduleId, TaskId},
        schedule::{Schedule, ScheduleStart, Trigger},
        time::Millis,
    },
    error::{Error, Result},
};

/// A schedule with its count; conditions follow. Labels other than unknown count, each episode once. Only a schedule that
/// waits for labels has a count: those of others may be months old, and every label reads all schedules.
macro_rules! select_schedules {
    ($rest:literal) => {
        concat!(
            "select *, case when labelled_episodes is null or paused then 0 else \
             (select count(distinct labels.episode_id) from labels \
             join episodes on episodes.id = labels.episode_id where episodes.task_id = schedules.task_id \
             and episodes.deleted_at is null and labels.id > schedules.label_mark and labels.outcome <> 'unknown') end as labelled_since \
             from schedules ",
            $rest
        )
    };
}

impl Record for Schedule {
    fn decode(row: &Row) -> sqlx::Result<Self> {
        Ok(Self {
            id: column(row, "id")?,
            task_id: column(row, "task_id")?,
            name: column(row, "name")?,
            trigger: match (column(row, "cron")?, column(row, "labelled_episodes")?) {
                (Some(cron), None) => Trigger::Cron(cron),
                (None, Some(episodes)) => Trigger::LabelledEpisodes(episodes),
                (None, None) | (Some(_), Some(_)) => return Err(unreadable("cron", "the schedule needs one trigger")),
            },
            // One damaged row, or one of a newer version, is not the end of the list and of the scheduler.
            pipeline: column(row, "pipeline").map_err(|error| error.to_string()),
            engine_options: column(row, "engine_options")?,
            paused: column(row, "paused")?,
            next_run_at: column(row, "next_run_at")?,
            last_run_at: column(row, "last_run_at")?,
            label_mark: column(row, "label_mark")?,
            labelled_since: column(row, "labelled_since")?,
            last_error: column(row, "last_error")?,
        })
    }
}

impl Store {
    /// Stores a new schedule; labels before it are not counted.
    ///
    /// # Errors
    /// Exists when the task has a schedule of this name; NotFound when the task was deleted since it was read.
    pub(crate) async fn insert_schedule(&self, schedule: &Schedule) -> Result<Schedule> {
        let (cron, labelled_episodes) = match &schedule.trigger {
            Trigger::Cron(cron) => (Some(cron), None),
            Trigger::LabelledEpisodes(episodes) => (None, Some(*episodes)),
        };
        let pipeline = schedule.pipeline()?;
        let mut tx = self.write().await?;
        sql::query(
            "insert into schedules (id, task_id, name, cron, labelled_episodes, pipeline, paused, next_run_at, \
             label_mark, created_at, engine_options) \
             values ($1, $2, $3, $4, $5, $6, $7, $8, (select coalesce(max(id), 0) from labels), $9, $10)",
        )
        .bind(schedule.id.param())
        .bind(schedule.task_id.param())
        .bind(&schedule.name)
        .bind(cron)
        .bind(labelled_episodes)
        .bind(pipeline.param())
        .bind(schedule.paused)
        .bind(schedule.next_run_at.param())
        .bind(Millis::now().param())
        .bind(&schedule.engine_options)
        .execute(&mut tx)
        .await
        .map_err(|error| {
            if is_duplicate(&error) {
                Error::exists(format!(
                    "the task has a schedule called {:?}; delete that one or choose another name",
                    schedule.name
                ))
            } else if error.as_database_error().is_some_and(|problem| problem.is_foreign_key_violation()) {
                Error::not_found("task", &schedule.task_id)
            } else {
                fault("adding a schedule")(error)
            }
        })?;
        self.commit(tx).await?;
        self.schedule(&schedule.id).await
    }

    /// A schedule.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn schedule(&self, id: &ScheduleId) -> Result<Schedule> {
        sql::query(select_schedules!("where id = $1"))
            .bind(id.param())
            .try_map(row::read)
            .fetch_optional(self.read())
            .await
            .map_err(fault("reading a schedule"))?
            .ok_or_else(|| Error::not_found("schedule", id))
    }

    /// At most `size` schedules of a task, or of all, that come after the id `after`, oldest first. The second value is the
    /// `after` of the next page; `None` on the last one.
    pub(crate) async fn schedules(
        &self,
        task: Option<&TaskId>,
        after: Option<&ScheduleId>,
        size: u32,
    ) -> Result<(Vec<Schedule>, Option<ScheduleId>)> {
        // One row more than requested shows whether there is a next page.
        let mut schedules: Vec<Schedule> = sql::query(select_schedules!(
            "where ($1 is null or task_id = $1) and ($2 is null or id > $2) order by id limit $3"
        ))
        .bind(task.map(Column::param))
        .bind(after.map(Column::param))
        .bind(i64::from(size) + 1)
        .try_map(row::read)
        .fetch_all(self.read())
        .await
        .map_err(fault("listing schedules"))?;
        let size = usize::try_from(size).unwrap_or(usize::MAX);
        let more = schedules.len() > size;
        schedules.truncate(size);
        let next = if more { schedules.last().map(|schedule| schedule.id.clone()) } else { None };
        Ok((schedules, next))
    }

    /// The schedules that are not paused, oldest first.
    pub(crate) async fn running_schedules(&self) -> Result<Vec<Schedule>> {
        sql::query(select_schedules!("where not paused order by id"))
            .try_map(row::read)
            .fetch_all(self.read())
            .await
            .map_err(fault("listing schedules"))
    }

    /// The number of the newest label.
    pub(crate) async fn newest_label(&self) -> Result<i64> {
        row::query_as("select coalesce(max(id), 0) from labels")
            .fetch_one(self.read())
            .await
            .map_err(fault("reading the newest label"))
    }

    /// Pauses or resumes a schedule. Either resets its count: labels during the pause are not counted.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn pause_schedule(
        &self,
        id: &ScheduleId,
        paused: bool,
        next_run_at: Option<Millis>,
    ) -> Result<Schedule> {
        let mut tx = self.write().await?;
        sql::query(
            "update schedules set paused = $1, next_run_at = $2, label_mark = (select coalesce(max(id), 0) from labels) \
             where id = $3 and paused <> $1",
        )
        .bind(paused)
        .bind(next_run_at.param())
        .bind(id.param())
        .execute(&mut tx)
        .await
        .map_err(fault("pausing a schedule"))?;
        self.commit(tx).await?;
        self.schedule(id).await
    }

    /// Stores the reason why a schedule could not start, and when cron tries again; a paused one stays as it is.
    pub(crate) async fn schedule_failed(
        &self,
        id: &ScheduleId,
        error: &str,
        next_run_at: Option<Millis>,
    ) -> Result<()> {
        let mut tx = self.write().await?;
        sql::query("update schedules set last_error = $1, next_run_at = $2 where id = $3 and not paused")
            .bind(error)
            .bind(next_run_at.param())
            .bind(id.param())
            .execute(&mut tx)
            .await
            .map_err(fault("noting a failed start"))?;
        self.commit(tx).await
    }

    /// Stores when cron starts a schedule next, unless that is paused.
    pub(crate) async fn move_schedule(&self, id: &ScheduleId, next_run_at: Millis) -> Result<()> {
        let mut tx = self.write().await?;
        sql::query("update schedules set next_run_at = $1 where id = $2 and not paused")
            .bind(next_run_at.param())
            .bind(id.param())
            .execute(&mut tx)
            .await
            .map_err(fault("storing the next start of a schedule"))?;
        self.commit(tx).await
    }

    /// Deletes a schedule; its past jobs stay.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn delete_schedule(&self, id: &ScheduleId) -> Result<()> {
        let mut tx = self.write().await?;
        let done = sql::query("delete from schedules where id = $1")
            .bind(id.param())
            .execute(&mut tx)
            .await
            .map_err(fault("deleting a schedule"))?;
        self.commit(tx).await?;
        if done == 0 { Err(Error::not_found("schedule", id)) } else { Ok(()) }
    }
}

/// Stores the state of a schedule after its start.
///
/// # Errors
/// Precondition when it was paused or deleted since it was read, or paused and resumed with labels in between: a pause
/// drops those.
pub(super) async fn started(tx: &mut Transaction, start: &ScheduleStart) -> Result<()> {
    let changed = sql::query(
        "update schedules set last_run_at = $1, next_run_at = $2, label_mark = $3, last_error = '' \
         where id = $4 and not paused and label_mark <= $3",
    )
    .bind(start.at.param())
    .bind(start.next_run_at.param())
    .bind(start.label_mark)
    .bind(start.id.param())
    .execute(&mut *tx)
    .await
    .map_err(fault("moving a schedule on"))?;
    if changed == 0 {
        return Err(Error::precondition(format!(
            "{} was paused or deleted while it started; no job was queued",
            start.id
        )));
    }
    Ok(())
}

#[cfg(test)]
mod tests;
