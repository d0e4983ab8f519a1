//! `backup`: the database at one moment and every blob that it names, copied beside a running server.
//!
//! The order makes every backup complete:
//!
//! 1. the server is prevented from removing blobs, so that blobs named by the copied database stay until they are
//!    copied;
//! 2. the database is copied first, in one read transaction, to a draft (of PostgreSQL by `pg_dump`): a blob stored later
//!    is named by no row of the copy; in the opposite order a row could name a blob that was stored too late to be copied;
//! 3. each blob is copied to a draft, checked by its digest, and renamed to its path; a blob of an earlier backup is
//!    copied again only if it is to be verified and does not match its name;
//! 4. the database's draft is renamed over the earlier one, then the manifest is written.
//!
//! A backup interrupted before step 4 leaves the earlier backup, with additional blobs. Open uploads are not part of a
//! backup: their clients have the recordings and send them again.

use std::{
    collections::HashSet,
    fs, io,
    path::{Path, PathBuf},
};

use super::{
    files::{Needed, Progress, grouped},
    manifest::{Manifest, MissingBlob},
    target,
};
use crate::{
    blobs::{self, Blobs, Copied, Copying, sync_folder},
    config::BackupConfig,
    data_folder::{DATABASE, DUMP, stamp::Stamp, ways_out},
    domain::id::BlobId,
    error::{DISK_FULL, DISK_READ_ONLY, Error, Result},
    store::{Database, NamedBlob, Postgres, ReadOnlyDatabase, Store},
};

/// Backs a data folder up and writes a summary to `out`; true when no blob is missing.
///
/// # Errors
/// Precondition when the target is not usable for a backup or is that of another lab, there is no database to back up or it
/// does not belong to the blobs, or `pg_dump` is missing or fails; Exhausted when the disk of the target is full or cannot
/// be written; Internal when a disk fails.
pub(super) async fn backup(config: &BackupConfig, out: &mut impl io::Write) -> Result<bool> {
    copy_to_target(config, out).await.map_err(|error| of_target(&config.target, error))
}

/// The target alone is written, so a disk that rejects writes is that of the target and not that of the data folder.
fn of_target(target: &Path, error: Error) -> Error {
    if ![DISK_FULL, DISK_READ_ONLY].contains(&error.message()) {
        return error;
    }
    let cause = std::error::Error::source(&error).map(|cause| cause.to_string()).unwrap_or_default();
    let why = format!(
        "the disk of the backup {} is full or cannot be written. An earlier backup there is unchanged. Free some space on \
         it or remount it, then retry",
        target.display()
    );
    Error::refused_by_disk(&why, "backing up", cause)
}

async fn copy_to_target(config: &BackupConfig, out: &mut impl io::Write) -> Result<bool> {
    let (source, target) = (config.data_dir.as_path(), config.target.as_path());
    let database = Database::configured(source, &config.database)?;
    let _lock = target::claim(&database, target)?;
    let blobs = Blobs::open(target)?;
    let copying = Copying::begin(source)?;
    clear_drafts(target)?;
    let made_at = jiff::Timestamp::now().to_string();
    let (name, (schema, named)) = match &database.postgres {
        None => (DATABASE, copy_sqlite(&database, target).await?),
        Some(at) => (DUMP, dump_postgres(at, &database, target).await?),
    };
    let draft = draft(target, name);
    fs::File::open(&draft).and_then(|file| file.sync_all()).map_err(fault("syncing", &draft))?;
    let needed = grouped(named);
    let folder = Stamp::read(source).ok().flatten().map(|stamp| stamp.folder);
    target::expect_same_lab((source, folder.as_deref()), (target, &blobs), &needed)?;
    let copied = copy_blobs(&Blobs::at(source)?, &blobs, &needed, config.verify)?;
    drop(copying);
    let manifest = Manifest {
        gleaner: env!("CARGO_PKG_VERSION").to_owned(),
        made_at,
        folder,
        schema,
        database: blobs::digest(&draft)?,
        blobs: copied.there + copied.new,
        bytes: copied.bytes,
        lacking: copied.lacking,
    };
    finish(target, name, &manifest)?;
    let removed = if config.prune { prune(&blobs, &needed)? } else { 0 };
    write_summary(out, target, &manifest, copied.new, removed)
        .map_err(|error| Error::internal("writing the backup's summary", error))?;
    Ok(manifest.lacking.is_empty())
}

/// The database's name until every blob that it names is copied.
fn draft(target: &Path, name: &str) -> PathBuf {
    target.join("tmp").join(name)
}

/// Removes what an interrupted backup has left.
fn clear_drafts(target: &Path) -> Result<()> {
    let drafts = target.join("tmp");
    for left in fs::read_dir(&drafts).map_err(fault("listing", &drafts))? {
        let left = left.map_err(fault("listing", &drafts))?.path();
        fs::remove_file(&left).map_err(fault("removing", &left))?;
    }
    Ok(())
}

