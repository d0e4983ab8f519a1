//! The database's own row: its name for the folder of its blobs and its generation, held against the stamp that lies
//! among the blobs, so that a database of another folder, or an older copy, never decides what is removed.

use std::{io::ErrorKind, os::unix::fs::MetadataExt as _, path::Path, sync::Arc};

use sqlx::SqlitePool;
use tokio_util::sync::CancellationToken;

use super::{Store, fault, row};
use crate::{
    blobs::Blobs,
    data_folder::{
        self,
        presence::Presence,
        stamp::{Stamp, StampFile},
        ways_out,
    },
    error::{Error, Kind, Result},
};

/// What the row says of the folder.
#[derive(Debug, Clone, PartialEq, Eq, sqlx::FromRow)]
struct Lab {
    folder: String,
    stamped: bool,
    generation: i64,
}

/// What ties an open database to its folder.
#[derive(Debug)]
pub(super) struct Tie {
    presence: Presence,
    stamp: StampFile,
}

impl Store {
    /// Opens the database of a data folder whose blobs it must belong to, creates it in a new folder, and starts a new
    /// generation of both. `accept` takes a database that does not belong to the blobs as it is.
    ///
    /// # Errors
    /// Precondition, with the ways out, when the database is missing, damaged, of another folder, or older than the blobs;
    /// as for [`Store::open`].
    pub(crate) async fn open_with_blobs(data_dir: &Path, blobs: &Blobs, accept: bool) -> Result<Self> {
        let path = data_folder::database(data_dir);
        let stamp = if accept { Stamp::read(data_dir).unwrap_or_default() } else { Stamp::read(data_dir)? };
        let before = found(&path, data_dir).await?;
        match misfit(before.as_ref(), stamp.as_ref(), blobs)? {
            Some(misfit) if !accept => {
                return Err(Error::precondition(format!("{}: {misfit}. {}", path.display(), ways_out(data_dir))));
            }
            Some(misfit) => tracing::warn!(file.path = %path.display(), "accepted by --accept-database: {misfit}"),
            None => {}
        }
        let store = Self::open(&path).await.map_err(|error| damaged(&path, data_dir, error))?;
        let (inode, bytes) = file(&path);
        if before.is_some() && stamp.as_ref().is_some_and(|stamp| stamp.inode != inode || stamp.bytes > bytes) {
            store.expect_sound(data_dir).await?;
        }
        store.tie(data_dir, stamp.map_or(0, |stamp| stamp.generation)).await
    }

    /// Ties the database to its folder: a new generation in both, first here and then on the stamp, so that a crash in
    /// between leaves the stamp behind, which is no misfit.
    async fn tie(self, data_dir: &Path, least: u64) -> Result<Self> {
        let started: Result<Lab> = async {
            let mut tx = self.write().await?;
            let lab = sqlx::query_as(
                "update lab set generation = max(generation, ?) + 1 returning folder, stamped, generation",
            )
            .bind(row::stored(least))
            .fetch_one(&mut *tx)
            .await
            .map_err(fault("starting a generation"))?;
            self.commit(tx).await?;
            Ok(lab)
        }
        .await;
        let lab = match started {
            Ok(lab) => lab,
            // A full disk is not in the way of the start: the generation stays.
            Err(error) if error.kind() == Kind::Exhausted => {
                tracing::error!(%error, "the generation of the database stays as it is");
                lab(&self.writer).await?
            }
            Err(error) => return Err(error),
        };
        let generation = row::count("lab.generation", lab.generation)?.max(least);
        let (inode, bytes) = file(&data_folder::database(data_dir));
        let stamp = StampFile::put(data_dir, Stamp { folder: lab.folder, generation, inode, bytes })?;
        if !lab.stamped {
            let mut tx = self.write().await?;
            sqlx::query("update lab set stamped = 1").execute(&mut *tx).await.map_err(fault("noting the stamp"))?;
            self.commit(tx).await?;
        }
        // The write-ahead log is there by now.
        let presence = Presence::note(data_dir)?;
        let _: std::result::Result<(), _> = self.tie.set(Tie { presence, stamp });
        Ok(self)
    }

    /// Commits a write that names a blob: when this returns, the stamp says that there is one generation more.
    pub(super) async fn commit_generation(&self, mut tx: sqlx::Transaction<'static, sqlx::Sqlite>) -> Result<()> {
        let generation: i64 = sqlx::query_scalar("update lab set generation = generation + 1 returning generation")
            .fetch_one(&mut *tx)
            .await
            .map_err(fault("counting a generation"))?;
        self.commit(tx).await?;
        let (tie, generation) = (Arc::clone(&self.tie), row::count("lab.generation", generation)?);
        let raising = tokio::task::spawn_blocking(move || tie.get().map_or(Ok(()), |tie| tie.stamp.raise(generation)));
        raising.await.map_err(|error| Error::internal("raising the stamp", error))?
    }

    /// Whether the files of the database, its stamp and its lock are still the ones that were opened.
    ///
    /// # Errors
    /// Precondition names what was deleted or replaced.
    pub(crate) fn verify(&self) -> Result<()> {
        self.tie.get().map_or(Ok(()), |tie| tie.presence.verify())
    }

