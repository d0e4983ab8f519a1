//! Recorded sessions become episodes with the data that was sent, in whatever way they end.

use gleaner_client::{Client, DrivePlan, Recorded, Session};
use gleaner_proto::v1::{session_request::Message as SessionMessage, session_response::Message as SessionReply, *};
use gleaner_recording::encode_jpeg;
use gleaner_sim::{Sim, Task as SimTask};
use tonic::Code;

use crate::support::{
    api::Api,
    lab,
    robot::{Robot, close, observe, start_sim, values},
    rollouts::{NAME, Sent, endless, episodes, messages, read, recorded, scored_deployment, step, tear},
    shared::shared,
    wait::{until, within},
};

#[tokio::test]
async fn recorded_session_reads_back_with_label_and_scores() {
    let shared = scored_deployment().await;
    let mut api = Api::connect(&shared.server).await;
    let client = Client::connect(shared.server.url(), None).await.unwrap();
    let mut session = Session::open_with(&client, recorded("read back")).await.unwrap();
    let (mut sim, mut sent) = (endless(), Sent::default());
    let scored = async {
        loop {
            let reply = step(&mut session, &mut sim, &mut sent).await;
            if let Some(score) = reply.score.filter(|_| sent.stamps.len() >= 6) {
                return score;
            }
        }
    };
    let score = within("a reply has a score", scored).await;
    assert!(score.w <= 0.0 && (0.0..=1.0).contains(&score.q) && shared.experts.contains(&score.match_episode_id));
    assert!(sent.stamps.contains(&score.observation_stamp_ns));
    let closed = session.close_as(Outcome::Failure).await.unwrap();
    let request = CreateSnapshotRequest { task: lab::TASK.into(), rule: None };
    let snapshot = api.snapshots.create_snapshot(request).await.unwrap().into_inner().snapshot.unwrap();
    let request = GetSnapshotRequest { snapshot_id: snapshot.id, omit_episodes: false };
    let counted = api.snapshots.get_snapshot(request).await.unwrap().into_inner().episodes;
    let counted = counted.iter().find(|episode| episode.episode_id == closed.episode_id).unwrap();
    assert_eq!(counted.role(), Role::Imperfect);

    let episode = episodes(&mut api, "read back", 1).await.remove(0);
    assert_eq!((&episode.id, episode.outcome()), (&closed.episode_id, Outcome::Failure));
    assert_eq!((episode.steps, episode.warnings), (u64::try_from(sent.stamps.len()).unwrap(), 0));
    let reading = read(&mut api, &episode.id).await;
    sent.expect_equal(&reading);
    assert_eq!(messages(&reading, "/policy/action"), episode.steps);
    // On a busy machine some segments have no score.
    assert!((1..=episode.steps).contains(&messages(&reading, "/policy/score")));
}

/// JPEG images are stored byte for byte, and the executed action replaces the policy's action.
#[tokio::test]
async fn rollout_of_a_disconnected_robot_is_stored() {
    let shared = scored_deployment().await;
    let mut api = Api::connect(&shared.server).await;
    let spec = lab::spec();
    let (height, width) = (spec.cameras[0].height, spec.cameras[0].width);
    let mut robot = Robot::connect(&mut api).await;
    robot.send(SessionMessage::Open(recorded("vanished"))).await;
    let SessionReply::Opened(opened) = robot.receive().await.unwrap() else { panic!("not opened") };
    let mut sim = start_sim();
    for step in 0..4_u8 {
        let mut observation = observe(&sim);
        if step > 0 {
            observation.executed_action = vec![f32::from(step); 7];
        }
        let color = observation.cameras[0].color.as_mut().unwrap();
        let jpeg = encode_jpeg(&color.data, height, width, 80).unwrap();
        (color.format, color.data) = (ImageFormat::Jpeg.into(), jpeg.into());
        robot.act(observation).await.unwrap();
        sim.step(&[0.0; 7]);
    }
    drop(robot);
    let episode = episodes(&mut api, "vanished", 1).await.remove(0);
    assert_eq!((episode.outcome(), episode.steps), (Outcome::Unknown, 4));
    assert_eq!(episode.file_name, format!("{}.mcap", opened.session_id));
    let actions = read(&mut api, &episode.id).await.episode.action();
    assert_eq!(actions[..21], [1.0; 7].into_iter().chain([2.0; 7]).chain([3.0; 7]).collect::<Vec<_>>());
}

