//! Scores of what is not stored: as the run scored its own, live or in one piece, and nothing is left of it.

use std::{io::Cursor, path::Path};

use gleaner_client::{Client, ClientError, StepScorer};
use gleaner_proto::v1::{
    score_recording_request::Message as Part, score_steps_request::Message as Say,
    score_steps_response::Message as Hear, *,
};
use gleaner_recording::{EpisodeWriter, read_episode};
use gleaner_sim::Task as SimTask;
use tonic::{Code, Status};

use crate::{
    api::Api,
    bad_input::refused,
    command,
    lab::{self, RECORDINGS},
    server::TestServer,
    shared::shared,
};

/// The first failure: imperfect in the shared run.
const FAILURE: usize = 6;
const NO_RUN: &str = "run_01ARZ3NDEKTSV4RRFFQ69G5FAV";

fn task_spec() -> gleaner_recording::TaskSpec {
    gleaner_sim::task_spec(SimTask::PickCube, &lab::sim_config())
}

fn recording_file(folder: &Path, bytes: &[u8]) -> std::path::PathBuf {
    let path = folder.join("attempt.mcap");
    std::fs::write(&path, bytes).unwrap();
    path
}

/// The steps of a recording, as a robot would have sent them.
fn steps(folder: &Path, bytes: &[u8]) -> Vec<(Observation, Vec<f32>)> {
    let spec = task_spec();
    let episode = read_episode(&recording_file(folder, bytes), &spec).unwrap().episode;
    let (all, size) = (episode.frames(), gleaner_recording::frame_bytes_per_step(&spec));
    let (proprioception, action) = (episode.proprioception(), episode.action());
    let (m, a) = (spec.proprioception_size(), spec.action_size());
    let step = |t: usize| {
        let frames = all.as_ref()[t * size..][..size].to_vec();
        let stamp = i64::try_from(t).unwrap() * 50_000_000;
        let seen = gleaner_client::observation(&spec, stamp, frames, proprioception[t * m..][..m].to_vec()).unwrap();
        (seen, action[t * a..][..a].to_vec())
    };
    (0..episode.steps()).map(step).collect()
}

async fn raw_run(api: &mut Api, encoder: &str) -> String {
    let raw = lab::with(lab::score(encoder), serde_json::json!({"scorer": "raw"}));
    api.succeed(lab::TASK, raw).await.result_id
}

#[tokio::test]
async fn a_recording_scores_bit_for_bit_as_the_stored_one() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let client = Client::connect(shared.server.url(), None).await.unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = recording_file(folder.path(), &RECORDINGS[FAILURE].bytes);
    let reply = client.score_recording(&shared.run, &path, |_| {}).await.unwrap();

    let episode = &shared.episodes[FAILURE];
    let stored = api.episode_scores(&shared.run, &episode.id).await;
    let unnamed = EpisodeScores { episode_id: String::new(), role: Role::Unspecified.into(), ..stored };
    assert_eq!(reply.scores.unwrap(), unnamed);
    let report = reply.report.unwrap();
    assert_eq!((report.steps, &report.mapping), (episode.steps, &episode.mapping));
}

#[tokio::test]
async fn an_episode_scores_step_by_step_as_the_stored_one() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let client = Client::connect(shared.server.url(), None).await.unwrap();
    let folder = tempfile::tempdir().unwrap();
    let stored = api.episode_scores(&shared.run, &shared.episodes[FAILURE].id).await;
    let mut live = StepScorer::open(&client, &shared.run).await.unwrap();
    let steps = steps(folder.path(), &RECORDINGS[FAILURE].bytes);
    assert_eq!(steps.len(), stored.w.len());
    let mut worst = 0.0_f64;
    for (t, (seen, action)) in steps.into_iter().enumerate() {
        let stamp = seen.stamp_ns;
        let score = live.score(seen, action).await.unwrap();
        assert_eq!(score.observation_stamp_ns, stamp);
        worst = worst.max((score.w - stored.w[t]).abs() / stored.w[t].abs().max(1.0));
        assert!((score.q - f64::from(stored.q[t])).abs() < 1e-4, "step {t}: {score:?}, {}", stored.q[t]);
        let expert = &stored.expert_ids[stored.match_episode[t] as usize];
        assert_eq!((&score.match_episode_id, score.match_step), (expert, stored.match_step[t]), "step {t}");
    }
    eprintln!("live w differs from the stored one by at most {worst:.2e}");
    assert!(worst < 1e-5, "{worst}");
    assert!(!live.draining());
}

