//! Real recordings of a simulator in both dialects through every stage; skipped without a folder of them.

use std::path::PathBuf;

use gleaner_proto::v1::*;
use gleaner_recording::TaskSpec;

use crate::support::{
    api::Api,
    files::root,
    lab::{self, Recording},
    server::TestServer,
    skipped::skipped,
};

/// The folder of recordings: `GLEANER_EPISODES`, or `shared/episodes` beside the checkout.
fn folder() -> Option<PathBuf> {
    let beside = root().join("../shared/episodes");
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
async fn recordings_of_both_dialects_fit_one_task() {
    if folder().is_none() {
        return skipped("no folder of real recordings (GLEANER_EPISODES)");
    }
    let server = TestServer::start().await;
    let mut api = Api::connect(&server).await;
    let text = std::fs::read_to_string(root().join("examples/pick_cube_maniskill.toml")).unwrap();
    let spec: TaskSpec = toml::from_str(&text).unwrap();
    let task = spec.name.clone();
    let created = CreateTaskRequest { spec: Some(gleaner_core::proto::task::spec_to_proto(spec.clone())) };
    api.tasks.create_task(created).await.unwrap();

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

    let policy = api.succeed(&task, lab::train(train_spec::Data::ExpertsOf(encoder), 2)).await.result_id;
    api.deploy("real@test", &policy).await;
    let request = ActRequest { deployment: "real@test".into(), observations: replayed(&spec) };
    let acted = api.policies.act(request).await.unwrap().into_inner();
    assert_eq!(acted.actions[0].values.len(), 7);
    assert!(acted.actions[0].values.iter().all(|value| value.is_finite()));
}

/// The first steps of a recording as the observations of a robot.
fn replayed(spec: &TaskSpec) -> Vec<Observation> {
    let recording = folder().unwrap().join("ros2").join(&some("ros2", &[("expert", 1)])[0].name);
    let episode = gleaner_recording::read_episode(&recording, spec).unwrap().episode;
    let (frames, proprioception, action) = (episode.frames(), episode.proprioception(), episode.action());
    let bytes = gleaner_recording::frame_bytes_per_step(spec);
    let (values, actions) = (spec.proprioception_size(), spec.action_size());
    (0..3)
        .map(|step| {
            let frame = frames.as_ref()[step * bytes..][..bytes].to_vec();
            let seen = proprioception[step * values..][..values].to_vec();
            let mut observation = gleaner_client::observation(spec, episode.stamps()[step], frame, seen).unwrap();
            if step > 0 {
                observation.executed_action = action[(step - 1) * actions..][..actions].to_vec();
            }
            observation
        })
        .collect()
}
