//! Several servers on one database in PostgreSQL and one data folder: one leads, the others are its standbys. Where
//! PostgreSQL is not installed, these tests print SKIPPED.

use gleaner_proto::v1::*;
use tonic::{Code, Status};

use crate::support::{
    api::Api,
    command,
    lab::{self, RECORDINGS},
    postgres::postgres,
    robot::{Robot, observe, start_sim},
    server::{TestServer, serve},
    wait::until,
};

const NAME: &str = "arm@prod";

/// Expects the refusal of a change by a standby, which names the leader.
fn expect_leader_named(refused: &Status, leader: &TestServer) {
    assert_eq!(refused.code(), Code::FailedPrecondition, "{refused}");
    assert!(refused.message().contains("standby") && refused.message().contains(leader.address()), "{refused}");
}

/// Sets a label as soon as a server leads.
async fn label_once_it_leads(api: &mut Api, episode: &str, outcome: Outcome) {
    until("the standby leads", async || api.label(episode, outcome).await.ok()).await;
}

/// Reads, sessions and the progress of jobs are served by the standby; changes reach it from the leader; it takes the
/// lead of a killed leader with an open session and the queue.
#[tokio::test]
async fn standby_serves_beside_its_leader_and_takes_the_lead_once_that_is_killed() {
    let Some((_database, url)) = postgres() else { return };
    let flags = ["--database", url.as_str(), "--standby"];
    let (mut leader, mut api, episodes) = lab::with_episodes(&flags).await;
    let (encoder, policy) = api.train_policy(2).await;
    api.deploy(NAME, &policy).await;

    let mut standby = TestServer::start_over(leader.data_dir(), &flags).await;
    let mut beside = Api::connect(&standby).await;
    assert_eq!(beside.episodes().await, episodes);
    assert!(beside.download(&episodes[0].id).await == RECORDINGS[0].bytes, "the recording differs");
    expect_leader_named(&beside.label(&episodes[1].id, Outcome::Unknown).await.unwrap_err(), &leader);
    expect_leader_named(&lab::push(&mut beside, lab::TASK, &RECORDINGS[0]).await.unwrap_err(), &leader);
    expect_leader_named(&beside.submit(lab::TASK, lab::pretrain(1)).await.unwrap_err(), &leader);

    let mut robot = Robot::open(&mut beside, NAME).await.unwrap();
    let mut sim = start_sim();
    let mut act = async |robot: &mut Robot| {
        let answer = robot.act(observe(&sim)).await.unwrap();
        sim.step(answer.actions[0].values.as_slice().try_into().unwrap());
    };
    act(&mut robot).await;
    let recorded = SessionOpen { deployment: NAME.into(), record: true, ..SessionOpen::default() };
    expect_leader_named(&Robot::open_with(&mut beside, recorded.clone()).await.err().unwrap(), &leader);

    // A deployment that the leader moves is moved for actions by the standby, which has the old one in memory.
    let now = observe(&start_sim());
    let request = ActRequest { deployment: NAME.into(), observations: vec![now] };
    let before = beside.policies.act(request.clone()).await.unwrap().into_inner().actions;
    let train = lab::train(train_spec::Data::ExpertsOf(encoder.clone()), 12);
    let second = api.succeed(lab::TASK, train).await.result_id;
    api.deploy(NAME, &second).await;
    let moved = api.policies.act(request.clone()).await.unwrap().into_inner().actions;
    assert_ne!(before, moved);
    until("the standby has the new policy", async || {
        (beside.policies.act(request.clone()).await.unwrap().into_inner().actions == moved).then_some(())
    })
    .await;

    let job = api.submit(lab::TASK, lab::pretrain(60)).await.unwrap();
    beside.watch_until(&job.id, |job| job.done >= 3).await;
    leader.kill().await;
    act(&mut robot).await;
    label_once_it_leads(&mut beside, &episodes[1].id, Outcome::Unknown).await;
    act(&mut robot).await;
    assert_eq!(robot.close().await.observations, 3);
    let ended = beside.watch(&job.id).await;
    assert_eq!(ended.state(), JobState::Succeeded, "{}", ended.error);
    let mut robot = Robot::open_with(&mut beside, recorded).await.unwrap();
    act(&mut robot).await;
    robot.close().await;

    // The old leader returns as the standby of the new one, and leads again once that has stopped.
    leader.start_again().await;
    let mut api = Api::connect(&leader).await;
    assert_eq!(api.episodes().await, beside.episodes().await);
    expect_leader_named(&api.label(&episodes[1].id, Outcome::Success).await.unwrap_err(), &standby);
    assert!(standby.stop().await);
    label_once_it_leads(&mut api, &episodes[1].id, Outcome::Success).await;
    assert!(leader.stop().await);
    let (sound, text) = command::server_text(&["check", "--database", &url], leader.data_dir()).await;
    assert!(sound, "{text}");
}

