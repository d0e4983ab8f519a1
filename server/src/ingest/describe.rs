//! The sidecar of a new recording, on disk before its row.

use super::{Ingest, off_runtime};
use crate::{
    domain::{description::Description, episode::InspectedEpisode, task::Task},
    error::Result,
};

impl Ingest {
    /// Writes the sidecars of an episode and its task before the row: a lost database is rebuilt from them.
    pub(super) async fn describe(&self, task: &Task, inspected: &InspectedEpisode, author: &str) -> Result<()> {
        let (id, recording) = (inspected.episode.id.clone(), inspected.episode.recording.clone());
        let (task_id, task) = (task.id.clone(), Description::task(task).to_json()?);
        let (blobs, json) = (self.blobs.clone(), Description::recording(inspected, author).to_json()?);
        off_runtime("writing a sidecar", move || {
            blobs.describe_task(task_id.as_str(), &task)?;
            blobs.describe(&recording, id.as_str(), &json)
        })
        .await
    }
}
