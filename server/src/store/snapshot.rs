//! Rows of snapshots: frozen lists of episodes with labels and roles.

use std::collections::HashMap;

use super::{
    Store, fault,
    page::newest_first,
    row::{self, Column as _, record},
    sql::{self, QueryBuilder, Transaction},
};
use crate::{
    domain::{
        episode::Outcome,
        id::{EpisodeId, SnapshotId, TaskId},
        limit::{Member, limited},
        page::Page,
        snapshot::{Role, RoleRule, Snapshot, SnapshotEpisode},
        time::Millis,
        work::InputEpisode,
    },
    error::{Error, Result},
};

/// Episodes of one insertion.
const BATCH: usize = 1000;

const COLUMNS: &str = "select id, task_id, rule, created_at, experts, imperfect from snapshots ";

record! { Snapshot: id, task_id, rule, expert_episodes = "experts", imperfect_episodes = "imperfect", created_at }
record! { SnapshotEpisode: episode_id, outcome, cohort, role, steps }
record! { InputEpisode: id = "episode_id", recording, steps, file_name, outcome, cohort }
record! { Placed: position; episode }
record! { PlacedMember: position; episode }

/// An episode at its place in a snapshot.
pub(crate) struct Placed {
    pub(crate) position: i64,
    pub(crate) episode: InputEpisode,
}

/// A frozen episode at its place in a snapshot.
struct PlacedMember {
    position: u32,
    episode: SnapshotEpisode,
}

impl Store {
    /// Freezes the task's present episodes and labels under a rule.
    ///
    /// # Errors
    /// Precondition when the rule leaves no expert or no imperfect episode.
    pub(crate) async fn create_snapshot(&self, task: &TaskId, rule: &RoleRule) -> Result<Snapshot> {
        let mut tx = self.write().await?;
        let members = members_now(&mut tx, task, rule).await?;
        self.insert_snapshot(tx, task, rule, &members).await
    }

    /// The task's present episodes and labels under the rule of a snapshot: that snapshot if it has the same ones, a new
    /// one otherwise.
    ///
    /// # Errors
    /// NotFound; otherwise as for [`Store::create_snapshot`].
    pub(crate) async fn renewed_snapshot(&self, id: &SnapshotId) -> Result<SnapshotId> {
        let (Snapshot { task_id, rule, .. }, had) = self.snapshot(id).await?;
        let mut tx = self.write().await?;
        let members = members_now(&mut tx, &task_id, &rule).await?;
        let now = members
            .iter()
            .map(|(Member { episode_id, cohort, role, .. }, outcome)| (episode_id, cohort, role, outcome));
        if had.iter().map(|episode| (&episode.episode_id, &episode.cohort, &episode.role, &episode.outcome)).eq(now) {
            return Ok(id.clone());
        }
        Ok(self.insert_snapshot(tx, &task_id, &rule, &members).await?.id)
    }

    async fn insert_snapshot(
        &self,
        mut tx: Transaction,
        task: &TaskId,
        rule: &RoleRule,
        members: &[(Member, Outcome)],
    ) -> Result<Snapshot> {
        let count = |role| members.iter().filter(|(member, _)| member.role == role).count() as u64;
        let snapshot = Snapshot {
            id: SnapshotId::new(),
            task_id: task.clone(),
            rule: rule.clone(),
            expert_episodes: count(Role::Expert),
            imperfect_episodes: count(Role::Imperfect),
            created_at: Millis::now(),
        };
        check_both_sides(&snapshot)?;
        insert(&mut tx, &snapshot, members).await?;
        crate::fail_point::pass("snapshot.rows_written");
        self.commit(tx).await?;
        crate::fail_point::pass("snapshot.committed");
        Ok(snapshot)
    }