/// Copies the database to the draft, without open uploads; returns its schema and the blobs that it names.
async fn copy_sqlite(database: &Database, target: &Path) -> Result<(i64, Vec<NamedBlob>)> {
    let draft = draft(target, DATABASE);
    fitting(database, ways_out(&database.data_dir)).await?.store.close().await;
    Store::copy(&database.data_dir.join(DATABASE), &draft).await?;
    let database = ReadOnlyDatabase::open(&draft).await?;
    let named = database.store.named_blobs().await?;
    database.store.close().await;
    Ok((database.schema, named))
}

/// Opens a database that must belong to the blobs, as at the start of a server: a database that is older than they are, or
/// of another folder, must not replace that of an earlier backup, which may be the newest copy of its history.
async fn fitting(database: &Database, remedy: String) -> Result<ReadOnlyDatabase> {
    // Before the database, whose generation is never behind.
    let stamp = Stamp::read(&database.data_dir)?;
    let opened = ReadOnlyDatabase::configured(database).await?;
    match opened.store.misfit(stamp.as_ref(), &Blobs::at(&database.data_dir)?).await? {
        None => Ok(opened),
        Some(misfit) => {
            let unchanged = "An earlier backup in the target is unchanged";
            Err(Error::precondition(format!("{database}: {misfit}. {unchanged}. {remedy}")))
        }
    }
}

/// The same of a database in PostgreSQL.
async fn dump_postgres(at: &Postgres, database: &Database, target: &Path) -> Result<(i64, Vec<NamedBlob>)> {
    let opened = fitting(database, "Name the data folder of its server with --data-dir".to_owned()).await?;
    let named = at.dump(&opened, &draft(target, DUMP)).await?;
    opened.store.close().await;
    Ok((opened.schema, named))
}

/// Counts of copied blobs.
#[derive(Default)]
struct CopiedBlobs {
    there: u64,
    new: u64,
    bytes: u64,
    lacking: Vec<MissingBlob>,
}

fn copy_blobs(source: &Blobs, target: &Blobs, needed: &[Needed], verify: bool) -> Result<CopiedBlobs> {
    let (mut copied, mut progress) = (CopiedBlobs::default(), Progress::new("blobs backed up", needed.len()));
    for Needed { blob, by, size_bytes: _ } in needed {
        match target.copy_from(source, blob, verify)? {
            Copied::New(size) => {
                copied.new += 1;
                copied.bytes += size;
            }
            Copied::There(size) => {
                copied.there += 1;
                copied.bytes += size;
            }
            Copied::Lacking(why) => copied.lacking.push(MissingBlob { blob: blob.clone(), why, needed_by: by.clone() }),
        }
        progress.one_more();
    }
    Ok(copied)
}

/// Replaces the earlier database, then writes the manifest.
fn finish(target: &Path, name: &str, manifest: &Manifest) -> Result<()> {
    Manifest::remove(target)?;
    let place = target.join(name);
    fs::rename(draft(target, name), &place).map_err(fault("renaming to", &place))?;
    // From before the database was moved to PostgreSQL or back.
    let earlier = target.join(if name == DUMP { DATABASE } else { DUMP });
    if earlier.exists() {
        fs::remove_file(&earlier).map_err(fault("removing", &earlier))?;
    }
    sync_folder(target)?;
    manifest.write(target)
}

/// Removes the blobs that the backup's database no longer names, and returns their number.
fn prune(blobs: &Blobs, needed: &[Needed]) -> Result<u64> {
    let named: HashSet<&BlobId> = needed.iter().map(|needed| &needed.blob).collect();
    let mut removed = 0;
    for found in blobs.list()? {
        if found.id.is_some_and(|id| !named.contains(&id)) {
            fs::remove_file(&found.path).map_err(fault("removing", &found.path))?;
            removed += 1;
        }
    }
    Ok(removed)
}

fn write_summary(
    out: &mut impl io::Write,
    target: &Path,
    manifest: &Manifest,
    new: u64,
    removed: u64,
) -> io::Result<()> {
    for MissingBlob { blob, why, needed_by } in &manifest.lacking {
        writeln!(out, "problem: blob {blob}: {why}; needed by {}", needed_by.join(", "))?;
    }
    let Manifest { blobs, bytes, schema, .. } = manifest;
    let (shown, pruned) = (target.display(), if removed > 0 { format!(", {removed} removed") } else { String::new() });
    writeln!(out, "schema {schema}; {blobs} blobs of {bytes} bytes, {new} of them new{pruned}")?;
    match manifest.lacking.len() {
        0 => writeln!(out, "backed up to {shown}"),
        lacking => writeln!(
            out,
            "backed up to {shown}, without {lacking} blobs that are missing or damaged in the data folder"
        ),
    }
}

fn fault<'a>(doing: &'a str, path: &'a Path) -> impl FnOnce(io::Error) -> Error + 'a {
    move |error| Error::internal(format!("{doing} {}", path.display()), error)
}
