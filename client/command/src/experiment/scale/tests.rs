//! Sizes over sizes, which of them win, and that a section without the flag changes no stage.

use std::path::{Path, PathBuf};

use serde_json::json;

use super::*;
use crate::experiment::file::Experiment;
use crate::experiment::stage::Graph;

const HEAD: &str = "name = \"x\"\ntask = \"pick_cube\"\n[data]\nimage = 16\nexperts = 3\nseed_stride = 50\n\
    cohorts = [{ agent = \"noise:1\", count = 2 }]\n";
const BASE: &str = "[base]\nseeds = [7]\nepisodes = 5\npretrain = { steps = 7, batch = 8, preset = \"small\" }\n\
    train = { batch = 9, precision = \"f32\", learning_rate = 0.01 }\nrule = { experts = 2, seed = 4 }\n";
const SCALE: &str = "[scale]\ndevice = \"cuda\"\npreset = \"base\"\nprecision = \"bf16\"\nimage = 64\n\
    seeds = [1, 2]\nepisodes = 200\npretrain = { steps = 70, batch = 80 }\ntrain = { steps = 90 }\n\
    rule = { experts = 20 }\ndata = { experts = 30 }\n";
const STUDY: &str = "[[study]]\ntable = \"cells\"\ncells = [{ label = \"a\", set = { method = \"bc\" } }]\n";

fn scaled(parts: &[&str]) -> Result<Experiment, String> {
    Experiment::parse_with(&parts.concat(), Sizes::Scaled)
}

fn keys(experiment: &Experiment) -> Vec<String> {
    Graph::new(experiment, experiment.device).stages.into_iter().map(|stage| stage.key).collect()
}

#[test]
fn the_sizes_of_the_section_replace_those_of_base_and_data() {
    let experiment = scaled(&[HEAD, BASE, SCALE, STUDY]).unwrap();
    assert_eq!((experiment.sizes, experiment.device), (Sizes::Scaled, Device::Cuda));
    let set = experiment.recordings.source().simulated().unwrap();
    assert_eq!((set.config.image, set.cohorts[0].count, set.cohorts[1].count), (64, 30, 2));
    // Each of the section's seeds has recordings of its own.
    assert_eq!(experiment.recordings.all().len(), 2);
    let cell = &experiment.studies[0].cells[0].settings;
    assert_eq!((&cell.seeds[..], cell.episodes, cell.rule.experts, cell.rule.seed), (&[1, 2][..], 200, 20, 4));
    assert_eq!(json!(cell.settings), json!({"preset": "base", "precision": "bf16"}));
    // A job's own preset and precision in the base give way; what is no size stays.
    assert_eq!(json!(cell.pretrain), json!({"steps": 70, "batch": 80}));
    assert_eq!(json!(cell.train), json!({"steps": 90, "batch": 9, "learning_rate": 0.01}));
    let train = cell.train_spec(1).unwrap().values();
    assert_eq!((&train["precision"], &train["preset"], &train["steps"]), (&json!("bf16"), &json!("base"), &json!(90)));
}

#[test]
fn what_a_study_or_a_cell_sets_wins() {
    let study = "[[study]]\ntable = \"cells\"\nset = { method = \"bc\", seeds = [5], train = { steps = 4 } }\ncells = [\n\
        { label = \"a\", set = { episodes = 6, preset = \"tiny\", rule = { experts = 1 } } },\n\
        { label = \"b\", set = { train = { batch = 3, precision = \"f32\" } } },\n]\n";
    let experiment = scaled(&[HEAD, BASE, SCALE, study]).unwrap();
    let [a, b] = &experiment.studies[0].cells[..] else { panic!("not two cells") };
    let (a, b) = (&a.settings, &b.settings);
    assert_eq!((&a.seeds[..], a.episodes, a.rule.experts), (&[5][..], 6, 1));
    assert_eq!((&a.settings["preset"], &a.settings["precision"]), (&json!("tiny"), &json!("bf16")));
    assert_eq!((&a.train["steps"], &a.train["batch"]), (&json!(4), &json!(9)));
    assert_eq!((b.episodes, &b.train["batch"], b.rule.experts), (200, &json!(3), 20));
    assert_eq!(b.train_spec(5).unwrap().values()["precision"], json!("f32"));
    let axes = "[[study]]\ntable = \"cells\"\naxes = { method = [\"bc\"], preset = [\"small\"] }\n";
    let cells = &scaled(&[HEAD, BASE, SCALE, axes]).unwrap().studies[0].cells;
    assert_eq!(cells[0].settings.settings["preset"], json!("small"));
}

#[test]
fn a_size_that_cannot_be_used_is_named() {
    for (scale, study, part) in [
        ("[scale]\npresets = \"base\"\n", STUDY, "unknown field `presets`"),
        ("[scale]\ntrain = { learning_rate = 0.1 }\n", STUDY, "unknown field `learning_rate`"),
        ("[scale]\npreset = \"huge\"\n", STUDY, "unknown variant `huge`"),
        ("[scale]\nepisodes = -1\n", STUDY, "-1"),
        ("[scale]\n", STUDY, "scale: the section is empty"),
        ("[scale]\nseeds = [1, 1]\n", STUDY, "with [scale]: base: seeds: a value is duplicated"),
        ("[scale]\nimage = 4\n", STUDY, "with [scale]: data: config.image: 4 is out of range"),
        ("[scale]\ndata = { experts = 60 }\n", STUDY, "with [scale]: data.seed_stride: 50 is less than the 62"),
        (
            "[scale]\ntrain = { steps = 90 }\n",
            &STUDY.replace("\"bc\"", "\"bc\", steps = 3"),
            "study \"Cells\": cell \"a\": steps: scale.train.steps would win over it; name it train.steps here",
        ),
    ] {
        // A section is checked without the flag too.
        for sizes in [Sizes::Base, Sizes::Scaled] {
            let problem = Experiment::parse_with(&[HEAD, BASE, scale, study].concat(), sizes).unwrap_err();
            assert!(problem.contains(part), "{problem}");
        }
    }
    let unknown = scaled(&[HEAD, BASE, "[scale]\npresets = \"base\"\n", STUDY]).unwrap_err();
    assert!(unknown.starts_with("line "), "{unknown}");
    let lacking = scaled(&[HEAD, BASE, STUDY]).unwrap_err();
    assert!(lacking.starts_with("--scale: the file has no section [scale]; add one"), "{lacking}");
}

