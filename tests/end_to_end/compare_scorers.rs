//! `gleaner compare-scorers` against a real server: on a snapshot with marks and policies, and on an encoder.

use std::path::Path;

use gleaner_proto::v1::*;
use serde_json::Value;

use crate::support::{
    api::Api,
    command::{Output, gleaner, json},
    lab,
    server::TestServer,
};

/// Sizes that take a second each.
const SMALLEST: [&str; 10] = [
    "--set",
    "pretrain.steps=3",
    "--set",
    "pretrain.batch=8",
    "--set",
    "segment_length=2",
    "--set",
    "train.steps=2",
    "--set",
    "train.batch=8",
];

/// A server with experts, failures and mild failures, some of which succeed; the id of their snapshot.
async fn recorded(folder: &Path) -> (TestServer, String) {
    let server = TestServer::start().await;
    let (url, folder) = (server.url(), folder.to_str().unwrap());
    let agents = ["--agent", "expert:4", "--agent", "freeze:1:3", "--agent", "mild=noise:0.3:3"];
    json(url, &[&["record", "--out", folder, "--image", "16"], &agents[..]].concat()).await;
    json(url, &["task", "create", "--sim", "pick_cube", "--image", "16"]).await;
    let pushed = gleaner(url, &["push", "--labels", &format!("{folder}/labels.csv")]).await;
    assert!(pushed.success, "{}", pushed.text());
    let cohorts = ["--expert-cohort", "expert", "--imperfect-cohort", "freeze", "--imperfect-cohort", "mild"];
    let snapshot = json(url, &[&["snapshot", "create"], &cohorts[..]].concat()).await;
    (server, snapshot["snapshot"]["id"].as_str().unwrap().to_owned())
}

async fn compare(server: &TestServer, words: &[&str]) -> Output {
    gleaner(server.url(), &[&["--json", "compare-scorers"], words].concat()).await
}

async fn jobs(server: &TestServer) -> Vec<Job> {
    let mut api = Api::connect(server).await;
    api.jobs.list_jobs(ListJobsRequest::default()).await.unwrap().into_inner().jobs
}

fn document(output: &Output) -> Value {
    assert!(output.success, "{}", output.text());
    serde_json::from_str(&output.out).unwrap()
}

