//! Scores made elsewhere: imported by the command and by any client, and used like those of a score job.

use std::fmt::Write as _;

use futures::{StreamExt as _, stream};
use gleaner_proto::v1::{import_scores_request::Message, *};
use serde_json::json;
use tonic::{Code, Status};

use crate::support::{
    api::Api,
    command::{self, expect_sound},
    errors::{absent_id, expect_error},
    lab,
    shared::{Shared, shared},
    wait::within,
};

/// The imperfect episodes of the shared snapshot.
fn imperfect(shared: &Shared) -> impl Iterator<Item = &Episode> {
    shared.episodes.iter().filter(|episode| episode.outcome() == Outcome::Failure)
}

/// A q for each step: it falls from 1 in steps that are exact in binary.
fn falling(episode: &Episode) -> Vec<f64> {
    (0..episode.steps).map(|step| 1.0 - f64::from(u32::try_from(step).unwrap()) / 1024.0).collect()
}

fn scored(episode: &Episode) -> ImportedEpisode {
    ImportedEpisode { episode_id: episode.id.clone(), q: falling(episode) }
}

fn open(shared: &Shared, source: &str) -> Message {
    let (snapshot_id, source) = (shared.snapshot.clone(), source.to_owned());
    Message::Open(ImportScoresOpen { snapshot_id, source, encoder_id: String::new() })
}

/// Each episode in a message of its own.
fn whole(shared: &Shared, source: &str) -> Vec<Message> {
    let episodes = imperfect(shared).map(|episode| batch(vec![scored(episode)]));
    std::iter::once(open(shared, source)).chain(episodes).collect()
}

fn batch(episodes: Vec<ImportedEpisode>) -> Message {
    Message::Batch(ImportedEpisodes { episodes })
}

async fn import(api: &mut Api, messages: Vec<Message>) -> Result<ScoreRun, Status> {
    let requests: Vec<_> = messages.into_iter().map(|message| ImportScoresRequest { message: Some(message) }).collect();
    Ok(api.scores.import_scores(tokio_stream::iter(requests)).await?.into_inner().score_run.unwrap())
}

async fn dataset(api: &mut Api, run: &str, selection: Selection) -> Dataset {
    let request = CreateDatasetRequest { score_run_id: run.to_owned(), selection: Some(selection) };
    api.datasets.create_dataset(request).await.unwrap().into_inner().dataset.unwrap()
}

fn policy(dataset: &str, policy: &str) -> job_spec::Spec {
    let data = train_spec::Data::DatasetId(dataset.to_owned());
    lab::with(lab::train(data, 2), json!({ "policy": policy }))
}

