//! The snapshots, imported scores and evaluations by a command that an experiment made, and the sizes of its runs, in a
//! file beside its report. Jobs and datasets need no file: the server finds them by their keys and selections.

use std::collections::BTreeMap;
use std::fs::{File, TryLockError};
use std::io::Write as _;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};

use gleaner_client::ClientError;
use serde::{Deserialize, Serialize};

use super::scale::Sizes;
use crate::failure::{Failure, Result};

const FILE: &str = "state.json";

#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Remembered {
    /// The sizes of every run in this folder.
    #[serde(skip_serializing_if = "is_base")]
    sizes: Sizes,
    /// Snapshots by their stage's key.
    snapshots: BTreeMap<String, String>,
    /// Imported score runs, by the keys of their stages with the input's id.
    runs: BTreeMap<String, String>,
    /// Evaluations by a command, by the keys of their stages with the policy's id.
    evaluations: BTreeMap<String, String>,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "the form that serde calls")]
fn is_base(sizes: &Sizes) -> bool {
    *sizes == Sizes::Base
}

/// The file and its content.
#[derive(Debug)]
pub(crate) struct State {
    path: PathBuf,
    remembered: Remembered,
}

impl State {
    /// What an earlier run left in a folder, or nothing.
    ///
    /// # Errors
    /// An unreadable file, and runs with other sizes: one report cannot have both.
    pub(crate) fn open(folder: &Path, sizes: Sizes) -> Result<Self> {
        let path = folder.join(FILE);
        let remembered: Remembered = match std::fs::read(&path) {
            Ok(bytes) => serde_json::from_slice(&bytes).map_err(|error| {
                Failure::message(format!("{}: {error}; delete the file to make new snapshots", path.display()))
            })?,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Remembered { sizes, ..Remembered::default() },
            Err(error) => return Err(ClientError::io(path)(error).into()),
        };
        if remembered.sizes != sizes {
            let (runs, fix) = match sizes {
                Sizes::Base => ("with", "add the flag"),
                Sizes::Scaled => ("without", "leave the flag out"),
            };
            let folder = folder.display();
            let problem = format!("{folder} has runs {runs} --scale; {fix}, or name another folder with --out");
            return Err(Failure::message(problem));
        }
        Ok(Self { path, remembered })
    }

    /// Writes the file of a new folder, so that no run with other sizes uses the folder too.
    pub(crate) fn begin(&self) -> Result<()> {
        if self.path.exists() { Ok(()) } else { self.store() }
    }

    pub(crate) fn snapshot(&self, key: &str) -> Option<&str> {
        self.remembered.snapshots.get(key).map(String::as_str)
    }

    /// Stores a snapshot; it is on disk when this returns.
    pub(crate) fn remember(&mut self, key: &str, snapshot_id: &str) -> Result<()> {
        self.remembered.snapshots.insert(key.to_owned(), snapshot_id.to_owned());
        self.store()
    }

    pub(crate) fn run(&self, key: &str) -> Option<&str> {
        self.remembered.runs.get(key).map(String::as_str)
    }

    /// Stores an imported score run; it is on disk when this returns.
    pub(crate) fn remember_run(&mut self, key: &str, run_id: &str) -> Result<()> {
        self.remembered.runs.insert(key.to_owned(), run_id.to_owned());
        self.store()
    }

    pub(crate) fn evaluation(&self, key: &str) -> Option<&str> {
        self.remembered.evaluations.get(key).map(String::as_str)
    }

    /// Stores an evaluation; it is on disk when this returns.
    pub(crate) fn remember_evaluation(&mut self, key: &str, evaluation_id: &str) -> Result<()> {
        self.remembered.evaluations.insert(key.to_owned(), evaluation_id.to_owned());
        self.store()
    }

    fn store(&self) -> Result<()> {
        let text = serde_json::to_vec_pretty(&self.remembered).map_err(|error| Failure::message(error.to_string()))?;
        Ok(replace(&self.path, &text).map_err(ClientError::io(&self.path))?)
    }
}

