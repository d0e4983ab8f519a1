//! A standby: serves reads and sessions beside the leader of its database, follows the changes that others make, and takes
//! the lead once the leader is gone.
//!
//! Two locks make a leader: that of the data folder, then that of the database. The first is held as long as a leader
//! lives, also while it has lost PostgreSQL, because its workers and uploads use the folder. The second keeps servers apart
//! whose folders do not share locks.

use std::time::Duration;

use super::Services;
use crate::{
    config::ServeConfig,
    error::{Error, Result},
    lock::DataLock,
    store::{Database, Postgres},
};

/// The interval of attempts to take the lead.
const ATTEMPT_EVERY: Duration = Duration::from_secs(1);

/// The configured database with its address in PostgreSQL.
///
/// # Errors
/// Invalid names the flag.
pub(super) fn database(config: &ServeConfig) -> Result<(Database, Postgres)> {
    let database = Database::configured(&config.data_dir, &config.database)?.of_server(config.listen);
    match database.postgres.clone() {
        Some(at) => Ok((database, at)),
        None => Err(Error::invalid("--standby", "needs --database: servers share a database in PostgreSQL")),
    }
}

/// Whether another server leads the configured database, although the lock of the data folder is free: its connection may
/// outlive it for seconds.
///
/// # Errors
/// Precondition when PostgreSQL cannot be used.
pub(crate) async fn has_leader(config: &ServeConfig) -> Result<bool> {
    let (_, at) = database(config)?;
    at.has_leader().await
}

/// Follows the leader, and takes the lead once its locks are free. Returns when this server leads; the lock of the folder
/// is put into `held` before anything is written.
///
/// # Errors
/// When this server leads and cannot repair what the leader before it has left.
pub(crate) async fn take_over(services: &Services, held: &mut Option<DataLock>) -> Result<()> {
    let following = services.store.each_change(|| async {
        services.jobs.changed_elsewhere();
        services.policies.follow_deployments().await;
    });
    tokio::select! {
        () = following => std::future::pending().await,
        () = take_lead(services, held) => {}
    }
    services.begin().await?;
    tracing::warn!("this server leads now: the leader before it is gone");
    Ok(())
}

/// Returns when this server has both locks.
async fn take_lead(services: &Services, held: &mut Option<DataLock>) {
    let mut reported = String::new();
    loop {
        match attempt(services, held).await {
            Ok(true) => return,
            Ok(false) => reported.clear(),
            // Once for each cause: the same one may last for hours.
            Err(error) if error.message() == reported => {}
            Err(error) => {
                tracing::error!(%error, "this standby cannot take the lead and retries every second");
                error.message().clone_into(&mut reported);
            }
        }
        tokio::time::sleep(ATTEMPT_EVERY).await;
    }
}

/// Takes both locks if they are free.
async fn attempt(services: &Services, held: &mut Option<DataLock>) -> Result<bool> {
    let data_dir = services.config.data_dir.clone();
    let taking = tokio::task::spawn_blocking(move || DataLock::take_if_free(&data_dir)).await;
    let Some(lock) = taking.map_err(|error| Error::internal("locking the data folder", error))?? else {
        services.store.look_for_leader().await?;
        return Ok(false);
    };
    let (database, at) = database(&services.config)?;
    // From here on a write may happen, which must end before the lock is released.
    *held = Some(lock);
    let took = services.store.take_lead(&at, &database, &services.blobs).await;
    if !matches!(took, Ok(true)) {
        *held = None;
    }
    took
}