/// The command reads episodes by file name, digest and id; the run is listed, counted, streamed, exported and trained on,
/// and the folder is sound.
#[tokio::test]
async fn an_imported_run_is_used_like_any_other() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let mut csv = String::from("episode,step,q\n");
    for (place, episode) in imperfect(&shared).enumerate() {
        let name = [&episode.file_name, &episode.blake3, &episode.id][place % 3];
        falling(episode).iter().enumerate().for_each(|(step, q)| writeln!(csv, "{name},{step},{q}").unwrap());
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scores.csv");
    std::fs::write(&path, csv).unwrap();
    let line = ["import-scores", &shared.snapshot, path.to_str().unwrap(), "--source", "an oracle"];
    let run = command::json(shared.server.url(), &line).await;
    let segments: u64 = imperfect(&shared).map(|episode| episode.steps).sum();
    assert_eq!((&run["imperfect_segments"], &run["encoder_id"]), (&segments.into(), &"".into()));
    assert_eq!(run["settings"], json!({ "scorer": "imported", "source": "an oracle" }));
    let run = run["id"].as_str().unwrap();
    assert_eq!(command::json(shared.server.url(), &line).await["id"], run, "the same scores are the same run");
    let listed = api
        .scores
        .list_score_runs(ListScoreRunsRequest { task: lab::TASK.into(), ..Default::default() })
        .await
        .unwrap();
    assert!(listed.into_inner().score_runs.iter().any(|one| one.id == run));

    let one = imperfect(&shared).next().unwrap();
    let scores = api.episode_scores(run, &one.id).await;
    assert_eq!(scores.w, falling(one));
    assert!(scores.match_episode.is_empty() && scores.role() == Role::Imperfect);
    let request = GetHistogramRequest { score_run_id: run.to_owned(), bins: 10, betas: vec![0.99] };
    let histogram = api.scores.get_histogram(request).await.unwrap().into_inner();
    let above = |q: &f64| *q > 0.99;
    let kept: usize = imperfect(&shared).map(|episode| falling(episode).iter().filter(|q| above(q)).count()).sum();
    assert_eq!((histogram.segments, histogram.kept[0].segments), (segments, kept as u64));
    assert_eq!(histogram.expert_auroc, None);

    let dataset = dataset(&mut api, run, lab::above(0.99)).await;
    assert_eq!(dataset.kept_segments, Some(kept as u64));
    let request =
        StreamSegmentsRequest { dataset_id: dataset.id.clone(), kept_only: true, ..StreamSegmentsRequest::default() };
    let mut stream = api.datasets.stream_segments(request).await.unwrap().into_inner();
    let mut streamed = 0;
    while let Some(response) = stream.message().await.unwrap() {
        let segment = response.segment.unwrap();
        assert_eq!(segment.first_step, segment.end_step, "without an encoder a segment is one step");
        streamed += 1;
    }
    assert_eq!(streamed, kept);
    api.succeed(lab::TASK, policy(&dataset.id, "bc")).await;
    let export = ExportSpec { dataset_id: dataset.id.clone(), ..ExportSpec::default() };
    api.succeed(lab::TASK, job_spec::Spec::Export(export)).await;
    let refused = api.submit(lab::TASK, policy(&dataset.id, "finetune")).await.unwrap_err();
    expect_error(&refused, Code::FailedPrecondition, &["spec.train.dataset_id", "imported without an encoder"]);
    let extend = ScoreSpec { extends: run.to_owned(), ..ScoreSpec::default() };
    let refused = api.submit(lab::TASK, job_spec::Spec::Score(extend)).await.unwrap_err();
    expect_error(&refused, Code::FailedPrecondition, &[run, "was imported"]);
    let live = ScoreRecordingOpen { score_run_id: run.to_owned(), ..ScoreRecordingOpen::default() };
    let live = ScoreRecordingRequest { message: Some(score_recording_request::Message::Open(live)) };
    let refused = api.scores.score_recording(tokio_stream::iter([live])).await.unwrap_err();
    expect_error(&refused, Code::FailedPrecondition, &[run, "cannot score live"]);
    expect_sound(shared.server.data_dir()).await;
}

#[tokio::test]
async fn a_policy_starts_from_the_encoder_of_an_import() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let mut messages = whole(&shared, "with an encoder");
    if let Message::Open(open) = &mut messages[0] {
        open.encoder_id = shared.encoder.clone();
    }
    let run = import(&mut api, messages).await.unwrap();
    assert_eq!(run.encoder_id, shared.encoder);
    let dataset = dataset(&mut api, &run.id, lab::top(0.2)).await;
    let job = api.succeed(lab::TASK, policy(&dataset.id, "finetune")).await;
    let policies = api.policies().await;
    assert_eq!(policies.iter().find(|policy| policy.id == job.result_id).unwrap().encoder_id, shared.encoder);
}

