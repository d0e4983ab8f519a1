//! Walks with a script in place of the inspector, which lists the ranges that it is started for.

use std::io::Write as _;
use std::process::{Command, Stdio};

use gleaner_inspector::{Assumed, Description};

use super::*;
use crate::inspector::Inspector;

/// Writes an empty file for up to MOST episodes of a run, and dies of the episode CAUSE. The last episode of a hundred is
/// refused.
const CHILD: &str = r#"#!/bin/sh
while [ $# -gt 0 ]; do
    case "$1" in
        --recording) dataset=$2 ;;
        --report) report=$2 ;;
        --frames) out=$2 ;;
        --convert) range=$2 ;;
    esac
    shift
done
echo "$range" >> "$dataset/calls"
number=${range%..*} end=${range#*..} results= most=MOST
while [ "$number" -lt "$end" ] && [ "$most" -gt 0 ]; do
    if [ "$number" -eq CAUSE ]; then exit 9; fi
    if [ "$number" -eq 99 ]; then result='{"Err":"no rows"}'; else result='{"Ok":{"steps":'$number',"success":null}}'; fi
    : > "$out/$number.mcap"
    results=$results,$result number=$((number + 1)) most=$((most - 1))
done
echo "{\"converted\":[${results#,}]}" > "$report"
"#;

struct Lab {
    folder: TempDir,
    intake: Intake,
}

impl Lab {
    /// A dataset, and a child that converts up to `most` episodes and dies of the episode `cause`.
    fn new(episodes: u64, most: u64, cause: i64) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("child");
        // Another process writes it: a file that is open for writing cannot run.
        let write = "cat > \"$0\" && chmod +x \"$0\"";
        let mut writer = Command::new("sh").args(["-c", write]).arg(&program).stdin(Stdio::piped()).spawn().unwrap();
        let script = CHILD.replace("MOST", &most.to_string()).replace("CAUSE", &cause.to_string());
        writer.stdin.take().unwrap().write_all(script.as_bytes()).unwrap();
        assert!(writer.wait().unwrap().success());
        let path = folder.path().join("pick");
        std::fs::create_dir(&path).unwrap();
        let description: Description = serde_json::from_value(serde_json::json!({
            "format": "x", "episodes": episodes, "steps": 0, "rate_stated": true, "fields": [], "cameras": [],
            "left_out": [], "spec": { "name": "pick", "rate_hz": 10.0, "action": [] },
        }))
        .unwrap();
        let intake = Intake { path, description, assumed: Assumed::default(), inspector: Inspector::of(program) };
        Self { folder, intake }
    }

    /// Walks over all episodes at once: the numbers of those with a recording, and the errors of the others.
    async fn walk(&self) -> (Vec<u64>, Vec<(u64, String)>) {
        let (mut made, mut refused) = (Vec::new(), Vec::new());
        let mut walk = self.intake.walk(0..self.intake.description.episodes);
        while let Some((number, episode)) = walk.next().await.unwrap() {
            match episode {
                Ok(episode) => {
                    assert!(episode.recording.ends_with(format!("pick_{number:06}.mcap")), "{:?}", episode.recording);
                    assert!(episode.recording.is_file() && episode.converted.steps == number);
                    made.push(number);
                }
                Err(why) => refused.push((number, why)),
            }
        }
        (made, refused)
    }

    fn calls(&self) -> Vec<String> {
        let calls = std::fs::read_to_string(self.folder.path().join("pick/calls")).unwrap();
        calls.lines().map(str::to_owned).collect()
    }
}

#[test]
fn the_runs_of_a_dataset_are_few_and_have_every_episode_once() {
    for episodes in [0, 1, 63, 64, 65, 129, 5_000, 76_000] {
        let runs: Vec<_> = Lab::new(episodes, 1, -1).intake.runs().collect();
        assert!(runs.len() <= 64, "{episodes}: {}", runs.len());
        let all: Vec<u64> = runs.into_iter().flatten().collect();
        assert_eq!(all, (0..episodes).collect::<Vec<_>>());
    }
}

#[tokio::test]
async fn neighbouring_episodes_are_converted_by_one_child() {
    let lab = Lab::new(100, 1000, -1);
    let refused = vec![(99, "no rows".to_owned())];
    assert_eq!(lab.walk().await, ((0..99).collect(), refused.clone()));
    assert_eq!(lab.calls(), ["0..100"]);
    let ended = Lab::new(100, 40, -1);
    assert_eq!(ended.walk().await, ((0..99).collect(), refused));
    assert_eq!(ended.calls(), ["0..100", "40..100", "80..100"], "a child may end a run early");
    let one = ended.intake.episode(7).await.unwrap().unwrap();
    assert_eq!(one.converted.steps, 7);
    assert_eq!(ended.calls().last().unwrap(), "7..8");
}

#[tokio::test]
async fn an_episode_that_a_child_dies_of_is_the_only_one_without_a_recording() {
    let lab = Lab::new(99, 1000, 37);
    let (made, refused) = lab.walk().await;
    assert_eq!(made, (0..99).filter(|number| *number != 37).collect::<Vec<_>>());
    assert!(refused.len() == 1 && refused[0].0 == 37 && refused[0].1.contains("its inspection failed"), "{refused:?}");
    assert!(lab.calls().len() < 20, "{:?}", lab.calls());
    // A child without results has an error for each.
    let dead = Lab::new(3, 0, -1);
    let (made, refused) = dead.walk().await;
    assert_eq!((made, refused.len()), (vec![], 3));
}
