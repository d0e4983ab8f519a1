//! Watches the disk, and that the database and the files of the data folder are the ones that were opened; logs when the
//! disk fills up and when one of them was deleted or replaced. Every write also checks this on its own.

use std::{path::PathBuf, time::Duration};

use crate::{blobs::Blobs, domain::time::Millis, store::Store};

const LOOK_AT_DISK_EVERY: Duration = Duration::from_secs(5);
const LOOK_AT_FILES_EVERY: Duration = Duration::from_secs(1);

/// Watches the disk until it is dropped.
pub(super) async fn watch_disk(blobs: Blobs) {
    let mut refusing = false;
    loop {
        refusing = log_change(&blobs, refusing).await;
        tokio::time::sleep(LOOK_AT_DISK_EVERY).await;
    }
}

/// Watches the files of the data folder and the database until one is lost; then logs that, and saves the content of an
/// open SQLite database.
pub(super) async fn watch_files(store: Store, data_dir: PathBuf) {
    let lost = store.lost();
    loop {
        if let Err(error) = store.verify() {
            tracing::error!(%error, "the database or a file of the data folder is not the one that the server opened");
            break;
        }
        tokio::select! {
            () = lost.cancelled() => {}
            () = tokio::time::sleep(LOOK_AT_FILES_EVERY) => {}
        }
    }
    if store.is_in_postgres() {
        return;
    }
    let saved = data_dir.join(format!("gleaner-saved-{}.db", Millis::now().0));
    match store.copy_to(&saved).await {
        Ok(()) => tracing::error!(
            file.path = %saved.display(),
            "the content of the open database was saved: once the server is stopped, move gleaner.db-wal and gleaner.db-shm away, \
             and rename this file to gleaner.db"
        ),
        Err(error) => tracing::error!(%error, "the content of the open database could not be saved"),
    }
}

/// Makes room where that is needed, logs a change, and returns whether new data is now rejected.
async fn log_change(blobs: &Blobs, refusing: bool) -> bool {
    match (blobs.room_for(0).await, refusing) {
        (Ok(()), true) => {
            tracing::info!("there is room on the disk again: uploads, recordings and jobs are accepted");
            false
        }
        (Err(error), false) => {
            tracing::error!(%error, "uploads, recordings and jobs are refused; other calls are served");
            true
        }
        (Ok(()), false) => false,
        (Err(_), true) => true,
    }
}
