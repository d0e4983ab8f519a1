//! Changes of tasks: a new specification, and deletion, where they harm nothing.

use super::super::{
    Store, fault, is_duplicate,
    row::{self, Column as _},
    sql::{self, Transaction},
};
use crate::{
    domain::{
        id::TaskId,
        task::{Task, check_change},
    },
    error::{Error, Result},
};
use gleaner_recording::TaskSpec;

/// The tables that name a task, with the noun of their rows.
const USES: [(&str, &str); 10] = [
    ("episodes", "episodes (those in the trash among them)"),
    ("uploads", "uploads"),
    ("snapshots", "snapshots"),
    ("encoders", "encoders"),
    ("score_runs", "score runs"),
    ("datasets", "datasets"),
    ("policies", "policies"),
    ("deployments", "deployments"),
    ("schedules", "schedules"),
    ("jobs", "jobs"),
];

impl Store {
    /// Replaces the specification of a task; returns the changed task, and whether anything uses it.
    ///
    /// # Errors
    /// NotFound; Exists when another task has the name; Precondition when episodes or results rest on what changes.
    pub(crate) async fn update_task(&self, id: &TaskId, spec: &TaskSpec) -> Result<(Task, bool)> {
        let mut tx = self.write().await?;
        let task = read(&mut tx, id).await?;
        let uses = uses(&mut tx, id).await?;
        if !uses.is_empty() {
            let mut read = mappings(&mut tx, id).await?;
            if uses.iter().any(|(noun, _)| *noun == "uploads") {
                // An upload may be in its inspection, by any mapping.
                read.extend(task.spec.mappings.iter().map(|mapping| mapping.name.clone()));
            }
            check_change(&task.spec, spec, &read).map_err(|(field, why)| {
                let used = listed(&uses);
                Error::precondition(format!(
                    "spec.{field}: {why}, and the task has {used}; create another task, or add a mapping instead"
                ))
            })?;
        }
        sql::query("update tasks set name = $1, spec = $2 where id = $3")
            .bind(&spec.name)
            .bind(spec.param())
            .bind(id.param())
            .execute(&mut tx)
            .await
            .map_err(|error| match is_duplicate(&error) {
                true => Error::exists(format!("a task named {:?} exists already; choose another name", spec.name)),
                false => fault("updating a task")(error),
            })?;
        self.commit(tx).await?;
        Ok((Task { spec: spec.clone(), ..task }, !uses.is_empty()))
    }

    /// Deletes a task.
    ///
    /// # Errors
    /// NotFound; Precondition while anything uses it.
    pub(crate) async fn delete_task(&self, id: &TaskId) -> Result<()> {
        let mut tx = self.write().await?;
        let task = read(&mut tx, id).await?;
        let uses = uses(&mut tx, id).await?;
        if !uses.is_empty() {
            let (name, used) = (&task.spec.name, listed(&uses));
            return Err(Error::precondition(format!(
                "task {name:?} has {used}; only a task without any can be deleted"
            )));
        }
        let deleted = sql::query("delete from tasks where id = $1").bind(id.param()).execute(&mut tx).await;
        deleted.map_err(fault("deleting a task"))?;
        self.commit(tx).await
    }
}

async fn read(tx: &mut Transaction, id: &TaskId) -> Result<Task> {
    sql::query("select id, spec, created_at from tasks where id = $1")
        .bind(id.param())
        .try_map(row::read)
        .fetch_optional(&mut *tx)
        .await
        .map_err(fault("reading a task"))?
        .ok_or_else(|| Error::not_found("task", id))
}

