//! Datasets and exports.

use futures::TryStreamExt as _;
use sqlx::{Sqlite, Transaction};

use super::{Store, commit, fault, packed::unpack, row};
use crate::{
    domain::{
        dataset::{Dataset, DatasetContents, DatasetCounts, ExportFile, KeptEpisode, KeptSegment},
        id::{DatasetId, EpisodeId, ExportId, JobId, ScoreRunId, TaskId},
        job::JobKind,
        score::{Histogram, ScoreRun, keeps},
        time::Millis,
    },
    error::{Error, Result},
};

#[derive(sqlx::FromRow)]
struct DatasetRow {
    id: String,
    task_id: String,
    score_run_id: String,
    beta: f64,
    created_at: i64,
}

impl DatasetRow {
    fn dataset(self) -> Result<Dataset> {
        Ok(Dataset {
            id: row::id("datasets.id", self.id)?,
            task_id: row::id("datasets.task_id", self.task_id)?,
            score_run_id: row::id("datasets.score_run_id", self.score_run_id)?,
            beta: self.beta,
            created_at: Millis(self.created_at),
        })
    }
}

#[derive(sqlx::FromRow)]
struct KeptRow {
    episode_id: String,
    q: Vec<u8>,
    match_episode: Vec<u8>,
    match_step: Vec<u8>,
}

impl KeptRow {
    /// The segments that β keeps; `None` when it keeps none.
    fn kept(self, beta: f64, experts: &[EpisodeId]) -> Result<Option<KeptEpisode>> {
        let q = unpack::<f32>("episode_scores.q", &self.q)?;
        let episodes = unpack::<u32>("episode_scores.match_episode", &self.match_episode)?;
        let steps = unpack::<u32>("episode_scores.match_step", &self.match_step)?;
        let mut segments = Vec::new();
        for (end_step, ((weight, episode), match_step)) in (0..).zip(q.zip(episodes).zip(steps)) {
            if keeps(weight, beta) {
                let expert = usize::try_from(episode).ok().and_then(|index| experts.get(index)).cloned();
                let match_episode = row::parsed("episode_scores.match_episode", expert)?;
                segments.push(KeptSegment { end_step, weight, match_episode, match_step });
            }
        }
        if segments.is_empty() {
            return Ok(None);
        }
        Ok(Some(KeptEpisode { episode_id: row::id("episode_scores.episode_id", self.episode_id)?, segments }))
    }
}

#[derive(sqlx::FromRow)]
struct FileRow {
    name: String,
    blob: String,
    size_bytes: i64,
}

impl FileRow {
    fn file(self) -> Result<ExportFile> {
        Ok(ExportFile {
            name: self.name,
            blob: row::id("export_files.blob", self.blob)?,
            size_bytes: row::count("export_files.size_bytes", self.size_bytes)?,
        })
    }
}

/// Adds a dataset; the job that makes its run is there already.
pub(super) async fn insert(tx: &mut Transaction<'_, Sqlite>, dataset: &Dataset) -> Result<()> {
    sqlx::query("insert into datasets (id, task_id, score_run_id, beta, created_at) values (?, ?, ?, ?, ?)")
        .bind(dataset.id.as_str())
        .bind(dataset.task_id.as_str())
        .bind(dataset.score_run_id.as_str())
        .bind(dataset.beta)
        .bind(dataset.created_at.0)
        .execute(&mut **tx)
        .await
        .map_err(fault("adding a dataset"))?;
    Ok(())
}

/// Adds a finished export.
pub(super) async fn insert_export(
    tx: &mut Transaction<'_, Sqlite>,
    export: &ExportId,
    dataset: &DatasetId,
    job: &JobId,
    files: &[ExportFile],
) -> Result<()> {
    sqlx::query("insert into exports (id, dataset_id, job_id, created_at) values (?, ?, ?, ?)")
        .bind(export.as_str())
        .bind(dataset.as_str())
        .bind(job.as_str())
        .bind(Millis::now().0)
        .execute(&mut **tx)
        .await
        .map_err(fault("adding an export"))?;
    for (position, file) in (0i64..).zip(files) {
        sqlx::query("insert into export_files (export_id, position, name, blob, size_bytes) values (?, ?, ?, ?, ?)")
            .bind(export.as_str())
            .bind(position)
            .bind(&file.name)
            .bind(file.blob.as_str())
            .bind(row::stored(file.size_bytes))
            .execute(&mut **tx)
            .await
            .map_err(fault("adding a file of an export"))?;
    }
    Ok(())
}