    /// A snapshot without its episodes.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn frozen(&self, id: &SnapshotId) -> Result<Snapshot> {
        let mut query = QueryBuilder::new(COLUMNS);
        query.push("where id = ").push_bind(id.param());
        let found = query.build().try_map(row::read).fetch_optional(self.read()).await;
        found.map_err(fault("reading a snapshot"))?.ok_or_else(|| Error::not_found("snapshot", id))
    }

    /// A snapshot with its episodes, in its order.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn snapshot(&self, id: &SnapshotId) -> Result<(Snapshot, Vec<SnapshotEpisode>)> {
        let snapshot = self.frozen(id).await?;
        let members = sql::query(
            "select episode_id, snapshot_episodes.outcome, snapshot_episodes.cohort, role, steps \
             from snapshot_episodes join episodes on episodes.id = episode_id \
             where snapshot_id = $1 order by position",
        )
        .bind(id.param())
        .try_map(row::read)
        .fetch_all(self.read())
        .await
        .map_err(fault("reading a snapshot's episodes"))?;
        Ok((snapshot, members))
    }

    /// At most `size` episodes of a snapshot behind a place (`None`: from the first one), in its order, and the place
    /// behind which the next page begins, if there is one.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn snapshot_episodes(
        &self,
        id: &SnapshotId,
        behind: Option<u32>,
        size: u32,
    ) -> Result<(Vec<SnapshotEpisode>, Option<u32>)> {
        self.frozen(id).await?;
        let members: Vec<PlacedMember> = sql::query(
            "select position, episode_id, snapshot_episodes.outcome, snapshot_episodes.cohort, role, steps \
             from snapshot_episodes join episodes on episodes.id = episode_id \
             where snapshot_id = $1 and position > $2 order by position limit $3",
        )
        .bind(id.param())
        .bind(behind.map_or(-1, i64::from))
        // One row more than requested shows whether there is a next page.
        .bind(i64::from(size) + 1)
        .try_map(row::read)
        .fetch_all(self.read())
        .await
        .map_err(fault("listing a snapshot's episodes"))?;
        let size = usize::try_from(size).unwrap_or(usize::MAX);
        let next = (members.len() > size).then(|| size.checked_sub(1).map(|last| members[last].position)).flatten();
        Ok((members.into_iter().take(size).map(|member| member.episode).collect(), next))
    }

    /// A task's snapshots, newest first.
    pub(crate) async fn snapshots(&self, task: &TaskId) -> Result<Vec<Snapshot>> {
        Ok(self.snapshots_page(task, &Page::whole()).await?.0)
    }

    /// A page of a task's snapshots, newest first, and the snapshot that the next one follows.
    pub(crate) async fn snapshots_page(
        &self,
        task: &TaskId,
        page: &Page<SnapshotId>,
    ) -> Result<(Vec<Snapshot>, Option<SnapshotId>)> {
        let mut query = QueryBuilder::new(COLUMNS);
        query.push("where task_id = ").push_bind(task.param());
        let found = newest_first(self.read(), query, page, |snapshot: &Snapshot| snapshot.id.clone()).await;
        found.map_err(fault("listing snapshots"))
    }

    /// Up to `most` episodes of a role behind a position of a snapshot, in its order.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn input_episodes(
        &self,
        id: &SnapshotId,
        role: Role,
        behind: i64,
        most: u32,
    ) -> Result<Vec<Placed>> {
        sql::query(
            "select position, episode_id, recording, steps, file_name, snapshot_episodes.outcome, snapshot_episodes.cohort \
             from snapshot_episodes join episodes on episodes.id = episode_id \
             where snapshot_id = $1 and position > $2 and role = $3 order by position limit $4",
        )
        .bind(id.param())
        .bind(behind)
        .bind(role.param())
        .bind(most)
        .try_map(row::read)
        .fetch_all(self.read())
        .await
        .map_err(fault("reading a snapshot's episodes"))
    }
}

