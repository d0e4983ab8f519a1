//! Rows of tasks.

use gleaner_recording::TaskSpec;

use super::{Store, fault, is_duplicate, row};
use crate::{
    domain::{
        id::TaskId,
        task::{OutcomeCounts, Task},
        time::Millis,
    },
    error::{Error, Result},
};

#[derive(sqlx::FromRow)]
pub(super) struct TaskRow {
    id: String,
    spec: String,
    created_at: i64,
}

#[derive(sqlx::FromRow)]
struct CountedRow {
    #[sqlx(flatten)]
    task: TaskRow,
    success: i64,
    failure: i64,
    unknown: i64,
}

impl TaskRow {
    pub(super) fn read(self) -> Result<Task> {
        Ok(Task {
            id: row::id("tasks.id", self.id)?,
            spec: row::json("tasks.spec", &self.spec)?,
            created_at: Millis(self.created_at),
        })
    }
}

impl CountedRow {
    fn read(self) -> Result<(Task, OutcomeCounts)> {
        let counts = OutcomeCounts {
            success: row::count("success", self.success)?,
            failure: row::count("failure", self.failure)?,
            unknown: row::count("unknown", self.unknown)?,
        };
        Ok((self.task.read()?, counts))
    }
}

impl Store {
    /// Creates a task.
    ///
    /// # Errors
    /// Exists when another task has the name.
    pub(crate) async fn insert_task(&self, spec: &TaskSpec) -> Result<Task> {
        let task = Task { id: TaskId::new(), spec: spec.clone(), created_at: Millis::now() };
        let mut tx = self.write().await?;
        sqlx::query("insert into tasks (id, name, spec, created_at) values (?, ?, ?, ?)")
            .bind(task.id.as_str())
            .bind(&spec.name)
            .bind(row::to_json(spec)?)
            .bind(task.created_at.0)
            .execute(&mut *tx)
            .await
            .map_err(|error| match is_duplicate(&error) {
                true => Error::exists(format!(
                    "a task named {:?} exists already; use it, or choose another name",
                    spec.name
                )),
                false => fault("inserting a task")(error),
            })?;
        self.commit(tx).await?;
        Ok(task)
    }

    /// The task with this name or id.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn task(&self, name_or_id: &str) -> Result<Task> {
        // An id takes precedence over a task with that name.
        sqlx::query_as::<_, TaskRow>(
            "select id, spec, created_at from tasks where id = ?1 or name = ?1 order by id = ?1 desc limit 1",
        )
        .bind(name_or_id)
        .fetch_optional(self.read())
        .await
        .map_err(fault("reading a task"))?
        .ok_or_else(|| Error::not_found("task", format!("{name_or_id:?}; list the tasks to see all names")))?
        .read()
    }

    /// The task with this id.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn task_by_id(&self, id: &TaskId) -> Result<Task> {
        sqlx::query_as::<_, TaskRow>("select id, spec, created_at from tasks where id = ?")
            .bind(id.as_str())
            .fetch_optional(self.read())
            .await
            .map_err(fault("reading a task"))?
            .ok_or_else(|| Error::not_found("task", id))?
            .read()
    }

    /// Every task with the counts of its episodes, oldest first.
    pub(crate) async fn tasks(&self) -> Result<Vec<(Task, OutcomeCounts)>> {
        sqlx::query_as::<_, CountedRow>(
            "select tasks.id, spec, tasks.created_at, \
                 count(*) filter (where outcome = 'success') as success, \
                 count(*) filter (where outcome = 'failure') as failure, \
                 count(*) filter (where outcome = 'unknown') as unknown \
             from tasks left join episodes on task_id = tasks.id and deleted_at is null group by tasks.id order by tasks.id",
        )
        .fetch_all(self.read())
        .await
        .map_err(fault("listing tasks"))?
        .into_iter()
        .map(CountedRow::read)
        .collect()
    }

    /// The id and the name of every task, by name.
    pub(crate) async fn task_names(&self) -> Result<Vec<(TaskId, String)>> {
        let rows: Vec<(String, String)> = sqlx::query_as("select id, name from tasks order by name")
            .fetch_all(self.read())
            .await
            .map_err(fault("listing the names of tasks"))?;
        rows.into_iter().map(|(id, name)| Ok((row::id("tasks.id", id)?, name))).collect()
    }

    /// The number of a task's episodes by outcome.
    pub(crate) async fn outcome_counts(&self, task: &TaskId) -> Result<OutcomeCounts> {
        let (success, failure, unknown) = sqlx::query_as::<_, (i64, i64, i64)>(
            "select count(*) filter (where outcome = 'success'), count(*) filter (where outcome = 'failure'), \
                 count(*) filter (where outcome = 'unknown') from episodes where task_id = ? \
                 and deleted_at is null",
        )
        .bind(task.as_str())
        .fetch_one(self.read())
        .await
        .map_err(fault("counting episodes"))?;
        Ok(OutcomeCounts {
            success: row::count("success", success)?,
            failure: row::count("failure", failure)?,
            unknown: row::count("unknown", unknown)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing;
    use crate::{domain::episode::Outcome, error::Kind};

    #[tokio::test]
    async fn a_task_is_found_by_name_and_by_id() {
        let (_dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        assert_eq!(store.task(&task.spec.name).await.unwrap().id, task.id);
        assert_eq!(store.task(task.id.as_str()).await.unwrap().spec, task.spec);
        assert_eq!(store.task_by_id(&task.id).await.unwrap().created_at, task.created_at);
        assert_eq!(store.task("nothing").await.unwrap_err().kind(), Kind::NotFound);
        let again = store.insert_task(&task.spec).await.unwrap_err();
        assert_eq!(again.kind(), Kind::Exists);
        assert!(again.message().contains(&task.spec.name));
    }

    #[tokio::test]
    async fn tasks_count_their_episodes_by_outcome() {
        let (_dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        for (outcome, times) in [(Outcome::Success, 2), (Outcome::Failure, 3)] {
            for _ in 0..times {
                testing::episode(&store, &task, outcome, "").await;
            }
        }
        let tasks = store.tasks().await.unwrap();
        let (found, counts) = &tasks[0];
        assert_eq!((tasks.len(), &found.id), (1, &task.id));
        assert_eq!((counts.success, counts.failure, counts.unknown), (2, 3, 0));
        let alone = store.outcome_counts(&task.id).await.unwrap();
        assert_eq!((alone.success, alone.failure, alone.unknown), (2, 3, 0));
    }
}
