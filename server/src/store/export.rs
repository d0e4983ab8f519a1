//! Exports and their files.

use super::{
    Store, fault,
    row::{self, Column as _, record},
    sql::{self, QueryBuilder, Transaction},
};
use crate::{
    domain::{
        dataset::ExportFile,
        id::{BlobId, DatasetId, ExportId, JobId},
        job::JobKind,
        page::Page,
        time::Millis,
    },
    error::{Error, Result},
};

/// Files of one insertion.
const BATCH: usize = 1000;

record! { ExportFile: name, blob, size_bytes }
record! { PlacedFile: position; file }

/// A file at its place in an export.
struct PlacedFile {
    position: u32,
    file: ExportFile,
}

/// Adds a finished export.
pub(super) async fn insert(
    tx: &mut Transaction,
    export: &ExportId,
    dataset: &DatasetId,
    job: &JobId,
    files: &[ExportFile],
) -> Result<()> {
    sql::query("insert into exports (id, dataset_id, job_id, created_at) values ($1, $2, $3, $4)")
        .bind(export.param())
        .bind(dataset.param())
        .bind(job.param())
        .bind(Millis::now().param())
        .execute(&mut *tx)
        .await
        .map_err(fault("adding an export"))?;
    for (first, files) in (0i64..).step_by(BATCH).zip(files.chunks(BATCH)) {
        let mut query =
            QueryBuilder::new("insert into export_files (export_id, position, name, blob, size_bytes) values ");
        for (position, file) in (first..).zip(files) {
            query.push(if position == first { "(" } else { ", (" });
            query.push_bind(export.param()).push(", ").push_bind(position).push(", ");
            query.push_bind(file.name.as_str()).push(", ").push_bind(file.blob.param()).push(", ");
            query.push_bind(file.size_bytes.param()).push(")");
        }
        query.build().execute(&mut *tx).await.map_err(fault("adding files of an export"))?;
    }
    Ok(())
}

impl Store {
    /// The files of a finished export, in order.
    ///
    /// # Errors
    /// NotFound; Precondition naming its job when that has not succeeded, or when its files are no longer kept.
    pub(crate) async fn export_files(&self, id: &ExportId) -> Result<Vec<ExportFile>> {
        Ok(self.export_files_page(id, &Page::whole()).await?.0)
    }

    /// A page of the files of a finished export, in order, and the place that the next one follows.
    ///
    /// # Errors
    /// As for [`Store::export_files`].
    pub(crate) async fn export_files_page(
        &self,
        id: &ExportId,
        page: &Page<u32>,
    ) -> Result<(Vec<ExportFile>, Option<u32>)> {
        self.expect_export(id).await?;
        let files: Vec<PlacedFile> = sql::query(
            "select position, name, blob, size_bytes from export_files where export_id = $1 and position > $2 \
             order by position limit $3",
        )
        .bind(id.param())
        .bind(page.after.map_or(-1, i64::from))
        .bind(page.rows())
        .try_map(row::read)
        .fetch_all(self.read())
        .await
        .map_err(fault("reading an export's files"))?;
        let (files, next) = page.cut(files, |placed| placed.position);
        Ok((files.into_iter().map(|placed| placed.file).collect(), next))
    }

    /// One file of a finished export.
    ///
    /// # Errors
    /// As for [`Store::export_files`]; NotFound when the export has no such file.
    pub(crate) async fn export_file(&self, id: &ExportId, name: &str) -> Result<ExportFile> {
        self.expect_export(id).await?;
        sql::query("select name, blob, size_bytes from export_files where export_id = $1 and name = $2")
            .bind(id.param())
            .bind(name)
            .try_map(row::read)
            .fetch_optional(self.read())
            .await
            .map_err(fault("reading a file of an export"))?
            .ok_or_else(|| Error::not_found(&format!("file in {id} called"), name))
    }

    /// Fails unless the export is finished and its files are kept.
    async fn expect_export(&self, id: &ExportId) -> Result<()> {
        // The first file is the first to be forgotten.
        let found: Option<bool> = row::query_as(
            "select exists (select 1 from export_files where export_id = $1 and position = 0) from exports where id = $1",
        )
        .bind(id.param())
        .fetch_optional(self.read())
        .await
        .map_err(fault("reading an export"))?;
        match found {
            Some(true) => Ok(()),
            Some(false) => Err(Error::precondition(format!(
                "the files of export {id} are no longer kept (--keep-exports-days of the server); export its dataset again"
            ))),
            None => Err(self.missing(JobKind::Export, "export", id.as_str()).await),
        }
    }

    /// The first export after `after`, in the order of their ids, that was made before `time` and whose files are kept.
    pub(crate) async fn expired_export(&self, time: Millis, after: Option<&ExportId>) -> Result<Option<ExportId>> {
        sql::query(
            "select id from exports where created_at < $1 and id > $2 \
             and exists (select 1 from export_files where export_id = exports.id) order by id limit 1",
        )
        .bind(time.param())
        .bind(after.map_or("", ExportId::as_str))
        .try_map(row::read)
        .fetch_optional(self.read())
        .await
        .map_err(fault("looking for old exports"))
    }

