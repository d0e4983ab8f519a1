//! `restore`: a new data folder from a backup, built beside its final path and moved there when it is complete; the dump of
//! a database in PostgreSQL fills an empty database, after every blob was copied.

use std::{collections::HashSet, fs, io, path::Path};

use super::{
    check::check_folder,
    files::{Needed, Progress, grouped},
    manifest::Manifest,
    target,
};
use crate::{
    blobs::{self, Blobs, Copied, sync_folder},
    config::{CheckConfig, RestoreConfig},
    data_folder::{DATABASE, DUMP},
    domain::id::BlobId,
    error::{Error, Result},
    store::{Database, Postgres, ReadOnlyDatabase},
};

/// Restores a backup and writes a report to `out`; true when the new data folder is intact. A backup with missing blobs
/// is restored without them.
///
/// # Errors
/// Precondition when there is no backup, it is from a newer program or of the other kind of database, its database is
/// damaged, or the target is not empty; Exhausted when the disk is full; Internal when it fails.
pub(super) async fn restore(config: &RestoreConfig, out: &mut impl io::Write) -> Result<bool> {
    let (backup, place) = (config.backup.as_path(), config.data_dir.as_path());
    let shown = place.display();
    if !target::is_backup(backup) {
        return Err(Error::precondition(format!("{} holds no finished backup", backup.display())));
    }
    if !target::is_free(place)? {
        return Err(Error::precondition(format!("{shown} is not empty; name an empty or new folder with --data-dir")));
    }
    let database = Database::configured(place, &config.database)?;
    let postgres = expect_kind(backup, &database)?;
    same_database(backup)?;
    if let Some(at) = postgres {
        at.expect_empty().await?;
    }
    let parent = target::parent(place);
    let made =
        fs::create_dir_all(&parent).and_then(|()| tempfile::Builder::new().prefix(".restoring-").tempdir_in(&parent));
    let draft = made.map_err(fault("making a folder in", &parent))?;
    if place.exists() {
        // Before hours of copying.
        expect_replaceable(&parent, place)?;
    }
    match postgres {
        None => fill(backup, draft.path()).await?,
        Some(at) => fill_with_postgres(backup, draft.path(), at).await?,
    }
    let check =
        CheckConfig { data_dir: draft.path().to_owned(), fast: true, json: false, database: config.database.clone() };
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

/// Rejects an empty folder that no other can replace: a rename is tried.
pub(super) fn expect_replaceable(parent: &Path, place: &Path) -> Result<()> {
    let probe = tempfile::Builder::new().prefix(".restoring-").tempdir_in(parent);
    let probe = probe.map_err(fault("making a folder in", parent))?;
    fs::rename(probe.path(), place).map_err(|error| {
        let shown = place.display();
        Error::precondition(format!(
            "{shown} cannot be replaced by the restored folder ({error}), as is so for the root of a mounted disk: name a \
             new folder within it, such as --data-dir {shown}/lab"
        ))
    })?;
    // The probe has moved: it needs no removal.
    let _ = probe.keep();
    Ok(())
}

/// The database in PostgreSQL to fill, for a backup of one; `None` for a backup of SQLite.
fn expect_kind<'a>(backup: &Path, database: &'a Database) -> Result<Option<&'a Postgres>> {
    let shown = backup.display();
    match (target::is_of_postgres(backup), &database.postgres) {
        (true, None) => Err(Error::precondition(format!(
            "{shown} is the backup of a database in PostgreSQL: name a new and empty one with --database"
        ))),
        (false, Some(_)) => Err(Error::precondition(format!(
            "{shown} is the backup of a SQLite database: restore it without --database, then move it with `gleaner-server \
             migrate`"
        ))),
        (_, postgres) => Ok(postgres.as_ref()),
    }
}

/// The database must match its manifest; a backup interrupted in its last step has no manifest.
fn same_database(backup: &Path) -> Result<()> {
    let Some(manifest) = Manifest::read(backup)? else { return Ok(()) };
    let name = if target::is_of_postgres(backup) { DUMP } else { DATABASE };
    match blobs::digest(&backup.join(name))? == manifest.database {
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
    copy_blobs(backup, place, needed.iter().map(|Needed { blob, .. }| blob))
}

/// Copies every blob of the backup, then fills the database, and removes the blobs that it does not name, such as recordings
/// that were permanently deleted. In this order a full disk leaves the database empty.
async fn fill_with_postgres(backup: &Path, place: &Path, at: &Postgres) -> Result<()> {
    if let Some(manifest) = Manifest::read(backup)?
        && manifest.schema > crate::store::newest_schema()
    {
        return Err(Error::precondition(format!(
            "{} has schema version {}, and this program {}: use gleaner-server {} or newer",
            backup.display(),
            manifest.schema,
            crate::store::newest_schema(),
            manifest.gleaner
        )));
    }
    let found = Blobs::at(backup)?.list()?;
    let ids: Vec<BlobId> = found.into_iter().filter_map(|found| found.id).collect();
    copy_blobs(backup, place, ids.iter())?;
    let named: HashSet<BlobId> = at.fill(&backup.join(DUMP)).await?.into_iter().map(|named| named.blob).collect();
    let blobs = Blobs::open(place)?;
    if let Some(removing) = blobs.removing().await? {
        for id in ids.iter().filter(|id| !named.contains(id)) {
            blobs.remove(id, &removing)?;
        }
    }
    Ok(())
}

fn copy_blobs<'a>(backup: &Path, place: &Path, ids: impl ExactSizeIterator<Item = &'a BlobId>) -> Result<()> {
    let (source, blobs) = (Blobs::at(backup)?, Blobs::open(place)?);
    let mut progress = Progress::new("blobs restored", ids.len());
    for blob in ids {
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
