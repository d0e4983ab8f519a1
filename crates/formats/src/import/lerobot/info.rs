//! `meta/info.json` and the statistics beside it.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read as _;
use std::path::{Component, Path, PathBuf};

use gleaner_core::ValueRange;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{names, unfit, unopened};
use crate::import::fields::Stated;
use crate::problem::Problem;

/// Most bytes of a file of JSON that is read whole.
const MOST_BYTES: u64 = 64 << 20;
const VERSIONS: [&str; 3] = ["v3.0", "v2.1", "v2.0"];
/// Rates that a task may have.
const RATES: std::ops::RangeInclusive<f64> = 0.01..=10_000.0;

/// The dataset as it describes itself.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Info {
    pub(super) codebase_version: String,
    pub(super) fps: f64,
    #[serde(default)]
    pub(super) robot_type: Option<String>,
    pub(super) total_episodes: u64,
    #[serde(default)]
    pub(super) chunks_size: Option<u64>,
    pub(super) data_path: String,
    #[serde(default)]
    pub(super) video_path: Option<String>,
    pub(super) features: BTreeMap<String, Feature>,
    /// The names of each feature's values.
    #[serde(skip)]
    pub(super) names: BTreeMap<String, Vec<String>>,
}

/// A feature as it is declared.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Feature {
    pub(super) dtype: String,
    #[serde(default)]
    pub(super) shape: Vec<u32>,
    #[serde(default)]
    pub(super) names: Value,
    #[serde(default, alias = "video_info", skip_serializing_if = "Value::is_null")]
    pub(super) info: Value,
}

impl Info {
    pub(super) fn read(folder: &Path) -> Result<Self, Problem> {
        let path = folder.join(super::INFO);
        let wrong = |problem: String| unfit(&path, &problem);
        let bytes = bytes(&path)?;
        let value: Value = serde_json::from_slice(&bytes)
            .map_err(|error| wrong(format!("it is not JSON: {error}; download the dataset again")))?;
        let version = value.get("codebase_version").and_then(Value::as_str).unwrap_or_default().to_owned();
        if !VERSIONS.contains(&version.as_str()) {
            return Err(wrong(format!(
                "codebase_version is {version:?}, and {} are read; convert the dataset with lerobot's own scripts",
                VERSIONS.join(", ")
            )));
        }
        let mut info: Self = serde_json::from_value(value)
            .map_err(|error| wrong(format!("{error}; compare it with LeRobot's description of {version}")))?;
        if !RATES.contains(&info.fps) {
            return Err(wrong(format!("fps is {}, and from 0.01 to 10000 are read; correct it", info.fps)));
        }
        info.names = names::names(&bytes);
        Ok(info)
    }

    /// Whether several episodes share a file.
    pub(super) fn shares_files(&self) -> bool {
        self.codebase_version == "v3.0"
    }

    /// A path of the dataset with its places filled in: `{name}` and `{name:03d}`.
    pub(super) fn fill(template: &str, values: &[(&str, &str)]) -> Option<PathBuf> {
        let (mut text, mut rest) = (String::new(), template);
        while let Some((before, after)) = rest.split_once('{') {
            let (place, after) = after.split_once('}')?;
            let (name, width) = place.split_once(':').unwrap_or((place, ""));
            let (_, value) = values.iter().find(|(known, _)| *known == name)?;
            let width: usize = width.trim_end_matches('d').parse().unwrap_or_default();
            text += before;
            text += &format!("{value:0>width$}", width = width.min(32));
            rest = after;
        }
        let path = PathBuf::from(text + rest);
        // A dataset must not name files outside of itself.
        path.components().all(|part| matches!(part, Component::Normal(_))).then_some(path)
    }
}

/// The bytes of a file of JSON.
pub(super) fn bytes(path: &Path) -> Result<Vec<u8>, Problem> {
    let file = File::open(path).map_err(unopened(path))?;
    let mut bytes = Vec::new();
    file.take(MOST_BYTES + 1).read_to_end(&mut bytes).map_err(Problem::io(path))?;
    if bytes.len() as u64 > MOST_BYTES {
        return Err(unfit(
            path,
            &format!("it has more than {} MiB, which no file of its kind needs", MOST_BYTES >> 20),
        ));
    }
    Ok(bytes)
}

/// What is stated of each value of each feature: by `meta/stats.json`, or by each episode's statistics. Without sound ones,
/// nothing.
pub(super) fn stats(folder: &Path) -> BTreeMap<String, Vec<Stated>> {
    let mut all = BTreeMap::new();
    let read = |name: &str| bytes(&folder.join(name)).unwrap_or_default();
    if let Ok(stats) = serde_json::from_slice(&read("meta/stats.json")) {
        add_stats(&mut all, &stats);
    }
    for line in read("meta/episodes_stats.jsonl").split(|&byte| byte == b'\n') {
        if let Ok(line) = serde_json::from_slice::<Value>(line) {
            add_stats(&mut all, &line["stats"]);
        }
    }
    all
}

fn add_stats(all: &mut BTreeMap<String, Vec<Stated>>, stats: &Value) {
    let numbers = |value: &Value| -> Option<Vec<f64>> { value.as_array()?.iter().map(Value::as_f64).collect() };
    for (feature, stat) in stats.as_object().into_iter().flatten() {
        let (Some(low), Some(high)) = (numbers(&stat["min"]), numbers(&stat["max"])) else { continue };
        let moments = numbers(&stat["mean"]).zip(numbers(&stat["std"]));
        let stated = low.iter().zip(&high).enumerate().map(|(at, (&minimum, &maximum))| {
            let range = ValueRange { minimum, maximum };
            let moments =
                moments.as_ref().and_then(|(means, deviations)| Some((*means.get(at)?, *deviations.get(at)?)));
            moments.map_or(Stated::range(range), |(mean, deviation)| Stated::moments(range, mean, deviation))
        });
        match all.get_mut(feature) {
            Some(known) => {
                known.iter_mut().zip(stated).for_each(|(known, stated)| *known = known.clone().with(stated));
            }
            None => _ = all.insert(feature.clone(), stated.collect()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn templates_are_filled_and_stay_within_the_dataset() {
        let values = [("video_key", "observation.images.top"), ("chunk_index", "2"), ("file_index", "1234")];
        let path = Info::fill("videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4", &values);
        assert_eq!(path.unwrap(), Path::new("videos/observation.images.top/chunk-002/file-1234.mp4"));
        for outside in ["../{chunk_index}", "/etc/{chunk_index}", "a/{other}", "a/{chunk_index"] {
            assert_eq!(Info::fill(outside, &values), None, "{outside}");
        }
        assert_eq!(Info::fill("{video_key}", &[("video_key", "../../x")]), None);
    }
}
