//! The first minutes with one's own recordings: inspected, a task drafted and checked without a server, then pushed.

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::support::{
    command::{Output, gleaner, json},
    files::root,
    server::TestServer,
    skipped::skipped,
};

/// No server is there: commands that ask one fail.
const NOWHERE: &str = "http://127.0.0.1:9";

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Copies fixtures of the reader into a folder.
fn copied(folder: &Path, names: &[&str]) {
    for name in names {
        std::fs::copy(root().join("crates/recording/fixtures").join(name), folder.join(name)).unwrap();
    }
}

/// Drafts a task from recordings into a file.
async fn drafted(recordings: &[&Path], file: &Path) -> Output {
    let words: Vec<&str> =
        ["task", "draft", "--name", "drafted"].into_iter().chain(recordings.iter().map(|path| text(path))).collect();
    let output = gleaner(NOWHERE, &words).await;
    assert!(output.success, "{}", output.errors);
    std::fs::write(file, &output.out).unwrap();
    output
}

/// Drafts a task from recordings, checks them, creates the task and pushes them; returns the mappings of the episodes.
async fn drafted_and_pushed(folders: &[&Path]) -> Vec<String> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("task.toml");
    drafted(folders, &file).await;
    let words: Vec<&str> =
        ["task", "check", text(&file)].into_iter().chain(folders.iter().map(|path| text(path))).collect();
    let checked = gleaner(NOWHERE, &words).await;
    assert!(checked.success, "{}", checked.text());

    let server = TestServer::start_with(&["--workers", "0"]).await;
    json(server.url(), &["task", "create", text(&file)]).await;
    let mut mappings = Vec::new();
    for path in folders {
        let pushed = json(server.url(), &["push", text(path), "--outcome", "unknown"]).await;
        let episodes = pushed["episodes"].as_array().unwrap();
        assert!(!episodes.is_empty() && pushed["failures"] == serde_json::json!([]), "{pushed}");
        mappings.extend(episodes.iter().map(|episode| episode["episode"]["mapping"].as_str().unwrap().to_owned()));
    }
    mappings.sort();
    mappings.dedup();
    mappings
}

#[tokio::test]
async fn drafts_of_each_dialect_are_accepted_with_their_recordings() {
    let folder = tempfile::tempdir().unwrap();
    copied(folder.path(), &["pick_cube_foxglove.mcap", "pick_cube_ros2.mcap"]);
    assert_eq!(drafted_and_pushed(&[folder.path()]).await, ["foxglove", "ros2"]);
    let folder = tempfile::tempdir().unwrap();
    copied(folder.path(), &["json_images.mcap"]);
    assert_eq!(drafted_and_pushed(&[folder.path()]).await, ["json"]);
}

#[tokio::test]
async fn a_draft_of_real_recordings_is_the_task_that_a_person_wrote() {
    let beside = root().join("../shared/episodes");
    let episodes = std::env::var_os("GLEANER_EPISODES").map_or(beside, PathBuf::from);
    if !episodes.is_dir() {
        return skipped("no folder of real recordings (GLEANER_EPISODES)");
    }
    // Some of each cohort.
    let mut folders = Vec::new();
    for dialect in ["foxglove", "ros2"] {
        let folder = tempfile::tempdir().unwrap();
        let mut names: Vec<_> = episodes.join(dialect).read_dir().unwrap().map(|entry| entry.unwrap().path()).collect();
        names.retain(|path| path.extension().is_some_and(|ending| ending == "mcap"));
        names.sort();
        for path in names.iter().step_by(6) {
            std::fs::copy(path, folder.path().join(path.file_name().unwrap())).unwrap();
        }
        folders.push(folder);
    }
    let paths: Vec<&Path> = folders.iter().map(tempfile::TempDir::path).collect();
    assert_eq!(drafted_and_pushed(&paths).await, ["foxglove", "ros2"]);

    let file = folders[0].path().join("task.toml");
    drafted(&paths, &file).await;
    let read = |text: &str| -> Value {
        let spec: gleaner_recording::TaskSpec = toml::from_str(text).unwrap();
        serde_json::to_value(spec).unwrap()
    };
    let [draft, written] =
        [file, root().join("examples/pick_cube_maniskill.toml")].map(|path| std::fs::read_to_string(&path).unwrap());
    let fields = |task: &Value| task["proprioception"].as_array().unwrap().len();
    let (mut drafted, written) = (read(&draft), read(&written));
    assert_eq!(fields(&drafted) + 1, fields(&written), "the joints' velocities are a comment");
    // A `#` without a space behind it is one of a line that a reader may use.
    let is_usable =
        |line: &&str| line.strip_prefix('#').is_some_and(|rest| !rest.starts_with(' ') || rest.starts_with("  "));
    let in_use: Vec<&str> = draft.lines().map(|line| if is_usable(&line) { &line[1..] } else { line }).collect();
    drafted = read(&in_use.join("\n"));
    for part in ["rate_hz", "cameras", "proprioception", "action"] {
        assert_eq!(drafted[part], written[part], "{part}");
    }
    let sources = |spec: &Value, mapping: usize| -> Vec<Value> {
        let mut fields = spec["mappings"][mapping]["fields"].as_array().unwrap().clone();
        fields.sort_by_key(|source| source["field"].as_str().unwrap().to_owned());
        fields
    };
    for mapping in [0, 1] {
        assert_eq!(sources(&drafted, mapping), sources(&written, mapping));
    }
}

