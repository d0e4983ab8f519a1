//! Recordings that their recorder has cut into parts, pushed as one episode with the `gleaner` command.

use std::path::{Path, PathBuf};

use gleaner_recording::{EpisodeWriter, StepRef, frame_bytes_per_step, read_episode};

use crate::support::{
    command::{gleaner, json},
    lab::{self, RECORDINGS},
};

/// Writes the steps of a recording into files of these numbers of steps.
fn write(paths: &[PathBuf], lengths: &[usize]) {
    let (folder, spec) = (tempfile::tempdir().unwrap(), lab::spec());
    let whole = folder.path().join("whole.mcap");
    std::fs::write(&whole, &RECORDINGS[0].bytes).unwrap();
    let episode = read_episode(&whole, &spec).unwrap().episode;
    let (frames, proprioception, action) = (episode.frames(), episode.proprioception(), episode.action());
    let sizes = [frame_bytes_per_step(&spec), spec.proprioception_size(), spec.action_size()];
    let mut step = 0;
    for (path, length) in paths.iter().zip(lengths) {
        let mut writer = EpisodeWriter::create(std::fs::File::create(path).unwrap(), &spec).unwrap();
        for at in step..step + length {
            let [frame, values, command] = sizes.map(|size| at * size..(at + 1) * size);
            let step_ref = StepRef {
                frames: &frames.as_ref()[frame],
                proprioception: &proprioception[values],
                action: &action[command],
            };
            writer.step(episode.stamps()[at], step_ref).unwrap();
        }
        writer.finish().unwrap();
        step += length;
    }
}

/// As rosbag2 writes it beside its parts.
fn metadata(parts: &[&str]) -> String {
    let list: String = parts.iter().map(|part| format!("    - {part}\n")).collect();
    format!("rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  relative_file_paths:\n{list}")
}

#[tokio::test]
async fn a_long_recording_is_cut_into_episodes_at_its_markers() {
    let (server, _api) = lab::with_task(&["--workers", "0"]).await;
    let (folder, spec) = (tempfile::tempdir().unwrap(), lab::spec());
    let path = folder.path().join("long.mcap");
    std::fs::write(&path, &RECORDINGS[0].bytes).unwrap();
    let episode = read_episode(&path, &spec).unwrap().episode;
    let (frames, proprioception, action) = (episode.frames(), episode.proprioception(), episode.action());
    let sizes = [frame_bytes_per_step(&spec), spec.proprioception_size(), spec.action_size()];
    let mut writer = EpisodeWriter::create(std::fs::File::create(&path).unwrap(), &spec).unwrap();
    for at in 0..20 {
        let [frame, values, command] = sizes.map(|size| at * size..(at + 1) * size);
        let stamp = episode.stamps()[at];
        for (step, mark) in [(2, "start"), (9, "success"), (11, "start"), (18, "failure")] {
            if step == at {
                writer.annotate("/episode_marker", stamp, &serde_json::json!({"data": mark})).unwrap();
            }
        }
        let step_ref = StepRef {
            frames: &frames.as_ref()[frame],
            proprioception: &proprioception[values],
            action: &action[command],
        };
        writer.step(stamp, step_ref).unwrap();
    }
    writer.finish().unwrap();
    let words = ["push", path.to_str().unwrap(), "--episodes-from", "/episode_marker"];
    let pushed = json(server.url(), &words).await;
    assert_eq!(pushed["failures"], serde_json::json!([]), "{pushed}");
    let episodes = pushed["episodes"].as_array().unwrap();
    let of = |name: &str| episodes.iter().map(|entry| entry["episode"][name].to_string()).collect::<Vec<_>>();
    assert!(of("steps").iter().all(|steps| steps.contains('7')), "{pushed}");
    let outcomes = of("outcome").iter().map(|outcome| outcome.to_lowercase()).collect::<Vec<_>>();
    assert!(outcomes[0].contains("success") && outcomes[1].contains("failure"), "{pushed}");
    let again = json(server.url(), &words).await;
    assert!(again["episodes"].as_array().unwrap().iter().all(|entry| entry["existed"] == serde_json::json!(true)));
    // The same steps by their times are the same episodes.
    let seconds = |step: usize| (episode.stamps()[step] - episode.stamps()[0]) as f64 / 1e9;
    let ranges = folder.path().join("ranges.csv");
    let row = |from, to, success, name| format!("{},{},{success},{name}\n", seconds(from), seconds(to));
    let rows = [row(2, 9, "true", ""), row(11, 18, "false", "second"), row(9, 11, "", "")];
    std::fs::write(&ranges, format!("start,end,success,name\n{}", rows.concat())).unwrap();
    let words = ["push", path.to_str().unwrap(), "--ranges", ranges.to_str().unwrap()];
    let cut = json(server.url(), &words).await;
    let cut = cut["episodes"].as_array().unwrap();
    assert_eq!((cut[0]["episode"]["outcome"].clone(), cut.len()), (episodes[0]["episode"]["outcome"].clone(), 3));
    assert_eq!(cut[2]["episode"]["outcome"], episodes[1]["episode"]["outcome"]);
    assert!(cut[2]["file"].as_str().unwrap().ends_with("long_second.mcap"), "{cut:?}");
    std::fs::write(&ranges, "start,end\n0,1\n0.5,1.2\n").unwrap();
    let refused = gleaner(server.url(), &words).await;
    assert!(!refused.success && refused.text().contains("overlaps the range 0 to 1 s"), "{}", refused.text());
    let refused = gleaner(server.url(), &["push", path.to_str().unwrap(), "--success-column", "done"]).await;
    assert!(!refused.success && refused.text().contains("datasets of other programs"), "{}", refused.text());
    let refused = gleaner(server.url(), &["push", path.to_str().unwrap(), "--episodes-from", "/marker"]).await;
    assert!(!refused.success && refused.text().contains("/episode_marker"), "{}", refused.text());
}

