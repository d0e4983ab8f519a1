//! Datasets of other programs on this machine: which paths are one, and its episodes as recordings.
//!
//! This process does not parse them: `gleaner-inspector` does. Must not know a server.

use std::path::{Path, PathBuf};

use gleaner_client::{Skipped, find_recordings, is_dataset};
use gleaner_inspector::{Assumed, Converted, Description};
use gleaner_recording::printable;
use tempfile::TempDir;

use crate::context::Context;
use crate::failure::{Failure, Result};
use crate::inspector::Inspector;

/// The name of the file of a robomimic export (`crates/formats`), without its ending.
const EXPORTED: &str = "dataset";

/// A dataset of another program, described.
#[derive(Debug)]
pub(crate) struct Intake {
    pub(crate) path: PathBuf,
    pub(crate) description: Description,
    assumed: Assumed,
    inspector: Inspector,
}

/// An episode as a recording, which is there as long as this is.
#[derive(Debug)]
pub(crate) struct Episode {
    pub(crate) recording: PathBuf,
    pub(crate) converted: Converted,
    _folder: TempDir,
}

/// Splits paths into datasets of other programs and the rest. A folder without recordings stands for the datasets in it.
pub(crate) fn split(paths: &[PathBuf]) -> (Vec<PathBuf>, Vec<PathBuf>) {
    let (mut datasets, mut others) = (Vec::new(), Vec::new());
    for path in paths {
        let mut inside = Vec::new();
        if is_dataset(path) {
            inside.push(path.clone());
        } else if path.is_dir() && find_recordings(std::slice::from_ref(path)).is_err() {
            below(path, &mut inside);
            inside.sort();
        }
        if inside.is_empty() {
            others.push(path.clone());
        }
        datasets.append(&mut inside);
    }
    (datasets, others)
}

/// The recordings of these paths; what is skipped is noted.
///
/// # Errors
/// As [`find_recordings`].
pub(crate) fn recordings(context: &Context, paths: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let found = find_recordings(paths)?;
    note(context, &found.skipped);
    Ok(found.recordings)
}

/// Notes what is skipped and why.
pub(crate) fn note(context: &Context, skipped: &[Skipped]) {
    for Skipped { path, reason } in skipped {
        let line = format!("skipped: {}: {reason}", path.display());
        context.output.note(printable::field(&line));
    }
}

/// Adds the datasets below a folder. Other links to folders are not followed, because one to a folder above would never end.
fn below(folder: &Path, datasets: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        if is_dataset(&path) {
            datasets.push(path);
        } else if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
            below(&path, datasets);
        }
    }
}

impl Intake {
    /// Reads the description of a dataset.
    ///
    /// # Errors
    /// The reason why it cannot be read.
    pub(crate) async fn open(path: &Path, assumed: &Assumed) -> Result<Self> {
        let inspector = Inspector::find()?;
        let description = inspector.describe(path, assumed).await?.map_err(|why| problem(path, &why))?;
        Ok(Self { path: path.to_owned(), description, assumed: assumed.clone(), inspector })
    }

    /// Opens each dataset.
    pub(crate) async fn open_all(paths: &[PathBuf], assumed: &Assumed) -> Result<Vec<Self>> {
        let mut intakes = Vec::with_capacity(paths.len());
        for path in paths {
            intakes.push(Self::open(path, assumed).await?);
        }
        Ok(intakes)
    }

    /// The dataset's name: that of its folder or file, as a name of a task and of a cohort may be.
    pub(crate) fn name(&self) -> String {
        let path = self.path.canonicalize().unwrap_or_else(|_| self.path.clone());
        let of_file = path.file_stem().filter(|stem| *stem != EXPORTED);
        // The file of an export here always has one name; its folder has the person's.
        let name = if path.is_dir() { path.file_name() } else { of_file.or(path.parent().and_then(Path::file_name)) };
        let plain = |c: char| if c.is_ascii_alphanumeric() || "_-.".contains(c) { c } else { '_' };
        let name: String = name.unwrap_or_default().to_string_lossy().chars().take(100).map(plain).collect();
        if name.is_empty() { "dataset".to_owned() } else { name }
    }

    /// What it holds, in some lines.
    pub(crate) fn shown(&self) -> String {
        let Description { format, episodes, steps, rate_stated, spec, left_out, .. } = &self.description;
        let guessed = if *rate_stated { "" } else { " (a guess; give it with --rate)" };
        let mut text = format!(
            "{}: {}, {episodes} episodes, {steps} steps at {} Hz{guessed}\n",
            printable::field(&self.path.display().to_string()),
            printable::field(format),
            spec.rate_hz
        );
        for left in left_out {
            let line = format!("left out: {}: {}", left.what, left.reason);
            text += &printable::field(&line);
            text.push('\n');
        }
        text
    }

    /// What an episode is called in messages: after the dataset's path, as the server lists it.
    pub(crate) fn place(&self, episode: u64) -> PathBuf {
        self.path.join(self.stem(episode))
    }

    fn stem(&self, episode: u64) -> String {
        format!("{}_{episode:06}", self.name())
    }

    /// Makes the recording of an episode, or returns why it cannot be used.
    pub(crate) async fn episode(&self, episode: u64) -> Result<std::result::Result<Episode, String>> {
        let folder = tempfile::tempdir()?;
        let recording = folder.path().join(format!("{}.mcap", self.stem(episode)));
        let converted = self.inspector.convert(&self.path, &self.assumed, episode, &recording).await?;
        Ok(converted.map(|converted| Episode { recording, converted, _folder: folder }))
    }
}

/// An error that begins with the path, once.
fn problem(path: &Path, why: &str) -> Failure {
    let shown = path.display().to_string();
    if why.starts_with(&shown) { Failure::message(why.to_owned()) } else { Failure::message(format!("{shown}: {why}")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn datasets_are_known_by_their_names() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir_all(at("pick/meta")).unwrap();
        std::fs::write(at("pick/meta/info.json"), "{}").unwrap();
        for file in ["a.mcap", "b.hdf5", "c.h5"] {
            std::fs::write(at(file), "").unwrap();
        }
        let all = [at("pick"), at("a.mcap"), at("b.hdf5"), at("c.h5"), folder.path().to_owned()];
        let (datasets, others) = split(&all);
        assert_eq!(datasets, [at("pick"), at("b.hdf5"), at("c.h5")]);
        assert_eq!(others, [at("a.mcap"), folder.path().to_owned()]);
        std::fs::create_dir_all(at("exports/lift")).unwrap();
        std::fs::rename(at("pick"), at("exports/pick")).unwrap();
        std::fs::rename(at("b.hdf5"), at("exports/lift/b.hdf5")).unwrap();
        let (datasets, others) = split(&[at("exports"), folder.path().to_owned()]);
        assert_eq!(datasets, [at("exports/lift/b.hdf5"), at("exports/pick")]);
        assert_eq!(others, [folder.path().to_owned()], "beside recordings, datasets are given by name");
    }
}