#[tokio::test]
async fn recordings_are_inspected_without_a_server_and_damage_is_named() {
    let folder = tempfile::tempdir().unwrap();
    copied(folder.path(), &["pick_cube_ros2.mcap"]);
    let (good, bad) = (folder.path().join("pick_cube_ros2.mcap"), folder.path().join("bad.mcap"));
    let pictures = folder.path().join("pictures");
    let found = json(NOWHERE, &["inspect", text(&good), "--pictures", text(&pictures)]).await;
    let topics = found["recordings"][0]["survey"]["topics"].as_array().unwrap();
    let joints = topics.iter().find(|topic| topic["topic"] == "/joint_states").unwrap();
    assert_eq!((joints["messages"].as_u64(), joints["encoding"].as_str()), (Some(6), Some("cdr")));
    assert_eq!(pictures.read_dir().unwrap().count(), 4);

    std::fs::write(&bad, b"not a recording").unwrap();
    let output = gleaner(NOWHERE, &["inspect", text(folder.path())]).await;
    assert!(!output.success && output.errors.contains("1 of 2 recordings cannot be read"), "{}", output.errors);
    assert!(output.out.contains("bad.mcap: the recording is not an MCAP file"), "{}", output.out);
    assert!(output.out.contains("panda_joint1") && output.out.contains("color 128×128 jpeg"), "{}", output.out);
}

#[tokio::test]
async fn labels_are_checked_with_the_recordings_without_a_server() {
    let folder = tempfile::tempdir().unwrap();
    copied(folder.path(), &["pick_cube_foxglove.mcap", "pick_cube_ros2.mcap"]);
    let task = folder.path().join("task.toml");
    drafted(&[folder.path()], &task).await;
    let labels = |name: &str, lines: &str| {
        let file = folder.path().join(name);
        std::fs::write(&file, lines).unwrap();
        file
    };
    let check = ["task", "check", text(&task), text(folder.path())];

    labels("labels.csv", "file,outcome\npick_cube_ros2.mcap,success\n");
    let missing = gleaner(NOWHERE, &check).await;
    let problem = "pick_cube_foxglove.mcap is not listed in";
    assert!(!missing.success && missing.errors.contains(problem), "{}", missing.text());

    let own = labels("trials.csv", "run;verdict;trouble\npick_cube_ros2;solved;\npick_cube_foxglove;bad;dropped\n");
    let columns = ["--labels", text(&own), "--label-columns", "file=run,outcome=verdict,cohort=trouble"];
    let suggested = drafted(&[folder.path()], &task).await.errors;
    let part = format!("{} --task-file task.toml {} --success-value WORD", text(folder.path()), columns.join(" "));
    assert!(suggested.contains(&part) && suggested.contains("of bad, solved"), "{part}: {suggested}");
    let named = [&check[..], &columns, &["--success-value", "solved"]].concat();
    let checked = gleaner(NOWHERE, &named).await;
    let line = format!("labels of {}: 1 success, 1 failure (1 \"dropped\")", own.display());
    assert!(checked.success && checked.out.contains(&line), "{}", checked.text());
    assert!(checked.out.contains("warning: scores need at least two successes"), "{}", checked.out);
    let (file, table) = (text(&task), columns.join(" "));
    let push = format!("gleaner push {} --task-file {file} {table} --success-value solved", text(folder.path()));
    assert!(checked.errors.contains(&push), "{push}: {}", checked.errors);
    let found = json(NOWHERE, &named).await;
    let label = |name: &str| {
        let rows = found["recordings"].as_array().unwrap().iter();
        rows.clone().find(|row| row["file"].as_str().unwrap().ends_with(name)).unwrap()["label"].clone()
    };
    assert_eq!(label("foxglove.mcap"), serde_json::json!({ "outcome": "failure", "cohort": "dropped" }));
    assert_eq!(label("ros2.mcap")["outcome"], "success");
}

