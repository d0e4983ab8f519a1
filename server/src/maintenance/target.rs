//! Checks of the target folders of backups and restores: other data is never overwritten.

use std::{
    collections::HashSet,
    fs, io,
    path::{Path, PathBuf},
};

use super::{files::Needed, manifest::Manifest};
use crate::{
    blobs::Blobs,
    config::DatabaseConfig,
    data_folder::{BACKUP, BLOBS, DATABASE, DUMP, stamp},
    domain::id::BlobId,
    error::{Error, Result},
    lock::DataLock,
    store::Database,
};

/// The content of the mark of a backup's folder, which is written first.
const NOTICE: &str =
    "A backup of gleaner's data. To use it: gleaner-server restore THIS_FOLDER --data-dir NEW_FOLDER\n";

/// Creates the folder of a backup, or reuses that of an earlier one, and locks it against other backups.
///
/// # Errors
/// Precondition when it has other data, has become a data folder, is inside the data folder or contains it, or another
/// backup is running.
pub(super) fn claim(database: &Database, target: &Path) -> Result<DataLock> {
    let (source, shown) = (database.data_dir.as_path(), target.display());
    let (there, what) = match &database.postgres {
        None => (source.join(DATABASE).is_file(), "database"),
        Some(_) => (source.join(BLOBS).is_dir(), "folder of blobs"),
    };
    if !there {
        return Err(Error::precondition(format!(
            "there is no {what} in {}; --data-dir names the data folder of a server",
            source.display()
        )));
    }
    if stamp::path(target).exists() {
        return Err(Error::precondition(format!(
            "a server has used {shown} as its data folder since the backup was made, and may have stored recordings in it: \
             name another folder for the backup"
        )));
    }
    let mark = target.join(BACKUP);
    if !mark.is_file() && !is_free(target)? {
        return Err(Error::precondition(format!(
            "{shown} holds other data; name an empty or new folder, or an earlier backup"
        )));
    }
    let fault = |error| Error::internal(format!("making {shown}"), error);
    fs::create_dir_all(target).map_err(fault)?;
    let (outer, inner) = (source.canonicalize().map_err(fault)?, target.canonicalize().map_err(fault)?);
    if outer.starts_with(&inner) || inner.starts_with(&outer) {
        return Err(Error::precondition(format!(
            "{shown} and the data folder lie within one another; back up to another place, best to another disk"
        )));
    }
    // Before the lock, whose error names --data-dir.
    drop(tempfile::tempfile_in(target).map_err(fault)?);
    let lock = DataLock::take(target)?;
    fs::write(&mark, NOTICE).map_err(fault)?;
    Ok(lock)
}

/// Rejects the backup of one lab over that of another, as with a wrong folder, or with the new and empty lab that a server
/// starts where a disk is not mounted. `folder` is the name of the data folder by its stamp. A restored lab has another
/// name than before, and names the blobs of its backup.
///
/// # Errors
/// Precondition when the folders have different names and `needed` lacks more than half of the earlier backup's blobs.
pub(super) fn expect_same_lab(
    (source, folder): (&Path, Option<&str>),
    (target, blobs): (&Path, &Blobs),
    needed: &[Needed],
) -> Result<()> {
    let earlier = Manifest::read(target).ok().flatten();
    if folder.is_some() && earlier.as_ref().and_then(|earlier| earlier.folder.as_deref()) == folder {
        return Ok(());
    }
    let there: HashSet<BlobId> = blobs.list()?.into_iter().filter_map(|found| found.id).collect();
    let all = there.len() as u64;
    let named = earlier.map_or(all, |earlier| earlier.blobs.min(all));
    let shared = needed.iter().filter(|needed| there.contains(&needed.blob)).count() as u64;
    if shared >= named.div_ceil(2) {
        return Ok(());
    }
    Err(Error::precondition(format!(
        "{} is the backup of another data folder: the database of {} names only {shared} of its {named} blobs. Name the \
         right folder with --data-dir and check that its disk is mounted, or name another folder for this backup",
        target.display(),
        source.display()
    )))
}

/// Rejects a command on a database that is not in the data folder.
///
/// # Errors
/// Precondition, with the commands to use.
pub(super) fn expect_sqlite(database: &DatabaseConfig, command: &str) -> Result<()> {
    if database.database.is_none() {
        return Ok(());
    }
    Err(Error::precondition(format!(
        "{command} works on SQLite in the data folder, not on PostgreSQL: restore a backup, or rebuild a SQLite database in \
         the folder without --database and move it with `gleaner-server migrate`"
    )))
}

/// Whether the folder is a backup that was finished at least once.
pub(super) fn is_backup(folder: &Path) -> bool {
    folder.join(BACKUP).is_file() && (folder.join(DATABASE).is_file() || is_of_postgres(folder))
}

/// Whether the database of a backup is a dump of PostgreSQL.
pub(super) fn is_of_postgres(folder: &Path) -> bool {
    folder.join(BACKUP).is_file() && folder.join(DUMP).is_file()
}

/// Whether a folder is missing or empty.
pub(super) fn is_free(folder: &Path) -> Result<bool> {
    match fs::read_dir(folder) {
        Ok(mut entries) => Ok(entries.next().is_none()),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(true),
        Err(error) if error.kind() == io::ErrorKind::NotADirectory => Ok(false),
        Err(error) => Err(Error::internal(format!("reading {}", folder.display()), error)),
    }
}

/// The parent of an existing or future folder.
pub(super) fn parent(folder: &Path) -> PathBuf {
    match folder.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent.to_owned(),
        Some(_) | None => PathBuf::from("."),
    }
}