#[tokio::test]
async fn an_episode_in_three_parts_has_the_steps_of_the_whole() {
    let (server, mut api) = lab::with_task(&["--workers", "0"]).await;
    let (url, folder) = (server.url(), tempfile::tempdir().unwrap());
    let at = |name: &str| folder.path().join(name);
    let names = ["run_0.mcap", "run_1.mcap", "run_2.mcap"];
    std::fs::create_dir(at("run")).unwrap();
    let parts = names.map(|name| at("run").join(name));
    write(&[at("whole.mcap")], &[20]);
    write(&parts, &[6, 9, 5]);

    let text = |path: &Path| path.to_str().unwrap().to_owned();
    let whole = json(url, &["push", &text(&at("whole.mcap"))]).await["episodes"][0]["episode"].clone();
    let joined = json(url, &["push", "--join", &text(&at("run"))]).await["episodes"][0].clone();
    assert_eq!(
        (&joined["episode"]["steps"], &joined["episode"]["duration_s"]),
        (&whole["steps"], &whole["duration_s"])
    );
    assert_eq!(
        (joined["episode"]["file_name"].as_str(), joined["episode"]["warnings"].as_u64()),
        (Some("run.mcap"), Some(0))
    );
    let stored = at("stored.mcap");
    json(url, &["download", joined["episode"]["id"].as_str().unwrap(), "--output", &text(&stored)]).await;
    let [found, expected] = [stored, at("whole.mcap")].map(|path| read_episode(&path, &lab::spec()).unwrap().episode);
    assert_eq!((found.stamps(), found.action()), (expected.stamps(), expected.action()));
    assert_eq!(found.proprioception(), expected.proprioception());
    assert_eq!(found.frames().as_ref(), expected.frames().as_ref());

    // The same parts are the same content, named or as a rosbag2 folder.
    let files = parts.each_ref().map(|part| text(part));
    let named = json(url, &[&["push", "--join"][..], &files.each_ref().map(String::as_str)].concat()).await;
    assert_eq!(named["episodes"][0]["existed"], true, "{named}");
    std::fs::write(at("run/metadata.yaml"), metadata(&names)).unwrap();
    std::fs::remove_file(at("whole.mcap")).unwrap();
    std::fs::remove_file(at("stored.mcap")).unwrap();
    let found = json(url, &["push", &text(folder.path())]).await;
    assert_eq!((found["episodes"].as_array().unwrap().len(), &found["episodes"][0]["existed"]), (1, &true.into()));
    assert_eq!(api.episodes().await.len(), 2);
}

#[tokio::test]
async fn missing_and_overlapping_parts_are_named_and_nothing_is_stored() {
    let (server, mut api) = lab::with_task(&["--workers", "0"]).await;
    let (url, folder) = (server.url(), tempfile::tempdir().unwrap());
    let at = |name: &str| folder.path().join(name);
    let names = ["run_0.mcap", "run_1.mcap", "run_2.mcap"];
    write(&names.map(&at), &[6, 9, 5]);
    std::fs::copy(at("run_0.mcap"), at("run_1.mcap")).unwrap();
    let output = gleaner(url, &["push", "--join", folder.path().to_str().unwrap()]).await;
    assert!(!output.success && output.out.contains("run_1.mcap: it overlaps with"), "{} {}", output.out, output.errors);
    std::fs::remove_file(at("run_1.mcap")).unwrap();
    for check in [&["--join"][..], &["--join", "--check"]] {
        let output = gleaner(url, &[&["push", folder.path().to_str().unwrap()], check].concat()).await;
        assert!(!output.success && output.out.contains("run_1.mcap: this part is missing"), "{}", output.out);
    }
    std::fs::write(at("metadata.yaml"), metadata(&names)).unwrap();
    let output = gleaner(url, &["push", folder.path().to_str().unwrap()]).await;
    assert!(!output.success && output.out.contains("metadata.yaml lists it"), "{} {}", output.out, output.errors);
    assert!(api.episodes().await.is_empty());
}
