//! The parts of a recording that its recorder has cut by size or duration: which files they are, and in which order.
//!
//! Reads names and `metadata.yaml`, as rosbag2 writes it; must not know a server or the contents of recordings apart from
//! their summary.

use std::collections::BTreeSet;
use std::io::{ErrorKind, Read as _};
use std::path::{Path, PathBuf};

use gleaner_recording::summarize;
use serde::Deserialize;

use crate::error::{ClientError, Result};
use crate::file::open_regular;

/// The file beside the parts of a rosbag2 recording.
pub const METADATA: &str = "metadata.yaml";
/// Larger files are not the metadata of a recording.
const METADATA_BYTES: u64 = 16 << 20;

/// The contents of `metadata.yaml` that are used here.
#[derive(Debug, Deserialize)]
struct Metadata {
    rosbag2_bagfile_information: Option<Rosbag>,
}

/// A rosbag2 recording as its metadata describes it.
#[derive(Debug, Deserialize)]
pub(crate) struct Rosbag {
    storage_identifier: String,
    /// Of the recorder, beside the compression that MCAP has of its own: empty, `NONE`, `FILE` or `MESSAGE`.
    #[serde(default)]
    compression_mode: Option<String>,
    /// The parts in their order.
    relative_file_paths: Vec<String>,
    /// Absent in early versions.
    #[serde(default)]
    files: Vec<RosbagFile>,
}

#[derive(Debug, Deserialize)]
struct RosbagFile {
    path: String,
    message_count: u64,
}

impl Rosbag {
    /// Reads the metadata in a folder; `None` if it has none, or metadata of another kind.
    ///
    /// # Errors
    /// [`ClientError::Io`]; [`ClientError::Invalid`] if it cannot be read as rosbag2 writes it.
    pub(crate) fn of(folder: &Path) -> Result<Option<Self>> {
        let path = folder.join(METADATA);
        let file = match open_regular(&path) {
            Err(ClientError::Io { source, .. }) if source.kind() == ErrorKind::NotFound => return Ok(None),
            file => file?,
        };
        let mut text = String::new();
        file.take(METADATA_BYTES).read_to_string(&mut text).map_err(ClientError::io(&path))?;
        let metadata: Metadata = serde_norway::from_str(&text)
            .map_err(|error| invalid(&path, &format!("{error}; write it again with `ros2 bag reindex`")))?;
        Ok(metadata.rosbag2_bagfile_information)
    }

    /// Why its files cannot be read as MCAP, and what to do; `None` if they can.
    pub(crate) fn unreadable(&self, folder: &Path) -> Option<String> {
        if self.storage_identifier != "mcap" {
            return Some(format!(
                "is a rosbag2 recording in the storage {:?}; convert it with `rosbags-convert --src {} --dst NEW_FOLDER \
                 --dst-storage mcap` (Python package rosbags), and push NEW_FOLDER",
                self.storage_identifier,
                folder.display()
            ));
        }
        let compressed = match self.compression_mode.as_deref().unwrap_or_default().to_ascii_uppercase().as_str() {
            "FILE" => "each file",
            "MESSAGE" => "each message",
            _ => return None,
        };
        Some(format!(
            "is a rosbag2 recording whose recorder compressed {compressed}; convert it with `ros2 bag convert` and \
             without a compression_mode"
        ))
    }

    /// Whether it has one file, which is the whole recording.
    pub(crate) fn is_whole(&self) -> bool {
        self.relative_file_paths.len() == 1
    }

