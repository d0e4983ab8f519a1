//! `migrate`: the database of a stopped server from SQLite to PostgreSQL, or back. The blobs stay where they are.

use std::{fs, io, path::Path};

use super::target::parent;
use crate::{
    blobs::{Blobs, sync_folder},
    config::{DatabaseConfig, MigrateConfig},
    data_folder::{DATABASE, beside_database, database, stamp::Stamp},
    domain::time::Millis,
    error::{Error, Result},
    lock::DataLock,
    store::{Database, Postgres, Store},
};

/// Moves the database and writes the number of rows of each table to `out`.
///
/// # Errors
/// Invalid names the flag; Precondition when a server runs, the target is not empty, or the database does not belong to
/// the blobs; Internal when a copied row differs.
pub(super) async fn migrate(config: &MigrateConfig, out: &mut impl io::Write) -> Result<()> {
    let data_dir = config.data_dir.as_path();
    let source = Database::configured(data_dir, &config.database)?;
    let to = config.to.reveal();
    let _lock = DataLock::take(data_dir)?;
    let (counts, shown) = match (&source.postgres, to) {
        (Some(at), "sqlite") => (to_sqlite(at, data_dir).await?, database(data_dir).display().to_string()),
        (None, url) if url.starts_with("postgres://") || url.starts_with("postgresql://") => {
            let named = DatabaseConfig { database: Some(config.to.clone()), ..config.database.clone() };
            let target = Database::configured(data_dir, &named)?;
            let Some(at) = &target.postgres else { return Err(wrong_target()) };
            (to_postgres(at, data_dir).await?, at.to_string())
        }
        (Some(_) | None, _) => return Err(wrong_target()),
    };
    let written = counts.iter().try_for_each(|(table, rows)| writeln!(out, "{rows:>10}  {table}"));
    let written = written.and_then(|()| writeln!(out, "moved to {shown}; every row is equal"));
    written.map_err(|error| Error::internal("writing the report", error))
}

fn wrong_target() -> Error {
    Error::invalid(
        "--to",
        "name a database of PostgreSQL (postgres://USER@HOST:PORT/NAME), or `sqlite` together with the --database to move",
    )
}

async fn to_postgres(at: &Postgres, data_dir: &Path) -> Result<Vec<(&'static str, u64)>> {
    if !database(data_dir).is_file() {
        let folder = data_dir.display();
        return Err(Error::precondition(format!(
            "{folder} holds no database; --data-dir names a server's data folder"
        )));
    }
    // Brings its schema up to date, and rejects one that does not belong to the blobs.
    let source = Store::open_with_blobs(&Database::in_folder(data_dir), &Blobs::open(data_dir)?, false).await?;
    let target = Store::serve_postgres(at).await?;
    let counts = source.transfer(&target).await?;
    target.close().await;
    source.close().await;
    set_aside(data_dir)?;
    Ok(counts)
}

/// Renames the SQLite database, so that no command takes it for the present one.
fn set_aside(data_dir: &Path) -> Result<()> {
    let mark = Millis::now().0;
    for suffix in ["", "-wal", "-shm"] {
        let (from, to) =
            (beside_database(data_dir, suffix), data_dir.join(format!("migrated-{mark}-{DATABASE}{suffix}")));
        match fs::rename(&from, &to) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                return Err(Error::internal(format!("renaming {}", from.display()), error));
            }
            Ok(()) | Err(_) => {}
        }
    }
    sync_folder(data_dir)
}

async fn to_sqlite(at: &Postgres, data_dir: &Path) -> Result<Vec<(&'static str, u64)>> {
    let place = database(data_dir);
    if place.exists() {
        return Err(Error::precondition(format!(
            "{} exists; move it away, or name another data folder",
            place.display()
        )));
    }
    let source = Store::serve_postgres(at).await?;
    let misfit = source.misfit(Stamp::read(data_dir)?.as_ref(), &Blobs::open(data_dir)?).await?;
    if let Some(misfit) = misfit {
        return Err(Error::precondition(format!("{at}: {misfit}")));
    }
    // Complete before it has its name.
    let draft = tempfile::Builder::new().prefix(".migrating-").tempdir_in(parent(&place));
    let draft = draft.map_err(|error| Error::internal("making a folder for the new database", error))?;
    let file = draft.path().join(DATABASE);
    let target = Store::open(&file).await?;
    let counts = source.transfer(&target).await?;
    target.close().await;
    source.close().await;
    let moved = fs::rename(&file, &place);
    moved.map_err(|error| Error::internal(format!("moving the new database to {}", place.display()), error))?;
    sync_folder(data_dir)?;
    Ok(counts)
}
