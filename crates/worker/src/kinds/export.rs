//! Export: the files of a dataset in a format of `gleaner-formats`, each a blob. Where storing a file is a rename, the files
//! become blobs once all are written, so that an export that fails leaves no blob without a row.

use std::{
    collections::BTreeMap,
    fs,
    os::unix::fs::MetadataExt as _,
    path::{Path, PathBuf},
};

use gleaner_core::{
    TaskSpec,
    dataset::{ExportFile, ExportSpec},
    error::Error,
    id::BlobId,
    work::{Inputs, Made},
};
use gleaner_data_folder::{
    BLOBS,
    blobs::{self, Blobs},
};
use gleaner_formats::{Export, Numbers, Piece, Problem, pieces};
use gleaner_learn::{Monitor as _, SourceError, StepSource as _};

use super::Work;
use crate::{
    episodes::{Episodes, Stored},
    failure::Failure,
    monitor::Watcher,
};

/// Writes the files of a dataset.
pub(super) fn perform(work: &mut Work, spec: ExportSpec) -> Result<Made, Failure> {
    work.monitor.phase("exporting");
    let folder =
        tempfile::tempdir_in(work.data_dir.join("tmp")).map_err(|error| Error::internal("making a folder", error))?;
    let episodes = work.episodes();
    let Inputs { experts, kept, .. } = &mut work.inputs;
    let pieces = pieces(std::mem::take(experts), std::mem::take(kept), spec.whole)?;
    let mut files = Files {
        folder: folder.path(),
        blobs: &work.blobs,
        inputs: &work.inputs,
        monitor: &mut work.monitor,
        episodes,
        pieces,
        open: None,
        files: Vec::new(),
        written: keeps_files(&work.data_dir).then(Vec::new),
        done: 0,
    };
    gleaner_formats::write(spec, &mut files)?;
    files.store()?;
    Ok(Made::Files(files.files))
}

/// Whether files wait in their folder until all are written: where they would be copied to a bucket or another disk, they
/// are stored one by one, so that the folder's disk does not hold all of them.
fn keeps_files(data_dir: &Path) -> bool {
    let disk = |folder: &str| fs::metadata(data_dir.join(folder)).map(|folder| folder.dev()).ok();
    !blobs::has_bucket(data_dir) && disk("tmp").is_some() && disk("tmp") == disk(BLOBS)
}

/// The steps and files of an export, in the server's data directory.
struct Files<'a> {
    folder: &'a Path,
    blobs: &'a Blobs,
    inputs: &'a Inputs,
    monitor: &'a mut Watcher,
    episodes: Episodes,
    pieces: Vec<Piece>,
    /// The piece that was read last, with its episode.
    open: Option<(usize, Stored)>,
    files: Vec<ExportFile>,
    /// The files that are to be stored once all are written; `None` where each is stored at once.
    written: Option<Vec<(BlobId, PathBuf)>>,
    done: usize,
}

impl Files<'_> {
    fn stored(&mut self, piece: usize) -> Result<&Stored, Failure> {
        let stored = match self.open.take() {
            Some((open, stored)) if open == piece => stored,
            Some(_) | None => self.episodes.stored(self.pieces[piece].episode())?,
        };
        Ok(&self.open.insert((piece, stored)).1)
    }

    /// Waits while the disk is nearly full: files of an export are written without a check of their own, and must not take
    /// the room of the database.
    fn wait_for_room(&self) -> Result<(), Failure> {
        match self.monitor.retry_while_full(|blobs| blobs.make_room(0)) {
            Err(_) if self.monitor.cancelled() => Err(Failure::Cancelled),
            waited => Ok(waited?),
        }
    }

    fn keep(&mut self, name: &str, blob: BlobId) -> Result<(), Failure> {
        let size = self.blobs.size(&blob)?.ok_or_else(|| Error::not_found("blob", &blob))?;
        self.files.push(ExportFile { name: name.to_owned(), blob, size_bytes: size });
        Ok(())
    }

    /// Stores the files that waited.
    fn store(&mut self) -> Result<(), Failure> {
        for (blob, path) in self.written.take().into_iter().flatten() {
            if self.monitor.cancelled() {
                return Err(Failure::Cancelled);
            }
            self.monitor.retry_while_full(|blobs| blobs.place(&blob, &path))?;
        }
        Ok(())
    }
}

impl Export for Files<'_> {
    type Error = Failure;

    fn task(&self) -> &TaskSpec {
        &self.inputs.task
    }

    fn origin(&self) -> &BTreeMap<String, String> {
        &self.inputs.origin
    }

    fn segment_length(&self) -> u32 {
        self.inputs.segment_length
    }

    fn pieces(&self) -> &[Piece] {
        &self.pieces
    }

    fn recording(&self, piece: usize) -> Result<impl AsRef<Path>, Failure> {
        Ok(self.blobs.fetched(&self.pieces[piece].episode().recording)?)
    }

    fn numbers(&mut self, piece: usize) -> Result<Numbers, Failure> {
        let steps = self.pieces[piece].steps.clone();
        let numbers = self.stored(piece)?.numbers(steps)?;
        Ok(Numbers { proprioception: numbers.proprioception, action: numbers.action })
    }

    fn frames(&mut self, piece: usize, step: usize) -> Result<Vec<u8>, Failure> {
        let mut frames = vec![0; gleaner_recording::frame_bytes_per_step(&self.inputs.task)];
        self.stored(piece)?.frames(step..step + 1, &mut frames)?;
        Ok(frames)
    }

    fn folder(&self) -> &Path {
        self.folder
    }

    fn finished(&mut self, name: &str) -> Result<(), Failure> {
        let path = self.folder.join(name);
        let Some(written) = &mut self.written else {
            let blob = self.monitor.retry_while_full(|blobs| blobs.put_file(&path))?;
            return self.keep(name, blob);
        };
        // Now, while the file is in the memory of the system.
        let blob = blobs::digest(&path)?;
        let file =
            fs::metadata(&path).map_err(|error| Error::internal(format!("reading {}", path.display()), error))?;
        written.push((blob.clone(), path));
        self.files.push(ExportFile { name: name.to_owned(), blob, size_bytes: file.len() });
        Ok(())
    }

    fn finished_recording(&mut self, piece: usize, name: &str) -> Result<(), Failure> {
        self.keep(name, self.pieces[piece].episode().recording.clone())
    }

    fn advance(&mut self) -> Result<(), Failure> {
        self.done += 1;
        let count = |length: usize| u64::try_from(length).unwrap_or(u64::MAX);
        self.monitor.progress(count(self.done), count(self.pieces.len()), &[]);
        if self.monitor.cancelled() { Err(Failure::Cancelled) } else { self.wait_for_room() }
    }
}

impl From<Problem> for Failure {
    fn from(problem: Problem) -> Self {
        match problem {
            Problem::Recording { episode, source } => Self::recording(&episode, &source),
            Problem::Unfit(_) => Self::Permanent(problem.to_string()),
            Problem::Io { .. } | Problem::Input(_) => Self::Retryable(problem.to_string()),
        }
    }
}

impl From<SourceError> for Failure {
    fn from(error: SourceError) -> Self {
        Self::Retryable(error.to_string())
    }
}

#[cfg(test)]
mod tests;
