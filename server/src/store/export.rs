//! Exports and their files.

use super::{
    Store, fault,
    row::{self, Column as _, record},
    sql::{self, Transaction},
};
use crate::{
    domain::{
        dataset::ExportFile,
        id::{DatasetId, ExportId, JobId},
        job::JobKind,
        page::Page,
        time::Millis,
    },
    error::{Error, Result},
};

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
    for (position, file) in (0i64..).zip(files) {
        sql::query(
            "insert into export_files (export_id, position, name, blob, size_bytes) values ($1, $2, $3, $4, $5)",
        )
        .bind(export.param())
        .bind(position)
        .bind(&file.name)
        .bind(file.blob.param())
        .bind(file.size_bytes.param())
        .execute(&mut *tx)
        .await
        .map_err(fault("adding a file of an export"))?;
    }
    Ok(())
}

impl Store {
    /// The files of a finished export, in order.
    ///
    /// # Errors
    /// NotFound, or Precondition naming its job when that has not succeeded.
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
        let there: i64 = row::query_as("select count(*) from exports where id = $1")
            .bind(id.param())
            .fetch_one(self.read())
            .await
            .map_err(fault("reading an export"))?;
        if there == 0 {
            return Err(self.missing(JobKind::Export, "export", id.as_str()).await);
        }
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
        let files = self.export_files(id).await?;
        let found = files.into_iter().find(|file| file.name == name);
        found.ok_or_else(|| Error::not_found(&format!("file in {id} called"), name))
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
    }
}