#[tokio::test]
async fn a_push_with_a_task_file_creates_nothing_unless_every_recording_fits() {
    let folder = tempfile::tempdir().unwrap();
    copied(folder.path(), &["pick_cube_foxglove.mcap", "pick_cube_ros2.mcap"]);
    let task = folder.path().join("task.toml");
    let next = drafted(&[folder.path()], &task).await.errors;
    assert!(next.contains(&format!("gleaner push {} --task-file task.toml", text(folder.path()))), "{next}");
    let labels = |lines: &str| std::fs::write(folder.path().join("labels.csv"), lines).unwrap();
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let push = ["push", text(folder.path()), "--task-file", text(&task)];

    labels("file,outcome\npick_cube_ros2.mcap,success\n");
    let unlabelled = gleaner(server.url(), &push).await;
    assert!(
        !unlabelled.success && unlabelled.errors.contains("foxglove.mcap is not listed in"),
        "{}",
        unlabelled.text()
    );
    let broken = folder.path().join("broken.mcap");
    std::fs::write(&broken, b"not a recording").unwrap();
    labels("file,outcome\npick_cube_ros2.mcap,success\npick_cube_foxglove.mcap,failure\nbroken.mcap,failure\n");
    let rejected = gleaner(server.url(), &push).await;
    for part in ["rejected: ", "1 of 3 recordings would be rejected", "no task was created and no recording sent"] {
        assert!(!rejected.success && rejected.errors.contains(part), "{part}: {}", rejected.text());
    }
    assert_eq!(json(server.url(), &["task", "list"]).await["tasks"].as_array().map_or(0, Vec::len), 0);

    std::fs::remove_file(&broken).unwrap();
    labels("file,outcome\npick_cube_ros2.mcap,success\npick_cube_foxglove.mcap,failure\n");
    let pushed = gleaner(server.url(), &push).await;
    for part in ["created task drafted", "accepted: 2 of 2 recordings", "1 success, 1 failure"] {
        assert!(pushed.success && pushed.errors.contains(part), "{part}: {}", pushed.text());
    }
    let counts = json(server.url(), &["task", "list"]).await["tasks"][0].clone();
    assert_eq!((&counts["success_count"], &counts["failure_count"]), (&1.into(), &1.into()), "{counts}");
    let again = gleaner(server.url(), &push).await;
    assert!(again.success && !again.errors.contains("created task"), "{}", again.text());

    let faster = std::fs::read_to_string(&task).unwrap().replace("rate_hz = 20.0", "rate_hz = 18.0");
    std::fs::write(&task, faster).unwrap();
    let other = gleaner(server.url(), &push).await;
    let problem = "the server has another task named drafted: `gleaner task update drafted";
    assert!(!other.success && other.errors.contains(problem), "{}", other.text());
}

#[tokio::test]
async fn a_wrong_topic_is_refused_once_with_the_nearest_one() {
    let folder = tempfile::tempdir().unwrap();
    copied(folder.path(), &["pick_cube_ros2.mcap"]);
    let (recording, file) = (folder.path().join("pick_cube_ros2.mcap"), folder.path().join("task.toml"));
    drafted(&[&recording], &file).await;
    let task = std::fs::read_to_string(&file).unwrap().replace("\"/joint_states\"", "\"/joint_state\"");
    std::fs::write(&file, task).unwrap();
    // Another recording with the same problem.
    let mut bytes = std::fs::read(&recording).unwrap();
    bytes.push(0);
    std::fs::write(folder.path().join("other.mcap"), bytes).unwrap();
    std::fs::write(
        folder.path().join("labels.csv"),
        "file,task,outcome\npick_cube_ros2.mcap,PickCube,success\nother.mcap,PickCube,failure\n",
    )
    .unwrap();

    let server = TestServer::start_with(&["--workers", "0"]).await;
    json(server.url(), &["task", "create", text(&file)]).await;
    // The labels are found, and their task is another.
    let output = gleaner(server.url(), &["push", text(folder.path())]).await;
    for part in ["labels.csv line", "no task \"PickCube\"", "--task drafted"] {
        assert!(!output.success && output.errors.contains(part), "{part}: {}", output.errors);
    }
    let output = gleaner(server.url(), &["push", text(folder.path()), "--task", "drafted"]).await;
    let rejected: Vec<&str> = output.out.lines().filter(|line| line.starts_with("rejected:")).collect();
    assert!(!output.success && rejected.len() == 1, "{}", output.text());
    for part in ["2 recordings (", "did you mean /joint_states?", "/tool_pose", "correct the mapping"] {
        assert!(rejected[0].contains(part), "{part}: {}", rejected[0]);
    }
    assert!(output.errors.contains("labels from"), "{}", output.errors);
}
