//! Folders of recordings, and what is wrong with some.

use std::fs::{read_to_string, write};

use tempfile::TempDir;

use super::*;
use crate::experiment::file::Experiment;
use crate::experiment::scale::Sizes;

/// A folder of three recordings: an expert's and two imperfect ones.
fn folder() -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| write(dir.path().join(name), text).unwrap();
    write("task.toml", "name = \"push\"\nrate_hz = 10.0\naction = [{ name = \"a\", size = 1 }]\n");
    write("labels.csv", "file,outcome,cohort\na.mcap,success,teleop\nb.mcap,failure,noise\nc.mcap,success,drop\n");
    write("marks.csv", "file,went_wrong\na.mcap,\nb.mcap,0\nc.mcap,4\n");
    for name in ["a.mcap", "b.mcap", "c.mcap"] {
        write(name, name);
    }
    dir
}

fn read(dir: &TempDir) -> Result<(Source, String), String> {
    let data =
        toml::from_str(&format!("folder = {:?}\nexperts = \"teleop\"", dir.path().file_name().unwrap())).unwrap();
    Source::read(None, &data, dir.path().parent().unwrap())
}

#[test]
fn a_folder_has_its_cohorts_and_task() {
    let dir = folder();
    let (source, _) = read(&dir).unwrap();
    assert_eq!((source.task_name(), source.experts(), source.imperfect()), ("push", "teleop", vec!["drop", "noise"]));
    let cohorts: Vec<(&str, String)> = source.agents();
    assert_eq!(cohorts.iter().map(|cohort| cohort.0).collect::<Vec<_>>(), ["teleop", "drop", "noise"]);
    assert!(source.is_marked() && source.simulated().is_none());

    std::fs::remove_file(dir.path().join("marks.csv")).unwrap();
    assert!(!read(&dir).unwrap().0.is_marked());
}

#[test]
fn the_digest_of_a_folder_depends_on_every_file_that_matters() {
    let dir = folder();
    let before = read(&dir).unwrap().1;
    write(dir.path().join("notes.txt"), "anything").unwrap();
    assert_eq!(read(&dir).unwrap().1, before);
    for name in ["labels.csv", "marks.csv", "task.toml", "c.mcap"] {
        let path = dir.path().join(name);
        let text = read_to_string(&path).unwrap();
        write(&path, format!("{text}\n")).unwrap();
        assert_ne!(read(&dir).unwrap().1, before, "{name}");
        write(&path, text).unwrap();
    }
    assert_eq!(read(&dir).unwrap().1, before);
}

#[test]
fn what_a_folder_lacks_is_named() {
    let problem = |change: &dyn Fn(&Path)| {
        let dir = folder();
        change(dir.path());
        read(&dir).unwrap_err()
    };
    let removed = |name: &'static str| problem(&move |path| std::fs::remove_file(path.join(name)).unwrap());
    let labelled = |text: &'static str| problem(&move |path| write(path.join("labels.csv"), text).unwrap());
    for (problem, parts) in [
        (removed("labels.csv"), ["data.folder: ", "labels.csv"]),
        (removed("task.toml"), ["data.folder: ", "no task.toml and no task.json"]),
        (removed("b.mcap"), ["data.folder: ", "b.mcap: No such file"]),
        (labelled("file,outcome,cohort\na.mcap,success,expert\n"), ["data.experts: ", "\"teleop\"; it has expert"]),
        (labelled("file,outcome,cohort\na.mcap,success,teleop\n"), ["data.folder: ", "no cohort beside the experts"]),
        (labelled("file,outcome\na.mcap,success\n"), ["data.folder: ", "a recording has no cohort"]),
    ] {
        assert!(parts.iter().all(|part| problem.contains(part)), "{problem}");
    }
}

#[test]
fn the_committed_file_for_recordings_is_valid() {
    let dir = folder();
    let labels = "file,outcome,cohort\na.mcap,success,expert\nb.mcap,failure,noise\n";
    write(dir.path().join("labels.csv"), labels).unwrap();
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/experiments/recorded.toml");
    let experiment = Experiment::read(&file, Some(dir.path()), Sizes::Base).unwrap();
    assert!(experiment.recordings.of(0).task.starts_with("push_") && experiment.studies.len() == 2, "{experiment:?}");
}

#[test]
fn what_recordings_without_a_simulator_do_not_allow_is_named() {
    let dir = folder();
    std::fs::remove_file(dir.path().join("marks.csv")).unwrap();
    let file = dir.path().join("x.toml");
    let problem = |more: &str, study: &str| {
        let data = "name = \"x\"\n[data]\nfolder = \".\"\nexperts = \"teleop\"\n";
        write(&file, format!("{data}{more}[[study]]\ntable = \"{study}\"\n")).unwrap();
        Experiment::read(&file, None, Sizes::Base).unwrap_err().to_string()
    };
    let words = r#"command = ["run", "{server}", "{deployment}", "{seed}", "{episodes}"]"#;
    let attempts = format!("[attempts]\nsimulation = \"x/y\"\n{words}\n");
    for (problem, part) in [
        (problem("", "methods"), "evaluate: no simulator is known for these recordings; give [attempts]"),
        (
            problem("seed_stride = 9\n[base]\nevaluate = false\n", "scoring"),
            "data.seed_stride: the recordings of a folder are the same for every seed",
        ),
        (problem(&attempts.replace("{seed}", ""), "methods"), "attempts.command: has no argument {seed}"),
        (problem(&attempts.replace("x/y", ""), "methods"), "attempts.simulation: "),
        (
            problem("[base]\nevaluate = false\noracle = true\n", "cells\"\naxes = { method = [\"ssdf\"] }\nname = \"x"),
            "oracle: the recordings have no marks",
        ),
    ] {
        assert!(problem.contains(part), "{problem}");
    }
}

#[test]
fn a_file_has_a_simulator_or_a_folder() {
    let data = |text: &str| toml::from_str(text).unwrap();
    let problem = |task, text| Source::read(task, &data(text), Path::new("")).unwrap_err();
    assert!(problem(Some(Task::PickCube), "folder = \"x\"").starts_with("task: "));
    assert!(problem(None, "experts = 3").starts_with("task: "));
    assert!(problem(None, "folder = \"x\"\nimage = 3").contains("unknown field `image`"));
    let mut simulated = data("experts = 3");
    assert!(replace_folder(&mut simulated, Path::new("x")).unwrap_err().starts_with("--recordings: "));
    let mut recorded = data("folder = \"x\"");
    replace_folder(&mut recorded, Path::new("/y")).unwrap();
    assert_eq!(recorded["folder"].as_str(), Some("/y"));
}
