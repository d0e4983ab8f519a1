//! The work of each kind of job: one file for each, and the list of them in [`Work::perform`].
//!
//! A kind opens its inputs, calls the learning crate, and stores its result as blobs. It reports to the monitor and
//! resumes from the checkpoint of an earlier attempt.

mod evaluate;
mod export;
mod pretrain;
mod score;
mod train;

use std::path::PathBuf;

use gleaner_core::{
    ImageWeights,
    id::BlobId,
    order::JobOrder,
    score::EpisodeScores,
    work::{FrozenRun, Inputs, Made},
};
use gleaner_data_folder::{blobs::Blobs, fail_point};

use crate::{episodes::Episodes, failure::Failure, monitor::Watcher, ranks::Ranks};

/// A job's work, ready to begin on a thread of its own.
pub(crate) struct Work {
    /// The way to the other processes of the attempt.
    pub(crate) ranks: Ranks,
    /// The server's data directory.
    pub(crate) data_dir: PathBuf,
    /// Threads of the tensor library.
    pub(crate) threads: u32,
    /// The store of results.
    pub(crate) blobs: Blobs,
    /// The episodes and blobs to work on.
    pub(crate) inputs: Inputs,
    /// The run that a score job extends.
    pub(crate) base: Option<Base>,
    /// The channel to the reporter.
    pub(crate) monitor: Watcher,
}

/// A score run to extend.
pub(crate) struct Base {
    /// Its frozen values.
    pub(crate) frozen: FrozenRun,
    /// Its scores, without q.
    pub(crate) scores: Vec<EpisodeScores>,
}

impl Work {
    /// Does the work of a kind. This is the list of kinds.
    ///
    /// `None` for a rank that does not lead.
    pub(crate) fn perform(mut self, order: JobOrder) -> Result<Option<Made>, Failure> {
        let peers = std::mem::replace(&mut self.ranks, Ranks::Alone).join()?;
        self.monitor.phase("reading episodes");
        match order {
            JobOrder::Pretrain { spec, .. } => pretrain::perform(&mut self, spec, peers),
            JobOrder::Score { spec, .. } => score::perform(&mut self, spec, peers),
            JobOrder::Train { spec, .. } => train::perform(&mut self, spec, peers),
            JobOrder::Export { spec, .. } => export::perform(&mut self, spec).map(Some),
            JobOrder::Evaluate { spec, .. } => evaluate::perform(&mut self, &spec, peers),
        }
    }

    fn episodes(&self) -> Episodes {
        Episodes::new(self.blobs.clone(), self.inputs.task.clone())
    }

    /// The checkpoint of an earlier attempt, if any.
    fn resume(&self) -> Result<Option<Vec<u8>>, Failure> {
        Ok(self.inputs.checkpoint.as_ref().map(|blob| self.blobs.get(blob)).transpose()?)
    }

    /// The bytes of a blob that the assignment names.
    fn input(&self, what: &str, blob: Option<&BlobId>) -> Result<Vec<u8>, Failure> {
        match blob {
            Some(blob) => Ok(self.blobs.get(blob)?),
            None => Err(Failure::Retryable(format!("the server named no {what}"))),
        }
    }

    /// The file that an image encoder begins with, if the settings name one.
    fn image_weights(&self, named: &ImageWeights) -> Result<Option<Vec<u8>>, Failure> {
        named.name().map(|_| self.input("digest of the image weights", named.digest())).transpose()
    }

    fn keep(&self, bytes: &[u8]) -> Result<BlobId, Failure> {
        let blob = self.monitor.retry_while_full(|blobs| blobs.put(bytes))?;
        fail_point::pass("result.blob_kept");
        Ok(blob)
    }
}
