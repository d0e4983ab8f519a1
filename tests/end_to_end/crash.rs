//! Crashes under load: the server is killed at random moments and at its fail points while many clients use it. Whatever
//! was acknowledged is there afterwards, nothing half done is seen, and every job ends.
//!
//! Short here; `make crash-test` is the long form. `GLEANER_CRASH_KILLS`, `_UPLOADS`, `_TRAINING_KILLS` and `_SEED` set
//! how much there is of each.

mod again;
mod check;
mod curator;
mod kills;
mod lab;
mod ledger;
mod load;
mod order;
mod sessions;
mod swept;
mod torn;
mod training;

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};

use rand::{SeedableRng as _, rngs::StdRng};

use self::lab::Lab;
use crate::server::TestServer;

/// How much of everything.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    pub kills: usize,
    pub uploads: u64,
    pub training_kills: usize,
    pub seed: u64,
}

impl Settings {
    fn read() -> Self {
        let settings = Self {
            kills: setting("KILLS", 5),
            uploads: setting("UPLOADS", 30),
            training_kills: setting("TRAINING_KILLS", 3),
            seed: setting("SEED", 1),
        };
        eprintln!("crash test: {settings:?}");
        settings
    }

    fn random(&self, purpose: u64) -> StdRng {
        StdRng::seed_from_u64(self.seed.wrapping_mul(1_000_003).wrapping_add(purpose))
    }
}

fn setting<T: std::str::FromStr>(name: &str, otherwise: T) -> T {
    let name = format!("GLEANER_CRASH_{name}");
    match std::env::var(&name) {
        Ok(text) => text.parse().unwrap_or_else(|_| panic!("{name}={text} is no number")),
        Err(_) => otherwise,
    }
}

/// The files of a data folder's blobs, without sidecars, stamp and trash.
fn blob_files(data_dir: &Path) -> BTreeSet<PathBuf> {
    let folders = data_dir.join("blobs").read_dir().unwrap().map(|entry| entry.unwrap().path());
    let hex = folders.filter(|folder| folder.file_name().unwrap().len() == 2);
    let files = hex.flat_map(|folder| folder.read_dir().unwrap()).map(|entry| entry.unwrap().path());
    files.filter(|file| file.extension().is_none()).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_acknowledged_outlives_every_crash() {
    let settings = Settings::read();
    let mut server = TestServer::start().await;
    let lab = Lab::set_up(&server, settings).await;
    let mut load = load::start(&lab);
    let tally = kills::run(&mut server, &lab, &mut load).await;
    load.end().await;
    check::until_whole(&lab).await;
    eprintln!("{tally}\n{}", lab.ledger.summary());

    assert!(server.stop().await, "a stop on request is a success");
    check::folders_are_clear(server.data_dir());
    check::check_is_clean(server.data_dir()).await;
    tally.is_what_was_asked(&settings);
}