/// Each acknowledged label is there after its server was killed and the other one leads.
#[tokio::test]
async fn acknowledged_changes_survive_every_change_of_the_leader() {
    let Some((mut database, url)) = postgres() else { return };
    let flags = ["--database", url.as_str(), "--standby", "--workers", "0"];
    let (mut leads, mut api, episodes) = lab::with_episodes(&flags).await;
    let mut follows = TestServer::start_over(leads.data_dir(), &flags).await;
    let outcomes = [Outcome::Unknown, Outcome::Failure, Outcome::Success];
    for turn in 0..6 {
        let mut next = Api::connect(&follows).await;
        // It has started.
        assert_eq!(next.episodes().await.len(), episodes.len());
        for (episode, outcome) in episodes.iter().zip(outcomes.into_iter().cycle().skip(turn)) {
            api.label(&episode.id, outcome).await.unwrap();
        }
        let acknowledged = api.episodes().await;
        if turn % 3 == 2 {
            // Both servers lose their connections; the leader lives and keeps the lead.
            database.kill();
            database.serve();
            until("the leader writes", async || api.label(&episodes[0].id, acknowledged[0].outcome()).await.ok()).await;
            let refused = next.label(&episodes[0].id, Outcome::Unknown).await.unwrap_err();
            assert!([Code::FailedPrecondition, Code::Unavailable].contains(&refused.code()), "{refused}");
        }
        leads.kill().await;
        label_once_it_leads(&mut next, &episodes[0].id, acknowledged[0].outcome()).await;
        assert_eq!(next.episodes().await, acknowledged);
        leads.start_again().await;
        (leads, follows) = (follows, leads);
        api = next;
    }
}

#[tokio::test]
async fn second_server_without_the_flag_and_standby_of_another_folder_are_refused() {
    let Some((_database, url)) = postgres() else { return };
    let flags = ["--database", url.as_str(), "--workers", "0"];
    let (leader, mut api) = lab::with_task(&flags).await;
    let other = tempfile::tempdir().unwrap();
    let started = async |folder: &std::path::Path, flags: &[&str]| {
        let output = command::run(&mut serve(folder, flags, "127.0.0.1:0")).await;
        assert!(!output.success, "{}", output.text());
        output.text().to_owned()
    };
    let text = started(leader.data_dir(), &flags).await;
    assert!(text.contains("another gleaner-server uses the data folder") && text.contains("--standby"), "{text}");
    let text = started(other.path(), &flags).await;
    assert!(text.contains("another gleaner-server uses this database") && text.contains("--standby"), "{text}");
    let text = started(other.path(), &[&flags[..], &["--standby"]].concat()).await;
    assert!(text.contains("needs the data folder of the leader") && text.contains("--data-dir"), "{text}");
    let text = started(leader.data_dir(), &["--standby"]).await;
    assert!(text.contains("--standby") && text.contains("--database"), "{text}");
    lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap();
}