/// Holds a folder for one run, until the returned value is dropped or the process ends: two runs would each replace the
/// other's file, and the first to end would stop the server of both.
///
/// # Errors
/// Another run holds the folder.
pub(crate) fn hold(folder: &Path) -> Result<File> {
    let held = File::open(folder).map_err(ClientError::io(folder))?;
    match held.try_lock() {
        // Some file systems cannot lock a folder.
        Ok(()) | Err(TryLockError::Error(_)) => Ok(held),
        Err(TryLockError::WouldBlock) => Err(Failure::message(format!(
            "another run uses {}; wait for its end, name another folder with --out, or write a report with --report",
            folder.display()
        ))),
    }
}

/// Replaces the content of a file: a reader sees the old content or the new, never a part.
pub(crate) fn replace(path: &Path, content: &[u8]) -> std::io::Result<()> {
    let folder = path.parent().unwrap_or_else(|| Path::new("."));
    // As any new file: readable for everyone, less the user's umask.
    let mut builder = tempfile::Builder::new();
    let mut file = builder.permissions(std::fs::Permissions::from_mode(0o666)).tempfile_in(folder)?;
    file.write_all(content)?;
    file.as_file().sync_all()?;
    file.persist(path).map_err(|error| error.error)?;
    std::fs::File::open(folder)?.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_run_finds_the_snapshots_of_the_first() {
        let folder = tempfile::tempdir().unwrap();
        let mut state = State::open(folder.path(), Sizes::Base).unwrap();
        assert_eq!(state.snapshot("a"), None);
        state.remember("a", "snap_1").unwrap();
        state.remember("b", "snap_2").unwrap();
        state.remember_run("a", "run_1").unwrap();
        state.remember_evaluation("c", "eval_1").unwrap();
        let second = State::open(folder.path(), Sizes::Base).unwrap();
        assert_eq!((second.snapshot("a"), second.run("a"), second.run("b")), (Some("snap_1"), Some("run_1"), None));
        assert_eq!((second.evaluation("c"), second.evaluation("a")), (Some("eval_1"), None));
    }

    #[test]
    fn a_folder_keeps_the_sizes_of_its_first_run() {
        let problem = |folder: &Path, sizes| State::open(folder, sizes).unwrap_err().to_string();
        let folder = tempfile::tempdir().unwrap();
        State::open(folder.path(), Sizes::Scaled).unwrap().begin().unwrap();
        State::open(folder.path(), Sizes::Scaled).unwrap().remember("a", "snap_1").unwrap();
        assert_eq!(State::open(folder.path(), Sizes::Scaled).unwrap().snapshot("a"), Some("snap_1"));
        let text = problem(folder.path(), Sizes::Base);
        assert!(text.contains("has runs with --scale; add the flag, or name another folder with --out"), "{text}");

        let folder = tempfile::tempdir().unwrap();
        State::open(folder.path(), Sizes::Base).unwrap().remember("a", "snap_1").unwrap();
        let text = problem(folder.path(), Sizes::Scaled);
        assert!(text.contains("has runs without --scale; leave the flag out, or name another folder"), "{text}");
        // Files of versions without the flag are of the base's sizes, and theirs stay readable to those versions.
        assert!(!std::fs::read_to_string(folder.path().join(FILE)).unwrap().contains("sizes"));
    }

    #[test]
    fn a_folder_has_one_run_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let first = hold(folder.path()).unwrap();
        let problem = hold(folder.path()).unwrap_err().to_string();
        assert!(problem.contains("another run uses") && problem.contains("--out"), "{problem}");
        drop(first);
        hold(folder.path()).unwrap();
    }

    #[test]
    fn a_malformed_file_is_rejected_with_the_fix() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(FILE), "{").unwrap();
        let message = State::open(folder.path(), Sizes::Base).unwrap_err().to_string();
        assert!(message.contains("state.json") && message.contains("delete"), "{message}");
    }
}