    /// The places and the blobs of the kept files of an export, in order.
    pub(crate) async fn kept_export_files(&self, id: &ExportId) -> Result<Vec<(u32, BlobId)>> {
        sql::query("select position, blob from export_files where export_id = $1 order by position")
            .bind(id.param())
            .try_map(row::read)
            .fetch_all(self.read())
            .await
            .map_err(fault("reading the files of an export"))
    }

    /// Forgets the files of an export up to this place. The export keeps its row, and its job releases its key, so that the
    /// same order makes the files again.
    pub(crate) async fn forget_export_files(&self, id: &ExportId, last: u32) -> Result<()> {
        let mut tx = self.write().await?;
        sql::query("delete from export_files where export_id = $1 and position <= $2")
            .bind(id.param())
            .bind(last)
            .execute(&mut tx)
            .await
            .map_err(fault("forgetting the files of an export"))?;
        sql::query("update jobs set key = '' where id = (select job_id from exports where id = $1)")
            .bind(id.param())
            .execute(&mut tx)
            .await
            .map_err(fault("releasing the key of an export"))?;
        self.commit(tx).await
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        domain::{episode::Outcome, job::JobSpec, selection::Selection},
        error::Kind,
        store::testing::{self, results},
    };

    #[tokio::test]
    async fn files_of_an_export_keep_their_order() {
        let (_dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        testing::episode(&store, &task, Outcome::Success, "").await;
        testing::episode(&store, &task, Outcome::Failure, "").await;
        let encoder = results::encoder(&store, &task).await;
        let run = results::run(&store, &task, &encoder, &[]).await;
        let dataset = store.insert_dataset(&run.id, Selection::beta(0.9)).await.unwrap();
        let export = ExportId::new();
        let spec = JobSpec::Export { dataset_id: dataset.id.clone(), spec: Default::default() };
        let job = results::job(&store, &task, spec, export.as_str()).await;
        assert_eq!(store.export_files(&export).await.unwrap_err().kind(), Kind::Precondition);

        let file =
            |name: &str| ExportFile { name: name.into(), blob: blake3::hash(name.as_bytes()).into(), size_bytes: 3 };
        let files = [file("z.mcap"), file("manifest.jsonl")];
        let mut tx = store.write().await.unwrap();
        insert(&mut tx, &export, &dataset.id, &job, &files).await.unwrap();
        store.commit(tx).await.unwrap();
        assert_eq!(store.export_files(&export).await.unwrap(), files);
        assert_eq!(store.export_file(&export, "manifest.jsonl").await.unwrap(), files[1]);
        assert_eq!(store.export_file(&export, "../x").await.unwrap_err().kind(), Kind::NotFound);

        let [before, after] = [-60_000, 60_000].map(|difference| Millis(Millis::now().0 + difference));
        assert_eq!(store.expired_export(before, None).await.unwrap(), None, "it is younger");
        assert_eq!(store.expired_export(after, None).await.unwrap(), Some(export.clone()));
        assert_eq!(store.expired_export(after, Some(&export)).await.unwrap(), None);
        let places =
            |from: u32| (from..).zip(files.iter().skip(usize::try_from(from).unwrap()).map(|file| file.blob.clone()));
        assert_eq!(store.kept_export_files(&export).await.unwrap(), places(0).collect::<Vec<_>>());
        store.forget_export_files(&export, 0).await.unwrap();
        assert_eq!(store.kept_export_files(&export).await.unwrap(), places(1).collect::<Vec<_>>());
        let [list, file] =
            [store.export_files(&export).await.map(drop), store.export_file(&export, "manifest.jsonl").await.map(drop)];
        for error in [list.unwrap_err(), file.unwrap_err()] {
            assert_eq!(error.kind(), Kind::Precondition, "a part of an export is no export");
            assert!(error.message().contains("export its dataset again"), "{error}");
        }
        store.forget_export_files(&export, 1).await.unwrap();
        assert_eq!(store.expired_export(after, None).await.unwrap(), None);
    }

    #[tokio::test]
    async fn names_by_other_rows_are_those_beside_the_export() {
        let (_dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        let episode = testing::episode(&store, &task, Outcome::Success, "").await;
        testing::episode(&store, &task, Outcome::Failure, "").await;
        let encoder = results::encoder(&store, &task).await;
        let run = results::run(&store, &task, &encoder, &[]).await;
        let dataset = store.insert_dataset(&run.id, Selection::beta(0.9)).await.unwrap().id;
        let own: BlobId = blake3::hash(b"own").into();
        let files = [("a", &own), ("b", &own), ("c", &episode.recording)];
        let file = |(name, blob): (&str, &BlobId)| ExportFile { name: name.into(), blob: blob.clone(), size_bytes: 3 };
        let export = results::export(&store, &task, &dataset, &files.map(file)).await;
        assert!(!store.names_blob_beside(&own, &export).await.unwrap());
        assert!(store.names_blob_beside(&episode.recording, &export).await.unwrap());
        let other = results::export(&store, &task, &dataset, &[file(("a", &own))]).await;
        assert!(store.names_blob_beside(&own, &export).await.unwrap());
        store.forget_export_files(&other, 0).await.unwrap();
        assert!(!store.names_blob_beside(&own, &export).await.unwrap());
    }
}
