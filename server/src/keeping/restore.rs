//! `restore`: a new data folder from a backup, made beside its place and moved there when it is whole.

use std::{fs, io, path::Path};

use super::{
    check::look_through,
    files::{Needed, Pace, grouped},
    manifest::Manifest,
    target,
};
use crate::{
    blobs::{self, Blobs, Copied, sync_folder},
    config::{CheckConfig, RestoreConfig},
    data_folder::DATABASE,
    error::{Error, Result},
    store::Look,
};

/// Restores a backup and tells `out` how it went; true when the new data folder is sound. One that lacks a blob is
/// restored without it: what is whole is worth having.
///
/// # Errors
/// Precondition when there is no backup, it is of a newer program, its database is damaged, or the target is not empty;
/// Exhausted when the disk is full; Internal when it refuses.
pub(super) async fn restore(config: &RestoreConfig, out: &mut impl io::Write) -> Result<bool> {
    let (backup, place) = (config.backup.as_path(), config.data_dir.as_path());
    let shown = place.display();
    if !target::is_backup(backup) {
        return Err(Error::precondition(format!("{} holds no backup that was ever finished", backup.display())));
    }
    if !target::is_free(place)? {
        return Err(Error::precondition(format!(
            "{shown} is not empty, and nothing is restored over what is there; name another --data-dir"
        )));
    }
    same_database(backup)?;
    let parent = target::parent(place);
    let made =
        fs::create_dir_all(&parent).and_then(|()| tempfile::Builder::new().prefix(".restoring-").tempdir_in(&parent));
    let draft = made.map_err(fault("making a folder in", &parent))?;
    fill(backup, draft.path()).await?;
    let check = CheckConfig { data_dir: draft.path().to_owned(), fast: true, json: false };
    let mut report = look_through(&check).await?;
    // Over a folder that is empty; one that is not any more refuses.
    fs::rename(draft.path(), place).map_err(fault("moving the restored folder to", place))?;
    // It has moved: there is nothing to clean up.
    let _ = draft.keep();
    sync_folder(&parent)?;
    report.data_dir = place.to_owned();
    report.tell(out).map_err(|error| Error::internal("telling what was restored", error))?;
    Ok(report.sound)
}

/// The database must be the one that the manifest speaks of; a backup that was cut while it ended has no manifest.
fn same_database(backup: &Path) -> Result<()> {
    let Some(manifest) = Manifest::read(backup)? else { return Ok(()) };
    match blobs::digest(&backup.join(DATABASE))? == manifest.database {
        true => Ok(()),
        false => Err(Error::precondition(format!(
            "the database of {} is not what its manifest says: it is damaged. Use another backup",
            backup.display()
        ))),
    }
}

/// Copies the database, and every blob that it names and the backup has whole.
async fn fill(backup: &Path, place: &Path) -> Result<()> {
    let database = place.join(DATABASE);
    fs::copy(backup.join(DATABASE), &database)
        .and_then(|_| fs::File::open(&database)?.sync_all())
        .map_err(fault("copying the database to", &database))?;
    let look = Look::open(&database).await?;
    let needed = grouped(look.store.named_blobs().await?);
    look.store.close().await;
    let (source, blobs) = (Blobs::at(backup), Blobs::open(place)?);
    let mut pace = Pace::new("blobs restored", needed.len());
    for Needed { blob, .. } in &needed {
        // What is lacking, the check tells.
        if let Copied::Lacking(why) = blobs.copy_from(&source, blob, false)? {
            tracing::error!(blob.id = %blob, why, "the backup lacks a blob");
        }
        pace.one_more();
    }
    Ok(())
}

fn fault<'a>(doing: &'a str, path: &'a Path) -> impl FnOnce(io::Error) -> Error + 'a {
    move |error| Error::internal(format!("{doing} {}", path.display()), error)
}
