//! The files of pretrained weights that jobs name: found in a folder of the server and stored as blobs when jobs are
//! queued, so that a job keeps its content and workers read it like any other input. Must not depend on what the files
//! hold; the learning crate checks it.

use std::{fs, path::Path, path::PathBuf};

use gleaner_core::ImageWeights;

use super::Jobs;
use crate::{
    blobs::Blobs,
    domain::{
        id::BlobId,
        order::{JobOrder, Plan},
        schedule::PipelineSpec,
    },
    error::{Error, Result},
};

/// Largest file, in bytes: three times the size of ResNet-34.
const LARGEST: u64 = 256 << 20;
/// Most names of files in an error.
const LISTED: usize = 20;

impl Jobs {
    /// The plan with the digests of the files that its jobs begin with, all of which are blobs. The caller holds
    /// `Blobs::naming` until the jobs have rows.
    ///
    /// # Errors
    /// Precondition when the server has no such file, or one of other content than the job names; Exhausted when the
    /// disk is nearly full.
    pub(super) async fn with_stored_weights(&self, mut plan: Plan) -> Result<Plan> {
        for job in &mut plan.jobs {
            let named = job.spec.image_weights().map_err(|problem| Error::invalid(&problem.field, problem.message))?;
            if let Some(stored) = self.stored_weights(&named).await? {
                job.spec = job.spec.clone().with_image_weights(stored);
            }
        }
        Ok(plan)
    }

    /// Checks the file that a pretraining begins with, before a snapshot is taken for it: snapshots of refused orders,
    /// such as those of a schedule that tries again and again, would stay.
    ///
    /// # Errors
    /// As for [`Jobs::with_stored_weights`].
    pub(super) async fn expect_weights(&self, order: &JobOrder) -> Result<()> {
        match order {
            JobOrder::Pretrain { spec, .. } => self.stored_weights(&spec.image_weights).await.map(drop),
            JobOrder::Score { .. } | JobOrder::Train { .. } | JobOrder::Export { .. } | JobOrder::Evaluate { .. } => {
                Ok(())
            }
        }
    }

    /// The same for every job of a pipeline.
    ///
    /// # Errors
    /// As for [`Jobs::with_stored_weights`].
    pub(super) async fn expect_weights_of_pipeline(&self, pipeline: &PipelineSpec) -> Result<()> {
        self.stored_weights(&pipeline.pretrain.image_weights).await?;
        if let Some(train) = &pipeline.train {
            let named = train.image_weights().map_err(|problem| Error::invalid(&problem.field, problem.message))?;
            self.stored_weights(&named).await?;
        }
        Ok(())
    }

    /// The name of a file with its digest, whose content is a blob; `None` if no file is named.
    async fn stored_weights(&self, named: &ImageWeights) -> Result<Option<ImageWeights>> {
        let Some(name) = named.name().map(str::to_owned) else { return Ok(None) };
        let (folder, blobs) = (self.0.config.jobs.image_weights_dir.clone(), self.0.blobs.clone());
        let wanted = named.digest().cloned();
        let stored = move || stored(folder.as_deref(), &blobs, &name, wanted);
        let stored = tokio::task::spawn_blocking(stored).await;
        let digest = stored.map_err(|error| Error::internal("storing image weights", error))??;
        Ok(Some(named.clone().with_digest(digest)))
    }
}

/// Stores the file `name` of the folder as a blob, unless the blob exists; with `wanted`, only that content.
fn stored(folder: Option<&Path>, blobs: &Blobs, name: &str, wanted: Option<BlobId>) -> Result<BlobId> {
    if let Some(wanted) = &wanted
        && blobs.size(wanted)?.is_some()
    {
        return Ok(wanted.clone());
    }
    let path = find(folder, name)?;
    let fault = |error| Error::internal(format!("reading {}", path.display()), error);
    let size = fs::metadata(&path).map_err(fault)?.len();
    if size > LARGEST {
        return Err(Error::precondition(format!(
            "image_weights: {name} on the server has {size} bytes, weights have at most {LARGEST}; name another file"
        )));
    }
    let bytes = fs::read(&path).map_err(fault)?;
    let found = BlobId::from(blake3::hash(&bytes));
    if let Some(wanted) = wanted.filter(|wanted| *wanted != found) {
        return Err(Error::precondition(format!(
            "image_weights: {name} on the server has the BLAKE3 digest {}, not {}; put the file with that digest back, or \
             leave the digest out",
            found.as_str(),
            wanted.as_str()
        )));
    }
    if blobs.size(&found)?.is_none() {
        blobs.put(&bytes)?;
    }
    Ok(found)
}

/// The path of the file of this name: one of the folder's own entries, so that a caller's text never becomes a path.
fn find(folder: Option<&Path>, name: &str) -> Result<PathBuf> {
    let folder = folder.ok_or_else(|| {
        Error::precondition(format!(
            "image_weights: the server has no folder of weights, in which {name} could be; start it with \
             --image-weights-dir"
        ))
    })?;
    let fault = |error| Error::internal(format!("listing {}", folder.display()), error);
    let mut names = Vec::new();
    for entry in fs::read_dir(folder).map_err(fault)? {
        let entry = entry.map_err(fault)?;
        // Names that a job could not have are not listed either.
        let weights = entry.file_name().into_string().ok().and_then(|name| ImageWeights::try_from(name).ok());
        let plain = weights.as_ref().filter(|weights| weights.digest().is_none() && entry.path().is_file());
        let found = plain.and_then(ImageWeights::name);
        match found {
            Some(found) if found == name => return Ok(entry.path()),
            Some(other) => names.push(other.to_owned()),
            None => {}
        }
    }
    names.sort();
    names.truncate(LISTED);
    let listed = if names.is_empty() { "is empty".to_owned() } else { format!("has {}", names.join(", ")) };
    Err(Error::precondition(format!(
        "image_weights: {name} is not in the server's --image-weights-dir, which {listed}"
    )))
}

#[cfg(test)]
mod tests;