#[tokio::test]
async fn concurrent_sessions_are_recorded_separately() {
    let shared = scored_deployment().await;
    let mut api = Api::connect(&shared.server).await;
    let client = Client::connect(shared.server.url(), None).await.unwrap();
    let mut runs = Vec::new();
    for seed in [3, 4] {
        let sim = Sim::new(SimTask::PickCube, lab::sim_config(), seed);
        runs.push((Session::open_with(&client, recorded("")).await.unwrap(), sim, Sent::default()));
    }
    for _ in 0..4 {
        for (session, sim, sent) in &mut runs {
            step(session, sim, sent).await;
        }
    }
    for (session, _, sent) in runs {
        let id = session.close().await.unwrap().episode_id;
        sent.expect_equal(&read(&mut api, &id).await);
        let listed = episodes(&mut api, NAME, 1).await;
        let episode = listed.iter().find(|episode| episode.id == id).unwrap();
        assert_eq!(episode.outcome(), Outcome::Unknown);
    }
    // A session without recording, and one that is too short for an episode.
    for open in [SessionOpen { deployment: NAME.into(), ..Default::default() }, recorded("too short")] {
        let mut session = Session::open_with(&client, open).await.unwrap();
        session.act(observe(&start_sim())).await.unwrap();
        assert_eq!(session.close_as(Outcome::Success).await.unwrap().episode_id, "");
    }
}

#[tokio::test]
async fn invalid_recorded_sessions_are_rejected() {
    let shared = scored_deployment().await;
    let mut api = Api::connect(&shared.server).await;
    let mut robot = Robot::connect(&mut api).await;
    robot.send(SessionMessage::Open(SessionOpen { record: false, ..recorded("no record") })).await;
    assert!(robot.receive().await.unwrap_err().message().starts_with("open.cohort: "));
    let mut same = Vec::new();
    for (first, second) in [(5, 5), (-5, 5)] {
        let mut robot = Robot::connect(&mut api).await;
        robot.send(SessionMessage::Open(recorded("bad stamps"))).await;
        robot.receive().await.unwrap();
        let stamped = |stamp_ns| Observation { stamp_ns, ..observe(&start_sim()) };
        let error = match robot.act(stamped(first)).await {
            Err(error) => error,
            Ok(_) => robot.act(stamped(second)).await.unwrap_err(),
        };
        assert_eq!(error.code(), Code::InvalidArgument);
        same.push(error.message().starts_with("observation.stamp_ns: "));
    }
    assert_eq!(same, [true, true]);
}

/// Two recorded attempts of at most `max_steps` steps.
fn two_attempts(deployment: &str, max_steps: u32, cohort: &str) -> DrivePlan {
    DrivePlan {
        deployment: deployment.into(),
        task: SimTask::PickCube,
        config: gleaner_sim::SimConfig { max_steps, ..lab::sim_config() },
        episodes: 2,
        seed: 50,
        sessions: 2,
        real_time: None,
        record: Some(Recorded { cohort: cohort.into() }),
    }
}

/// The result of the simulator labels the episodes, in lock step and in real time.
#[tokio::test]
async fn drive_records_its_episodes() {
    let shared = scored_deployment().await;
    let mut api = Api::connect(&shared.server).await;
    let client = Client::connect(shared.server.url(), None).await.unwrap();
    let plan = two_attempts(NAME, 8, "driven");
    let driven = client.drive(&plan, |_| {}).await.unwrap();
    assert_eq!(driven.recorded(), 2);
    let listed = episodes(&mut api, "driven", 2).await;
    for run in &driven.episodes {
        let episode = listed.iter().find(|episode| run.episode_ids == [episode.id.clone()]).unwrap();
        let outcome = if run.success { Outcome::Success } else { Outcome::Failure };
        assert_eq!((episode.outcome(), episode.steps), (outcome, u64::from(run.steps)));
    }

    // Slower than the simulator's own rate, for machines that are busy with other tests.
    let mut control = gleaner_client::robot::ControlPlan::new(NAME, 2.0).unwrap();
    (control.record, control.cohort) = (true, "in real time".into());
    let mut robot = gleaner_client::robot::SimRobot::new(SimTask::PickCube, plan.config, 50);
    let report = client.control(&mut robot, &control, std::future::pending()).await.unwrap();
    let episode = episodes(&mut api, "in real time", 1).await.remove(0);
    assert_eq!((report.episode_ids.as_slice(), episode.outcome()), ([episode.id].as_slice(), Outcome::Failure));
}