impl Store {
    /// Makes a dataset of a score run that is there or still may come; β is in [0, 1].
    ///
    /// # Errors
    /// NotFound; Precondition when the run's job gave up.
    pub(crate) async fn insert_dataset(&self, run: &ScoreRunId, beta: f64) -> Result<Dataset> {
        let dataset = Dataset {
            id: DatasetId::new(),
            task_id: self.maker(JobKind::Score, "score run", run.as_str()).await?.task_id,
            score_run_id: run.clone(),
            beta,
            created_at: Millis::now(),
        };
        let mut tx = self.write().await?;
        insert(&mut tx, &dataset).await?;
        commit(tx).await?;
        Ok(dataset)
    }

    /// A dataset, whether or not its score run is finished.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn dataset(&self, id: &DatasetId) -> Result<Dataset> {
        let found: Option<DatasetRow> = sqlx::query_as("select * from datasets where id = ?")
            .bind(id.as_str())
            .fetch_optional(self.read())
            .await
            .map_err(fault("reading a dataset"))?;
        found.ok_or_else(|| Error::not_found("dataset", id))?.dataset()
    }

    /// A task's datasets, newest first.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn datasets(&self, task: &TaskId) -> Result<Vec<Dataset>> {
        let rows: Vec<DatasetRow> = sqlx::query_as("select * from datasets where task_id = ? order by id desc")
            .bind(task.as_str())
            .fetch_all(self.read())
            .await
            .map_err(fault("reading datasets"))?;
        rows.into_iter().map(DatasetRow::dataset).collect()
    }

    /// What each dataset holds, in order; `None` while its score run is not finished. Reads each run once, however
    /// many thresholds look at it.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn dataset_counts(&self, datasets: &[Dataset]) -> Result<Vec<Option<DatasetCounts>>> {
        let mut counts = vec![None; datasets.len()];
        let mut places: Vec<usize> = (0..datasets.len()).collect();
        places.sort_by_key(|&place| &datasets[place].score_run_id);
        for places in places.chunk_by(|&a, &b| datasets[a].score_run_id == datasets[b].score_run_id) {
            let run = match self.score_run(&datasets[places[0]].score_run_id).await {
                Ok(run) => run,
                Err(error) if error.kind() == crate::error::Kind::Precondition => continue,
                Err(error) => return Err(error),
            };
            let betas: Vec<f64> = places.iter().map(|&place| datasets[place].beta).collect();
            let kept = self.fill(&run.id, Histogram::new(1, &betas)).await?.kept();
            let expert_segments = self.run_counts(&run).await?.expert_segments;
            for (&place, kept) in places.iter().zip(kept) {
                counts[place] =
                    Some(DatasetCounts { kept_segments: kept.segments, kept_episodes: kept.episodes, expert_segments });
            }
        }
        Ok(counts)
    }

    /// Everything a dataset holds, by reference.
    ///
    /// # Errors
    /// NotFound; Precondition when its score run is not finished.
    pub(crate) async fn dataset_contents(&self, id: &DatasetId) -> Result<DatasetContents> {
        let dataset = self.dataset(id).await?;
        let run = self.score_run(&dataset.score_run_id).await?;
        let kept = self.kept(&run, dataset.beta).await?;
        Ok(DatasetContents {
            snapshot_id: run.snapshot_id.clone(),
            encoder_id: run.encoder_id.clone(),
            experts: run.expert_ids.clone(),
            kept,
            dataset,
            run,
        })
    }

    /// Every imperfect episode with its segments that β keeps, if any; rows come one by one.
    async fn kept(&self, run: &ScoreRun, beta: f64) -> Result<Vec<KeptEpisode>> {
        let mut rows = sqlx::query_as::<_, KeptRow>(
            "select episode_id, q, match_episode, match_step from episode_scores \
             where score_run_id = ? and role = 'imperfect' order by position",
        )
        .bind(run.id.as_str())
        .fetch(self.read());
        let mut kept = Vec::new();
        while let Some(found) = rows.try_next().await.map_err(fault("reading a dataset's segments"))? {
            kept.extend(found.kept(beta, &run.expert_ids)?);
        }
        Ok(kept)
    }

    /// The files of a finished export, in order.
    ///
    /// # Errors
    /// NotFound, or Precondition naming its job when that has not succeeded.
    pub(crate) async fn export_files(&self, id: &ExportId) -> Result<Vec<ExportFile>> {
        let there: i64 = sqlx::query_scalar("select count(*) from exports where id = ?")
            .bind(id.as_str())
            .fetch_one(self.read())
            .await
            .map_err(fault("reading an export"))?;
        if there == 0 {
            return Err(self.missing(JobKind::Export, "export", id.as_str()).await);
        }
        let rows: Vec<FileRow> =
            sqlx::query_as("select name, blob, size_bytes from export_files where export_id = ? order by position")
                .bind(id.as_str())
                .fetch_all(self.read())
                .await
                .map_err(fault("reading an export's files"))?;
        rows.into_iter().map(FileRow::file).collect()
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
mod tests;
