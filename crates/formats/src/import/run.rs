//! Recordings of neighbouring episodes, for which a dataset is opened once.

use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use gleaner_recording::RecordingError;

use super::{Assumed, Converted, Dataset, guarded, open, panicked};
use crate::problem::Problem;

/// The recording of an episode in the folder of a run.
#[must_use]
pub fn run_file(folder: &Path, episode: u64) -> PathBuf {
    folder.join(format!("{episode}.mcap"))
}

/// Writes neighbouring episodes of a dataset, by their numbers from 0, as recordings into a folder: the first ones, at least
/// one, until `enough` returns true for the bytes written. Returns their results in order; the file of each is
/// [`run_file`]. An episode that cannot be used does not keep the next ones from being converted, but a failed file
/// operation ends the run before its episode, for which a run of its own then has the whole disk.
///
/// # Errors
/// If the dataset cannot be opened, or the folder not be made.
pub fn convert_run(
    path: &Path,
    assumed: &Assumed,
    episodes: Range<u64>,
    folder: &Path,
    enough: impl Fn(u64) -> bool,
) -> Result<Vec<Result<Converted, Problem>>, Problem> {
    std::fs::create_dir_all(folder).map_err(Problem::io(folder))?;
    let mut dataset = guarded(path, || open(path, assumed).map_err(Problem::from))?;
    let (mut results, mut bytes, end) = (Vec::new(), 0_u64, episodes.end);
    for episode in episodes {
        let out = run_file(folder, episode);
        let converted = record(path, dataset.as_mut(), episode..end, &out);
        if converted.as_ref().is_err_and(is_of_files) && !results.is_empty() {
            break;
        }
        bytes = bytes.saturating_add(std::fs::metadata(&out).map_or(0, |file| file.len()));
        results.push(converted);
        if enough(bytes) {
            break;
        }
    }
    Ok(results)
}

/// Records the first of these episodes. After an error there is no file, also none of an earlier call.
pub(super) fn record(
    path: &Path,
    dataset: &mut dyn Dataset,
    episodes: Range<u64>,
    out: &Path,
) -> Result<Converted, Problem> {
    let converted = attempt(path, dataset, episodes, out);
    if converted.is_err() {
        // The cause is the first error; a file that was never made is no second one.
        std::fs::remove_file(out).ok();
    }
    converted
}

fn attempt(path: &Path, dataset: &mut dyn Dataset, episodes: Range<u64>, out: &Path) -> Result<Converted, Problem> {
    let (episode, stated) = (episodes.start, dataset.episodes());
    if episode >= stated {
        return Err(Problem::Unfit(format!("there is no episode {episode}: the dataset has {stated}")));
    }
    let mut caught = |episodes: Range<u64>| {
        let work = || {
            let (recorder, success) = dataset.record(episodes, out)?;
            Ok(Converted { steps: recorder.finish()?, success })
        };
        catch_unwind(AssertUnwindSafe(work))
    };
    let followed = episodes.end > episode.saturating_add(1);
    let converted = match caught(episodes) {
        // The damage may be in what the next episodes alone need.
        Err(_) if followed => caught(episode..episode.saturating_add(1)),
        first => first,
    };
    converted.unwrap_or_else(|_| Err(panicked(path)))
}

/// Whether a file could not be read or written, as on a full disk.
fn is_of_files(problem: &Problem) -> bool {
    match problem {
        Problem::Io { .. } => true,
        Problem::Recording { source, .. } => matches!(source, RecordingError::Io { .. } | RecordingError::Write(_)),
        Problem::Unfit(_) | Problem::Input(_) => false,
    }
}
