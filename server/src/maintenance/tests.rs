//! Fixtures: a data folder with an episode, an encoder and a policy, each with its blob.

mod backing_up;
mod checking;
mod exports;
mod losing;
mod rebuilding;
mod sweeping;

use std::path::Path;

use tempfile::TempDir;

use super::{check::check_folder, report::Report};
use crate::{
    blobs::Blobs,
    config::{CheckConfig, DatabaseConfig},
    domain::{episode::Outcome, id::BlobId, task::Task},
    ingest::{Ingest, testing::open_on},
    store::{
        Store,
        testing::{self, results},
    },
};

pub(super) struct Lab {
    pub(super) dir: TempDir,
    pub(super) store: Store,
    pub(super) blobs: Blobs,
    pub(super) task: Task,
    pub(super) ingest: Ingest,
    /// The blob of an episode.
    pub(super) recording: BlobId,
    /// The blob of an encoder and a policy.
    pub(super) checkpoint: BlobId,
}

/// One episode of each role, an encoder and a policy with the same content, all jobs finished.
pub(super) async fn lab() -> Lab {
    // The commands work on SQLite in the folder.
    let (dir, store) = testing::sqlite().await;
    let blobs = Blobs::open(dir.path()).unwrap();
    let task = testing::task(&store).await;
    let mut recording = None;
    for (content, outcome) in [(b"success", Outcome::Success), (b"failure", Outcome::Failure)] {
        let upload = crate::domain::episode::Upload { outcome, ..testing::upload(&task, content) };
        recording = Some(blobs.put(content).unwrap());
        store.insert_upload(&upload, None).await.unwrap();
        store.finish_upload(&upload, &testing::inspected(&task, &upload)).await.unwrap();
    }
    let encoder = results::encoder(&store, &task).await;
    let checkpoint = blobs.put(b"encoder").unwrap();
    let policy = results::policy(&store, &task, &encoder, checkpoint.clone()).await;
    for job in [&encoder.job_id, policy.job_id().unwrap()] {
        results::set_state(&store, job, crate::domain::job::JobState::Succeeded, "").await;
    }
    let ingest = open_on(&dir, &store).await;
    Lab { dir, store, blobs, task, ingest, recording: recording.unwrap(), checkpoint }
}

pub(super) async fn checked(data_dir: &Path, fast: bool) -> Report {
    check_folder(&CheckConfig { data_dir: data_dir.to_owned(), fast, json: false, database: DatabaseConfig::default() })
        .await
        .unwrap()
}
