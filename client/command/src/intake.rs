//! Datasets of other programs on this machine: which paths are one, and its episodes as recordings.
//!
//! This process does not parse them: `gleaner-inspector` does. Must not know a server.

mod name;
mod walk;

use std::path::{Path, PathBuf};

use gleaner_client::{Skipped, find_recordings, is_dataset};
use gleaner_inspector::{Assumed, Described, Description};
use gleaner_recording::printable;

use crate::context::Context;
use crate::failure::{Failure, Result};
use crate::inspector::Inspector;
use crate::words;
pub(crate) use walk::{Conversion, Episode};

/// A path that is a dataset of another program by its name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Candidate {
    pub(crate) path: PathBuf,
    /// Whether a search found it: a command continues without such a file if it cannot be read.
    pub(crate) searched: bool,
}

/// The datasets among candidates.
#[derive(Debug, Default)]
pub(crate) struct Opened {
    pub(crate) intakes: Vec<Intake>,
    /// Files of other programs.
    pub(crate) skipped: Vec<Skipped>,
    /// Files that cannot be used, with the reasons.
    pub(crate) refused: Vec<(PathBuf, String)>,
}

/// A dataset of another program, described.
#[derive(Debug)]
pub(crate) struct Intake {
    pub(crate) path: PathBuf,
    pub(crate) description: Description,
    assumed: Assumed,
    inspector: Inspector,
}

/// Splits paths into datasets of other programs and the rest. A folder without recordings stands for the datasets in it.
pub(crate) fn split(paths: &[PathBuf]) -> (Vec<Candidate>, Vec<PathBuf>) {
    let (mut datasets, mut others) = (Vec::new(), Vec::new());
    for path in paths {
        let mut inside = Vec::new();
        if is_dataset(path) {
            datasets.push(Candidate { path: path.clone(), searched: false });
            continue;
        }
        if path.is_dir() && find_recordings(std::slice::from_ref(path)).is_err() {
            below(path, &mut inside);
            inside.sort();
        }
        if inside.is_empty() {
            others.push(path.clone());
        }
        datasets.extend(inside.into_iter().map(|path| Candidate { path, searched: true }));
    }
    (datasets, others)
}

/// Refuses an option of datasets of other programs where none is given, rather than to ignore it.
pub(crate) fn expect_datasets(datasets: &[Candidate], assumed: &Assumed) -> Result<()> {
    let Assumed { rate_hz, success_column } = assumed;
    let (flag, remedy) = match (rate_hz, success_column) {
        (_, Some(_)) => ("--success-column", "labels of recordings are in a labels.csv (--labels)"),
        (Some(_), None) => ("--rate", "recordings have the times of their messages, and a task file has rate_hz"),
        (None, None) => return Ok(()),
    };
    if datasets.is_empty() {
        let problem = format!("{flag} applies to datasets of other programs, and none is given");
        return Err(Failure::message(format!("{problem}; {remedy}")));
    }
    Ok(())
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
    /// Opens each dataset. A file that a search has found and that cannot be read does not keep the others from being read.
    ///
    /// # Errors
    /// The reason why a dataset cannot be read that is a folder or was given by its path, or why all others cannot.
    pub(crate) async fn open_all(context: &Context, candidates: &[Candidate], assumed: &Assumed) -> Result<Opened> {
        let mut opened = Opened::default();
        if candidates.is_empty() {
            return Ok(opened);
        }
        let inspector = Inspector::find()?;
        for candidate in candidates {
            let path = &candidate.path;
            let described = inspector.describe(path, assumed).await?;
            if let Some(description) = opened.sorted(candidate, described)? {
                let (assumed, inspector) = (assumed.clone(), inspector.clone());
                opened.intakes.push(Self { path: path.clone(), description, assumed, inspector });
            }
        }
        if opened.intakes.is_empty() {
            return Err(opened.none_left(context));
        }
        Ok(opened)
    }

    /// The dataset's name: that of its folder or file, as a name of a task and of a cohort may be.
    pub(crate) fn name(&self) -> String {
        name::of(&self.path)
    }

    /// The name of a task for it: that of its environment if it states one, else its own.
    pub(crate) fn task_name(&self) -> String {
        name::of_task(&self.path, self.description.environment.as_deref())
    }

    /// What it holds, in some lines.
    pub(crate) fn shown(&self) -> String {
        let Description { format, episodes, steps, rate_stated, spec, left_out, .. } = &self.description;
        let guessed = if *rate_stated { "" } else { " (a guess; give it with --rate)" };
        let mut text = format!(
            "{}: {}, {}, {} at {} Hz{guessed}\n",
            printable::field(&self.path.display().to_string()),
            printable::field(format),
            words::counted(*episodes, "episode", "episodes"),
            words::counted(*steps, "step", "steps"),
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
}

impl Opened {
    /// The description of a dataset. A file that a search found and that has none is skipped if it is of another program,
    /// else refused.
    fn sorted(
        &mut self,
        Candidate { path, searched }: &Candidate,
        described: std::result::Result<Described, String>,
    ) -> Result<Option<Description>> {
        let found = *searched && path.is_file();
        match described {
            Ok(Described::Dataset(description)) => return Ok(Some(*description)),
            Ok(Described::OtherProgram(why)) if found => {
                self.skipped.push(Skipped { path: path.clone(), reason: reason(path, &why).to_owned() });
            }
            Err(why) if found => self.refused.push((path.clone(), reason(path, &why).to_owned())),
            Ok(Described::OtherProgram(why)) | Err(why) => return Err(problem(path, &why)),
        }
        Ok(None)
    }

    /// Notes the files that are not used.
    pub(crate) fn note(&self, context: &Context) {
        note(context, &self.skipped);
        for (path, why) in &self.refused {
            let line = format!("not used: {}: {why}", path.display());
            context.output.note(printable::field(&line));
        }
    }

    /// The error where every file is refused: it names the first one, after a note on each of the others.
    fn none_left(mut self, context: &Context) -> Failure {
        let count = self.skipped.len() + self.refused.len();
        let skipped = self.skipped.drain(..).map(|Skipped { path, reason }| (path, reason));
        let mut files: Vec<(PathBuf, String)> = self.refused.drain(..).chain(skipped).collect();
        let first = if files.is_empty() { None } else { Some(files.remove(0)) };
        let first = first.map(|(path, why)| format!("{}: {why}", path.display())).unwrap_or_default();
        Self { refused: files, ..self }.note(context);
        Failure::message(format!(
            "the HDF5 files in the folders given cannot be used ({count}), such as {first}; give recordings, or datasets of \
             LeRobot or robomimic"
        ))
    }
}

/// The reason alone of an error that may begin with the path.
fn reason<'a>(path: &Path, why: &'a str) -> &'a str {
    why.strip_prefix(&path.display().to_string()).and_then(|rest| rest.strip_prefix(": ")).unwrap_or(why)
}

