//! Exports by the command: every format, an episode with its scores, and what cannot be exported. The files stay in
//! `target/tmp/exports`, where `make check-lerobot` and `make check-robomimic` open them.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use gleaner_proto::v1::*;
use gleaner_recording::{Limits, read_episode, survey};
use serde_json::Value;

use crate::support::{api::Api, command, http, lab, shared::shared};

async fn dataset(api: &mut Api, run: &str, beta: f64) -> String {
    let request = CreateDatasetRequest { score_run_id: run.to_owned(), selection: Some(lab::above(beta)) };
    api.datasets.create_dataset(request).await.unwrap().into_inner().dataset.unwrap().id
}

/// A folder that does not exist.
fn fresh(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("exports").join(name);
    if path.exists() {
        std::fs::remove_dir_all(&path).unwrap();
    }
    path
}

/// The digest of each file that the command's answer lists.
fn digests(reply: &Value) -> BTreeMap<String, String> {
    let text = |file: &Value, key: &str| file[key].as_str().unwrap().to_owned();
    reply["files"].as_array().unwrap().iter().map(|file| (text(file, "name"), text(file, "blake3"))).collect()
}

#[tokio::test]
async fn a_dataset_is_exported_in_every_format() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let dataset = dataset(&mut api, &shared.run, 0.5).await;
    let url = shared.server.url();
    let mut episodes = Vec::new();
    for format in ["mcap", "lerobot", "lerobot_video", "robomimic"] {
        let out = fresh(format);
        let (path, again) = (out.to_str().unwrap(), fresh("again"));
        let kind = format.trim_end_matches("_video");
        let video: &[&str] = if kind == format { &[] } else { &["--video"] };
        let line = [&["export", &dataset, "--format", kind], video, &["--out"]].concat();
        let files = digests(&command::json(url, &[&line[..], &[path]].concat()).await);
        let second = digests(&command::json(url, &[&line[..], &[again.to_str().unwrap()]].concat()).await);
        assert_eq!(files, second, "{format}: the same dataset is the same bytes");
        for (name, digest) in &files {
            let bytes = std::fs::read(out.join(name)).unwrap();
            assert_eq!(blake3::hash(&bytes).to_hex().to_string(), *digest, "{format}: {name}");
        }
        episodes.push(match format {
            "mcap" => {
                assert!(files.contains_key("manifest.jsonl") && files.contains_key("manifest.parquet"));
                files.len() - 2
            }
            "lerobot" => {
                let info: Value = serde_json::from_slice(&std::fs::read(out.join("meta/info.json")).unwrap()).unwrap();
                assert_eq!(info["features"]["observation.images.hand"]["shape"], serde_json::json!([16, 16, 3]));
                usize::try_from(info["total_episodes"].as_u64().unwrap()).unwrap()
            }
            "lerobot_video" => {
                let info: Value = serde_json::from_slice(&std::fs::read(out.join("meta/info.json")).unwrap()).unwrap();
                assert_eq!(info["features"]["observation.images.hand"]["dtype"], "video");
                assert!(files.contains_key("videos/observation.images.hand/chunk-000/file-000.mp4"), "{files:?}");
                continue;
            }
            _ => {
                let bytes = std::fs::read(out.join("dataset.hdf5")).unwrap();
                assert!(bytes.starts_with(b"\x89HDF\r\n\x1a\n"));
                continue;
            }
        });
        // What is there is not touched.
        let refused = command::gleaner(url, &[&line[..], &[path]].concat()).await;
        assert!(!refused.success && refused.errors.contains("has files in it"), "{}", refused.errors);
        assert!(files.keys().all(|name| out.join(name).is_file()));
        std::fs::remove_dir_all(again).unwrap();
    }
    assert_eq!(episodes[0], episodes[1], "each MCAP file is an episode of LeRobot's dataset");
    assert!(episodes[0] > 6, "six experts and at least one kept stretch");
    let refused = command::gleaner(url, &["export", &dataset, "--depth", "--out", "unused"]).await;
    assert!(!refused.success && refused.errors.contains("spec.export.depth"), "{}", refused.errors);
    assert!(!Path::new("unused").exists());
}