/// The task's episodes selected by the rule, with their outcomes.
///
/// Ordered by content, not by arrival: the trained model depends on the order, and concurrent uploads arrive in any
/// order.
async fn members_now(tx: &mut Transaction, task: &TaskId, rule: &RoleRule) -> Result<Vec<(Member, Outcome)>> {
    let rows: Vec<(EpisodeId, String, Outcome, String)> = sql::query(
        "select id, recording, outcome, cohort from episodes where task_id = $1 and deleted_at is null order by recording, id",
    )
    .bind(task.param())
    .try_map(row::read)
    .fetch_all(&mut *tx)
    .await
    .map_err(fault("reading the task's episodes"))?;
    let mut outcomes = HashMap::with_capacity(rows.len());
    let mut members = Vec::with_capacity(rows.len());
    for (episode_id, recording, outcome, cohort) in rows {
        if let Some(role) = rule.role(outcome, &cohort) {
            outcomes.insert(episode_id.clone(), outcome);
            members.push(Member { episode_id, recording, cohort, role });
        }
    }
    let members = limited(members, rule).into_iter();
    Ok(members.filter_map(|member| outcomes.get(&member.episode_id).map(|&outcome| (member, outcome))).collect())
}

fn check_both_sides(snapshot: &Snapshot) -> Result<()> {
    let rule = &snapshot.rule;
    for (role, episodes, word) in
        [(Role::Expert, snapshot.expert_episodes, "success"), (Role::Imperfect, snapshot.imperfect_episodes, "failure")]
    {
        if episodes == 0 {
            let fix = if role == Role::Imperfect && rule.imperfect_per_expert > 0.0 && rule.imperfect_per_expert < 1.0 {
                "push or label some, or raise imperfect_per_expert".to_owned()
            } else if rule.by_cohort() {
                "name cohorts that the task's episodes have".to_owned()
            } else {
                format!("push or label episodes as {word}")
            };
            return Err(Error::precondition(format!(
                "the task has no {} episode under this rule: {fix}",
                role.as_str()
            )));
        }
    }
    Ok(())
}

async fn insert(tx: &mut Transaction, snapshot: &Snapshot, members: &[(Member, Outcome)]) -> Result<()> {
    sql::query(
        "insert into snapshots (id, task_id, rule, created_at, experts, imperfect, label_mark) \
         values ($1, $2, $3, $4, $5, $6, (select coalesce(max(id), 0) from labels))",
    )
    .bind(snapshot.id.param())
    .bind(snapshot.task_id.param())
    .bind(snapshot.rule.param())
    .bind(snapshot.created_at.param())
    .bind(snapshot.expert_episodes.param())
    .bind(snapshot.imperfect_episodes.param())
    .execute(&mut *tx)
    .await
    .map_err(fault("inserting a snapshot"))?;
    for (first, members) in (0i64..).step_by(BATCH).zip(members.chunks(BATCH)) {
        let mut query = QueryBuilder::new(
            "insert into snapshot_episodes (snapshot_id, position, episode_id, outcome, cohort, role) values ",
        );
        for (position, (member, outcome)) in (first..).zip(members) {
            query.push(if position == first { "(" } else { ", (" });
            query.push_bind(snapshot.id.as_str()).push(", ").push_bind(position).push(", ");
            query.push_list([member.episode_id.as_str(), outcome.as_str(), &member.cohort, member.role.as_str()]);
            query.push(")");
        }
        query.build().execute(&mut *tx).await.map_err(fault("inserting a snapshot's episodes"))?;
    }
    sql::query(
        "update snapshots set expert_steps = (select coalesce(sum(steps), 0) from snapshot_episodes \
         join episodes on episodes.id = episode_id where snapshot_id = snapshots.id and role = 'expert') where id = $1",
    )
    .bind(snapshot.id.param())
    .execute(&mut *tx)
    .await
    .map_err(fault("counting the steps of experts"))?;
    Ok(())
}

#[cfg(test)]
mod tests;
