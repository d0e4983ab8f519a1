//! The line of a labels file for each recording of a push, by its path or its name. Must not know a server.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use gleaner_client::{BAG_METADATA, LabelledFile};

use crate::failure::{Failure, Result};
use crate::words;

/// A row, and its file.
type Row<'a> = (LabelledFile, &'a Path);

/// The rows of these recordings; each must have one, and rows of one recording must have the same labels. Where there is
/// only one labels file, a row whose path does not exist names a recording wherever it is, such as `a` or `day/a.mcap` for
/// `data/day/a.mcap`.
pub(super) fn chosen<'a>(
    rows: Vec<Row<'a>>,
    recordings: Vec<PathBuf>,
    files: &[PathBuf],
    found: bool,
) -> Result<Vec<Row<'a>>> {
    let mut by_place: HashMap<PathBuf, Vec<Row>> = HashMap::new();
    for row in rows {
        by_place.entry(place(&row.0.path)).or_default().push(row);
    }
    let named: Vec<String> = files.iter().map(|file| file.display().to_string()).collect();
    let named = named.join(", ");
    let mut chosen: Vec<(PathBuf, Option<Row>)> = Vec::with_capacity(recordings.len());
    for path in recordings {
        let place = place(&path);
        let parts = parts(&by_place, &place);
        let keys = [Some(place), folder(&path).map(self::place)].into_iter().flatten().chain(parts);
        let own: Vec<Row> = keys.filter_map(|key| by_place.remove(&key)).flatten().collect();
        let row = agreed(&path, own).map_err(Failure::message)?;
        chosen.push((path, row));
    }
    if files.len() == 1 {
        let left = by_place.into_values().flatten().filter(|(row, _)| !row.path.exists()).collect();
        by_name(&mut chosen, left).map_err(|problem| Failure::message(format!("{named}: {problem}")))?;
    }
    let (mut rows, mut missing) = (Vec::new(), Vec::new());
    for (path, row) in chosen {
        match row {
            Some((row, file)) => rows.push((LabelledFile { path, ..row }, file)),
            None => missing.push(path.display().to_string()),
        }
    }
    if missing.is_empty() {
        return Ok(rows);
    }
    let other = if found { ", or push with --outcome, which ignores the file" } else { "" };
    let verb = if missing.len() == 1 { "is" } else { "are" };
    let problem = format!("{} {verb} not listed in {named}", words::some(&missing));
    Err(Failure::message(format!("{problem}; add a line for each{other}")))
}

fn place(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.to_owned())
}

/// The listed files of a recording in several parts, which is their folder.
fn parts(by_place: &HashMap<PathBuf, Vec<Row>>, place: &Path) -> Vec<PathBuf> {
    if !place.is_dir() {
        return Vec::new();
    }
    let mut parts: Vec<PathBuf> = by_place.keys().filter(|key| key.parent() == Some(place)).cloned().collect();
    parts.sort();
    parts
}

/// The rosbag2 folder of a recording, which may be listed by its own name or by that of its first file, whatever their
/// number.
fn folder(path: &Path) -> Option<&Path> {
    path.parent().filter(|folder| folder.join(BAG_METADATA).is_file())
}

/// The first of a recording's rows, whose labels must be the same.
fn agreed<'a>(path: &Path, rows: Vec<Row<'a>>) -> std::result::Result<Option<Row<'a>>, String> {
    let labels = |(row, _): &Row| (row.outcome, row.cohort.clone(), row.task.clone());
    let mut rows = rows.into_iter();
    let Some(first) = rows.next() else { return Ok(None) };
    match rows.find(|row| labels(row) != labels(&first)) {
        None => Ok(Some(first)),
        Some(other) => {
            let line = |(row, file): &Row| format!("line {} of {}", row.line, file.display());
            let (path, first, other) = (path.display(), line(&first), line(&other));
            Err(format!("{path}: {first} and {other} give it different labels; keep one"))
        }
    }
}

