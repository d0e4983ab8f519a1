//! Rows of open uploads. A row's `committed` counts bytes that are synced to disk.

use super::{
    Store, episode, fault,
    row::{self, Column as _, record},
    sql::{self, QueryBuilder, Transaction},
};
use crate::{
    domain::{
        episode::{Episode, InspectedEpisode, Upload},
        id::{BlobId, TaskId, UploadId},
        time::Millis,
    },
    error::{Error, Result},
};

const COLUMNS: &str =
    "select id, task_id, file_name, size_bytes, blake3, committed, outcome, cohort, author, client from uploads ";

record! { Upload: id, task_id, file_name, size_bytes, blake3, committed, outcome, cohort, author, client }

impl Store {
    /// Opens an upload, unless its client has `most` open already; returns whether it was opened. `None`: no limit.
    pub(crate) async fn insert_upload(&self, upload: &Upload, most: Option<u64>) -> Result<bool> {
        let mut tx = self.write().await?;
        // Counted and inserted in one statement, so that concurrent calls cannot exceed the limit together.
        let inserted = sql::query(
            "insert into uploads (id, task_id, file_name, size_bytes, blake3, committed, outcome, cohort, author, \
                 client, created_at) select $1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11 \
                 where $12 is null or (select count(*) from uploads where client = $10) < $12",
        )
        .bind(upload.id.param())
        .bind(upload.task_id.param())
        .bind(&upload.file_name)
        .bind(upload.size_bytes.param())
        .bind(upload.blake3.param())
        .bind(upload.committed.param())
        .bind(upload.outcome.param())
        .bind(&upload.cohort)
        .bind(&upload.author)
        .bind(upload.client.param())
        .bind(Millis::now().param())
        .bind(most.param())
        .execute(&mut tx)
        .await
        .map_err(fault("opening an upload"))?;
        self.commit(tx).await?;
        Ok(inserted == 1)
    }

    /// An open upload.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn upload(&self, id: &UploadId) -> Result<Upload> {
        let mut query = QueryBuilder::new(COLUMNS);
        query.push("where id = ").push_bind(id.param());
        let found = query.build().try_map(row::read).fetch_optional(self.read()).await;
        found.map_err(fault("reading an upload"))?.ok_or_else(|| no_upload(id))
    }

    /// The task's open uploads of this content, the one with the most bytes first.
    pub(crate) async fn uploads_of(&self, task: &TaskId, blake3: &BlobId) -> Result<Vec<Upload>> {
        let mut query = QueryBuilder::new(COLUMNS);
        query.push("where task_id = ").push_bind(task.param());
        query.push(" and blake3 = ").push_bind(blake3.param()).push(" order by committed desc, id");
        query.build().try_map(row::read).fetch_all(self.read()).await.map_err(fault("listing uploads"))
    }

    /// Every open upload, oldest first.
    pub(crate) async fn uploads(&self) -> Result<Vec<Upload>> {
        let mut query = QueryBuilder::new(COLUMNS);
        query.push("order by id");
        query.build().try_map(row::read).fetch_all(self.read()).await.map_err(fault("listing uploads"))
    }

    /// Raises an upload's committed size; it never decreases. Must be called after the bytes are synced.
    ///
    /// # Errors
    /// NotFound when the upload is not open any more.
    pub(crate) async fn commit_upload(&self, id: &UploadId, committed: u64) -> Result<()> {
        let mut tx = self.write().await?;
        let result = sql::query(
            "update uploads set committed = case when committed < $1 then $1 else committed end where id = $2",
        )
        .bind(committed.param())
        .bind(id.param())
        .execute(&mut tx)
        .await
        .map_err(fault("committing an upload's bytes"))?;
        if result == 0 {
            return Err(no_upload(id));
        }
        self.commit(tx).await?;
        crate::fail_point::pass("upload.size_committed");
        Ok(())
    }

    /// Removes an upload; a missing one is not an error.
    pub(crate) async fn delete_upload(&self, id: &UploadId) -> Result<()> {
        let mut tx = self.write().await?;
        delete(&mut tx, id).await?;
        self.commit(tx).await
    }

    /// The uploads that were opened before `time`.
    pub(crate) async fn uploads_before(&self, time: Millis) -> Result<Vec<Upload>> {
        let mut query = QueryBuilder::new(COLUMNS);
        query.push("where created_at < ").push_bind(time.param());
        query.build().try_map(row::read).fetch_all(self.read()).await.map_err(fault("listing old uploads"))
    }

    /// Ends an upload: in one transaction its row is removed and the episode becomes visible. When the same content has
    /// become visible in the meantime, that episode is returned, whatever its label.
    pub(crate) async fn finish_upload(&self, upload: &Upload, inspected: &InspectedEpisode) -> Result<Episode> {
        let mut tx = self.write().await?;
        delete(&mut tx, &upload.id).await?;
        let (task, recording) = (&inspected.episode.task_id, &inspected.episode.recording);
        let episode = match episode::by_recording(&mut tx, task, recording).await? {
            Some(existing) => existing,
            None => episode::insert(&mut tx, inspected, &upload.author).await?,
        };
        crate::fail_point::pass("episode.row_written");
        self.commit_generation(tx).await?;
        crate::fail_point::pass("episode.committed");
        Ok(episode)
    }
}

fn no_upload(id: &UploadId) -> Error {
    Error::not_found("open upload", format!("{id}; start again"))
}

async fn delete(tx: &mut Transaction, id: &UploadId) -> Result<()> {
    sql::query("delete from uploads where id = $1")
        .bind(id.param())
        .execute(&mut *tx)
        .await
        .map_err(fault("deleting an upload"))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::testing;
    use super::*;
    use crate::error::Kind;

    #[tokio::test]
    async fn committed_never_falls() {
        let (_dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        let upload = testing::upload(&task, b"recording");
        store.insert_upload(&upload, None).await.unwrap();
        store.commit_upload(&upload.id, 7).await.unwrap();
        store.commit_upload(&upload.id, 4).await.unwrap();
        assert_eq!(store.upload(&upload.id).await.unwrap().committed, 7);
        assert_eq!(store.uploads_of(&task.id, &upload.blake3).await.unwrap()[0].id, upload.id);
    }

    #[tokio::test]
    async fn the_same_content_becomes_one_episode() {
        let (_dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        let (one, two) = (testing::upload(&task, b"recording"), testing::upload(&task, b"recording"));
        let mut finished = Vec::new();
        for upload in [&one, &two] {
            store.insert_upload(upload, None).await.unwrap();
            let episode = testing::inspected(&task, upload);
            finished.push(store.finish_upload(upload, &episode).await.unwrap().id);
        }
        assert_eq!(finished[0], finished[1]);
        assert_eq!(store.episode_of(&task.id, &one.blake3).await.unwrap().unwrap().id, finished[0]);
        assert_eq!(store.labels(&finished[0]).await.unwrap().len(), 1);
        assert!(store.uploads().await.unwrap().is_empty());
        assert_eq!(store.commit_upload(&one.id, 9).await.unwrap_err().kind(), Kind::NotFound);
    }

    #[tokio::test]
    async fn old_uploads_are_found() {
        let (_dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        store.insert_upload(&testing::upload(&task, b"recording"), None).await.unwrap();
        assert!(store.uploads_before(Millis(0)).await.unwrap().is_empty());
        assert_eq!(store.uploads_before(Millis(i64::MAX)).await.unwrap().len(), 1);
    }
}
