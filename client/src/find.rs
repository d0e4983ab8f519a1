//! Recordings found in folders, and what was skipped there because it cannot be sent.
//!
//! Reads the file system; must not know a server. A link to a regular file stands for that file, wherever it lies. Links to
//! folders are not followed, because one to a folder above would never end.

use std::collections::BTreeSet;
use std::fs::DirEntry;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::error::{ClientError, Result};
use crate::parts::Rosbag;
use crate::{file, foreign};

/// What a search found.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Found {
    /// Recordings, sorted, each once.
    pub recordings: Vec<PathBuf>,
    /// What was skipped, in the order it was found.
    pub skipped: Vec<Skipped>,
}

/// Something in a searched folder that is not sent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Skipped {
    /// Where it is.
    pub path: PathBuf,
    /// Why it is skipped, such as "is a FIFO".
    pub reason: String,
}

/// Finds recordings: a file stands for itself, a folder for every regular file `*.mcap` below it. In a folder, what
/// cannot be sent (FIFOs, sockets, devices, links that lead nowhere, folders that cannot be read) is skipped, and so is what
/// may be a dataset of another program by its name, beside recordings. A folder whose `metadata.yaml` lists several parts
/// (rosbag2) stands for one recording.
///
/// # Errors
/// [`ClientError::Io`] for a path that is not there; [`ClientError::Invalid`] for a path that is neither a regular file
/// nor a folder, for a folder without recordings, and, with the command that converts it, for a ROS 1 bag, a rosbag2
/// recording in SQLite, or a file of TensorFlow's records.
pub fn find_recordings(paths: &[PathBuf]) -> Result<Found> {
    let mut search = Search::default();
    for path in paths {
        let kind = std::fs::metadata(path).map_err(ClientError::io(path))?.file_type();
        if kind.is_file() {
            if let Some(remedy) = foreign::remedy(path) {
                return Err(ClientError::Invalid(remedy));
            }
            search.recordings.insert(path.clone());
        } else if kind.is_dir() {
            search.named_folder(path)?;
        } else {
            return Err(file::irregular(path, kind));
        }
    }
    Ok(Found { recordings: search.recordings.into_iter().collect(), skipped: search.skipped })
}

/// Why a dataset of another program beside recordings is skipped. Names alone do not decide whether it is one: an HDF5 file
/// can have the weights of a network, and its contents are read in a process with limits only.
const DATASET: &str = "may be a dataset of another program; give it by its own path";

#[derive(Default)]
struct Search {
    recordings: BTreeSet<PathBuf>,
    skipped: Vec<Skipped>,
    /// What to do with the first file of another format.
    remedy: Option<String>,
}

impl Search {
    fn named_folder(&mut self, path: &Path) -> Result<()> {
        let (before, skipped_before) = (self.recordings.len(), self.skipped.len());
        self.remedy = None;
        self.folder(path);
        if self.recordings.len() > before {
            return Ok(());
        }
        let skipped = &self.skipped[skipped_before..];
        let reasons: Vec<String> =
            skipped.iter().map(|Skipped { path, reason }| format!("{} {reason}", path.display())).collect();
        let skipped = match reasons.len() {
            0 => String::new(),
            count => format!("; skipped {count}: {}", reasons.join(", ")),
        };
        let remedy = self.remedy.take().map(|remedy| format!("; {remedy}")).unwrap_or_default();
        let problem = format!("{}: there is no *.mcap in this folder or below it", path.display());
        Err(ClientError::Invalid(problem + &skipped + &remedy))
    }

    fn folder(&mut self, folder: &Path) {
        match Rosbag::of(folder) {
            Ok(Some(rosbag)) => match rosbag.unreadable(folder) {
                Some(reason) => return self.skip(folder, reason),
                None if !rosbag.is_whole() => return self.parts(folder),
                None => {}
            },
            // The reason why its metadata cannot be used is returned when it is sent.
            Err(ClientError::Invalid(_)) => return self.parts(folder),
            Ok(None) | Err(_) => {}
        }
        match std::fs::read_dir(folder) {
            Err(error) => self.skip(folder, format!("cannot be read: {error}")),
            Ok(entries) => {
                for entry in entries {
                    match entry {
                        Ok(entry) => self.entry(&entry),
                        Err(error) => self.skip(folder, format!("cannot be read to its end: {error}")),
                    }
                }
            }
        }
    }

    fn parts(&mut self, folder: &Path) {
        self.recordings.insert(folder.to_owned());
    }

    fn entry(&mut self, entry: &DirEntry) {
        let path = entry.path();
        let named = path.extension().is_some_and(|extension| extension == "mcap");
        let kind = match entry.file_type() {
            Ok(kind) => kind,
            Err(error) => return self.skip(&path, format!("cannot be inspected: {error}")),
        };
        if kind.is_dir() {
            let before = (self.recordings.len(), self.skipped.len());
            self.folder(&path);
            if self.recordings.len() == before.0 && foreign::is_dataset(&path) {
                // Whatever lies in it is a part of it.
                self.skipped.truncate(before.1);
                self.skip(&path, DATASET.to_owned());
            } else if named && before == (self.recordings.len(), self.skipped.len()) {
                self.skip(&path, "is a folder without recordings".to_owned());
            }
        } else if kind.is_symlink() {
            self.link(path, named);
        } else if named && kind.is_file() {
            self.recordings.insert(path);
        } else if named {
            self.skip(&path, file::describe(kind).to_owned());
        } else if kind.is_file() && foreign::is_dataset(&path) {
            self.skip(&path, DATASET.to_owned());
        } else if self.remedy.is_none() && kind.is_file() {
            self.remedy = foreign::remedy(&path);
        }
    }

    fn link(&mut self, path: PathBuf, named: bool) {
        match std::fs::metadata(&path).map(|target| target.file_type()) {
            Ok(kind) if kind.is_dir() => {
                self.skip(&path, "is a link to a folder, which is not followed; push that folder by name".to_owned());
            }
            Ok(kind) if kind.is_file() && foreign::is_dataset(&path) => self.skip(&path, DATASET.to_owned()),
            _ if !named => {}
            Ok(kind) if kind.is_file() => {
                self.recordings.insert(path);
            }
            Ok(kind) => self.skip(&path, format!("is a link to something that {}", file::describe(kind))),
            Err(error) if error.kind() == ErrorKind::NotFound => {
                self.skip(&path, "is a link to a file that is not there".to_owned());
            }
            Err(error) => self.skip(&path, format!("is a link that cannot be followed: {error}")),
        }
    }

    fn skip(&mut self, path: &Path, reason: String) {
        self.skipped.push(Skipped { path: path.to_owned(), reason });
    }
}

#[cfg(test)]
mod tests;
