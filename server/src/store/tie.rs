//! The link of an open database to its folder: the files that must stay in place, and the stamp that its generation is
//! compared with. Must not depend on SQL.

use crate::data_folder::{presence::Presence, stamp::StampFile};

/// The link of an open database to its folder.
#[derive(Debug)]
pub(super) struct Tie {
    pub(super) presence: Presence,
    pub(super) stamp: StampFile,
}

impl Tie {
    /// Whether a database that was connected to again, with this name of the folder and this generation, still has what
    /// was acknowledged. From the first that does not have it on, no write is acknowledged.
    pub(super) fn is_still(&self, folder: &str, generation: u64) -> bool {
        let stamp = self.stamp.content();
        let still = stamp.folder == folder && stamp.generation <= generation;
        if !still {
            self.presence.declare_lost(format!(
                "the database that answers now is another one or an earlier copy (generation {generation}, the stamp has \
                 {}): no change is acknowledged any more. Stop the server, have the newest copy of the database answer, \
                 and start it again",
                stamp.generation
            ));
        }
        still
    }
}