#[tokio::test]
async fn faulty_imports_are_rejected_and_store_nothing() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let one = imperfect(&shared).next().unwrap();
    let name = one.id.as_str();
    let faulty = |change: fn(&mut ImportedEpisode)| {
        let mut messages = whole(&shared, "faulty");
        if let Message::Batch(batch) = &mut messages[1] {
            change(&mut batch.episodes[0]);
        }
        messages
    };
    let missing = || [vec![open(&shared, "faulty")], whole(&shared, "faulty").split_off(2)].concat();
    let with = |message: Message| [whole(&shared, "faulty"), vec![message]].concat();
    let expert = shared.episodes.iter().find(|episode| episode.outcome() == Outcome::Success).unwrap();
    let opened = |change: fn(&mut ImportScoresOpen)| {
        let mut open = ImportScoresOpen { snapshot_id: shared.snapshot.clone(), ..ImportScoresOpen::default() };
        change(&mut open);
        vec![Message::Open(open)]
    };
    let cases: [(Vec<Message>, Code, &[&str]); 19] = [
        (vec![], Code::InvalidArgument, &["open: "]),
        (vec![batch(vec![scored(one)])], Code::InvalidArgument, &["open: "]),
        (with(open(&shared, "again")), Code::InvalidArgument, &["open: ", "already"]),
        (opened(|open| open.snapshot_id = "x".into()), Code::InvalidArgument, &["open.snapshot_id: "]),
        (opened(|open| open.snapshot_id = absent_id("snap")), Code::NotFound, &["no snapshot"]),
        (opened(|open| open.source = "x".repeat(256)), Code::InvalidArgument, &["open.source: "]),
        (opened(|open| open.encoder_id = "x".into()), Code::InvalidArgument, &["open.encoder_id: "]),
        (opened(|open| open.encoder_id = absent_id("enc")), Code::NotFound, &["no encoder"]),
        (opened(|_| {}), Code::InvalidArgument, &["batch.episodes: ", "is missing"]),
        (with(batch(vec![])), Code::InvalidArgument, &["batch.episodes: "]),
        (faulty(|one| one.episode_id = "x".into()), Code::InvalidArgument, &["batch.episodes.episode_id: "]),
        (faulty(|one| one.episode_id = absent_id("ep")), Code::InvalidArgument, &[&absent_id("ep"), "is not in"]),
        (missing(), Code::InvalidArgument, &[name, "is missing"]),
        (faulty(|one| one.q.truncate(3)), Code::InvalidArgument, &[name, "3 values"]),
        (with(batch(vec![scored(one)])), Code::InvalidArgument, &[name, "is duplicated"]),
        (with(batch(vec![scored(expert)])), Code::InvalidArgument, &["is missing", "or none"]),
        (faulty(|one| one.q[2] = 1.5), Code::InvalidArgument, &["batch.episodes.q: ", name, "at step 2"]),
        (faulty(|one| one.q[4] = f64::NAN), Code::InvalidArgument, &["batch.episodes.q: ", name, "at step 4"]),
        (faulty(|one| one.q[0] = f64::NEG_INFINITY), Code::InvalidArgument, &[name, "at step 0"]),
    ];
    for (messages, code, words) in cases {
        expect_error(&import(&mut api, messages).await.unwrap_err(), code, words);
    }
    let listed = api
        .scores
        .list_score_runs(ListScoreRunsRequest { task: lab::TASK.into(), ..Default::default() })
        .await
        .unwrap();
    let from = |run: &ScoreRun| lab::given(&run.settings)["source"].clone();
    assert!(listed.into_inner().score_runs.iter().all(|run| from(run) != "faulty"));
}

/// The limit of a message is that of every rpc. An import may have many, but no episode more than once, so that the memory
/// of the server is bounded by the snapshot.
#[tokio::test]
async fn the_memory_of_an_import_is_limited() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let one = imperfect(&shared).next().unwrap();
    let huge = ImportedEpisode { episode_id: one.id.clone(), q: vec![0.5; (33 << 20) / size_of::<f64>()] };
    let refused = import(&mut api, vec![open(&shared, "huge"), batch(vec![huge])]).await.unwrap_err();
    expect_error(&refused, Code::ResourceExhausted, &["the limit is: 33554432 bytes"]);

    let endless = stream::repeat(batch(vec![scored(one)]));
    let requests = stream::iter([open(&shared, "endless")]).chain(endless);
    let requests = requests.map(|message| ImportScoresRequest { message: Some(message) });
    let refused = within("the server rejects the stream", api.scores.import_scores(requests)).await.unwrap_err();
    expect_error(&refused, Code::InvalidArgument, &[&one.id, "is duplicated"]);
}
