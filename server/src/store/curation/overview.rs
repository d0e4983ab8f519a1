//! Overview of all tasks with their cohorts.

use crate::{
    domain::{
        curation::{TaskOverview, Totals},
        id::TaskId,
    },
    error::Result,
    store::{
        Store, fault,
        row::{self, Column as _, record},
        sql,
    },
};

/// Some tasks at a glance. Episodes are counted for those tasks only, from an index, and before they meet the tasks'
/// specs: a sort of joined rows would carry a spec for each episode.
const OVERVIEW: &str = "with shown as materialized (select id, spec, created_at from tasks \
         where instr(lower(name), $1) > 0 order by id desc limit $2 offset $3), \
     counted as (select task_id, count(*) filter (where outcome = 'success') as success, \
         count(*) filter (where outcome = 'failure') as failure, count(*) filter (where outcome = 'unknown') as unknown, \
         sum(duration_s) / 3600 as hours, cast(sum(size_bytes) as bigint) as bytes, count(distinct nullif(cohort, '')) as cohorts \
         from episodes where task_id in (select id from shown) and deleted_at is null group by task_id) \
     select id, spec, created_at, coalesce(success, 0) as success, coalesce(failure, 0) as failure, \
         coalesce(unknown, 0) as unknown, coalesce(hours, 0.0) as hours, coalesce(bytes, 0) as bytes, \
         coalesce(cohorts, 0) as cohorts \
     from shown left join counted on task_id = id order by id desc";

record! { TaskOverview: hours, bytes, cohorts; task, outcomes }

impl Store {
    /// Tasks with totals, newest first; the trash is left out. Of the tasks with `text` in their name, ignoring the
    /// case of ASCII letters, the result leaves out the first `skip` and has at most `most`.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn overview(&self, text: &str, skip: usize, most: usize) -> Result<Vec<TaskOverview>> {
        sql::query(OVERVIEW)
            .bind(text.to_ascii_lowercase())
            .bind(i64::try_from(most).unwrap_or(i64::MAX))
            .bind(i64::try_from(skip).unwrap_or(i64::MAX))
            .try_map(row::read)
            .fetch_all(self.read())
            .await
            .map_err(fault("looking over the tasks"))
    }

    /// The number of tasks with `text` in their name, as [`Store::overview`] finds them.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn count_tasks(&self, text: &str) -> Result<u64> {
        sql::query("select count(*) from tasks where instr(lower(name), $1) > 0")
            .bind(text.to_ascii_lowercase())
            .try_map(row::read)
            .fetch_one(self.read())
            .await
            .map_err(fault("counting tasks"))
    }

    /// Sums over all tasks.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn totals(&self) -> Result<Totals> {
        let (tasks, episodes, hours, bytes) = sql::query(
            "select (select count(*) from tasks), count(*), coalesce(sum(duration_s), 0.0) / 3600, \
                 cast(coalesce(sum(size_bytes), 0) as bigint) from episodes where deleted_at is null",
        )
        .try_map(row::read)
        .fetch_one(self.read())
        .await
        .map_err(fault("summing up the tasks"))?;
        Ok(Totals { tasks, episodes, hours, bytes })
    }

    /// The cohorts of a task's episodes, by name, including the empty one if an episode has no cohort.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn cohorts(&self, task: &TaskId) -> Result<Vec<String>> {
        row::query_as("select distinct cohort from episodes where task_id = $1 and deleted_at is null order by cohort")
            .bind(task.param())
            .fetch_all(self.read())
            .await
            .map_err(fault("listing cohorts"))
    }
}

#[cfg(test)]
mod tests {
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

        let all = store.overview("", 0, 9).await.unwrap();
        assert_eq!(all.iter().map(|one| &one.task.id).collect::<Vec<_>>(), [&empty.unwrap().id, &task.id]);
        let (other, one) = (&all[0], &all[1]);
        assert_eq!((one.outcomes.success, one.outcomes.failure, one.outcomes.unknown), (2, 2, 1));
        assert_eq!((one.bytes, one.cohorts), (bytes, 2), "episodes without a cohort are not one");
        assert!((one.hours * 3600.0 - 5.0 * 1.9).abs() < 1e-9, "{}", one.hours);
        assert_eq!((other.outcomes.success, other.bytes, other.cohorts, other.hours), (0, 0, 0, 0.0));
        assert_eq!(store.cohorts(&task.id).await.unwrap(), ["", "ada", "bob"]);
        let totals = store.totals().await.unwrap();
        assert_eq!((totals.tasks, totals.episodes, totals.bytes), (2, 5, bytes));
        assert!((totals.hours - one.hours).abs() < 1e-12, "{}", totals.hours);
    }

    #[tokio::test]
    async fn tasks_are_paged_and_found_by_a_part_of_their_name() {
        let (_dir, store) = testing::store().await;
        assert_eq!(store.totals().await.unwrap(), crate::domain::curation::Totals::default());
        for name in ["Pick_cube", "push_cube", "pick_peg", "100%"] {
            let spec = gleaner_recording::TaskSpec { name: name.into(), ..testing::spec() };
            store.insert_task(&spec).await.unwrap();
        }
        let names = async |text: &str, skip, most| {
            let found = store.overview(text, skip, most).await.unwrap();
            found.into_iter().map(|one| one.task.spec.name).collect::<Vec<_>>()
        };
        assert_eq!(names("", 0, 3).await, ["100%", "pick_peg", "push_cube"]);
        assert_eq!(names("", 3, 3).await, ["Pick_cube"]);
        assert_eq!(names("PICK_", 0, 9).await, ["pick_peg", "Pick_cube"]);
        assert_eq!(names("%", 0, 9).await, ["100%"], "no character is special");
        assert_eq!((store.count_tasks("cube").await.unwrap(), store.count_tasks("peg").await.unwrap()), (2, 1));
    }

    /// A page counts the episodes of its own tasks, and reads them from an index.
    #[tokio::test]
    async fn a_page_of_tasks_reads_no_whole_episodes() {
        let (_dir, store) = testing::sqlite().await;
        let plan = testing::plan(&store, super::OVERVIEW).await;
        assert!(plan.iter().any(|step| step.contains("COVERING INDEX episodes_at_a_glance")), "{plan:?}");
    }
}