    /// Ends once one of those files was found deleted or replaced; never for a database that is only looked at.
    pub(crate) fn lost(&self) -> CancellationToken {
        self.tie.get().map(|tie| tie.presence.lost()).unwrap_or_default()
    }

    /// Whether the stamp of a data folder belongs to this database; the sentence says why not.
    ///
    /// # Errors
    /// When the database or the stamp cannot be read.
    pub(crate) async fn misfit(&self, stamp: Option<&Stamp>, blobs: &Blobs) -> Result<Option<String>> {
        misfit(Some(&lab(&self.readers).await?), stamp, blobs)
    }

    /// Whether the stamp names this very database, of whatever generation.
    pub(crate) async fn belongs_to(&self, stamp: Option<&Stamp>) -> Result<bool> {
        let lab = lab(&self.readers).await?;
        Ok(stamp.is_some_and(|stamp| stamp.folder == lab.folder))
    }

    /// A database file that is another than the last time, a copy, was perhaps copied while it was written.
    async fn expect_sound(&self, data_dir: &Path) -> Result<()> {
        match self.integrity().await?.first() {
            None => Ok(()),
            Some((subject, problem)) => Err(Error::precondition(format!(
                "{} is another file than at the last start, and damaged: {subject}: {problem}. {}",
                data_folder::database(data_dir).display(),
                ways_out(data_dir)
            ))),
        }
    }
}

/// Has a copy of a database belong to no folder yet: the one where it is served first is its own from then on, and has
/// every row described anew.
pub(super) async fn detach(copy: &SqlitePool) -> Result<()> {
    let there: bool = sqlx::query_scalar("select exists (select 1 from sqlite_master where name = 'lab')")
        .fetch_one(copy)
        .await
        .map_err(fault("looking for the database's row"))?;
    let statements = [
        "update lab set folder = lower(hex(randomblob(16))), stamped = 0, generation = 0",
        "insert or ignore into sidecar_queue (id) select id from tasks union all select id from episodes \
         where purged_at is null union all select id from encoders union all select id from policies",
    ];
    for statement in statements.into_iter().filter(|_| there) {
        sqlx::query(statement).execute(copy).await.map_err(fault("detaching a copy of the database"))?;
    }
    Ok(())
}

async fn lab(pool: &SqlitePool) -> Result<Lab> {
    sqlx::query_as("select folder, stamped, generation from lab")
        .fetch_one(pool)
        .await
        .map_err(fault("reading the database's row"))
}

/// The row of the database at `path`, which is left as it is. A database from before the row has none yet; its row is
/// that of a database that was never stamped. `None` when there is no database.
async fn found(path: &Path, data_dir: &Path) -> Result<Option<Lab>> {
    let unusable = |problem: String| damaged(path, data_dir, Error::internal("opening it", problem));
    match std::fs::metadata(path) {
        Ok(file) if file.len() > 0 => {}
        // SQLite makes an empty file before it writes the first page.
        Ok(file) if file.is_file() => return Ok(None),
        Ok(_) => return Err(unusable("it is not a file".to_owned())),
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(unusable(error.to_string())),
    }
    let pool = super::connect_to_existing(path).await.map_err(|error| unusable(error.to_string()))?;
    let read = async {
        let named = "select exists (select 1 from sqlite_master where name = ?)";
        if super::look::known_schema(&pool, path).await? == 0 {
            return Ok(None);
        }
        let there: bool =
            sqlx::query_scalar(named).bind("lab").fetch_one(&pool).await.map_err(fault("looking for the row"))?;
        let never = Lab { folder: String::new(), stamped: false, generation: 0 };
        if there { lab(&pool).await.map(Some) } else { Ok(Some(never)) }
    }
    .await;
    pool.close().await;
    read.map_err(|error| damaged(path, data_dir, error))
}

/// Why a database and a folder of blobs do not belong together, if they do not.
fn misfit(lab: Option<&Lab>, stamp: Option<&Stamp>, blobs: &Blobs) -> Result<Option<String>> {
    let misfit = match (lab, stamp) {
        (None, None) if blobs.is_empty()? => return Ok(None),
        (None, _) => "there is no database, or an empty one, and the folder holds blobs".to_owned(),
        // From before stamps, or a crash before the first one.
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
            let generation = row::count("lab.generation", lab.generation)?;
            if generation >= stamp.generation {
                return Ok(None);
            }
            format!(
                "the database is older than the blobs (generation {generation}, the stamp says {}): it is an earlier copy, \
                 or was copied without its write-ahead log ({}-wal)",
                stamp.generation,
                data_folder::DATABASE
            )
        }
    };
    Ok(Some(misfit))
}

/// The inode of a file and its bytes; zeros for none.
fn file(path: &Path) -> (u64, u64) {
    std::fs::metadata(path).map_or((0, 0), |file| (file.ino(), file.len()))
}

/// What SQLite says of a file that it cannot use is the operator's to hear, not a fault of ours.
fn damaged(path: &Path, data_dir: &Path, error: Error) -> Error {
    if error.kind() != Kind::Internal {
        return error;
    }
    Error::precondition(format!("{} cannot be used: {error}. {}", path.display(), ways_out(data_dir)))
}

#[cfg(test)]
mod tests;