/// Episodes of which nothing is kept included.
#[tokio::test]
async fn imperfect_episodes_are_exported_whole_in_every_format() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let dataset = dataset(&mut api, &shared.run, 1.0).await;
    let url = shared.server.url();
    let exported = async |format: &str| {
        let out = fresh(&format!("whole_{format}"));
        let line = ["export", &dataset, "--format", format, "--whole", "--out", out.to_str().unwrap()];
        (digests(&command::json(url, &line).await), out)
    };
    let (files, out) = exported("mcap").await;
    for episode in &shared.episodes {
        let name = format!("{}.mcap", episode.id);
        assert!(files.contains_key(&name), "{name}: {files:?}");
        let reading = read_episode(&out.join(name), &lab::spec()).unwrap();
        assert_eq!(u64::try_from(reading.episode.steps()).unwrap(), episode.steps);
        let scored = reading.report.topics.iter().any(|topic| topic.topic == "/gleaner/quality");
        assert_eq!(scored, episode.outcome() == Outcome::Failure, "{}", episode.id);
    }
    let (_, out) = exported("lerobot").await;
    let info: Value = serde_json::from_slice(&std::fs::read(out.join("meta/info.json")).unwrap()).unwrap();
    assert_eq!(info["total_episodes"].as_u64().unwrap(), shared.episodes.len() as u64);
    assert_eq!(info["total_frames"].as_u64().unwrap(), shared.episodes.iter().map(|one| one.steps).sum::<u64>());
    assert!(std::fs::read_to_string(out.join("README.md")).unwrap().contains("imperfect ones, whole"));
    let (files, _) = exported("robomimic").await;
    assert!(files.contains_key("dataset.hdf5"));
}

#[tokio::test]
async fn an_episode_is_exported_whole_with_its_scores() {
    let shared = shared().await;
    let failed = shared.episodes.iter().find(|episode| episode.outcome() == Outcome::Failure).unwrap();
    let (folder, url) = (fresh("episode"), shared.server.url());
    let out = folder.join("scored.mcap");
    let line = ["export", "--episode", &failed.id, "--scores", &shared.run, "--out", out.to_str().unwrap()];
    let written = command::gleaner(url, &line).await;
    assert!(written.success && written.out.contains(&failed.id), "{}", written.text());
    let reading = read_episode(&out, &lab::spec()).unwrap();
    assert_eq!(u64::try_from(reading.episode.steps()).unwrap(), failed.steps);
    let quality = reading.report.topics.iter().find(|topic| topic.topic == "/gleaner/quality").unwrap();
    assert_eq!((quality.messages, quality.encoding.as_str()), (failed.steps, "protobuf"));
    let refused = command::gleaner(url, &line).await;
    assert!(!refused.success && refused.errors.contains("exists; give another name"), "{}", refused.errors);
    // Its page has the same messages; the file that they come from has another name there.
    let page = format!("{}/episodes/{}", shared.server.pages(), failed.id);
    let served = http::file(&format!("{page}/scored.mcap?run={}", shared.run)).await;
    let copy = fresh("served");
    std::fs::create_dir_all(&copy).unwrap();
    std::fs::write(copy.join("scored.mcap"), served).unwrap();
    let [own, other] = [&out, &copy.join("scored.mcap")].map(|path| read_episode(path, &lab::spec()).unwrap());
    assert!(own.episode.frames().as_ref() == other.episode.frames().as_ref());
    assert_eq!(own.report.topics, other.report.topics);
    let numbers = |path: &Path| survey(path, &Limits::default(), None).unwrap().topics;
    assert_eq!(numbers(&out), numbers(&copy.join("scored.mcap")), "with the ranges of q and w");
    let shown = http::get(&format!("{page}?run={}", shared.run)).await;
    assert!(shown.contains(&format!("/scored.mcap?run={}&amp;beta=0.5", shared.run)), "{shown}");
    let left: Vec<_> = folder.read_dir().unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(left, ["scored.mcap"]);
}