/// A policy that draws its actions draws those of an attempt as a session with the attempt's seed does.
#[tokio::test]
async fn drive_draws_each_attempt_under_its_own_seed() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let data = train_spec::Data::ExpertsIn(shared.snapshot.clone());
    let flow = lab::with(lab::train(data, 1), serde_json::json!({"policy": "flow", "execute_length": 1}));
    let policy = api.succeed(lab::TASK, flow).await.result_id;
    let deployment = "drawn@test";
    api.deploy(deployment, &policy).await;
    let plan = two_attempts(deployment, 3, "drawn");
    let client = Client::connect(shared.server.url(), None).await.unwrap();
    let driven = client.drive(&plan, |_| {}).await.unwrap();
    episodes(&mut api, "drawn", 2).await;
    for run in &driven.episodes {
        let reading = read(&mut api, &run.episode_ids[0]).await;
        let mut under = [Vec::new(), Vec::new()];
        for (seed, actions) in [run.seed, 0].into_iter().zip(&mut under) {
            let open = SessionOpen { deployment: deployment.into(), seed, ..SessionOpen::default() };
            let mut robot = Robot::open_with(&mut api, open).await.unwrap();
            let mut sim = Sim::new(plan.task, plan.config, run.seed);
            while !sim.done() {
                let action = values(&robot.act(observe(&sim)).await.unwrap().actions[..1]);
                sim.step(action.as_slice().try_into().unwrap());
                actions.extend(action);
            }
        }
        let driven = reading.episode.action();
        assert!(close(&driven, &under[0]), "{driven:?} {:?}", under[0]);
        assert!(!close(&driven, &under[1]), "{driven:?} under another seed");
    }
}

/// After a kill or a stop during a session, the recorded steps are an episode once the server has started again.
#[tokio::test]
async fn rollouts_survive_a_kill_and_a_stop() {
    let (mut server, mut api, _) = lab::with_episodes(&["--drain-seconds", "0"]).await;
    let (_, policy_id) = api.train_policy(1).await;
    api.deploy(NAME, &policy_id).await;

    let client = Client::connect(server.url(), None).await.unwrap();
    let mut session = Session::open_with(&client, recorded("killed")).await.unwrap();
    let rollouts = server.data_dir().join("rollouts");
    let file = rollouts.join(format!("{}.mcap", session.opened().session_id));
    let (mut sim, mut sent) = (endless(), Sent::default());
    // The file is written from time to time: first its header, and on a busy machine a step or less at once. Two steps
    // must be whole in what is not torn.
    let (mut size, mut grown) = (0, 0);
    let running = async {
        while grown < 8 {
            step(&mut session, &mut sim, &mut sent).await;
            let now = std::fs::metadata(&file).map_or(0, |file| file.len());
            grown += u8::from(now > size);
            size = now;
        }
    };
    within("steps are written to the disk", running).await;
    server.kill().await;
    tear(&file);
    std::fs::write(rollouts.join("ses_unusable.mcap"), b"a file of another program").unwrap();
    server.start_again().await;

    let mut api = Api::connect(&server).await;
    let episode = episodes(&mut api, "killed", 1).await.remove(0);
    assert_eq!(episode.outcome(), Outcome::Unknown);
    let reading = read(&mut api, &episode.id).await;
    let steps = reading.episode.steps();
    assert!((2..=sent.stamps.len()).contains(&steps), "{steps} of {}", sent.stamps.len());
    assert_eq!(reading.episode.stamps(), &sent.stamps[..steps]);
    assert!(reading.episode.frames().as_ref() == &sent.frames[..sent.frames.len() / sent.stamps.len() * steps]);
    // The episode is listed as soon as it is stored, before the file of the rollout is removed.
    until("the rollout's file is removed", async || (!file.exists()).then_some(())).await;

    let client = Client::connect(server.url(), None).await.unwrap();
    let mut session = Session::open_with(&client, recorded("stopped")).await.unwrap();
    let (mut sim, mut sent) = (start_sim(), Sent::default());
    for _ in 0..3 {
        step(&mut session, &mut sim, &mut sent).await;
    }
    assert!(server.stop().await);
    server.start_again().await;
    let mut api = Api::connect(&server).await;
    let episode = episodes(&mut api, "stopped", 1).await.remove(0);
    assert_eq!((episode.outcome(), episode.steps), (Outcome::Unknown, 3));
    assert!(rollouts.join("unusable").join("ses_unusable.mcap").exists(), "the unusable file is not set aside");
}
