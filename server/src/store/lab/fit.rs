//! The check that a database and a folder of blobs belong together. Read-only, because a mismatch must be left
//! unchanged.

use std::{io::ErrorKind, os::unix::fs::MetadataExt as _, path::Path};

use super::{Lab, lab};
use crate::{
    blobs::Blobs,
    data_folder::{self, stamp::Stamp, ways_out},
    error::{Error, Kind, Result},
    store::{Postgres, Store, schema},
};

/// The row of the database at `path`, which is not changed. A database from before that row counts as one that was
/// never stamped. `None` when the database is missing or empty.
pub(super) async fn found(path: &Path, data_dir: &Path) -> Result<Option<Lab>> {
    let unusable = |problem: String| damaged(path, data_dir, Error::internal("opening it", problem));
    match std::fs::metadata(path) {
        Ok(file) if file.len() > 0 => {}
        // SQLite creates an empty file before it writes the first page.
        Ok(file) if file.is_file() => return Ok(None),
        Ok(_) => return Err(unusable("it is not a file".to_owned())),
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(unusable(error.to_string())),
    }
    std::fs::OpenOptions::new().read(true).write(true).open(path).map_err(|error| {
        Error::precondition(format!(
            "{} cannot be opened to read and write: {error}. The user that runs the server must own the data folder: \
             `chown -R USER {}`",
            path.display(),
            data_dir.display()
        ))
    })?;
    // Read-only: the write-ahead log of another database must not be merged into this one.
    let database = crate::store::read_only::open_read_only(path).await.map_err(|error| unusable(error.to_string()))?;
    let read = async {
        if schema::known(&database.readers, path.display()).await? == 0 {
            return Ok(None);
        }
        let there = schema::has_table(&database.readers, "lab").await?;
        if must_be_checked(path, data_dir) {
            database.expect_sound(data_dir).await?;
        }
        let never = Lab { folder: String::new(), stamped: false, generation: 0, missing: 0 };
        if there { lab(&database.readers).await.map(Some) } else { Ok(Some(never)) }
    }
    .await;
    database.close().await;
    read.map_err(|error| damaged(path, data_dir, error))
}

/// The same in PostgreSQL.
pub(super) async fn found_in_postgres(at: &Postgres) -> Result<Option<Lab>> {
    // Before the database is compared with the blobs: that of a running server has another folder.
    at.expect_usable(true).await?;
    let store = Store::look_at(at).await?;
    let known = schema::known(&store.readers, at).await;
    let found = match known {
        Ok(0) => Ok(None),
        Ok(_) => lab(&store.readers).await.map(Some),
        Err(error) => Err(error),
    };
    store.close().await;
    found
}

/// Whether SQLite must check the database before it is used: its file is another one than at the last start, or
/// smaller, or has a write-ahead log to merge, which may be another database's.
fn must_be_checked(path: &Path, data_dir: &Path) -> bool {
    let stamp = Stamp::read(data_dir).ok().flatten();
    let (inode, bytes) = file(path);
    let other = stamp.is_some_and(|stamp| stamp.inode != inode || stamp.bytes > bytes);
    other || file(&data_folder::beside_database(data_dir, "-wal")).1 > 0
}

/// The reason why a database and a folder of blobs do not belong together; `None` if they do.
pub(super) fn misfit(lab: Option<&Lab>, stamp: Option<&Stamp>, blobs: &Blobs) -> Result<Option<String>> {
    let misfit = match (lab, stamp) {
        (None, None) if blobs.is_empty()? => return Ok(None),
        (None, _) => "the database is missing or empty, and the folder holds blobs".to_owned(),
        (Some(Lab { missing, .. }), _) if *missing != 0 => format!(
            "the database is a mixture of two copies: it records {missing} more episodes than it contains. Its \
             write-ahead log ({}-wal) may belong to another copy",
            data_folder::DATABASE
        ),
        // A database from before stamps, or a crash before the first one.
        (Some(Lab { stamped: false, .. }), None) => return Ok(None),
        (Some(Lab { stamped: true, .. }), None) => format!(
            "the database belongs to a folder of blobs with a stamp ({}), and this one has none: are the blobs on a disk \
             that is not mounted, or is this a backup?",
            crate::data_folder::stamp::FILE
        ),
        (Some(lab), Some(stamp)) if lab.folder != stamp.folder => {
            "the database belongs to another folder, or is older than this folder's stamp".to_owned()
        }
        (Some(lab), Some(stamp)) => {
            if lab.generation >= stamp.generation {
                return Ok(None);
            }
            format!(
                "the database is older than the blobs (generation {}, the stamp has {}): it is an earlier copy, \
                 or was copied without its write-ahead log ({}-wal)",
                lab.generation,
                stamp.generation,
                data_folder::DATABASE
            )
        }
    };
    Ok(Some(misfit))
}

/// The inode and the size of a file; zeros for a missing one.
pub(super) fn file(path: &Path) -> (u64, u64) {
    std::fs::metadata(path).map_or((0, 0), |file| (file.ino(), file.len()))
}

/// SQLite's error about an unusable file is for the operator; it is not an internal error.
pub(super) fn damaged(path: &Path, data_dir: &Path, error: Error) -> Error {
    if error.kind() != Kind::Internal {
        return error;
    }
    Error::precondition(format!("{} cannot be used: {error}. {}", path.display(), ways_out(data_dir)))
}