    /// The parts, which must all be there, with as many messages as the metadata states.
    fn parts(&self, folder: &Path) -> Result<Vec<PathBuf>> {
        if let Some(problem) = self.unreadable(folder) {
            return Err(invalid(folder, &format!("it {problem}")));
        }
        let there: BTreeSet<PathBuf> = recordings_in(folder)?.into_iter().collect();
        let mut parts = Vec::new();
        for listed in &self.relative_file_paths {
            let path = folder.join(Path::new(listed).file_name().unwrap_or_default());
            if !there.contains(&path) {
                let problem = format!(
                    "this part is missing: {METADATA} lists it; copy it here, or write {METADATA} \
                     again with `ros2 bag reindex` if the recording begins or ends without it"
                );
                return Err(invalid(&path, &problem));
            }
            if parts.contains(&path) {
                return Err(invalid(&path, &format!("{METADATA} lists this part twice")));
            }
            self.check_count(listed, &path)?;
            parts.push(path);
        }
        match there.iter().find(|path| !parts.contains(path)) {
            Some(path) => Err(invalid(
                path,
                &format!("{METADATA} beside it does not list this file; move it away, or run `ros2 bag reindex`"),
            )),
            None => Ok(parts),
        }
    }

    /// Compares the number of messages of a part with its own summary, if both state one.
    fn check_count(&self, listed: &str, path: &Path) -> Result<()> {
        let stated = self.files.iter().find(|file| file.path == listed).map(|file| file.message_count);
        let found = summarize(path).ok().flatten().map(|summary| summary.messages);
        match stated.zip(found) {
            Some((stated, found)) if stated != found => Err(invalid(
                path,
                &format!("it has {found} messages, and {METADATA} states {stated}; copy the file again"),
            )),
            Some(_) | None => Ok(()),
        }
    }
}

/// The parts in a folder, in their order: as the metadata of rosbag2 lists them, or else by the numbers in their names.
///
/// # Errors
/// [`ClientError::Io`]; [`ClientError::Invalid`] names a part that is missing or belongs to another recording.
pub(crate) fn parts_in(folder: &Path) -> Result<Vec<PathBuf>> {
    match Rosbag::of(folder)? {
        Some(rosbag) => rosbag.parts(folder),
        None => in_order(recordings_in(folder)?, folder),
    }
}

/// Parts by the numbers at the end of their names: `run_0.mcap`, `run_1.mcap`, and so on. `place`: for the error without
/// any.
///
/// # Errors
/// [`ClientError::Invalid`] names a part that is missing, duplicated or belongs to another recording.
pub(crate) fn in_order(paths: Vec<PathBuf>, place: &Path) -> Result<Vec<PathBuf>> {
    let mut numbered = Vec::new();
    for path in paths {
        let (name, number) = number(&path).ok_or_else(|| {
            invalid(&path, "parts of a recording are named NAME_0.mcap, NAME_1.mcap, and so on; rename the file")
        })?;
        numbered.push((number, name, path));
    }
    numbered.sort();
    let Some((begin, name, first)) = numbered.first().cloned() else {
        return Err(invalid(place, "there is no *.mcap in this folder"));
    };
    // Recorders count from 0 or from 1.
    for (expected, (number, other, path)) in (begin.min(1)..).zip(&numbered) {
        if *other != name {
            let problem =
                format!("it is a part of another recording than {}; join one recording at a time", first.display());
            return Err(invalid(path, &problem));
        }
        if *number < expected {
            return Err(invalid(path, "its number is duplicated; push each part once"));
        }
        if *number > expected {
            let missing = path.with_file_name(format!("{name}_{expected}.mcap"));
            return Err(invalid(&missing, &format!("this part is missing: {} is there", path.display())));
        }
    }
    Ok(numbered.into_iter().map(|(_, _, path)| path).collect())
}

/// The name of a recording and the number of its part.
pub(crate) fn number(path: &Path) -> Option<(String, u64)> {
    let (name, number) = path.file_stem()?.to_str()?.rsplit_once('_')?;
    let digits = !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit());
    digits.then(|| Some((name.to_owned(), number.parse().ok()?))).flatten()
}

/// The files `*.mcap` in a folder, sorted.
fn recordings_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(ClientError::io(folder))? {
        let path = entry.map_err(ClientError::io(folder))?.path();
        if path.extension().is_some_and(|extension| extension == "mcap") {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}

fn invalid(path: &Path, problem: &str) -> ClientError {
    ClientError::Invalid(format!("{}: {problem}", path.display()))
}

#[cfg(test)]
mod tests;