#[tokio::test]
async fn scorers_are_compared_with_marks_and_policies_and_a_second_run_adds_no_job() {
    let dir = tempfile::tempdir().unwrap();
    let recordings = dir.path().join("recordings");
    let (server, snapshot) = recorded(&recordings).await;
    let (marks, out) = (recordings.join("marks.csv"), dir.path().join("out"));
    let (marks, folder) = (marks.to_str().unwrap(), out.to_str().unwrap());
    let scorers = ["--scorer", "ssdf", "--scorer", "raw local_scale=false", "--scorer", "deminf"];
    let options = ["--seeds", "2", "--train", "bc", "--evaluations", "2", "--length-bins", "2", "--marks", marks];
    let words = [&[snapshot.as_str(), "--out", folder], &scorers[..], &options, &SMALLEST].concat();
    let found = document(&compare(&server, &words).await);

    let made = jobs(&server).await;
    let count = |kind| made.iter().filter(|job| job.kind() == kind).count();
    let counts = [JobKind::Pretrain, JobKind::Score, JobKind::Train, JobKind::Evaluate].map(count);
    assert_eq!(counts, [2, 6, 6, 6], "an encoder for each seed, shared by the scorers");
    assert_eq!(
        (&found["marked"], &found["imperfect"], &found["simulation"]),
        (&6.into(), &6.into(), &"pick_cube".into())
    );
    for scorer in found["scorers"].as_array().unwrap() {
        assert_eq!((&scorer["runs"], &scorer["success"]["pooled"]["episodes"]), (&2.into(), &4.into()), "{scorer}");
        let numbers =
            [&scorer["stability"], &scorer["length"][0]["spearman"], &scorer["separated"]["marked"][0]["mean"]];
        assert!(numbers.iter().all(|number| number.as_f64().is_some_and(|number| number.abs() <= 1.0)), "{scorer}");
        assert!(scorer["separated"]["marked"][0]["pairs"].as_u64().is_some_and(|pairs| pairs > 0), "{scorer}");
    }
    assert_eq!(found["agreement"].as_array().unwrap().len(), 3);
    // Raw observations do not depend on the encoder.
    assert_eq!(found["scorers"][1]["stability"], 1.0);

    let report = std::fs::read_to_string(out.join("report.md")).unwrap();
    assert!(report.contains("## AUROC of marked segments") && report.contains("| mild "), "{report}");
    assert!(std::fs::read_to_string(out.join("scorers.csv")).unwrap().contains("ssdf / deminf,agreement,,"));
    assert_eq!(document(&compare(&server, &words).await), found);
    assert_eq!(jobs(&server).await.len(), made.len(), "finished jobs are not repeated");

    // Scores made elsewhere are a further row, with policies of their own.
    let mut api = Api::connect(&server).await;
    let messages = lab::import(&mut api, &snapshot, "my_scores").await;
    let imported = api.scores.import_scores(tokio_stream::iter(messages)).await.unwrap().into_inner();
    let run = imported.score_run.unwrap().id;
    let found = document(&compare(&server, &[&words[..], &["--run", &run]].concat()).await);
    let scorers = found["scorers"].as_array().unwrap();
    assert_eq!((scorers.len(), found["agreement"].as_array().unwrap().len()), (4, 6));
    let own = &scorers[3];
    assert_eq!(own["label"], format!("my_scores {run}"));
    assert_eq!((&own["runs"], &own["success"]["pooled"]["episodes"]), (&1.into(), &4.into()), "{own}");
    assert!(own["settings"].as_object().is_none_or(serde_json::Map::is_empty), "{own}");
    let added = jobs(&server).await.len() - made.len();
    assert_eq!(added, 4, "a training and an evaluation for each of two seeds");
    assert!(found["command"].as_str().unwrap().contains(&format!("--run {run}")), "{found}");
    let other =
        json(server.url(), &["snapshot", "create", "--expert-cohort", "expert", "--imperfect-cohort", "mild"]).await;
    let other = other["snapshot"]["id"].as_str().unwrap();
    let refused = compare(&server, &[other, "--run", &run]).await;
    assert!(!refused.success && refused.errors.contains("give a run of that snapshot"), "{}", refused.text());
}

#[tokio::test]
async fn an_encoder_is_compared_by_every_scorer_and_gaps_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let (server, snapshot) = recorded(&dir.path().join("recordings")).await;
    let (url, settings) = (server.url(), ["--steps", "3", "--batch", "8", "--segment-length", "2", "--wait"]);
    let encoder = json(url, &[&["pretrain", "--snapshot", &snapshot], &settings[..]].concat()).await;
    let encoder = encoder["result_id"].as_str().unwrap();
    let offered = json(url, &["kinds"]).await["scorers"].as_array().unwrap().len();

    // The number of gradient steps is of no interest here.
    let output = gleaner(url, &["compare-scorers", encoder, "--seeds", "2", "--set", "progress_steps=4"]).await;
    assert!(output.success, "{}", output.text());
    for gap in ["no marks", "one run", "not trained", "No episode has a mark."] {
        assert!(output.out.contains(gap), "{gap}: {}", output.out);
    }
    // One run of each scorer, and a second one of those with random numbers.
    let scored = jobs(&server).await.iter().filter(|job| job.kind() == JobKind::Score).count();
    assert!(scored > offered && scored < 2 * offered, "{scored} of {offered}");

    for (words, part) in [
        (&["ep_1"][..], "give the ids of encoders (enc_…)"),
        (&[encoder, encoder], "is duplicated"),
        (&[encoder, "--scorer", "cupid"], "supported: raw, ssdf"),
        (&[encoder, "--set", "pretrain.steps=5"], "has no effect"),
        (&[encoder, "--top-fraction", "2"], "--top-fraction: 2 is outside"),
        (&[encoder, "--train", "bc", "--simulation", "stack_cube"], "--simulation: "),
        (&[encoder, "--marks", "absent.csv"], "absent.csv"),
    ] {
        let output = compare(&server, words).await;
        assert!(!output.success && output.errors.contains(part), "{words:?}: {}", output.text());
    }
}
