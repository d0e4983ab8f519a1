//! What an experiment must remember itself, in a file beside its report: the snapshots it made. Jobs and datasets
//! the server finds again by itself.

use std::collections::BTreeMap;
use std::io::Write as _;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};

use gleaner_client::ClientError;
use serde::{Deserialize, Serialize};

use crate::failure::{Failure, Result};

const FILE: &str = "state.json";

#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Remembered {
    /// Snapshots by their stage's key.
    snapshots: BTreeMap<String, String>,
}

/// The file and what is in it.
#[derive(Debug)]
pub(crate) struct State {
    path: PathBuf,
    remembered: Remembered,
}

impl State {
    /// What an earlier run left in a folder, or nothing.
    pub(crate) fn open(folder: &Path) -> Result<Self> {
        let path = folder.join(FILE);
        let remembered = match std::fs::read(&path) {
            Ok(bytes) => serde_json::from_slice(&bytes).map_err(|error| {
                Failure::told(format!("{}: {error}; delete the file to make the snapshots anew", path.display()))
            })?,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Remembered::default(),
            Err(error) => return Err(ClientError::io(path)(error).into()),
        };
        Ok(Self { path, remembered })
    }

    pub(crate) fn snapshot(&self, key: &str) -> Option<&str> {
        self.remembered.snapshots.get(key).map(String::as_str)
    }

    /// Remembers a snapshot, on disk before this returns.
    pub(crate) fn remember(&mut self, key: &str, snapshot_id: &str) -> Result<()> {
        self.remembered.snapshots.insert(key.to_owned(), snapshot_id.to_owned());
        let text = serde_json::to_vec_pretty(&self.remembered).map_err(|error| Failure::told(error.to_string()))?;
        Ok(replace(&self.path, &text).map_err(ClientError::io(&self.path))?)
    }
}

/// Puts a file's new content in place of the old: whoever reads it meanwhile sees one or the other, never a part.
pub(crate) fn replace(path: &Path, content: &[u8]) -> std::io::Result<()> {
    let folder = path.parent().unwrap_or_else(|| Path::new("."));
    // As any other file that is made: for everyone, less what the user keeps to himself.
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
    fn a_second_run_knows_what_the_first_made() {
        let folder = tempfile::tempdir().unwrap();
        let mut state = State::open(folder.path()).unwrap();
        assert_eq!(state.snapshot("a"), None);
        state.remember("a", "snap_1").unwrap();
        state.remember("b", "snap_2").unwrap();
        assert_eq!(State::open(folder.path()).unwrap().snapshot("a"), Some("snap_1"));
    }

    #[test]
    fn a_broken_file_is_named_with_the_mend() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(FILE), "{").unwrap();
        let said = State::open(folder.path()).unwrap_err().to_string();
        assert!(said.contains("state.json") && said.contains("delete"), "{said}");
    }
}
