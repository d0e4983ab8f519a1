//! The load of the crash tests: clients that use a server which is killed, and the ledger of what it acknowledged.

pub mod check;
pub mod curator;
pub mod kills;
pub mod lab;
pub mod ledger;
pub mod load;
pub mod sessions;

use rand::{SeedableRng as _, rngs::StdRng};

/// The size of the load; `GLEANER_CRASH_KILLS`, `_UPLOADS`, `_TRAINING_KILLS`, `_SLURM_KILLS` and `_SEED` set
/// it.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    pub kills: usize,
    pub uploads: u64,
    pub training_kills: usize,
    pub slurm_kills: usize,
    pub seed: u64,
}

impl Settings {
    pub fn read() -> Self {
        let settings = Self {
            kills: setting("KILLS", 5),
            uploads: setting("UPLOADS", 30),
            training_kills: setting("TRAINING_KILLS", 3),
            slurm_kills: setting("SLURM_KILLS", 2),
            seed: setting("SEED", 1),
        };
        eprintln!("crash test: {settings:?}");
        settings
    }

    pub fn random(&self, purpose: u64) -> StdRng {
        StdRng::seed_from_u64(self.seed.wrapping_mul(1_000_003).wrapping_add(purpose))
    }
}

fn setting<T: std::str::FromStr>(name: &str, default: T) -> T {
    let name = format!("GLEANER_CRASH_{name}");
    match std::env::var(&name) {
        Ok(text) => text.parse().unwrap_or_else(|_| panic!("{name}={text} is not a number")),
        Err(_) => default,
    }
}
