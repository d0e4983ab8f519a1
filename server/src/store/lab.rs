//! The database's own row: its name for the folder of its blobs and its generation, compared with the stamp among the
//! blobs, so that a database of another folder, or an older copy, never decides which blobs are removed.

mod fit;

use std::{path::Path, sync::Arc};

use tokio_util::sync::CancellationToken;

use self::fit::{damaged, file, found, misfit};
use super::{
    Database, Store, fault,
    row::{self, Column as _, record},
    schema,
    sql::{self, Pool, Transaction},
    tie::Tie,
};
use crate::{
    blobs::Blobs,
    data_folder::{
        self,
        presence::Presence,
        stamp::{Stamp, StampFile},
        way_to_accept, ways_out,
    },
    error::{Error, Kind, Result},
};

/// The row of the database itself.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Lab {
    folder: String,
    stamped: bool,
    generation: u64,
    /// Expected number of episodes minus the actual number.
    missing: i64,
}

record! { Lab: folder, stamped, generation, missing }

/// The columns of [`Lab`].
macro_rules! columns {
    () => {
        "folder, stamped, generation, episodes - (select count(*) from episodes) as missing"
    };
}

/// The relation of a database to a stamp.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Comparison {
    /// Both have the same name for the folder.
    pub(crate) same_folder: bool,
    /// The folder is the same, and the database is not older.
    pub(crate) current: bool,
    /// The database is not a mixture of two copies.
    pub(crate) whole: bool,
}

impl Store {
    /// Opens the database of a data folder whose blobs it must belong to, creates it in a new folder, and starts a new
    /// generation of both. `accept` uses a database unchanged although it does not belong to the blobs, or is a backup's.
    ///
    /// # Errors
    /// Precondition, with the remedies, when the database is missing, damaged, of another folder, or older than the
    /// blobs, when the folder is a backup, and when there is nothing to accept; as for [`Store::open`].
    pub(crate) async fn open_with_blobs(database: &Database, blobs: &Blobs, accept: bool) -> Result<Self> {
        let data_dir = database.data_dir.as_path();
        let found = match &database.postgres {
            None => found(&data_folder::database(data_dir), data_dir).await?,
            Some(at) => fit::found_in_postgres(at).await?,
        };
        let stamp = match Stamp::read(data_dir) {
            // After a crash or on a full disk during the first stamp.
            Err(_) if accept || found.as_ref().is_some_and(|lab| !lab.stamped) => None,
            stamp => stamp?,
        };
        let misfit = misfit(found.as_ref(), stamp.as_ref(), blobs)?;
        let is_backup = misfit.is_none() && data_folder::is_unused_backup(data_dir);
        match &misfit {
            Some(misfit) if !accept => {
                let moves = database.postgres.is_some() && found.is_none() && data_folder::database(data_dir).is_file();
                let first =
                    if moves { "Move the SQLite database of the folder with `gleaner-server migrate`. " } else { "" };
                let ways = way_to_accept(data_dir);
                return Err(Error::precondition(format!("{database}: {misfit}. {first}{ways}")));
            }
            Some(misfit) => tracing::warn!(%database, "accepted by --accept-database: {misfit}"),
            None if is_backup && !accept => {
                return Err(Error::precondition(format!(
                    "{}; `gleaner-server serve --data-dir {} --accept-database` uses the backup itself as the data folder \
                     from then on",
                    data_folder::backup_is_no_lab(data_dir),
                    data_dir.display()
                )));
            }
            None if is_backup => tracing::warn!(
                data.dir = %data_dir.display(),
                "accepted by --accept-database: the backup is a data folder from now on, and no backup replaces it"
            ),
            None if accept => {
                return Err(Error::precondition(format!(
                    "--accept-database: {database} belongs to the blobs beside it; start without this flag"
                )));
            }
            None if found.is_none() => tracing::info!(
                data.dir = %data_dir.display(),
                "a new data folder was created; if it should hold data already, its disk may not be mounted"
            ),
            None => {}
        }
        let store = match &database.postgres {
            None => {
                let path = data_folder::database(data_dir);
                Self::open(&path).await.map_err(|error| damaged(&path, data_dir, error))?
            }
            Some(at) => Self::serve_postgres(at).await?,
        };
        if misfit.is_some() {
            // The sidecars may be newer than these rows.
            store.forget_queued_sidecars().await?;
        }
        store.tie(data_dir, stamp.map_or(0, |stamp| stamp.generation)).await
    }

    /// Ties the database to its folder: a new generation in both, first here and then in the stamp, so that a crash in
    /// between leaves the stamp behind, which is accepted.
    ///
    /// # Errors
    /// When the database or the disk fails.
    pub(crate) async fn tie(self, data_dir: &Path, least: u64) -> Result<Self> {
        let lab = match self.start_generation(least).await {
            Ok(lab) => lab,
            // A full disk must not prevent the start, so the generation stays.
            Err(error) if error.kind() == Kind::Exhausted => {
                tracing::error!(%error, "the generation of the database stays as it is");
                lab(&self.writer).await?
            }
            Err(error) => return Err(error),
        };
        let generation = lab.generation.max(least);
        let (inode, bytes) = file(&data_folder::database(data_dir));
        let stamp = StampFile::put(data_dir, Stamp { folder: lab.folder, generation, inode, bytes })?;
        if !lab.stamped {
            let mut tx = self.write().await?;
            sql::query("update lab set stamped = true").execute(&mut tx).await.map_err(fault("noting the stamp"))?;
            self.commit(tx).await?;
        }
        // The write-ahead log exists from here on.
        let presence = Presence::note(data_dir)?;
        let _: std::result::Result<(), _> = self.tie.set(Tie { presence, stamp });
        Ok(self)
    }

