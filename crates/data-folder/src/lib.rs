//! The data folder of a server, apart from its database: names and permissions of its files, the lock that one server
//! holds on it, blobs, the stamp that ties the database to them, and a check that its files are still the ones that
//! were opened.
//!
//! Plain blocking code, shared by the server and its workers. Must not depend on rows or on the content of blobs.

pub mod access;
pub mod blobs;
pub mod caches;
pub mod fail_point;
pub mod file_limit;
pub mod lock;
pub mod presence;
pub mod stamp;

use std::path::{Path, PathBuf};

use gleaner_core::{TaskSpec, id::BlobId};

/// Name of the database within a data folder, and within a backup.
pub const DATABASE: &str = "gleaner.db";
/// Name of the dump of a database in PostgreSQL within a backup.
pub const DUMP: &str = "gleaner.dump";
/// Name of the mark of a backup's folder.
pub const BACKUP: &str = "BACKUP";
/// Name of the folder of the blobs.
pub const BLOBS: &str = "blobs";
/// Name of the file that one server at a time locks.
pub const LOCK: &str = "lock";
/// Name of the file that every standby locks together with the others.
pub const STANDBYS: &str = "standbys";

/// Path of the database of a data folder.
pub fn database(data_dir: &Path) -> PathBuf {
    data_dir.join(DATABASE)
}

/// Path of a file that SQLite keeps beside the database: `-wal`, `-shm` or `-journal`.
pub fn beside_database(data_dir: &Path, suffix: &str) -> PathBuf {
    data_dir.join(format!("{DATABASE}{suffix}"))
}

/// Path of the folder of the logs of jobs.
pub fn logs(data_dir: &Path) -> PathBuf {
    data_dir.join("logs")
}

/// Whether the folder is a backup that no server has used as its data folder.
pub fn is_unused_backup(data_dir: &Path) -> bool {
    data_dir.join(BACKUP).is_file() && !stamp::path(data_dir).exists()
}

/// The reason why no server, and no command that writes, uses a backup as its data folder, with the remedy.
pub fn backup_is_no_lab(data_dir: &Path) -> String {
    let shown = data_dir.display();
    format!(
        "{shown} is a backup, which a server would change, and which no later backup could then replace. The folder is \
         unchanged. `gleaner-server restore {shown} --data-dir NEW` makes a data folder of it"
    )
}

/// The remedies for a data folder whose database is missing, damaged or does not match the blobs, as the end of an
/// error message.
pub fn ways_out(data_dir: &Path) -> String {
    let shown = data_dir.display();
    format!(
        "The data folder is unchanged. `gleaner-server restore BACKUP --data-dir NEW` restores a backup into a new \
         folder; `gleaner-server rebuild --data-dir {shown}` completes or rebuilds the database from the sidecars \
         beside the blobs"
    )
}

/// The third remedy, for an existing database or none at all.
pub fn way_to_accept(data_dir: &Path) -> String {
    format!(
        "{}; `gleaner-server serve --data-dir {} --accept-database` takes the database as it is, once: blobs that it does \
         not name then move to the trash",
        ways_out(data_dir),
        data_dir.display()
    )
}

/// Name of the folder of files that are derived from recordings and can be rebuilt.
pub const CACHE: &str = "cache";
/// Suffix of the files of stored features in that folder.
pub const FEATURES: &str = "features";

/// The paths of the decoded steps of one task's recordings. Derived: each file can always be rebuilt.
#[derive(Debug, Clone)]
pub struct FramePaths {
    folder: PathBuf,
    task: String,
}

impl FramePaths {
    /// Those in a data folder for this task.
    pub fn new(data_dir: &Path, spec: &TaskSpec) -> Self {
        // Every specification can be written as JSON: it came from JSON.
        let spec = serde_json::to_vec(&spec.of_steps()).unwrap_or_default();
        let task = blake3::hash(&spec).to_hex().get(..16).unwrap_or_default().to_owned();
        Self { folder: data_dir.join(CACHE), task }
    }

    /// The path of this recording's decoded steps.
    pub fn of(&self, recording: &BlobId) -> PathBuf {
        self.folder.join(format!("{recording}-{}.frames", self.task))
    }
}

/// The path of one recording's decoded steps, as [`FramePaths`] has it.
pub fn frames_path(data_dir: &Path, recording: &BlobId, spec: &TaskSpec) -> PathBuf {
    FramePaths::new(data_dir, spec).of(recording)
}

#[cfg(test)]
mod tests {
    use gleaner_core::{FieldSpec, OpenpiKey};

    use super::*;

    #[test]
    fn words_units_and_keys_of_clients_do_not_discard_decoded_steps() {
        let task = TaskSpec {
            name: "reach".to_owned(),
            instruction: String::new(),
            rate_hz: 10.0,
            cameras: Vec::new(),
            proprioception: vec![FieldSpec::new("pose", 2)],
            action: Vec::new(),
            alignment: gleaner_core::Alignment::default(),
            tolerance: 0.25,
            mappings: Vec::new(),
            openpi: Vec::new(),
        };
        let openpi = vec![OpenpiKey { name: "pose".to_owned(), key: "observation/state_0".to_owned() }];
        let path = |spec: &TaskSpec| frames_path(Path::new("lab"), &BlobId::from(blake3::hash(b"recording")), spec);
        assert_eq!(path(&TaskSpec { openpi, ..task.clone() }), path(&task));
        assert_eq!(path(&TaskSpec { instruction: "reach".to_owned(), ..task.clone() }), path(&task));
        let pose = FieldSpec { unit: "m".to_owned(), ..FieldSpec::new("pose", 2) };
        assert_eq!(path(&TaskSpec { proprioception: vec![pose], ..task.clone() }), path(&task));
        assert_ne!(path(&TaskSpec { rate_hz: 5.0, ..task.clone() }), path(&task));
    }
}