#[test]
fn steps_of_all_jobs_are_accepted_where_no_size_hides_them() {
    let study = STUDY.replace("\"bc\"", "\"bc\", steps = 3");
    assert!(scaled(&[HEAD, "[base]\n", "[scale]\nepisodes = 9\n", &study]).is_ok());
    let own = STUDY.replace("\"bc\"", "\"bc\", steps = 3, train = { steps = 5 }");
    assert!(scaled(&[HEAD, "[base]\n", "[scale]\ntrain = { steps = 90 }\n", &own]).is_ok());
    // In the base they give way, as every size there.
    assert!(scaled(&[HEAD, "[base]\nsteps = 3\n", "[scale]\ntrain = { steps = 90 }\n", STUDY]).is_ok());
}

#[test]
fn a_section_changes_no_stage_without_the_flag() {
    let plain = Experiment::parse(&[HEAD, BASE, STUDY].concat()).unwrap();
    let with_section = Experiment::parse(&[HEAD, BASE, SCALE, STUDY].concat()).unwrap();
    assert_eq!((with_section.sizes, with_section.device), (Sizes::Base, Device::Cpu));
    assert_eq!(keys(&plain), keys(&with_section));
    let scaled_keys = keys(&scaled(&[HEAD, BASE, SCALE, STUDY]).unwrap());
    assert!(keys(&plain).iter().all(|key| !scaled_keys.contains(key)), "no stage of one is a stage of the other");
    // Work that no size changes has the same key on the same device, and is the same.
    let of_episodes = scaled(&[HEAD, BASE, "[scale]\nepisodes = 9\n", STUDY]).unwrap();
    let same: Vec<bool> = keys(&of_episodes).iter().zip(&keys(&plain)).map(|(one, two)| one == two).collect();
    assert_eq!(same, [true, true, false], "a snapshot, a training, and evaluations");
}

/// A folder of recordings, for the files whose recordings are made elsewhere.
pub(in super::super) fn folder() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(dir.path().join(name), text).unwrap();
    write("task.toml", "name = \"push\"\nrate_hz = 10.0\naction = [{ name = \"a\", size = 1 }]\n");
    write("labels.csv", "file,outcome,cohort\na.mcap,success,expert\nb.mcap,failure,noise\n");
    write("marks.csv", "file,went_wrong\na.mcap,\nb.mcap,0\n");
    write("a.mcap", "a");
    write("b.mcap", "b");
    dir
}

#[test]
fn the_recordings_of_a_folder_have_no_size_to_change() {
    let dir = folder();
    let file = dir.path().join("x.toml");
    for (scale, field) in [("image = 64", "image"), ("data = { experts = 9 }", "data.experts")] {
        let text = format!(
            "name = \"x\"\n[data]\nfolder = \".\"\n[scale]\n{scale}\n[base]\nevaluate = false\n\
             [[study]]\ntable = \"scoring\"\n"
        );
        std::fs::write(&file, text).unwrap();
        let problem = Experiment::read(&file, None, Sizes::Scaled).unwrap_err().to_string();
        assert!(problem.contains(&format!("scale.{field}: the recordings of a folder")), "{problem}");
    }
}

#[test]
fn every_committed_file_but_the_smallest_scales_up_and_keeps_its_stages() {
    let dir = folder();
    let committed = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/experiments");
    let paths = std::fs::read_dir(committed).unwrap().map(|entry| entry.unwrap().path());
    let is_scaled =
        |path: &PathBuf| path.extension().is_some_and(|extension| extension == "toml") && !path.ends_with("quick.toml");
    let read = |path: &Path, sizes| {
        let text = std::fs::read_to_string(path).unwrap();
        let recordings = text.contains("folder = ").then_some(dir.path());
        Experiment::read(path, recordings, sizes).unwrap()
    };
    for path in paths.filter(is_scaled) {
        let name = path.file_name().unwrap().to_str().unwrap();
        let mut table: Table = std::fs::read_to_string(&path).unwrap().parse().unwrap();
        assert!(table.remove("scale").is_some(), "{name}");
        let bare = dir.path().join(name);
        std::fs::write(&bare, table.to_string()).unwrap();
        let (plain, scaled) = (read(&path, Sizes::Base), read(&path, Sizes::Scaled));
        assert_eq!(keys(&plain), keys(&read(&bare, Sizes::Base)), "{name}");
        assert_eq!(scaled.device, Device::Cuda, "{name}");
        let cells = |experiment: &Experiment| experiment.studies.iter().flat_map(|study| study.cells.clone()).collect();
        let [before, after]: [Vec<_>; 2] = [cells(&plain), cells(&scaled)];
        for (plain, cell) in before.iter().zip(&after) {
            let settings = &cell.settings;
            // A study's own seeds stay.
            let own = settings.seeds == plain.settings.seeds;
            assert!(own || settings.seeds.len() == 10, "{name}: {}", cell.label);
            assert!(!settings.evaluate || settings.episodes == 200, "{name}: {}", cell.label);
            assert_eq!(settings.settings["preset"], json!("base"), "{name}: {}", cell.label);
        }
    }
}