#[tokio::test]
async fn a_deployment_names_a_run_and_rolling_back_brings_the_one_before() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let request = |run: &str| DeployRequest {
        name: "scored@test".into(),
        policy_id: shared.policy.clone(),
        score_run_id: run.to_owned(),
    };
    api.policies.deploy(request("")).await.unwrap();
    let deployed = api.policies.deploy(request(&shared.run)).await.unwrap().into_inner().deployment.unwrap();
    assert_eq!((&deployed.score_run_id, deployed.history.len()), (&shared.run, 2));

    let raw = raw_run(&mut api, &shared.encoder).await;
    for (run, code, words) in [
        (NO_RUN, Code::NotFound, ["no score run", NO_RUN]),
        ("run", Code::InvalidArgument, ["score_run_id", "run_"]),
        (&raw, Code::FailedPrecondition, ["raw", "such as ssdf"]),
    ] {
        refused(&api.policies.deploy(request(run)).await.unwrap_err(), code, &words);
    }
    let back = RollBackRequest { name: "scored@test".into() };
    let back = api.policies.roll_back(back).await.unwrap().into_inner().deployment.unwrap();
    assert_eq!((back.score_run_id.as_str(), back.history.len()), ("", 3), "what was refused left nothing");
    let listed = api.policies.list_deployments(ListDeploymentsRequest::default()).await.unwrap().into_inner();
    let listed = listed.deployments.into_iter().find(|one| one.name == "scored@test").unwrap();
    assert_eq!(listed, back);
    assert_eq!(listed.history.iter().map(|one| one.score_run_id.as_str()).collect::<Vec<_>>(), ["", &shared.run, ""]);
}

async fn send(api: &mut Api, parts: Vec<Part>) -> Result<ScoreRecordingResponse, Status> {
    let requests: Vec<_> = parts.into_iter().map(|part| ScoreRecordingRequest { message: Some(part) }).collect();
    Ok(api.scores.score_recording(tokio_stream::iter(requests)).await?.into_inner())
}

fn open(run: &str, size_bytes: u64) -> Part {
    Part::Open(ScoreRecordingOpen { score_run_id: run.into(), file_name: "attempt.mcap".into(), size_bytes })
}

#[tokio::test]
async fn recordings_that_cannot_be_scored() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let run = shared.run.as_str();
    let raw = raw_run(&mut api, &shared.encoder).await;
    let whole = || Part::Data(RECORDINGS[FAILURE].bytes.clone());
    let empty = EpisodeWriter::create(Cursor::new(Vec::new()), &task_spec()).unwrap().finish().unwrap().into_inner();
    let cases: [(Vec<Part>, Code, &[&str]); 11] = [
        (vec![], Code::InvalidArgument, &["open: "]),
        (vec![whole()], Code::InvalidArgument, &["open: "]),
        (vec![open("x", 0)], Code::InvalidArgument, &["open.score_run_id: "]),
        (vec![open(NO_RUN, 0)], Code::NotFound, &[NO_RUN]),
        (vec![open(&raw, 0), whole()], Code::FailedPrecondition, &["raw", "ssdf"]),
        (vec![open(run, 0), open(run, 0)], Code::InvalidArgument, &["open: ", "already"]),
        (vec![open(run, 0)], Code::InvalidArgument, &["attempt.mcap", "empty"]),
        (vec![open(run, 7), whole()], Code::InvalidArgument, &["open.size_bytes: ", "more"]),
        (vec![open(run, 1 << 60), whole()], Code::ResourceExhausted, &["--max-upload-bytes"]),
        (vec![open(run, 0), Part::Data("ply\nformat ascii".repeat(50).into())], Code::InvalidArgument, &["MCAP"]),
        (vec![open(run, 0), Part::Data(empty.into())], Code::InvalidArgument, &["recording: "]),
    ];
    for (parts, code, words) in cases {
        refused(&send(&mut api, parts).await.unwrap_err(), code, words);
    }
    let nowhere = ScoreRecordingRequest { message: None };
    let said = api.scores.score_recording(tokio_stream::iter([nowhere])).await.unwrap_err();
    refused(&said, Code::InvalidArgument, &["open: "]);
}

async fn hear(api: &mut Api, says: Vec<Say>) -> Result<Vec<LiveScore>, Status> {
    let requests: Vec<_> = says.into_iter().map(|say| ScoreStepsRequest { message: Some(say) }).collect();
    let mut answers = api.scores.score_steps(tokio_stream::iter(requests)).await?.into_inner();
    let mut scores = Vec::new();
    while let Some(answer) = answers.message().await? {
        match answer.message.unwrap() {
            Hear::Score(score) => scores.push(score),
            Hear::Draining(draining) => panic!("{draining:?}"),
        }
    }
    Ok(scores)
}

