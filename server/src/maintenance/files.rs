//! Compares the files of a data folder with the rows that name them.

use std::{
    collections::HashSet,
    fs, io,
    path::Path,
    time::{Duration, Instant},
};

use super::{report::Report, worth};
use crate::{
    blobs::Blobs,
    domain::{episode::Upload, id::BlobId},
    error::{Error, Kind, Result},
    ingest::part_path,
    store::{NamedBlob, Store},
};

/// The interval of progress lines on standard error.
const REPORT_EVERY: Duration = Duration::from_secs(2);

/// The inputs of the comparison and its report.
pub(super) struct Files<'a> {
    pub(super) store: &'a Store,
    pub(super) data_dir: &'a Path,
    pub(super) report: &'a mut Report,
}

/// A blob and every row that needs it.
pub(super) struct Needed {
    pub(super) blob: BlobId,
    pub(super) by: Vec<String>,
    pub(super) size_bytes: Option<u64>,
}

/// Writes progress lines to standard error.
pub(super) struct Progress {
    what: &'static str,
    done: usize,
    all: usize,
    reported: Instant,
}

impl Progress {
    pub(super) fn new(what: &'static str, all: usize) -> Self {
        Self { what, done: 0, all, reported: Instant::now() }
    }

    #[expect(clippy::print_stderr, reason = "the command's progress; its result is on standard output")]
    pub(super) fn one_more(&mut self) {
        self.done += 1;
        if self.reported.elapsed() > REPORT_EVERY {
            eprintln!("{} of {} {}", self.done, self.all, self.what);
            self.reported = Instant::now();
        }
    }
}

impl Files<'_> {
    /// Checks every blob named by a row: present, of the right size and, if `digests`, with the right content. Records
    /// files without a row as notes.
    pub(super) async fn blobs(&mut self, digests: bool) -> Result<()> {
        let blobs = Blobs::at(self.data_dir)?;
        let needed = grouped(self.store.named_blobs().await?);
        let mut progress = Progress::new("blobs checked", needed.len());
        for needed in &needed {
            progress.one_more();
            self.report.blobs += 1;
            match inspect(&blobs, needed, digests) {
                Ok(bytes) => self.report.bytes += bytes,
                // Its row may have been removed since.
                Err(problem) => {
                    if self.store.names_blob(&needed.blob).await? {
                        let by = needed.by.join(", ");
                        self.report.problem(format!("blob {}", needed.blob), format!("{problem}; needed by {by}"));
                    }
                }
            }
        }
        let named: HashSet<&BlobId> = needed.iter().map(|needed| &needed.blob).collect();
        for found in blobs.list()? {
            match found.id {
                Some(id) if named.contains(&id) => {}
                Some(id) => self.report.note(
                    format!("blob {id}"),
                    format!("its {} bytes have no row; the server's sweep moves it to the trash", found.size_bytes),
                ),
                None => self.report.note(found.path.display().to_string(), "is not a blob; the server ignores it"),
            }
        }
        Ok(())
    }

    /// Checks that open uploads have their acknowledged bytes.
    pub(super) async fn uploads(&mut self) -> Result<()> {
        let blobs = Blobs::at(self.data_dir)?;
        for upload in self.store.uploads().await? {
            let Some(lost) = lost(self.data_dir, &blobs, &upload)? else { continue };
            // It may have been finished since the listing.
            match self.store.upload(&upload.id).await {
                Err(error) if error.kind() == Kind::NotFound => {}
                Err(error) => return Err(error),
                Ok(_) => self.report.problem(upload.id.to_string(), lost),
            }
        }
        Ok(())
    }

    /// Records the blobs in the trash as notes; a recording that was not deleted by a user stays there.
    pub(super) async fn trash(&mut self) -> Result<()> {
        let blobs = Blobs::at(self.data_dir)?;
        for found in blobs.list_trash()? {
            let described = found.id.as_ref().map(|id| blobs.descriptions(id)).transpose()?.unwrap_or_default();
            let stays = worth::stays(&found, &described);
            let named = match &found.id {
                Some(id) => blobs.size(id)?.is_none() && self.store.names_blob(id).await?,
                None => false,
            };
            let until = match stays {
                _ if named => "is in the trash, and a row names it; the server's next sweep restores it",
                true => "stays in the trash: it was not deleted by a person. `gleaner-server rebuild` restores it",
                false => "is in the trash; the server's sweep deletes it after --trash-days",
            };
            self.report.note(found.path.display().to_string(), until);
        }
        Ok(())
    }

    /// Records as notes the recordings of sessions that are not stored yet, or are unusable.
    pub(super) fn recordings(&mut self) -> Result<()> {
        let folder = self.data_dir.join("rollouts");
        for (folder, what) in [
            (folder.join("unusable"), "is unusable and was set aside"),
            (
                folder,
                "is not stored as an episode yet; the server stores it at its next start or when its session ends",
            ),
        ] {
            for path in entries(&folder)? {
                if path.extension().is_some_and(|extension| extension == "mcap") {
                    self.report.note(path.display().to_string(), format!("a session's recording that {what}"));
                }
            }
        }
        Ok(())
    }
}