/// An error that begins with the path, once.
fn problem(path: &Path, why: &str) -> Failure {
    Failure::message(format!("{}: {}", path.display(), reason(path, why)))
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
        let given = |name: &str| Candidate { path: at(name), searched: false };
        assert_eq!(datasets, ["pick", "b.hdf5", "c.h5"].map(given));
        assert_eq!(others, [at("a.mcap"), folder.path().to_owned()]);
        std::fs::create_dir_all(at("exports/lift")).unwrap();
        std::fs::rename(at("pick"), at("exports/pick")).unwrap();
        std::fs::rename(at("b.hdf5"), at("exports/lift/b.hdf5")).unwrap();
        let (datasets, others) = split(&[at("exports"), folder.path().to_owned()]);
        let found = |name: &str| Candidate { path: at(name), searched: true };
        assert_eq!(datasets, ["exports/lift/b.hdf5", "exports/pick"].map(found));
        assert_eq!(others, [folder.path().to_owned()], "beside recordings, datasets are given by name");
    }

    #[test]
    fn options_of_datasets_are_refused_without_a_dataset() {
        let given = [Candidate { path: "x.hdf5".into(), searched: false }];
        let (rate, column) = (Some(30.0), Some("next.success".to_owned()));
        let refused = |rate_hz, success_column: Option<String>| {
            let assumed = Assumed { rate_hz, success_column };
            assert!(expect_datasets(&given, &assumed).is_ok());
            expect_datasets(&[], &assumed).err().map(|error| error.to_string())
        };
        assert!(refused(rate, None).unwrap().starts_with("--rate applies to datasets of other programs, and none"));
        assert!(refused(None, column).unwrap().starts_with("--success-column applies to datasets"));
        assert_eq!(refused(None, None), None);
    }

    #[test]
    fn files_of_other_programs_are_skipped_and_damaged_ones_refused() {
        let folder = tempfile::tempdir().unwrap();
        let [other, cut] = ["w.h5", "y.hdf5"].map(|name| folder.path().join(name));
        for file in [&other, &cut] {
            std::fs::write(file, "").unwrap();
        }
        let mut opened = Opened::default();
        let mut sorted = |path: &PathBuf, searched, other_program: bool| {
            let why = format!("{}: no HDF5 file of robomimic", path.display());
            let described = if other_program { Ok(Described::OtherProgram(why)) } else { Err(why) };
            opened.sorted(&Candidate { path: path.clone(), searched }, described)
        };
        // The class decides, and not the text.
        assert!(sorted(&other, true, true).unwrap().is_none() && sorted(&cut, true, false).unwrap().is_none());
        for (path, searched, other_program) in [(&other, false, true), (&cut, false, false), (&other, false, false)] {
            assert!(sorted(path, searched, other_program).is_err());
        }
        // A folder of LeRobot.
        assert!(sorted(&folder.path().to_owned(), true, false).is_err());
        let reason = "no HDF5 file of robomimic".to_owned();
        assert_eq!(opened.skipped, [Skipped { path: other, reason: reason.clone() }]);
        assert_eq!(opened.refused, [(cut, reason)]);
        assert_eq!(problem(Path::new("x/y"), "x/y: cut").to_string(), "x/y: cut");
        assert_eq!(problem(Path::new("x/y"), "cut").to_string(), "x/y: cut");
    }
}
