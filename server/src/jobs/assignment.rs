//! The input of a worker: what its kind of job needs, and the checkpoint to resume from.

use std::collections::BTreeMap;

use futures::Stream;

use super::{Jobs, input_episodes::PART, kinds};
use crate::{
    domain::{
        id::BlobId,
        job::Job,
        work::{InputPart, Inputs},
    },
    error::{Error, Result},
};

impl Jobs {
    /// The input of a running job without its episodes, which [`Jobs::input_parts`] streams.
    ///
    /// # Errors
    /// When the database cannot be read, or a required input is missing.
    pub(crate) async fn inputs(&self, job: &Job) -> Result<Inputs> {
        let task = self.0.store.task_by_id(&job.task_id).await?;
        let mut inputs = Inputs {
            task: task.spec,
            experts: Vec::new(),
            imperfect: Vec::new(),
            kept: Vec::new(),
            encoder: None,
            checkpoint: self.whole_checkpoint(job).await?,
            segment_length: 0,
            origin: BTreeMap::new(),
            policy: None,
            base: None,
        };
        kinds::add_inputs(self, &job.spec, &mut inputs).await?;
        Ok(inputs)
    }

    /// The episodes of a running job, in parts that each fit a message.
    ///
    /// # Errors
    /// Precondition when a recording was permanently deleted; when the database cannot be read.
    pub(crate) async fn input_parts(&self, job: &Job) -> Result<impl Stream<Item = Result<InputPart>> + Send + use<>> {
        self.parts(kinds::sources(self, &job.spec).await?, PART).await
    }

    /// The checkpoint to resume from. A missing or damaged checkpoint is never used: it is removed together with the
    /// reports up to it, and the job starts again with the same result. One that a bucket has lost is sent again from a
    /// sound copy.
    async fn whole_checkpoint(&self, job: &Job) -> Result<Option<BlobId>> {
        let Some(blob) = &job.checkpoint else { return Ok(None) };
        let (blobs, id) = (self.0.blobs.clone(), blob.clone());
        let looking = move || {
            let found = blobs.size(&id)?.map(|_| blobs.digest(&id)).transpose()?;
            if found.as_ref() == Some(&id) { Ok(found) } else { Ok(blobs.resend(&id)?.then_some(id).or(found)) }
        };
        let found = tokio::task::spawn_blocking(looking).await;
        let found = found.map_err(|error| Error::internal("looking at a checkpoint", error))??;
        if found.as_ref() == Some(blob) {
            return Ok(job.checkpoint.clone());
        }
        let damage = if found.is_some() { "is damaged" } else { "is gone" };
        tracing::error!(job.id = %job.id, blob.id = %blob, damage, "a job's checkpoint cannot be used: the job starts from the beginning");
        self.0.store.drop_checkpoint(&job.id, blob).await?;
        self.0.forget(blob.clone()).await;
        Ok(None)
    }
}