    async fn start_generation(&self, least: u64) -> Result<Lab> {
        let mut tx = self.write().await?;
        let lab = sql::query(concat!(
            "update lab set generation = case when generation < $1 then $1 else generation end + 1 returning ",
            columns!()
        ))
        .bind(least.param())
        .try_map(row::read)
        .fetch_one(&mut tx)
        .await
        .map_err(fault("starting a generation"))?;
        self.commit(tx).await?;
        Ok(lab)
    }

    /// Commits a write whose loss in an older copy of the database must be detected: when this returns, the stamp has
    /// the new generation.
    pub(super) async fn commit_generation(&self, mut tx: Transaction) -> Result<()> {
        let generation = sql::query("update lab set generation = generation + 1 returning generation")
            .try_map(row::read)
            .fetch_one(&mut tx)
            .await
            .map_err(fault("counting a generation"))?;
        self.commit(tx).await?;
        let tie = Arc::clone(&self.tie);
        let raising = tokio::task::spawn_blocking(move || tie.get().map_or(Ok(()), |tie| tie.stamp.raise(generation)));
        raising.await.map_err(|error| Error::internal("raising the stamp", error))?
    }

    /// Whether the files of the database, its stamp and its lock are still the ones that were opened.
    ///
    /// # Errors
    /// Precondition names the file that was deleted or replaced.
    pub(crate) fn verify(&self) -> Result<()> {
        self.tie.get().map_or(Ok(()), |tie| tie.presence.verify())
    }

    /// A token that is cancelled once one of those files is found deleted or replaced; never for a read-only database.
    pub(crate) fn lost(&self) -> CancellationToken {
        self.tie.get().map(|tie| tie.presence.lost()).unwrap_or_default()
    }

    /// The reason why the stamp of a data folder does not belong to this database; `None` when it does.
    ///
    /// # Errors
    /// When the database or the stamp cannot be read.
    pub(crate) async fn misfit(&self, stamp: Option<&Stamp>, blobs: &Blobs) -> Result<Option<String>> {
        misfit(Some(&lab(&self.readers).await?), stamp, blobs)
    }

    /// The relation of the database to a stamp.
    pub(crate) async fn compare(&self, stamp: Option<&Stamp>) -> Result<Comparison> {
        let lab = lab(&self.readers).await?;
        let same = stamp.filter(|stamp| stamp.folder == lab.folder);
        Ok(Comparison {
            same_folder: same.is_some(),
            current: same.is_some_and(|stamp| lab.generation >= stamp.generation),
            whole: lab.missing == 0,
        })
    }

    async fn expect_sound(&self, data_dir: &Path) -> Result<()> {
        match self.integrity().await?.first() {
            None => Ok(()),
            Some((subject, problem)) => Err(Error::precondition(format!(
                "{} is damaged: {subject}: {problem}. If its write-ahead log ({}-wal) and index (-shm) are another file's, \
                 move them away. {}",
                data_folder::database(data_dir).display(),
                data_folder::DATABASE,
                ways_out(data_dir)
            ))),
        }
    }
}

/// Removes a copy's link to its folder: the first folder it is served in becomes its own, and every row is described
/// again. The workers of a cluster that run its jobs are the first server's: that of the copy queues these jobs again.
pub(super) async fn detach(copy: &Pool) -> Result<()> {
    let there = schema::has_table(copy, "lab").await?;
    if schema::has_column(copy, "jobs", "engine").await? {
        let leave = "update jobs set engine = '', engine_id = '', process = null where state = 'running'";
        sql::query(leave).execute(copy).await.map_err(fault("detaching the jobs of a copy"))?;
    }
    let name = match copy {
        Pool::Sqlite(_) => "update lab set folder = lower(hex(randomblob(16))), stamped = false, generation = 0",
        Pool::Postgres(_) => {
            "update lab set folder = replace(gen_random_uuid()::text, '-', ''), stamped = false, generation = 0"
        }
    };
    let describe = "insert into sidecar_queue (id) select id from (select id from tasks union all select id from episodes \
         where purged_at is null union all select id from encoders union all select id from policies) as described \
         where true on conflict do nothing";
    for statement in [name, describe].into_iter().filter(|_| there) {
        sql::query(statement).execute(copy).await.map_err(fault("detaching a copy of the database"))?;
    }
    Ok(())
}

async fn lab(pool: &Pool) -> Result<Lab> {
    sql::query(concat!("select ", columns!(), " from lab"))
        .try_map(row::read)
        .fetch_one(pool)
        .await
        .map_err(fault("reading the database's row"))
}

#[cfg(test)]
mod tests;
