//! Tasks at a glance, and who is in them.

use crate::{
    domain::{curation::TaskOverview, id::TaskId, task::OutcomeCounts},
    error::Result,
    store::{Store, fault, row, task::TaskRow},
};

#[derive(sqlx::FromRow)]
struct OverviewRow {
    #[sqlx(flatten)]
    task: TaskRow,
    success: i64,
    failure: i64,
    unknown: i64,
    hours: f64,
    bytes: i64,
    cohorts: i64,
}

impl OverviewRow {
    fn read(self) -> Result<TaskOverview> {
        Ok(TaskOverview {
            task: self.task.read()?,
            outcomes: OutcomeCounts {
                success: row::count("success", self.success)?,
                failure: row::count("failure", self.failure)?,
                unknown: row::count("unknown", self.unknown)?,
            },
            hours: self.hours,
            bytes: row::count("bytes", self.bytes)?,
            cohorts: row::count("cohorts", self.cohorts)?,
        })
    }
}

impl Store {
    /// Every task at a glance, oldest first; the trash is left out.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn overview(&self) -> Result<Vec<TaskOverview>> {
        let rows: Vec<OverviewRow> = sqlx::query_as(
            "select tasks.id, spec, tasks.created_at, \
                 count(*) filter (where outcome = 'success') as success, \
                 count(*) filter (where outcome = 'failure') as failure, \
                 count(*) filter (where outcome = 'unknown') as unknown, \
                 coalesce(sum(duration_s), 0.0) / 3600 as hours, coalesce(sum(size_bytes), 0) as bytes, \
                 count(distinct cohort) as cohorts \
             from tasks left join episodes on task_id = tasks.id and deleted_at is null group by tasks.id order by tasks.id",
        )
        .fetch_all(self.read())
        .await
        .map_err(fault("looking over the tasks"))?;
        rows.into_iter().map(OverviewRow::read).collect()
    }

    /// The cohorts of a task's episodes, by name; the empty one too, if any is of none.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn cohorts(&self, task: &TaskId) -> Result<Vec<String>> {
        sqlx::query_scalar(
            "select distinct cohort from episodes where task_id = ? and deleted_at is null order by cohort",
        )
        .bind(task.as_str())
        .fetch_all(self.read())
        .await
        .map_err(fault("listing cohorts"))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use crate::{domain::episode::Outcome, store::testing};

    #[tokio::test]
    async fn a_task_is_summed_up_without_its_trash() {
        let (_dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        let empty = store.insert_task(&gleaner_recording::TaskSpec { name: "empty".into(), ..testing::spec() }).await;
        let mut bytes = 0;
        for (outcome, cohort) in [
            (Outcome::Success, "ada"),
            (Outcome::Success, ""),
            (Outcome::Failure, "bob"),
            (Outcome::Failure, "ada"),
            (Outcome::Unknown, ""),
        ] {
            bytes += testing::episode(&store, &task, outcome, cohort).await.size_bytes;
        }
        let gone = testing::episode(&store, &task, Outcome::Failure, "eve").await;
        store.delete_episodes(&[gone.id], false).await.unwrap();

        let all = store.overview().await.unwrap();
        assert_eq!(all.iter().map(|one| &one.task.id).collect::<Vec<_>>(), [&task.id, &empty.unwrap().id]);
        let (one, other) = (&all[0], &all[1]);
        assert_eq!((one.outcomes.success, one.outcomes.failure, one.outcomes.unknown), (2, 2, 1));
        assert_eq!((one.bytes, one.cohorts), (bytes, 3));
        assert!((one.hours * 3600.0 - 5.0 * 1.9).abs() < 1e-9, "{}", one.hours);
        assert_eq!((other.outcomes.success, other.bytes, other.cohorts, other.hours), (0, 0, 0, 0.0));
        assert_eq!(store.cohorts(&task.id).await.unwrap(), ["", "ada", "bob"]);
    }
}
