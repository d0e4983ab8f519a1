//! Datasets of other programs as recordings: a dataset in, one MCAP recording for each episode out.
//!
//! [`describe`] returns what a dataset holds, with a task that its recordings fit; [`convert`] writes the recording of one
//! episode. A format is one file here, or a folder, and a line in `open`. Datasets are untrusted: both functions run in a
//! process with limits, and damage is an error. Memory follows an episode's numbers and one picture, not the dataset. The
//! same episode gives the same bytes wherever the dataset lies.

mod description;
mod fields;
mod lerobot;
mod mp4;
mod recorder;
mod robomimic;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

pub use description::{Converted, Description, FieldOrigin, LeftOut};
use recorder::Recorder;

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

    /// Begins the recording of an episode, by its number from 0, at `out`, and writes its steps. Returns the recording and
    /// whether the episode succeeded, if the dataset states it.
    ///
    /// # Errors
    /// [`Problem`] with the file, the place in it and the fix.
    fn record(&self, episode: u64, out: &Path) -> Result<(Recorder, Option<bool>), Problem>;
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
    let converted = guarded(path, || {
        let dataset = open(path, assumed)?;
        let episodes = dataset.episodes();
        if episode >= episodes {
            return Err(Problem::Unfit(format!("there is no episode {episode}: the dataset has {episodes}")));
        }
        let (recorder, success) = dataset.record(episode, out)?;
        Ok(Converted { steps: recorder.finish()?, success })
    });
    if converted.is_err() {
        // The cause is the first error; a file that was never made is no second one.
        std::fs::remove_file(out).ok();
    }
    converted
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
    let damaged = |_| {
        let problem = "a file of it is damaged, and its reader failed; copy or download the dataset again";
        Err(Problem::Unfit(format!("{}: {problem}", path.display())).into())
    };
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(damaged)
}

#[cfg(test)]
mod tests;
