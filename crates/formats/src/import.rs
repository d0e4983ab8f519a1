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
    /// What it holds.
    fn description(&self) -> &Description;

    /// Looks for every file that an episode needs.
    ///
    /// # Errors
    /// [`Problem::Unfit`] names the first that is missing.
    fn check_files(&self) -> Result<(), Problem>;

    /// Begins the recording of an episode, by its number from 0, at `out`, and writes its steps. Returns the recording and
    /// whether the episode succeeded, if the dataset states it.
    ///
    /// # Errors
    /// [`Problem`] with the file, the place in it and the fix.
    fn record(&self, episode: u64, out: &Path) -> Result<(Recorder, Option<bool>), Problem>;
}

/// Returns what a dataset holds.
///
/// # Arguments
/// `rate_hz`: steps per second where the dataset does not state them.
///
/// # Errors
/// [`Problem::Unfit`] with the fault of the dataset and the fix; [`Problem::Io`].
pub fn describe(path: &Path, rate_hz: Option<f64>) -> Result<Description, Problem> {
    guarded(path, || {
        let dataset = open(path, rate_hz)?;
        dataset.check_files()?;
        Ok(dataset.description().clone())
    })
}

/// Writes one episode of a dataset, by its number from 0, as a recording to `out`. After an error there is no file.
///
/// # Errors
/// Like [`describe`].
pub fn convert(path: &Path, rate_hz: Option<f64>, episode: u64, out: &Path) -> Result<Converted, Problem> {
    let converted = guarded(path, || {
        let dataset = open(path, rate_hz)?;
        let episodes = dataset.description().episodes;
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

fn open(path: &Path, rate_hz: Option<f64>) -> Result<Box<dyn Dataset>, Problem> {
    if path.is_dir() { lerobot::open(path) } else { robomimic::open(path, rate_hz) }
}

/// Readers of parquet, MP4 and HDF5 may panic on damage.
fn guarded<T>(path: &Path, work: impl FnOnce() -> Result<T, Problem>) -> Result<T, Problem> {
    let damaged = |_| {
        let problem = "a file of it is damaged, and its reader failed; copy or download the dataset again";
        Err(Problem::Unfit(format!("{}: {problem}", path.display())))
    };
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(damaged)
}

#[cfg(test)]
mod tests;
