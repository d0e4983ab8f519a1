//! Scores of recordings and steps that are not stored: equal to those of stored episodes, and without a stored row.

mod invalid;

use std::path::{Path, PathBuf};

use gleaner_client::{Client, ClientError, StepScorer};
use gleaner_proto::v1::*;
use gleaner_recording::read_episode;
use serde_json::json;
use tonic::Code;

use crate::support::{
    api::Api,
    command,
    errors::{absent_id, expect_error},
    files,
    lab::{self, RECORDINGS},
    server::TestServer,
    shared::shared,
};

/// The first success: an expert of the shared run.
const EXPERT: usize = 0;
/// The first failure: imperfect in the shared run.
const FAILURE: usize = 6;

fn recording_file(folder: &Path, bytes: &[u8]) -> PathBuf {
    let path = folder.join("attempt.mcap");
    std::fs::write(&path, bytes).unwrap();
    path
}

/// The steps of a recording as the observations and actions of a robot.
fn steps(folder: &Path, bytes: &[u8]) -> Vec<(Observation, Vec<f32>)> {
    let spec = lab::spec();
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

async fn random_run(api: &mut Api, encoder: &str) -> String {
    let random = lab::with(lab::score(encoder), serde_json::json!({"scorer": "random"}));
    api.succeed(lab::TASK, random).await.result_id
}

/// Scores the recording of a stored episode; returns the episode, the response, and the scores that the run stored.
async fn scored_again(place: usize) -> (Episode, ScoreRecordingResponse, EpisodeScores) {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let client = Client::connect(shared.server.url(), None).await.unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = recording_file(folder.path(), &RECORDINGS[place].bytes);
    let reply = client.score_recording(&shared.run, &path, |_| {}).await.unwrap();
    let episode = shared.episodes[place].clone();
    let stored = api.episode_scores(&shared.run, &episode.id).await;
    (episode, reply, stored)
}

#[tokio::test]
async fn unstored_recording_scores_like_the_stored_one() {
    let (episode, reply, stored) = scored_again(FAILURE).await;
    let unnamed = EpisodeScores { episode_id: String::new(), role: Role::Unspecified.into(), ..stored };
    assert_eq!(reply.scores.unwrap(), unnamed);
    let report = reply.report.unwrap();
    assert_eq!((report.steps, &report.mapping), (episode.steps, &episode.mapping));
}

#[tokio::test]
async fn recording_of_an_expert_is_compared_with_the_other_experts() {
    let (episode, reply, stored) = scored_again(EXPERT).await;
    let scores = reply.scores.unwrap();
    assert_eq!((&scores.episode_id, scores.role()), (&episode.id, Role::Expert));
    assert_eq!((&scores.w, &scores.match_episode), (&stored.w, &stored.match_episode));
    assert!(scores.w.iter().all(|w| *w < 0.0), "{:?}", scores.w);
}

#[tokio::test]
async fn steps_score_like_the_stored_episode() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let client = Client::connect(shared.server.url(), None).await.unwrap();
    let folder = tempfile::tempdir().unwrap();
    // With a lookahead, a lead-in or earliness the q of the stored episode knows later steps or its length.
    let own = json!({"lookahead": 0.0, "lead_in": 0.0, "earliness": 0.0});
    let alone = lab::with(lab::score(&shared.encoder), own);
    let run = api.succeed(lab::TASK, alone).await.result_id;
    let stored = api.episode_scores(&run, &shared.episodes[FAILURE].id).await;
    let mut live = StepScorer::open(&client, &run).await.unwrap();
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
async fn rollback_restores_the_previous_score_run() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let request = |run: &str| DeployRequest {
        name: "scored@test".into(),
        policy_id: shared.policy.clone(),
        score_run_id: run.to_owned(),
        ..DeployRequest::default()
    };
    api.policies.deploy(request("")).await.unwrap();
    let deployed = api.policies.deploy(request(&shared.run)).await.unwrap().into_inner().deployment.unwrap();
    assert_eq!((&deployed.score_run_id, deployed.history.len()), (&shared.run, 2));

    let random = random_run(&mut api, &shared.encoder).await;
    let absent = absent_id("run");
    for (run, code, words) in [
        (absent.as_str(), Code::NotFound, ["no score run", absent.as_str()]),
        ("run", Code::InvalidArgument, ["score_run_id", "run_"]),
        (&random, Code::FailedPrecondition, ["random", "raw or ssdf"]),
    ] {
        expect_error(&api.policies.deploy(request(run)).await.unwrap_err(), code, &words);
    }
    let back = RollBackRequest { name: "scored@test".into() };
    let back = api.policies.roll_back(back).await.unwrap().into_inner().deployment.unwrap();
    assert_eq!((back.score_run_id.as_str(), back.history.len()), ("", 3), "a rejected deployment changed the history");
    let listed = api.policies.list_deployments(ListDeploymentsRequest::default()).await.unwrap().into_inner();
    let listed = listed.deployments.into_iter().find(|one| one.name == "scored@test").unwrap();
    assert_eq!(listed, back);
    assert_eq!(listed.history.iter().map(|one| one.score_run_id.as_str()).collect::<Vec<_>>(), ["", &shared.run, ""]);
}
/// Every file in the data folder, except descriptions and their drafts, which the server writes in the background.
fn stored_files(server: &TestServer) -> Vec<PathBuf> {
    let passes = |name: &str| !files::is_draft(name) && !name.ends_with(".json");
    files::tree(server.data_dir(), passes).into_iter().filter(|path| !path.is_dir()).collect()
}

/// On a server of its own, because the list of its files must not change.
#[tokio::test]
async fn scoring_stores_nothing() {
    let (server, mut api, _) = lab::with_episodes(&[]).await;
    let encoder = api.succeed(lab::TASK, lab::pretrain(1)).await.result_id;
    let run = api.succeed(lab::TASK, lab::score(&encoder)).await.result_id;
    let client = Client::connect(server.url(), None).await.unwrap();
    let fresh = lab::record("wrong_goal:1.0".parse().unwrap(), Outcome::Failure, 77);
    let folder = tempfile::tempdir().unwrap();
    let path = recording_file(folder.path(), &fresh.bytes);
    let listing = ListEpisodesRequest { task: lab::TASK.into(), ..ListEpisodesRequest::default() };
    let (files, episodes) =
        (stored_files(&server), api.episodes.list_episodes(listing.clone()).await.unwrap().into_inner());

    let reply = client.score_recording(&run, &path, |_| {}).await.unwrap();
    let scores = reply.scores.unwrap();
    let json = command::json(server.url(), &["score-recording", &run, path.to_str().unwrap()]).await;
    assert_eq!(json["scores"]["w"].as_array().unwrap().len(), scores.w.len());
    assert_eq!(json["scores"]["w"][0].as_f64(), Some(scores.w[0]));
    let mut live = StepScorer::open(&client, &run).await.unwrap();
    for (seen, action) in steps(folder.path(), &fresh.bytes) {
        live.score(seen, action).await.unwrap();
    }
    drop(live);
    let broken = recording_file(folder.path(), b"ply");
    let error = client.score_recording(&run, &broken, |_| {}).await.unwrap_err();
    assert!(matches!(error, ClientError::Rejected(_)), "{error}");

    assert_eq!(stored_files(&server), files);
    assert_eq!(api.episodes.list_episodes(listing).await.unwrap().into_inner(), episodes);
    assert!(!scores.q.is_empty() && scores.q.iter().all(|q| (0.0..=1.0).contains(q)));
}
