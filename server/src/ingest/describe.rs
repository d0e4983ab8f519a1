//! The sidecars of new recordings and of changed tasks.

use gleaner_recording::TaskSpec;

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

    /// Replaces the specification of a task, and its sidecar if it has one.
    ///
    /// # Errors
    /// NotFound; Exists; Precondition when episodes or results rest on what changes; Exhausted or Internal when the disk
    /// fails.
    pub(crate) async fn update_task(&self, name_or_id: &str, spec: &TaskSpec) -> Result<Task> {
        let id = self.store.task(name_or_id).await?.id;
        let (task, used) = self.store.update_task(&id, spec).await?;
        if used {
            // A crash before this leaves the sidecar of the earlier specification, which reads every episode too.
            let (blobs, id, json) = (self.blobs.clone(), task.id.clone(), Description::task(&task).to_json()?);
            off_runtime("writing a sidecar", move || blobs.describe_task(id.as_str(), &json)).await?;
        }
        Ok(task)
    }

    /// Deletes a task that nothing uses, and its sidecar.
    ///
    /// # Errors
    /// NotFound; Precondition while anything uses it; Internal when the disk fails.
    pub(crate) async fn delete_task(&self, name_or_id: &str) -> Result<()> {
        let id = self.store.task(name_or_id).await?.id;
        self.store.delete_task(&id).await?;
        let blobs = self.blobs.clone();
        off_runtime("removing a sidecar", move || blobs.forget_task(id.as_str())).await
    }
}
