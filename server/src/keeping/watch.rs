//! Looks now and then how full the disk is, and tells the log when that begins or ceases to matter. Whoever takes
//! something in asks for itself.

use std::time::Duration;

use crate::blobs::Blobs;

const LOOK_EVERY: Duration = Duration::from_secs(5);

/// Looks until it is dropped.
pub(super) async fn watch(blobs: Blobs) {
    let mut refusing = false;
    loop {
        refusing = look(&blobs, refusing);
        tokio::time::sleep(LOOK_EVERY).await;
    }
}

/// Tells of a change, and says whether new things are refused now.
fn look(blobs: &Blobs, refusing: bool) -> bool {
    match (blobs.expect_room(0), refusing) {
        (Ok(()), true) => {
            tracing::info!("there is room on the disk again: uploads, recordings and jobs are taken");
            false
        }
        (Err(error), false) => {
            tracing::error!(%error, "uploads, recordings and jobs are refused; all else goes on");
            true
        }
        (Ok(()), false) => false,
        (Err(_), true) => true,
    }
}
