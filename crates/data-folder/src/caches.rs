//! Files derived from recordings: decoded steps, and features of their segments. Each can be made again, so they are
//! removed when their total exceeds a limit or when other data needs their space, the least recently used first.
//!
//! A reader opens a file for each read, and has one that is gone made again, so no lock is needed. Must not depend on the
//! content of the files.

use std::{
    collections::BinaryHeap,
    fs::{File, FileTimes},
    io::ErrorKind,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
    time::{Duration, Instant, SystemTime},
};

use crate::{CACHE, FEATURES};
use gleaner_core::{
    error::{Error, Result},
    id::BlobId,
};

/// The files that one listing remembers to be removed next; their number bounds the memory of an eviction.
const REMEMBERED: usize = 1024;
/// The time for which a listing is used. Other processes write files too.
const LISTING_LASTS: Duration = Duration::from_secs(60);

/// The derived files of one data folder.
#[derive(Debug)]
pub struct Caches {
    folder: PathBuf,
    /// `None`: no limit.
    most_bytes: Option<u64>,
    listed: Mutex<Option<Listing>>,
}

/// A derived file.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Derived {
    /// The order of eviction: features before decoded steps, because they are of no use without them.
    steps: bool,
    /// The time of the last use, as far as the file system records it.
    pub used: SystemTime,
    /// Its path.
    pub path: PathBuf,
    /// The recording that it comes from.
    pub recording: BlobId,
    /// Its size.
    pub bytes: u64,
    /// The time of the last write.
    pub made: SystemTime,
}

/// What a listing of the folder found, kept up to date by this process's own writes.
#[derive(Debug)]
struct Listing {
    at: Instant,
    bytes: u64,
    /// The next files to remove, the last one first.
    next: Vec<Derived>,
}

/// Notes that a derived file is in use. A failure is not an error: the file then looks older than it is.
pub fn note_use(path: &Path) {
    let _ = File::open(path).and_then(|file| file.set_times(FileTimes::new().set_accessed(SystemTime::now())));
}

impl Caches {
    /// The derived files of a data folder, without a limit on their size.
    pub fn at(data_dir: &Path) -> Self {
        Self { folder: data_dir.join(CACHE), most_bytes: None, listed: Mutex::default() }
    }

    /// The same files with a limit on their total size.
    #[must_use]
    pub fn limited(self, most_bytes: Option<u64>) -> Self {
        Self { most_bytes, ..self }
    }

