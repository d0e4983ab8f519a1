//! Datasets of other programs as recordings: a dataset in, one MCAP recording for each episode out.
//!
//! [`describe`] returns what a dataset holds, with a task that its recordings fit; [`convert`] writes the recording of one
//! episode, and [`convert_run`] those of neighbouring episodes, for which what they share is read once. A format is one file
//! here, or a folder, and a line in `open`. Datasets are untrusted: these functions run in a process with limits, and damage
//! is an error. Memory follows an episode's numbers and one picture, not the dataset. The same episode gives the same bytes
//! wherever the dataset lies, and whichever episodes are converted with it.

mod description;
mod fields;
mod lerobot;
mod mp4;
mod recorder;
mod robomimic;
mod run;

use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

pub use description::{Converted, Description, FieldOrigin, LeftOut};
use recorder::Recorder;
pub use run::{convert_run, run_file};

use crate::problem::Problem;

/// A dataset of one format, opened.
trait Dataset {
    /// Number of episodes that it states.
    fn episodes(&self) -> u64;

    /// What it holds, after a look at all of its tables and for every file that an episode needs.
    ///
    /// # Errors
    /// [`Problem::Unfit`] with the first fault, or the first file that is missing.
    fn description(&self) -> Result<Description, Problem>;

    /// Begins the recording of the first of these episodes, by their numbers from 0, at `out`, and writes its steps. Returns
    /// the recording and whether the episode succeeded, if the dataset states it. The others are recorded next: what they
    /// have in common may be read now and kept.
    ///
    /// # Errors
    /// [`Problem`] with the file, the place in it and the fix, of the first episode alone.
    fn record(&mut self, episodes: Range<u64>, out: &Path) -> Result<(Recorder, Option<bool>), Problem>;
}

/// What a person states of a dataset.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Assumed {
    /// Steps per second where the dataset does not state them.
    pub rate_hz: Option<f64>,
    /// The column whose last value states whether an episode succeeded: true, or a number above zero. Without one, that of
    /// the format's own conventions.
    pub success_column: Option<String>,
}

/// Why a path has no description.
#[derive(Debug, thiserror::Error)]
pub enum Undescribed {
    /// A sound file of another program, with what it lacks.
    #[error("{0}")]
    OtherProgram(String),
    /// A dataset that cannot be used, or a file that is damaged.
    #[error(transparent)]
    Problem(#[from] Problem),
}

impl From<Undescribed> for Problem {
    fn from(error: Undescribed) -> Self {
        match error {
            Undescribed::OtherProgram(lack) => Self::Unfit(lack),
            Undescribed::Problem(problem) => problem,
        }
    }
}

/// Returns what a dataset holds.
///
/// # Errors
/// [`Undescribed::OtherProgram`]; [`Problem::Unfit`] with the fault of the dataset and the fix; [`Problem::Io`].
pub fn describe(path: &Path, assumed: &Assumed) -> Result<Description, Undescribed> {
    guarded(path, || Ok(open(path, assumed)?.description()?))
}

/// Writes one episode of a dataset, by its number from 0, as a recording to `out`. After an error there is no file. Of
/// the tables, the parts that the episode needs are read: [`describe`] checks all of them.
///
/// # Errors
/// Like [`describe`], with a file of another program as [`Problem::Unfit`].
pub fn convert(path: &Path, assumed: &Assumed, episode: u64, out: &Path) -> Result<Converted, Problem> {
    let opened = guarded(path, || open(path, assumed).map_err(Problem::from));
    let mut dataset = opened.inspect_err(|_| {
        std::fs::remove_file(out).ok();
    })?;
    run::record(path, dataset.as_mut(), episode..episode.saturating_add(1), out)
}

/// The error of a column that cannot state the outcome, with those that can.
fn no_success_column(name: &str, known: &[&str]) -> String {
    let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
    format!("{name:?} is not a column with one number or flag a step; --success-column can be one of: {known}")
}

fn open(path: &Path, assumed: &Assumed) -> Result<Box<dyn Dataset>, Undescribed> {
    if path.is_dir() { Ok(lerobot::open(path, assumed)?) } else { robomimic::open(path, assumed) }
}

/// Readers of parquet, MP4 and HDF5 may panic on damage.
fn guarded<T, E: From<Problem>>(path: &Path, work: impl FnOnce() -> Result<T, E>) -> Result<T, E> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| Err(panicked(path).into()))
}

/// The error of a dataset whose reader panicked.
fn panicked(path: &Path) -> Problem {
    let problem = "a file of it is damaged, and its reader failed; copy or download the dataset again";
    Problem::Unfit(format!("{}: {problem}", path.display()))
}

#[cfg(test)]
mod tests;
