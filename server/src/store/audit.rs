//! Rows of the audit log: insertion, and removal when they are old.

use super::{
    Store, fault,
    row::{self, Column as _, record},
    sql,
};
use crate::{
    domain::{access::AuditEntry, time::Millis},
    error::Result,
};

/// Entries removed in one transaction.
const FORGOTTEN_AT_ONCE: u32 = if cfg!(test) { 2 } else { 10_000 };

record! { AuditEntry: at, token_id, caller = "who", peer, rpc, subjects, outcome }

impl Store {
    /// Adds an entry.
    pub(crate) async fn insert_audit(&self, entry: &AuditEntry) -> Result<()> {
        let mut tx = self.write_beside().await?;
        sql::query(
            "insert into audit (at, token_id, who, peer, rpc, subjects, outcome) values ($1, $2, $3, $4, $5, $6, $7)",
        )
        .bind(entry.at.param())
        .bind(entry.token_id.param())
        .bind(&entry.caller)
        .bind(&entry.peer)
        .bind(&entry.rpc)
        .bind(entry.subjects.param())
        .bind(&entry.outcome)
        .execute(&mut tx)
        .await
        .map_err(fault("writing the audit log"))?;
        self.commit(tx).await
    }

    /// The entries since a time, oldest first: the newest `most` of them.
    pub(crate) async fn audit(&self, since: Millis, most: u32) -> Result<Vec<AuditEntry>> {
        sql::query(
            "select at, token_id, who, peer, rpc, subjects, outcome from (select * from audit where at >= $1 \
             order by at desc, id desc limit $2) as newest order by at, id",
        )
        .bind(since.param())
        .bind(most)
        .try_map(row::read)
        .fetch_all(self.read())
        .await
        .map_err(fault("reading the audit log"))
    }

    /// Removes the entries before a time, in batches so that others can write in between, and returns their number.
    pub(crate) async fn forget_audit(&self, before: Millis) -> Result<u64> {
        let mut forgotten = 0;
        loop {
            let mut tx = self.write().await?;
            let some = sql::query("delete from audit where id in (select id from audit where at < $1 limit $2)")
                .bind(before.param())
                .bind(FORGOTTEN_AT_ONCE)
                .execute(&mut tx)
                .await
                .map_err(fault("forgetting the audit log"))?;
            self.commit(tx).await?;
            forgotten += some;
            if some < u64::from(FORGOTTEN_AT_ONCE) {
                return Ok(forgotten);
            }
        }
    }
}

#[cfg(test)]
impl Store {
    /// Blocks all other writers until it is dropped.
    pub(crate) async fn hold_writer(&self) -> Result<impl Sized> {
        self.write().await
    }
}

#[cfg(test)]
mod tests {
    use super::{super::testing, *};
    use crate::domain::id::TokenId;

    #[tokio::test]
    async fn entries_are_ordered_and_limited_to_the_newest() {
        let (_dir, store) = testing::store().await;
        let entry = |at| AuditEntry {
            at: Millis(at),
            token_id: (at > 1).then(TokenId::new),
            caller: "anna".into(),
            peer: "10.0.0.7:9".into(),
            rpc: "TaskService/CreateTask".into(),
            subjects: vec!["spec.name=reach".into()],
            outcome: "ok".into(),
        };
        let entries: Vec<AuditEntry> = (1..=4).map(entry).collect();
        for entry in &entries {
            store.insert_audit(entry).await.unwrap();
        }
        assert_eq!(store.audit(Millis(0), 10).await.unwrap(), entries);
        assert_eq!(store.audit(Millis(2), 2).await.unwrap(), entries[2..]);
        assert!(store.audit(Millis(5), 10).await.unwrap().is_empty());
        assert_eq!(store.forget_audit(Millis(4)).await.unwrap(), 3);
        assert_eq!(store.audit(Millis(0), 10).await.unwrap(), entries[3..]);
    }
}
