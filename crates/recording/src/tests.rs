//! Tests of the whole crate: real recordings, each finding, and damaged files.

mod bombs;
mod caches;
mod corpus;
mod damage;
mod findings;
mod fuzz_corpus;
mod golden;
mod images;
mod integrity;
mod poses;
mod rollouts;
pub(crate) mod scene;
mod steps;
mod times;
pub(crate) mod video;

use std::path::{Path, PathBuf};

use gleaner_core::TaskSpec;

/// The pick-cube task as the repository's example describes it.
pub(crate) fn pick_cube() -> TaskSpec {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/pick_cube_maniskill.toml");
    toml::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

pub(crate) fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures").join(name)
}
