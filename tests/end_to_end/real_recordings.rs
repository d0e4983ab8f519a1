//! Real recordings of a simulator lab, in both dialects, through the whole way; skipped where they are not at hand.

use std::path::PathBuf;

use gleaner_proto::v1::*;

use crate::{
    api::Api,
    lab::{self, Recording},
    server::TestServer,
};

/// The folder of recordings: `GLEANER_EPISODES`, or `shared/episodes` beside the checkout.
fn folder() -> Option<PathBuf> {
    let beside = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/episodes");
    let folder = std::env::var_os("GLEANER_EPISODES").map_or(beside, PathBuf::from);
    folder.is_dir().then_some(folder)
}

/// The first recordings of some cohorts, as a dialect's labels.csv lists them.
fn some(dialect: &str, wanted: &[(&str, usize)]) -> Vec<Recording> {
    let dir = folder().unwrap().join(dialect);
    let labels = std::fs::read_to_string(dir.join("labels.csv")).unwrap();
    let rows: Vec<Vec<&str>> = labels.lines().skip(1).map(|line| line.split(',').collect()).collect();
    let mut recordings = Vec::new();
    for (cohort, count) in wanted {
        for row in rows
            .iter()
            .filter(|row| row[3].trim() == *cohort && (*cohort == "expert" || row[2] == "failure"))
            .take(*count)
        {
            recordings.push(Recording {
                name: row[0].to_owned(),
                bytes: std::fs::read(dir.join(row[0])).unwrap().into(),
                outcome: if row[2] == "success" { Outcome::Success } else { Outcome::Failure },
                cohort: (*cohort).to_owned(),
            });
        }
    }
    recordings
}

#[tokio::test]
async fn both_dialects_are_one_task() {
    if folder().is_none() {
        eprintln!("skipped: no folder of real recordings (GLEANER_EPISODES)");
        return;
    }
    let server = TestServer::start().await;
    let mut api = Api::connect(&server).await;
    let text =
        std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/pick_cube_maniskill.toml")).unwrap();
    let spec: gleaner_recording::TaskSpec = toml::from_str(&text).unwrap();
    let task = spec.name.clone();
    let spec = gleaner_client::spec::to_proto(&spec);
    api.tasks.create_task(CreateTaskRequest { spec: Some(spec) }).await.unwrap();

    let mut mappings = std::collections::BTreeSet::new();
    for dialect in ["foxglove", "ros2"] {
        for recording in some(dialect, &[("expert", 2), ("release", 1), ("goal", 1)]) {
            let episode = lab::push(&mut api, &task, &recording).await.unwrap();
            assert!(episode.steps > 10, "{} has {} steps", recording.name, episode.steps);
            mappings.insert(episode.mapping);
        }
    }
    assert_eq!(mappings.len(), 2, "{mappings:?}");

    let encoder = api.succeed(&task, lab::pretrain(2)).await.result_id;
    let run = api.succeed(&task, lab::score(&encoder)).await.result_id;
    let request = GetHistogramRequest { score_run_id: run.clone(), bins: 0, betas: vec![0.5] };
    assert!(api.scores.get_histogram(request).await.unwrap().into_inner().segments > 100);
}
