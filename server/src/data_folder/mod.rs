//! The data folder as a whole: the names of what lies in it, the stamp that ties its database to its blobs, whether its
//! files are still the ones that were opened, and its permissions. Must not depend on rows or on the content of blobs.

pub mod access;
pub(crate) mod presence;
pub(crate) mod stamp;

use std::path::{Path, PathBuf};

/// Name of the database within a data folder, and within a backup.
pub(crate) const DATABASE: &str = "gleaner.db";
/// Name of the folder of the blobs.
pub(crate) const BLOBS: &str = "blobs";
/// Name of the file that one server at a time locks.
pub(crate) const LOCK: &str = "lock";

/// Path of the database of a data folder.
pub(crate) fn database(data_dir: &Path) -> PathBuf {
    data_dir.join(DATABASE)
}

/// Path of a file that SQLite keeps beside the database: `-wal`, `-shm` or `-journal`.
pub(crate) fn beside_database(data_dir: &Path, suffix: &str) -> PathBuf {
    data_dir.join(format!("{DATABASE}{suffix}"))
}

/// The ways out of a data folder whose database is missing, damaged or not the blobs' own, as the end of an error message.
pub(crate) fn ways_out(data_dir: &Path) -> String {
    let shown = data_dir.display();
    format!(
        "Nothing was changed. `gleaner-server restore BACKUP --data-dir NEW` restores a backup into a new folder; \
         `gleaner-server rebuild --data-dir {shown}` completes or rebuilds the database from the sidecars beside the blobs"
    )
}

/// The third way out, where there is a database to take or none at all.
pub(crate) fn way_to_accept(data_dir: &Path) -> String {
    format!(
        "{}; `gleaner-server serve --data-dir {} --accept-database` takes the database as it is, once: blobs that it does \
         not name then move to the trash",
        ways_out(data_dir),
        data_dir.display()
    )
}
