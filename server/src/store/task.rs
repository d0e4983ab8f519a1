//! Rows of tasks.

mod change;

use gleaner_recording::TaskSpec;

use super::{
    Store, fault, is_duplicate,
    row::{self, Column as _, Record as _, record},
    sql::{self, QueryBuilder},
};
use crate::{
    domain::{
        id::TaskId,
        page::Page,
        task::{OutcomeCounts, Task},
        time::Millis,
    },
    error::{Error, Result},
};

record! { Task: id, spec, created_at }
record! { OutcomeCounts: success, failure, unknown }

impl Store {
    /// Creates a task.
    ///
    /// # Errors
    /// Exists when another task has the name.
    pub(crate) async fn insert_task(&self, spec: &TaskSpec) -> Result<Task> {
        let task = Task { id: TaskId::new(), spec: spec.clone(), created_at: Millis::now() };
        let mut tx = self.write().await?;
        sql::query("insert into tasks (id, name, spec, created_at) values ($1, $2, $3, $4)")
            .bind(task.id.param())
            .bind(&spec.name)
            .bind(spec.param())
            .bind(task.created_at.param())
            .execute(&mut tx)
            .await
            .map_err(|error| match is_duplicate(&error) {
                true => Error::exists(format!(
                    "a task named {:?} exists already; use it, update it, or choose another name",
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
        sql::query("select id, spec, created_at from tasks where id = $1 or name = $1 order by id = $1 desc limit 1")
            .bind(name_or_id)
            .try_map(row::read)
            .fetch_optional(self.read())
            .await
            .map_err(fault("reading a task"))?
            .ok_or_else(|| Error::not_found("task", format!("{name_or_id:?}; list the tasks to see all names")))
    }

    /// The task with this id.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn task_by_id(&self, id: &TaskId) -> Result<Task> {
        sql::query("select id, spec, created_at from tasks where id = $1")
            .bind(id.param())
            .try_map(row::read)
            .fetch_optional(self.read())
            .await
            .map_err(fault("reading a task"))?
            .ok_or_else(|| Error::not_found("task", id))
    }

    /// Every task with the counts of its episodes, oldest first.
    #[cfg(test)]
    pub(crate) async fn tasks(&self) -> Result<Vec<(Task, OutcomeCounts)>> {
        Ok(self.tasks_page(&Page::whole()).await?.0)
    }

    /// A page of the tasks with the counts of their episodes, oldest first, and the task that the next one follows.
    pub(crate) async fn tasks_page(&self, page: &Page<TaskId>) -> Result<(Vec<(Task, OutcomeCounts)>, Option<TaskId>)> {
        let mut query = QueryBuilder::new(
            "select listed.id as id, listed.spec as spec, listed.created_at as created_at, \
                 count(*) filter (where outcome = 'success') as success, \
                 count(*) filter (where outcome = 'failure') as failure, \
                 count(*) filter (where outcome = 'unknown') as unknown \
             from (select id, spec, created_at from tasks",
        );
        if let Some(after) = &page.after {
            query.push(" where id > ").push_bind(after.param());
        }
        query.push(" order by id limit ").push_bind(page.rows());
        query.push(
            ") as listed left join episodes on task_id = listed.id and deleted_at is null \
             group by listed.id, listed.spec, listed.created_at order by listed.id",
        );
        let tasks = query
            .build()
            .try_map(|row| Ok((Task::decode(&row)?, OutcomeCounts::decode(&row)?)))
            .fetch_all(self.read())
            .await
            .map_err(fault("listing tasks"))?;
        Ok(page.cut(tasks, |(task, _)| task.id.clone()))
    }

    /// The id and the name of every task, by name.
    pub(crate) async fn task_names(&self) -> Result<Vec<(TaskId, String)>> {
        sql::query("select id, name from tasks order by name")
            .try_map(row::read)
            .fetch_all(self.read())
            .await
            .map_err(fault("listing the names of tasks"))
    }

    /// The number of a task's episodes by outcome.
    pub(crate) async fn outcome_counts(&self, task: &TaskId) -> Result<OutcomeCounts> {
        let (success, failure, unknown) = sql::query(
            "select count(*) filter (where outcome = 'success'), count(*) filter (where outcome = 'failure'), \
                 count(*) filter (where outcome = 'unknown') from episodes where task_id = $1 \
                 and deleted_at is null",
        )
        .bind(task.param())
        .try_map(row::read)
        .fetch_one(self.read())
        .await
        .map_err(fault("counting episodes"))?;
        Ok(OutcomeCounts { success, failure, unknown })
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