/// Each blob once, with all rows that need it.
pub(super) fn grouped(named: Vec<NamedBlob>) -> Vec<Needed> {
    let mut needed: Vec<Needed> = Vec::new();
    for NamedBlob { blob, needed_by, size_bytes } in named {
        match needed.last_mut() {
            Some(last) if last.blob == blob => {
                last.by.push(needed_by);
                last.size_bytes = last.size_bytes.or(size_bytes);
            }
            Some(_) | None => needed.push(Needed { blob, by: vec![needed_by], size_bytes }),
        }
    }
    needed
}

/// The size of an intact blob, or a description of its fault.
fn inspect(blobs: &Blobs, needed: &Needed, digests: bool) -> std::result::Result<u64, String> {
    let size = match blobs.size(&needed.blob) {
        Ok(Some(size)) => size,
        Ok(None) => return Err("is not there".to_owned()),
        Err(error) => return Err(format!("cannot be read: {error}")),
    };
    if let Some(expected) = needed.size_bytes.filter(|&expected| expected != size) {
        return Err(format!("is damaged: it has {size} bytes, not {expected}"));
    }
    if digests {
        match blobs.digest(&needed.blob) {
            Ok(digest) if digest == needed.blob => {}
            Ok(_) => return Err("is damaged: its content does not match its name".to_owned()),
            Err(error) => return Err(format!("cannot be read: {error}")),
        }
    }
    Ok(size)
}

/// The missing part of an upload, if any.
fn lost(data_dir: &Path, blobs: &Blobs, upload: &Upload) -> Result<Option<String>> {
    let path = part_path(data_dir, &upload.id);
    let size = match fs::metadata(&path) {
        Ok(file) => Some(file.len()),
        Err(error) if error.kind() == io::ErrorKind::NotFound => None,
        Err(error) => return Err(Error::internal(format!("reading {}", path.display()), error)),
    };
    // A crash between the move and the commit of the row leaves the recording among the blobs.
    let placed = upload.committed == upload.size_bytes && blobs.size(&upload.blake3)?.is_some();
    if size.is_some_and(|size| size >= upload.committed) || placed {
        return Ok(None);
    }
    let has = size.map_or_else(|| "has no file".to_owned(), |size| format!("has only {size} bytes on disk"));
    Ok(Some(format!("{has}, and {} were acknowledged", upload.committed)))
}

/// The entries of a folder; none if it does not exist.
pub(super) fn entries(folder: &Path) -> Result<Vec<std::path::PathBuf>> {
    let fault = |error| Error::internal(format!("listing {}", folder.display()), error);
    match fs::read_dir(folder) {
        Ok(found) => found.map(|entry| entry.map(|entry| entry.path())).collect::<io::Result<_>>().map_err(fault),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
        Err(error) => Err(fault(error)),
    }
}
