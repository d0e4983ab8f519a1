//! A folder of recordings made elsewhere: `labels.csv`, the task's spec, and marks if there are any.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use gleaner_client::read_labels;
use gleaner_core::TaskSpec;
use gleaner_sim::{AgentKind, LABELS, MARKS};
use serde::Deserialize;

use crate::cmd::task::read_spec;

/// Names that the task's spec may have.
const SPECS: [&str; 2] = ["task.toml", "task.json"];

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Settings {
    /// The path of the folder, relative to the experiment's file.
    folder: PathBuf,
    /// The name of the experts' cohort.
    #[serde(default = "Settings::experts")]
    experts: String,
}

impl Settings {
    fn experts() -> String {
        AgentKind::Expert.name().to_owned()
    }
}

/// Recordings with their labels.
#[derive(Clone, Debug)]
pub(crate) struct Folder {
    pub(crate) path: PathBuf,
    pub(super) spec: TaskSpec,
    pub(super) experts: String,
    /// The other cohorts, by name.
    pub(super) imperfect: Vec<String>,
    /// Whether there are marks.
    pub(super) is_marked: bool,
}

impl Folder {
    /// The folder, and a digest of every file in it that matters.
    pub(super) fn read(settings: &Settings, beside: &Path) -> Result<(Self, String), String> {
        let path = beside.join(&settings.folder);
        let field = |problem: String| format!("folder: {problem}");
        let labels = read_labels(&path.join(LABELS)).map_err(|error| field(error.to_string()))?;
        let mut cohorts: BTreeSet<&str> = labels.iter().map(|file| file.cohort.as_str()).collect();
        if cohorts.remove("") {
            return Err(field(format!("{LABELS}: a recording has no cohort; give each the name of who recorded it")));
        }
        if !cohorts.remove(settings.experts.as_str()) {
            let (experts, there) = (&settings.experts, cohorts.into_iter().collect::<Vec<_>>().join(", "));
            return Err(format!("experts: {LABELS} has no cohort {experts:?}; it has {there}"));
        }
        if cohorts.is_empty() {
            return Err(field(format!("{LABELS} has no cohort beside the experts")));
        }
        let imperfect = cohorts.into_iter().map(str::to_owned).collect();
        let spec_path = SPECS.iter().map(|name| path.join(name)).find(|path| path.is_file());
        let spec_path =
            spec_path.ok_or_else(|| field(format!("{} has no {}", path.display(), SPECS.join(" and no "))))?;
        let spec = read_spec(&spec_path).map_err(|failure| field(failure.to_string()))?;
        let marks = Some(path.join(MARKS)).filter(|path| path.is_file());
        let is_marked = marks.is_some();

        let mut hasher = blake3::Hasher::new();
        hasher.update(settings.experts.as_bytes());
        let files = [path.join(LABELS), spec_path].into_iter().chain(marks);
        for file in files.chain(labels.iter().map(|file| file.path.clone())) {
            digest_of(&file, &mut hasher).map_err(|error| field(format!("{}: {error}", file.display())))?;
        }
        let experts = settings.experts.clone();
        Ok((Self { path, spec, experts, imperfect, is_marked }, super::digest(hasher.finalize())))
    }
}

/// Adds a file's digest, which has the same length for each.
fn digest_of(path: &Path, hasher: &mut blake3::Hasher) -> std::io::Result<()> {
    let mut content = blake3::Hasher::new();
    content.update_reader(std::fs::File::open(path)?)?;
    hasher.update(content.finalize().as_bytes());
    Ok(())
}