/// The rows that name a task, by their noun.
async fn uses(tx: &mut Transaction, id: &TaskId) -> Result<Vec<(&'static str, i64)>> {
    let counts: Vec<(String, i64)> = row::query_as(
        "select 'episodes', count(*) from episodes where task_id = $1 \
         union all select 'uploads', count(*) from uploads where task_id = $1 \
         union all select 'snapshots', count(*) from snapshots where task_id = $1 \
         union all select 'encoders', count(*) from encoders where task_id = $1 \
         union all select 'score_runs', count(*) from score_runs where task_id = $1 \
         union all select 'datasets', count(*) from datasets where task_id = $1 \
         union all select 'policies', count(*) from policies where task_id = $1 \
         union all select 'deployments', count(*) from deployments where task_id = $1 \
         union all select 'schedules', count(*) from schedules where task_id = $1 \
         union all select 'jobs', count(*) from jobs where task_id = $1",
    )
    .bind(id.param())
    .fetch_all(&mut *tx)
    .await
    .map_err(fault("counting the uses of a task"))?;
    let noun = |(table, count): (String, i64)| {
        let (_, noun) = USES.iter().find(|(known, _)| *known == table)?;
        (count > 0).then_some((*noun, count))
    };
    Ok(counts.into_iter().filter_map(noun).collect())
}

/// The mappings by which its episodes were read.
async fn mappings(tx: &mut Transaction, id: &TaskId) -> Result<Vec<String>> {
    let found = row::query_as("select distinct mapping from episodes where task_id = $1").bind(id.param());
    found.fetch_all(&mut *tx).await.map_err(fault("reading the mappings of episodes"))
}

fn listed(uses: &[(&str, i64)]) -> String {
    uses.iter().map(|(noun, count)| format!("{count} {noun}")).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::super::super::testing;
    use super::*;
    use crate::{domain::episode::Outcome, error::Kind};

    #[tokio::test]
    async fn unused_tasks_change_and_used_ones_get_mappings_only() {
        let (_dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        let mut spec = TaskSpec { name: "renamed".into(), rate_hz: 7.0, ..task.spec.clone() };
        assert!(!store.update_task(&task.id, &spec).await.unwrap().1);
        assert_eq!(store.task("renamed").await.unwrap().spec, spec);

        let changed = store.task_by_id(&task.id).await.unwrap();
        testing::episode(&store, &changed, Outcome::Success, "").await;
        spec.rate_hz = 8.0;
        let refused = store.update_task(&task.id, &spec).await.unwrap_err();
        assert_eq!(refused.kind(), Kind::Precondition);
        assert!(refused.message().contains("spec.rate_hz") && refused.message().contains("1 episodes"), "{refused}");
        spec.rate_hz = 7.0;
        spec.mappings.push(gleaner_recording::Mapping {
            name: "further".into(),
            cameras: Vec::new(),
            fields: Vec::new(),
            clock: None,
        });
        assert!(store.update_task(&task.id, &spec).await.unwrap().1);
        assert_eq!(store.task_by_id(&task.id).await.unwrap().spec, spec);
    }

    #[tokio::test]
    async fn tasks_are_deleted_once_nothing_uses_them() {
        let (_dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        store.delete_task(&task.id).await.unwrap();
        assert_eq!(store.delete_task(&task.id).await.unwrap_err().kind(), Kind::NotFound);
        let task = testing::task(&store).await;
        testing::episode(&store, &task, Outcome::Success, "").await;
        let refused = store.delete_task(&task.id).await.unwrap_err();
        assert!(refused.kind() == Kind::Precondition && refused.message().contains("1 episodes"), "{refused}");
    }

    #[tokio::test]
    async fn every_table_that_names_a_task_is_counted() {
        let (_dir, store) = testing::sqlite().await;
        let named: Vec<String> = row::query_as(
            "select m.name from sqlite_master m, pragma_foreign_key_list(m.name) f where m.type = 'table' and f.\"table\" = 'tasks'",
        )
        .fetch_all(store.read())
        .await
        .unwrap();
        let counted: BTreeSet<String> = USES.iter().map(|(table, _)| (*table).to_owned()).collect();
        assert_eq!(named.into_iter().collect::<BTreeSet<_>>(), counted);
    }
}
