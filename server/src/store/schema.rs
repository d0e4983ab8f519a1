//! The schema of a database: its version, and its update by the migrations of this program.

use std::{fmt::Display, sync::LazyLock};

use include_dir::{Dir, include_dir};
use sqlx::{
    SqlSafeStr as _,
    migrate::{MigrateError, Migration, MigrationType, Migrator},
};

use super::{fault, row, sql::Pool};
use crate::error::{Error, Result};

/// The migrations of SQLite. Those of PostgreSQL have the same numbers, from the one with which they begin.
pub(super) static SQLITE: LazyLock<Migrator> = LazyLock::new(|| migrator(&SQLITE_FILES));
static POSTGRES: LazyLock<Migrator> = LazyLock::new(|| migrator(&POSTGRES_FILES));

// `sqlx::migrate!` would compile both databases a second time, for the compiler itself.
static SQLITE_FILES: Dir<'static> = include_dir!("$CARGO_MANIFEST_DIR/../migrations/sqlite");
static POSTGRES_FILES: Dir<'static> = include_dir!("$CARGO_MANIFEST_DIR/../migrations/postgres");

/// The migrations of a folder, with the description and checksum that `sqlx` gives each. Other files are left out.
fn migrator(files: &'static Dir<'static>) -> Migrator {
    let migration = |file: &'static include_dir::File<'static>| {
        let (version, description) = file.path().to_str()?.strip_suffix(".sql")?.split_once('_')?;
        let (version, sql) = (version.parse().ok()?, file.contents_utf8()?);
        let (description, alone) = (description.replace('_', " "), sql.starts_with("-- no-transaction"));
        Some(Migration::new(version, description.into(), MigrationType::Simple, sql.into_sql_str(), alone))
    };
    Migrator::with_migrations(files.files().filter_map(migration).collect())
}

/// The newest migration of this program.
pub(crate) fn newest() -> i64 {
    SQLITE.iter().map(|migration| migration.version).max().unwrap_or_default()
}

/// Brings the schema of a database up to date; `shown`: the database, for people.
///
/// # Errors
/// Precondition when the database was migrated by a newer program.
pub(super) async fn update(pool: &Pool, shown: impl Display) -> Result<()> {
    let found = known(pool, &shown).await?;
    if found > 0 && found < newest() {
        tracing::info!(schema.found = found, schema.newest = newest(), "updating the database");
    }
    let updated = match pool {
        Pool::Sqlite(pool) => SQLITE.run(pool).await,
        Pool::Postgres(pool) => POSTGRES.run(pool).await,
    };
    updated.map_err(|error| {
        if let MigrateError::VersionMissing(version) = error {
            return Error::precondition(format!(
                "the database {shown} has a migration {version} that this program does not know: use the gleaner-server \
                 that made it"
            ));
        }
        Error::internal("migrating the database", error)
    })
}

/// Rejects a database migrated by a newer program; returns its newest migration, 0 for none.
///
/// # Errors
/// Precondition names both versions.
pub(super) async fn known(pool: &Pool, shown: impl Display) -> Result<i64> {
    let found = version(pool).await?;
    expect_known(found, shown)?;
    Ok(found)
}

/// The newest migration of a database, 0 for none.
///
/// # Errors
/// As of a read.
pub(super) async fn version(pool: &Pool) -> Result<i64> {
    if !has_table(pool, "_sqlx_migrations").await? {
        return Ok(0);
    }
    let found: Option<i64> = row::query_as("select max(version) from _sqlx_migrations")
        .fetch_one(pool)
        .await
        .map_err(fault("reading the database's version"))?;
    Ok(found.unwrap_or_default())
}

/// Rejects the version of a newer program.
///
/// # Errors
/// Precondition names both versions.
pub(super) fn expect_known(found: i64, shown: impl Display) -> Result<()> {
    let newest = newest();
    if found <= newest {
        return Ok(());
    }
    Err(Error::precondition(format!(
        "the database {shown} has schema version {found}, and gleaner-server {} supports versions up to {newest}: use the \
         newer gleaner-server that made it, or restore an earlier backup",
        env!("CARGO_PKG_VERSION"),
    )))
}

/// Whether a database has this table.
///
/// # Errors
/// Internal.
pub(super) async fn has_table(pool: &Pool, name: &str) -> Result<bool> {
    let tables = match pool {
        Pool::Sqlite(_) => "select exists (select 1 from sqlite_master where name = $1)",
        Pool::Postgres(_) => "select to_regclass($1) is not null",
    };
    let exists = row::query_as(tables).bind(name).fetch_one(pool).await;
    exists.map_err(fault("reading the database's schema"))
}

/// Whether a table has this column.
pub(super) async fn has_column(pool: &Pool, table: &str, name: &str) -> Result<bool> {
    let columns = match pool {
        Pool::Sqlite(_) => "select exists (select 1 from pragma_table_info($1) where name = $2)",
        Pool::Postgres(_) => {
            "select exists (select 1 from information_schema.columns \
             where table_schema = current_schema() and table_name = $1 and column_name = $2)"
        }
    };
    let exists = row::query_as(columns).bind(table).bind(name).fetch_one(pool).await;
    exists.map_err(fault("reading the database's schema"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_is_a_migration_and_no_number_is_missing() {
        for (migrator, files) in [(&SQLITE, &SQLITE_FILES), (&POSTGRES, &POSTGRES_FILES)] {
            let versions: Vec<i64> = migrator.iter().map(|migration| migration.version).collect();
            assert_eq!(versions.len(), files.files().count());
            assert!(versions.is_sorted_by(|one, next| one + 1 == *next), "{versions:?}");
        }
        let known = SQLITE.iter().find(|migration| migration.version == 32).unwrap();
        assert_eq!(known.description, "schedule engine options");
    }

    #[test]
    fn both_databases_have_the_same_newest_migration() {
        assert_eq!(POSTGRES.iter().map(|migration| migration.version).max(), Some(newest()));
    }
}