    /// Calls `visit` for each derived file, in no order; other files are skipped.
    ///
    /// # Errors
    /// Internal when the folder cannot be read; the errors of `visit`.
    pub fn visit(&self, mut visit: impl FnMut(Derived) -> Result<()>) -> Result<()> {
        let entries = match std::fs::read_dir(&self.folder) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
            entries => entries.map_err(|error| self.fault(error))?,
        };
        for entry in entries {
            match Derived::read(entry.map_err(|error| self.fault(error))?.path()) {
                Ok(Some(file)) => visit(file)?,
                Ok(None) => {}
                // Replaced or removed since the listing.
                Err(error) if error.kind() == ErrorKind::NotFound => {}
                Err(error) => return Err(self.fault(error)),
            }
        }
        Ok(())
    }

    /// Removes a derived file and returns whether it was there.
    ///
    /// # Errors
    /// Internal when the disk fails.
    pub fn remove(&self, file: &Derived) -> Result<bool> {
        match std::fs::remove_file(&file.path) {
            Ok(()) => Ok(true),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(false),
            Err(error) => Err(self.fault(error)),
        }
    }

    /// Removes files until `bytes` more fit below the limit, or all are removed: a file above the limit is kept alone.
    /// Returns the bytes removed. To be called before each new file; counts it.
    ///
    /// # Errors
    /// Internal when the disk fails.
    pub fn fit(&self, bytes: u64) -> Result<u64> {
        let Some(most) = self.most_bytes else { return Ok(0) };
        let mut listed = self.listed.lock().unwrap_or_else(PoisonError::into_inner);
        if listed.as_ref().is_none_or(|listing| listing.at.elapsed() >= LISTING_LASTS) {
            *listed = Some(self.list()?);
        }
        let there = listed.as_ref().map_or(0, |listing| listing.bytes);
        let freed = self.remove_oldest(&mut listed, there.saturating_add(bytes).saturating_sub(most), None)?;
        if let Some(listing) = listed.as_mut() {
            listing.bytes = listing.bytes.saturating_add(bytes);
        }
        Ok(freed)
    }

    /// Counts a new file by its own size, where [`Caches::fit`] expected `expected` bytes: others are removed if they exceed
    /// the limit with it.
    ///
    /// # Errors
    /// Internal when the disk fails.
    pub fn count(&self, path: &Path, expected: u64) -> Result<()> {
        let Some(most) = self.most_bytes else { return Ok(()) };
        let bytes = std::fs::metadata(path).map_err(|error| self.fault(error))?.len();
        let mut listed = self.listed.lock().unwrap_or_else(PoisonError::into_inner);
        let there = match listed.as_mut().filter(|listing| listing.at.elapsed() < LISTING_LASTS) {
            Some(listing) => {
                listing.bytes = listing.bytes.saturating_sub(expected).saturating_add(bytes);
                listing.bytes
            }
            None => listed.insert(self.list()?).bytes,
        };
        self.remove_oldest(&mut listed, there.saturating_sub(most), Some(path)).map(drop)
    }

    /// Removes at least `bytes`, if there are as many, and returns the bytes removed.
    ///
    /// # Errors
    /// Internal when the disk fails.
    pub fn evict(&self, bytes: u64) -> Result<u64> {
        self.remove_oldest(&mut self.listed.lock().unwrap_or_else(PoisonError::into_inner), bytes, None)
    }

    /// As [`Caches::evict`]; the file `kept` stays.
    fn remove_oldest(&self, listed: &mut Option<Listing>, bytes: u64, kept: Option<&Path>) -> Result<u64> {
        let (mut freed, mut removed, mut in_vain) = (0_u64, 0_u64, false);
        while freed < bytes {
            let Some(file) = listed.as_mut().and_then(|listing| listing.next.pop()) else {
                let listing = listed.insert(self.list()?);
                if in_vain || listing.next.is_empty() {
                    break;
                }
                in_vain = true;
                continue;
            };
            if kept == Some(file.path.as_path()) {
                continue;
            }
            // It may have been used or written again since the listing, or removed by another process.
            let gone = match Derived::read(file.path.clone()) {
                Ok(Some(now)) if now.used <= file.used => {
                    if self.remove(&file)? {
                        in_vain = false;
                        removed += 1;
                        freed = freed.saturating_add(file.bytes);
                    }
                    true
                }
                Ok(_) => false,
                Err(error) => error.kind() == ErrorKind::NotFound,
            };
            if let Some(listing) = listed.as_mut().filter(|_| gone) {
                listing.bytes = listing.bytes.saturating_sub(file.bytes);
            }
        }
        if removed > 0 {
            tracing::info!(caches.removed = removed, caches.bytes = freed, "derived files made room");
        }
        Ok(freed)
    }

    /// The size of all files, and those to remove first.
    fn list(&self) -> Result<Listing> {
        let (mut bytes, mut oldest) = (0_u64, BinaryHeap::with_capacity(REMEMBERED + 1));
        self.visit(|file| {
            bytes = bytes.saturating_add(file.bytes);
            oldest.push(file);
            if oldest.len() > REMEMBERED {
                oldest.pop();
            }
            Ok(())
        })?;
        let mut next = oldest.into_sorted_vec();
        next.reverse();
        Ok(Listing { at: Instant::now(), bytes, next })
    }

    fn fault(&self, error: std::io::Error) -> Error {
        Error::internal(format!("removing derived files from {}", self.folder.display()), error)
    }
}

impl Derived {
    /// Whether it holds features, not decoded steps.
    pub fn is_features(&self) -> bool {
        !self.steps
    }

    /// `None` for a file that is not derived.
    fn read(path: PathBuf) -> std::io::Result<Option<Self>> {
        let recording = path.file_stem().and_then(|name| name.to_str()?.split('-').next()?.to_owned().try_into().ok());
        let Some(recording) = recording else { return Ok(None) };
        let file = std::fs::metadata(&path)?;
        let made = file.modified()?;
        // Some file systems do not record reads; then the oldest are removed first.
        let used = file.accessed().map_or(made, |read| read.max(made));
        let steps = path.extension().is_none_or(|extension| extension != FEATURES);
        Ok(Some(Self { steps, used, path, recording, bytes: file.len(), made }))
    }
}

#[cfg(test)]
mod tests;