/// Gives each recording without a row the one that ends its path.
fn by_name<'a>(chosen: &mut [(PathBuf, Option<Row<'a>>)], left: Vec<Row<'a>>) -> std::result::Result<(), String> {
    let mut left: Vec<Row> = left;
    left.sort_by_key(|(row, _)| row.line);
    for row in left {
        let named = |path: &Path| {
            let recording = path.extension().is_some_and(|ending| ending == "mcap");
            let stem = recording.then(|| path.with_extension(""));
            [Some(path), stem.as_deref(), folder(path)].into_iter().flatten().any(|path| path.ends_with(&row.0.listed))
        };
        let mut found: Vec<_> = chosen.iter_mut().filter(|(path, _)| named(path)).collect();
        let line = format!("line {}: {}", row.0.line, row.0.listed.display());
        match found.as_mut_slice() {
            [] => {}
            [(_, place @ None)] => *place = Some(row),
            [(path, Some((other, _)))] => {
                return Err(format!("{line} names {}, as line {} does; keep one", path.display(), other.line));
            }
            several => {
                let paths: Vec<String> = several.iter().map(|(path, _)| path.display().to_string()).collect();
                return Err(format!("{line} names {}; list each by its path", words::some(&paths)));
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use gleaner_proto::v1::Outcome;

    use super::*;

    #[test]
    fn a_recording_without_a_line_is_named() {
        let labels = PathBuf::from("x/labels.csv");
        let row = |path: &str, line| (LabelledFile { line, ..listed(path.into(), "") }, labels.as_path());
        let rows = vec![row("x/a.mcap", 2), row("x/b.mcap", 3)];
        let files = [labels.clone()];
        assert_eq!(chosen(rows.clone(), vec!["x/b.mcap".into()], &files, false).unwrap(), [row("x/b.mcap", 3)]);
        let message = chosen(rows, vec!["x/c.mcap".into()], &files, true).unwrap_err().to_string();
        assert!(
            message.contains("x/c.mcap is not listed in x/labels.csv") && message.contains("--outcome"),
            "{message}"
        );
    }

    fn listed(path: PathBuf, cohort: &str) -> LabelledFile {
        let (listed, cohort) = (path.clone(), cohort.into());
        LabelledFile { path, listed, line: 2, task: None, outcome: Outcome::Success, cohort }
    }

    #[test]
    fn a_rosbag2_folder_is_listed_by_its_name_or_its_first_file() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for bag in ["one", "two", "three"] {
            std::fs::create_dir(at(bag)).unwrap();
            for file in [BAG_METADATA, "bag_0.mcap"] {
                std::fs::write(at(bag).join(file), "").unwrap();
            }
        }
        let file = at("labels.csv");
        let rows = [("one", "a"), ("two/bag_0.mcap", "b"), ("three/bag_0.mcap", "c")];
        let rows = rows.map(|(path, cohort)| (listed(at(path), cohort), file.as_path())).to_vec();
        // The third has several parts, so it is pushed as a folder.
        let recordings = vec![at("one/bag_0.mcap"), at("two/bag_0.mcap"), at("three")];
        let found = chosen(rows, recordings.clone(), std::slice::from_ref(&file), true).unwrap();
        let paired: Vec<(&PathBuf, &str)> = found.iter().map(|(row, _)| (&row.path, row.cohort.as_str())).collect();
        assert_eq!(paired, recordings.iter().zip(["a", "b", "c"]).collect::<Vec<_>>());
    }

    #[test]
    fn lines_of_one_recording_with_different_labels_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for bag in ["one", "parts"] {
            std::fs::create_dir(at(bag)).unwrap();
            for file in [BAG_METADATA, "bag_0.mcap", "bag_1.mcap"] {
                std::fs::write(at(bag).join(file), "").unwrap();
            }
        }
        std::fs::write(at("a.mcap"), "").unwrap();
        let (one, other) = (at("labels.csv"), at("more.csv"));
        let pair = |recording: &str, paths: [&str; 2], cohorts: [&str; 2]| {
            let rows = [(2, &one, 0), (7, &other, 1)];
            let rows =
                rows.map(|(line, file, n)| (LabelledFile { line, ..listed(at(paths[n]), cohorts[n]) }, file.as_path()));
            chosen(rows.to_vec(), vec![at(recording)], &[one.clone(), other.clone()], true)
                .map(|found| found[0].0.cohort.clone())
                .map_err(|failure| failure.to_string())
        };
        for (recording, paths) in [
            ("a.mcap", ["a.mcap", "one/../a.mcap"]),
            ("one/bag_0.mcap", ["one", "one/bag_0.mcap"]),
            ("parts", ["parts/bag_0.mcap", "parts/bag_1.mcap"]),
        ] {
            assert_eq!(pair(recording, paths, ["slipped", "slipped"]).unwrap(), "slipped");
            let refused = pair(recording, paths, ["slipped", "dropped"]).unwrap_err();
            let named =
                [recording.into(), format!("line 2 of {}", one.display()), format!("line 7 of {}", other.display())];
            assert!(named.iter().all(|part| refused.contains(part)), "{refused}");
        }
    }

    #[test]
    fn every_recording_without_a_line_is_named_at_once() {
        let file = PathBuf::from("labels.csv");
        let recordings = vec!["a.mcap".into(), "b.mcap".into(), "c.mcap".into()];
        let rows = vec![(listed("b.mcap".into(), ""), file.as_path())];
        let problem = chosen(rows, recordings, std::slice::from_ref(&file), true).unwrap_err().to_string();
        assert!(
            problem.starts_with("a.mcap, c.mcap are not listed in labels.csv; add a line for each, or"),
            "{problem}"
        );
    }

    #[test]
    fn a_table_elsewhere_names_recordings_without_their_folders() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for bag in ["bags/one", "bags/two", "bags/day"] {
            std::fs::create_dir_all(at(bag)).unwrap();
        }
        for file in ["bags/one/metadata.yaml", "bags/one/one_0.mcap", "bags/two/b.c.mcap", "bags/day/d.mcap", "e.mcap"]
        {
            std::fs::write(at(file), "").unwrap();
        }
        let file = at("results.csv");
        let row =
            |line, name: &str| (LabelledFile { line, listed: name.into(), ..listed(at(name), name) }, file.as_path());
        let files = [file.clone(), at("more.csv")];
        let cohorts = |rows: &[(u64, &str)], recordings: &[&str], files: &[PathBuf]| {
            let rows = rows.iter().map(|&(line, name)| row(line, name)).collect();
            let recordings = recordings.iter().map(|name| at(name)).collect();
            let found = chosen(rows, recordings, files, false).map_err(|error| error.to_string())?;
            Ok::<_, String>(found.into_iter().map(|(row, _)| row.cohort).collect::<Vec<_>>())
        };
        let all = ["bags/one/one_0.mcap", "bags/two/b.c.mcap", "bags/day/d.mcap"];
        let names = [(2, "one"), (3, "b.c"), (4, "day/d.mcap"), (5, "other")];
        assert_eq!(cohorts(&names, &all, &files[..1]).unwrap(), ["one", "b.c", "day/d.mcap"]);
        // One folder's file does not label the recordings of another.
        assert!(cohorts(&names, &all, &files).unwrap_err().contains("are not listed"));
        // A path that exists is that recording only.
        std::fs::write(at("bags/e.mcap"), "").unwrap();
        assert!(cohorts(&[(2, "e.mcap")], &["bags/e.mcap"], &files[..1]).unwrap_err().contains("is not listed"));
        assert_eq!(cohorts(&[(2, "e.mcap")], &["e.mcap"], &files[..1]).unwrap(), ["e.mcap"]);
        for (rows, part) in [
            (&[(2, "d"), (3, "day/d")][..], "day/d.mcap, as line 2 does; keep one"),
            (&[(2, "b.c"), (9, "d")], "one_0.mcap is not listed"),
        ] {
            let refused = cohorts(rows, &all, &files[..1]).unwrap_err();
            assert!(refused.contains(part), "{refused}");
        }
        // The name of a folder has no ending.
        assert!(cohorts(&[(2, "run")], &["bags/run.1"], &files[..1]).unwrap_err().contains("run.1 is not listed"));
        let twice = cohorts(&[(7, "d.mcap")], &["bags/two/d.mcap", "bags/day/d.mcap"], &files[..1]).unwrap_err();
        assert!(
            twice.contains("results.csv: line 7: d.mcap names ") && twice.ends_with("list each by its path"),
            "{twice}"
        );
    }
}