#[tokio::test]
async fn steps_that_cannot_be_scored() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let folder = tempfile::tempdir().unwrap();
    let good = steps(folder.path(), &RECORDINGS[FAILURE].bytes).swap_remove(0);
    let open = |run: &str| Say::Open(ScoreStepsOpen { score_run_id: run.into() });
    let step = |spoil: fn(&mut ScoreStep)| {
        let (seen, action) = good.clone();
        let mut step = ScoreStep { observation: Some(seen), action };
        spoil(&mut step);
        Say::Step(step)
    };
    fn seen(step: &mut ScoreStep) -> &mut Observation {
        step.observation.as_mut().unwrap()
    }
    let right = || step(|_| {});
    assert_eq!(hear(&mut api, vec![open(&shared.run), right(), right()]).await.unwrap().len(), 2);

    for (says, code, words) in [
        (vec![], Code::InvalidArgument, "open: "),
        (vec![right()], Code::InvalidArgument, "open: "),
        (vec![open(NO_RUN), right()], Code::NotFound, NO_RUN),
        (vec![open(&shared.run), open(&shared.run)], Code::InvalidArgument, "open: "),
        (vec![open(&shared.run)], Code::InvalidArgument, "step: at least one is required"),
    ] {
        refused(&hear(&mut api, says).await.unwrap_err(), code, &[words]);
    }
    type Spoil = fn(&mut ScoreStep);
    let spoiled: [(Spoil, &str); 9] = [
        (|step| step.observation = None, "step.observation: "),
        (|step| step.action.truncate(1), "step.action: "),
        (|step| step.action[0] = f32::NAN, "step.action[0]: "),
        (|step| seen(step).proprioception.truncate(1), "step.observation.proprioception: "),
        (|step| seen(step).cameras.truncate(1), "step.observation.cameras: "),
        (|step| seen(step).executed_action = vec![0.0], "step.observation.executed_action: "),
        (|step| seen(step).deadline_us = 5, "step.observation.deadline_us: "),
        (|step| seen(step).stamp_ns = -1, "step.observation.stamp_ns: "),
        (
            |step| {
                let data = vec![0xFF, 0xD8, 0xFF, 0xE0, 1, 2, 3].into();
                seen(step).cameras[0].color = Some(Image { format: ImageFormat::Jpeg.into(), data });
            },
            "step.observation.cameras[0].color: ",
        ),
    ];
    for (spoil, field) in spoiled {
        let says = vec![open(&shared.run), right(), step(spoil)];
        refused(&hear(&mut api, says).await.unwrap_err(), Code::InvalidArgument, &[field]);
    }
}

/// Every file in the data directory.
fn kept(server: &TestServer) -> Vec<std::path::PathBuf> {
    let mut waiting = vec![server.data_dir().to_owned()];
    let mut files = Vec::new();
    while let Some(path) = waiting.pop() {
        match path.is_dir() {
            true => waiting.extend(path.read_dir().unwrap().map(|entry| entry.unwrap().path())),
            false => files.push(path),
        }
    }
    // The description of a result is written in the background.
    files.retain(|path| !path.to_string_lossy().contains(".enc_"));
    files.sort();
    files
}

/// On a server of its own, so that nobody else adds anything. The command line, too.
#[tokio::test]
async fn nothing_is_kept_of_what_is_scored() {
    let server = TestServer::start().await;
    let mut api = Api::connect(&server).await;
    lab::set_up(&mut api).await;
    let encoder = api.succeed(lab::TASK, lab::pretrain(1)).await.result_id;
    let run = api.succeed(lab::TASK, lab::score(&encoder)).await.result_id;
    let client = Client::connect(server.url(), None).await.unwrap();
    let fresh = lab::record("wrong_goal:1.0".parse().unwrap(), Outcome::Failure, 77);
    let folder = tempfile::tempdir().unwrap();
    let path = recording_file(folder.path(), &fresh.bytes);
    let listing = ListEpisodesRequest { task: lab::TASK.into(), ..ListEpisodesRequest::default() };
    let (files, episodes) = (kept(&server), api.episodes.list_episodes(listing.clone()).await.unwrap().into_inner());

    let reply = client.score_recording(&run, &path, |_| {}).await.unwrap();
    let scores = reply.scores.unwrap();
    let said = command::json(server.url(), &["score-recording", &run, path.to_str().unwrap()]).await;
    assert_eq!(said["scores"]["w"].as_array().unwrap().len(), scores.w.len());
    assert_eq!(said["scores"]["w"][0].as_f64(), Some(scores.w[0]));
    let mut live = StepScorer::open(&client, &run).await.unwrap();
    for (seen, action) in steps(folder.path(), &fresh.bytes) {
        live.score(seen, action).await.unwrap();
    }
    drop(live);
    let broken = recording_file(folder.path(), b"ply");
    let error = client.score_recording(&run, &broken, |_| {}).await.unwrap_err();
    assert!(matches!(error, ClientError::Rejected(_)), "{error}");

    assert_eq!(kept(&server), files);
    assert_eq!(api.episodes.list_episodes(listing).await.unwrap().into_inner(), episodes);
    assert!(!scores.q.is_empty() && scores.q.iter().all(|q| (0.0..=1.0).contains(q)));
}
