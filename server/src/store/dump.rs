//! Copies of a database by PostgreSQL's own programs: a dump of one moment beside a running server, and an empty database
//! filled from a dump. Must not depend on files but the dump.

use std::{io, path::Path};

use tokio::process::Command;

use super::{NamedBlob, Postgres, ReadOnlyDatabase, Store, fault::fault, lab, row, schema};
use crate::error::{Error, Result};

impl Postgres {
    /// Dumps the database at one moment to a new file, without open uploads, whose files are not copied; returns its
    /// blobs as the dump names them.
    ///
    /// # Errors
    /// Precondition when `pg_dump` is missing, older than PostgreSQL, or fails.
    pub(crate) async fn dump(&self, database: &ReadOnlyDatabase, to: &Path) -> Result<Vec<NamedBlob>> {
        self.expect_program("pg_dump", self.version(&database.store).await?).await?;
        self.expect_program("pg_restore", 0).await?;
        let mut tx = database.store.read().begin_read().await.map_err(fault("beginning a dump"))?;
        let snapshot: String =
            row::query_as("select pg_export_snapshot()").fetch_one(&mut tx).await.map_err(fault("beginning a dump"))?;
        let named = Store::named_blobs_on(&mut tx).await?;
        let mut command = self.program("pg_dump");
        command.args(["--format=custom", "--no-owner", "--no-privileges", "--exclude-table-data=uploads"]);
        command
            .arg(format!("--snapshot={snapshot}"))
            .arg(format!("--dbname={}", self.shown_url()))
            .arg("--file")
            .arg(to);
        run("pg_dump", command).await?;
        drop(tx);
        // Reads all of it.
        let mut command = self.program("pg_restore");
        command.args(["--file", "/dev/null"]).arg(to);
        run("pg_restore", command).await?;
        Ok(named)
    }

    /// Rejects a database with tables, and a machine without `pg_restore`.
    ///
    /// # Errors
    /// Precondition.
    pub(crate) async fn expect_empty(&self) -> Result<()> {
        let store = Store::look_at(self).await?;
        let found = schema::known(&store.readers, self).await;
        store.close().await;
        if found? > 0 {
            return Err(Error::precondition(format!(
                "{self} is not empty; create a database with `createdb` and name it with --database"
            )));
        }
        self.expect_program("pg_restore", 0).await
    }

    /// Fills an empty database from a dump, all of it or nothing, and returns the blobs that it names. The first folder that
    /// it is served with becomes its own.
    ///
    /// # Errors
    /// Precondition when `pg_restore` fails.
    pub(crate) async fn fill(&self, from: &Path) -> Result<Vec<NamedBlob>> {
        let mut command = self.program("pg_restore");
        command.args(["--exit-on-error", "--single-transaction", "--no-owner", "--no-privileges"]);
        command.arg(format!("--dbname={}", self.shown_url())).arg(from);
        run("pg_restore", command).await?;
        let store = Store::serve_postgres(self).await?;
        lab::detach(&store.writer).await?;
        let named = store.named_blobs().await?;
        store.close().await;
        Ok(named)
    }

    /// The major version of the server.
    async fn version(&self, store: &Store) -> Result<i64> {
        row::query_as("select cast(current_setting('server_version_num') as bigint) / 10000")
            .fetch_one(store.read())
            .await
            .map_err(fault("reading PostgreSQL's version"))
    }

    /// Rejects a program that is missing or older than a server of this version.
    async fn expect_program(&self, name: &str, least: i64) -> Result<()> {
        let mut command = self.program(name);
        command.arg("--version");
        let shown = run(name, command).await?;
        match major(&shown) {
            Some(found) if found >= least => Ok(()),
            _ => Err(Error::precondition(format!(
                "{name} on PATH is {}, and the server {self} has version {least}: install the programs of PostgreSQL {least} \
                 or newer (Debian: postgresql-client-{least}), and put their folder first on PATH",
                shown.trim()
            ))),
        }
    }
}

/// The major version in a line such as `pg_dump (PostgreSQL) 15.8 (Debian 15.8-1)`.
fn major(shown: &str) -> Option<i64> {
    let version = shown.split_whitespace().find(|word| word.starts_with(|first: char| first.is_ascii_digit()))?;
    version.split(|part: char| !part.is_ascii_digit()).next()?.parse().ok()
}

/// Runs a program to its end, and returns its output.
async fn run(name: &str, mut command: Command) -> Result<String> {
    let output = command.output().await.map_err(|error| {
        Error::precondition(if error.kind() == io::ErrorKind::NotFound {
            format!("{name} is not on PATH: backups of a database in PostgreSQL need its programs (Debian: postgresql-client)")
        } else {
            format!("{name} cannot be started: {error}")
        })
    })?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    let errors = String::from_utf8_lossy(&output.stderr);
    Err(Error::precondition(format!("{name} failed ({}): {}", output.status, errors.trim())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_of_programs_are_read() {
        for (shown, version) in [
            ("pg_dump (PostgreSQL) 15.18 (Debian 15.18-0+deb12u1)", Some(15)),
            ("pg_restore (PostgreSQL) 17beta2", Some(17)),
            ("pg_dump", None),
        ] {
            assert_eq!(major(shown), version, "{shown}");
        }
    }

    #[tokio::test]
    async fn missing_and_old_programs_are_named_with_the_remedy() {
        let at = Postgres::at("postgres://gleaner:hunter2@db/lab").unwrap();
        let missing = at.expect_program("pg_dump_of_nobody", 15).await.unwrap_err();
        assert!(missing.message().contains("is not on PATH"), "{missing}");
        // Its version is not that of PostgreSQL: older than any.
        let old = at.expect_program("true", 99).await.unwrap_err();
        assert!(old.message().contains("postgresql-client-99") && !old.message().contains("hunter2"), "{old}");
    }
}
