//! `restore`: a new data folder from a backup, built beside its final path and moved there when it is complete.

use std::{fs, io, path::Path};

use super::{
    check::check_folder,
    files::{Needed, Progress, grouped},
    manifest::Manifest,
    target,
};
use crate::{
    blobs::{self, Blobs, Copied, sync_folder},
    config::{CheckConfig, DatabaseConfig, RestoreConfig},
    data_folder::DATABASE,
    error::{Error, Result},
    store::ReadOnlyDatabase,
};

/// Restores a backup and writes a report to `out`; true when the new data folder is intact. A backup with missing blobs
/// is restored without them.
///
/// # Errors
/// Precondition when there is no backup, it is from a newer program, its database is damaged, or the target is not
/// empty; Exhausted when the disk is full; Internal when it fails.
pub(super) async fn restore(config: &RestoreConfig, out: &mut impl io::Write) -> Result<bool> {
    let (backup, place) = (config.backup.as_path(), config.data_dir.as_path());
    let shown = place.display();
    if !target::is_backup(backup) {
        return Err(Error::precondition(format!("{} holds no finished backup", backup.display())));
    }
    if !target::is_free(place)? {
        return Err(Error::precondition(format!("{shown} is not empty; name an empty or new folder with --data-dir")));
    }
    same_database(backup)?;
    let parent = target::parent(place);
    let made =
        fs::create_dir_all(&parent).and_then(|()| tempfile::Builder::new().prefix(".restoring-").tempdir_in(&parent));
    let draft = made.map_err(fault("making a folder in", &parent))?;
    fill(backup, draft.path()).await?;
    let check =
        CheckConfig { data_dir: draft.path().to_owned(), fast: true, json: false, database: DatabaseConfig::default() };
    let mut report = check_folder(&check).await?;
    // An empty folder is replaced; a folder that has been filled in the meantime is an error.
    fs::rename(draft.path(), place).map_err(fault("moving the restored folder to", place))?;
    // The draft has moved: it needs no removal.
    let _ = draft.keep();
    sync_folder(&parent)?;
    report.data_dir = place.to_owned();
    report.write_text(out).map_err(|error| Error::internal("writing the report", error))?;
    Ok(report.sound)
}

/// The database must match its manifest; a backup interrupted in its last step has no manifest.
fn same_database(backup: &Path) -> Result<()> {
    let Some(manifest) = Manifest::read(backup)? else { return Ok(()) };
    match blobs::digest(&backup.join(DATABASE))? == manifest.database {
        true => Ok(()),
        false => Err(Error::precondition(format!(
            "the database of {} does not match its manifest: it is damaged. Use another backup",
            backup.display()
        ))),
    }
}

/// Copies the database, and every intact blob that it names.
async fn fill(backup: &Path, place: &Path) -> Result<()> {
    let database = place.join(DATABASE);
    fs::copy(backup.join(DATABASE), &database)
        .and_then(|_| fs::File::open(&database)?.sync_all())
        .map_err(fault("copying the database to", &database))?;
    let database = ReadOnlyDatabase::open(&database).await?;
    let needed = grouped(database.store.named_blobs().await?);
    database.store.close().await;
    let (source, blobs) = (Blobs::at(backup)?, Blobs::open(place)?);
    let mut progress = Progress::new("blobs restored", needed.len());
    for Needed { blob, .. } in &needed {
        // Missing blobs are reported by the check.
        if let Copied::Lacking(why) = blobs.copy_from(&source, blob, false)? {
            tracing::error!(blob.id = %blob, why, "the backup lacks a blob");
        }
        progress.one_more();
    }
    Ok(())
}

fn fault<'a>(doing: &'a str, path: &'a Path) -> impl FnOnce(io::Error) -> Error + 'a {
    move |error| Error::internal(format!("{doing} {}", path.display()), error)
}
