//! A standby: a server that reads the database of a leader and takes the lead once that is gone.

use super::{
    Database, Store,
    fault::fault,
    postgres::{self, Postgres},
    schema,
    sql::Pool,
};
use crate::{
    blobs::Blobs,
    data_folder::stamp::Stamp,
    error::{Error, Result},
};

impl Store {
    /// Opens the database of a leader, whose blobs must be in the same data folder.
    ///
    /// # Errors
    /// Precondition when it cannot be used, is empty, has another schema than this program, or belongs to other blobs.
    pub(crate) async fn follow(at: &Postgres, database: &Database, blobs: &Blobs) -> Result<Self> {
        let store = Self::follow_postgres(at).await?;
        match store.expect_same_lab(at, database, blobs).await {
            Ok(_) => {
                store.look_for_leader().await?;
                Ok(store)
            }
            Err(error) => {
                store.close().await;
                Err(error)
            }
        }
    }

    /// Rejects a change unless this server leads.
    ///
    /// # Errors
    /// Precondition names the leader; Unavailable while no server leads.
    pub(crate) fn expect_leader(&self) -> Result<()> {
        self.role.as_ref().map_or(Ok(()), |role| role.expect_leader())
    }

    /// Notes which server leads, for the errors of changes.
    ///
    /// # Errors
    /// Unavailable without PostgreSQL.
    pub(crate) async fn look_for_leader(&self) -> Result<()> {
        if let (Some(role), Pool::Postgres(readers)) = (&self.role, &self.readers) {
            role.note_leader(postgres::leader(readers).await.map_err(fault("looking for the leader"))?);
        }
        Ok(())
    }

    /// Takes the lock of the database and a new generation, after which this server may write; false while another server
    /// has the lock. The lock of the data folder must be held.
    ///
    /// # Errors
    /// Precondition when the database does not belong to the blobs or has another schema; Unavailable without PostgreSQL.
    pub(crate) async fn take_lead(&self, at: &Postgres, database: &Database, blobs: &Blobs) -> Result<bool> {
        let (Some(role), Pool::Postgres(writer)) = (&self.role, &self.writer) else { return Ok(true) };
        self.look_for_leader().await?;
        if role.has_leader() {
            return Ok(false);
        }
        let generation = self.expect_same_lab(at, database, blobs).await?;
        // Its beginning takes the lock.
        drop(writer.acquire().await.map_err(fault("taking the lead"))?);
        role.take_over();
        match self.clone().tie(&database.data_dir, generation).await {
            Ok(_) => Ok(true),
            Err(error) => {
                role.follow();
                Err(error)
            }
        }
    }

    /// Returns when this server leads.
    pub(crate) async fn leads(&self) {
        if let Some(role) = &self.role {
            role.leads().await;
        }
    }

    /// Accepts changes from now on.
    pub(crate) fn lead(&self) {
        if let Some(role) = &self.role {
            role.lead();
        }
    }

    /// Rejects a database that is not the one of the blobs; returns the generation of their stamp.
    async fn expect_same_lab(&self, at: &Postgres, database: &Database, blobs: &Blobs) -> Result<u64> {
        match schema::known(&self.readers, at).await? {
            found if found == schema::newest() => {}
            0 => {
                return Err(Error::precondition(format!(
                    "{at}: the database is empty: its leader has not started yet; start this standby again"
                )));
            }
            found => {
                return Err(Error::precondition(format!(
                    "{at}: the database has schema version {found}, and this program {}; use the gleaner-server of its leader",
                    schema::newest()
                )));
            }
        }
        // Before the database, whose generation is never behind.
        let stamp = Stamp::read(&database.data_dir)?;
        match self.misfit(stamp.as_ref(), blobs).await? {
            None => Ok(stamp.map_or(0, |stamp| stamp.generation)),
            Some(misfit) => Err(Error::precondition(format!(
                "{at}: {misfit}. A standby needs the data folder of the leader, on a file system that they share, at --data-dir"
            ))),
        }
    }
}
