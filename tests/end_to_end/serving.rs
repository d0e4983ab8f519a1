//! Serving: the shared policy by sessions, by `Act` and in real time, and invalid requests.

use gleaner_proto::v1::{session_request::Message as SessionMessage, *};
use gleaner_sim::Task as SimTask;
use tonic::Code;

use crate::support::{
    api::Api,
    files, lab,
    robot::{Robot, close, observe, start_sim, values},
    shared::{NAME, shared},
};

/// A session and Act see the same history, so they give the same actions.
#[tokio::test]
async fn session_and_act_agree() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let mut robot = Robot::open(&mut api, NAME).await.unwrap();
    let mut sim = start_sim();
    let mut window: Vec<Observation> = Vec::new();
    let mut last: Vec<f32> = vec![];
    for _ in 0..6 {
        let mut observation = observe(&sim);
        observation.executed_action.clone_from(&last);
        window.push(observation.clone());
        let action = robot.act(observation.clone()).await.unwrap();
        assert_eq!((action.observation_stamp_ns, action.dropped), (observation.stamp_ns, 0));

        let request = ActRequest { deployment: NAME.into(), observations: window.clone() };
        let act = api.policies.act(request).await.unwrap().into_inner();
        assert!(close(&values(&act.actions), &values(&action.actions)), "{:?} and {:?}", act.actions, action.actions);
        last.clone_from(&action.actions[0].values);
        sim.step(last.as_slice().try_into().unwrap());
    }
    let closed = robot.close().await;
    assert_eq!((closed.observations, closed.dropped), (6, 0));
    robot.expect_end().await;
}

/// A regressed gripper of 0.4, or a move of 1.3, is nothing that the robot does or that the policy saw in training.
#[tokio::test]
async fn every_action_of_a_session_is_one_that_the_robot_executes() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let mut robot = Robot::open(&mut api, NAME).await.unwrap();
    let bounds = |range: &ActionRange| (range.minimum, range.maximum, range.binary);
    let ranges: Vec<_> = robot.opened.action_ranges.iter().map(bounds).collect();
    let (within, binary) = ((Some(-1.0), Some(1.0), false), (Some(-1.0), Some(1.0), true));
    assert_eq!(ranges, [within, within, within, within, within, within, binary]);
    let mut sim = start_sim();
    for _ in 0..6 {
        let answer = robot.act(observe(&sim)).await.unwrap();
        for action in values(&answer.actions).chunks(7) {
            assert!(action.iter().all(|value| value.abs() <= 1.0) && action[6].abs() == 1.0, "{action:?}");
        }
        sim.step(answer.actions[0].values.as_slice().try_into().unwrap());
    }
}

#[tokio::test]
async fn deployment_may_hide_the_history_from_its_policy() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let request = DeployRequest {
        name: "hidden@test".into(),
        policy_id: shared.policy.clone(),
        hide_history: true,
        ..DeployRequest::default()
    };
    let deployed = api.policies.deploy(request).await.unwrap().into_inner().deployment.unwrap();
    assert!(deployed.hide_history && deployed.history[0].hide_history);
    let mut sim = start_sim();
    let mut first = observe(&sim);
    sim.step(&[0.5, -0.5, 0.2, 0.0, 0.0, 0.0, 1.0]);
    let mut now = observe(&sim);
    now.executed_action = vec![0.5, -0.5, 0.2, 0.0, 0.0, 0.0, 1.0];
    let mut act = async |deployment: &str, first: &Observation| {
        let request = ActRequest { deployment: deployment.into(), observations: vec![first.clone(), now.clone()] };
        values(&api.policies.act(request).await.unwrap().into_inner().actions)
    };
    let (hidden, shown) = (act("hidden@test", &first).await, act(NAME, &first).await);
    first.proprioception.iter_mut().for_each(|value| *value += 0.1);
    assert_eq!(act("hidden@test", &first).await, hidden);
    assert_ne!(act(NAME, &first).await, shown);
    assert_ne!(hidden, shown);
}

/// Two concurrent sessions give the same actions as one: neither uses the other's history.
#[tokio::test]
async fn sessions_are_isolated() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let observation = observe(&start_sim());
    let mut alone = Robot::open(&mut api, NAME).await.unwrap();
    let first = alone.act(observation.clone()).await.unwrap().actions;
    let (mut left, mut right) =
        (Robot::open(&mut api, NAME).await.unwrap(), Robot::open(&mut api, NAME).await.unwrap());
    let mut shifted = observation.clone();
    shifted.proprioception.iter_mut().for_each(|value| *value += 0.5);
    right.act(shifted).await.unwrap();
    let broken = Observation { cameras: vec![], ..observation.clone() };
    assert_eq!(right.act(broken).await.unwrap_err().code(), Code::InvalidArgument);
    let actions = left.act(observation).await.unwrap().actions;
    assert!(close(&values(&actions), &values(&first)), "{actions:?} and {first:?}");
}

#[tokio::test]
async fn invalid_observations_are_rejected() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let good = observe(&start_sim());
    let mut missing = good.clone();
    missing.cameras.pop();
    let mut unknown = good.clone();
    unknown.cameras[0].camera = "ceiling".into();
    let mut small = good.clone();
    small.cameras[0].color = Some(Image { format: ImageFormat::Raw.into(), data: vec![0; 30].into() });
    let mut broken = good.clone();
    broken.cameras[1].color =
        Some(Image { format: ImageFormat::Jpeg.into(), data: b"\xff\xd8\xff broken".to_vec().into() });
    let mut short = good.clone();
    short.proprioception.pop();
    let mut not_a_number = good.clone();
    not_a_number.proprioception[2] = f32::NAN;
    let mut wrong_action = good.clone();
    wrong_action.executed_action = vec![0.0; 3];
    let spec = lab::spec();
    let hand = spec.cameras[1].name.as_str();
    for (observation, words) in [
        (missing, vec![hand]),
        (unknown, vec!["ceiling"]),
        (small, vec!["cameras[0].color"]),
        (broken, vec!["cameras[1].color"]),
        (short, vec!["proprioception"]),
        (not_a_number, vec!["proprioception[2]"]),
        (wrong_action, vec!["executed_action"]),
    ] {
        let request = ActRequest { deployment: NAME.into(), observations: vec![observation.clone()] };
        let by_act = api.policies.act(request).await.unwrap_err();
        let mut robot = Robot::open(&mut api, NAME).await.unwrap();
        let by_session = robot.act(observation).await.unwrap_err();
        for status in [by_act, by_session] {
            assert_eq!(status.code(), Code::InvalidArgument, "{status}");
            for word in &words {
                assert!(status.message().contains(word), "{word:?} is not in {:?}", status.message());
            }
        }
    }
}

#[tokio::test]
async fn invalid_session_openings_are_rejected() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let unknown = Robot::open(&mut api, "absent@prod").await.err().unwrap();
    assert_eq!(unknown.code(), Code::NotFound, "{unknown}");
    let mut early = Robot::connect(&mut api).await;
    let error = early.act(observe(&start_sim())).await.unwrap_err();
    assert_eq!(error.code(), Code::InvalidArgument, "{error}");
    let mut twice = Robot::open(&mut api, NAME).await.unwrap();
    twice.send(SessionMessage::Open(SessionOpen { deployment: NAME.into(), ..SessionOpen::default() })).await;
    assert_eq!(twice.receive().await.unwrap_err().code(), Code::InvalidArgument);
    let empty = ActRequest { deployment: NAME.into(), observations: vec![] };
    assert_eq!(api.policies.act(empty).await.unwrap_err().code(), Code::InvalidArgument);
}

#[tokio::test]
async fn invalid_deployments_are_rejected() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let policies = api.policies().await;
    let policy = policies[0].id.clone();
    let slash = DeployRequest { name: "../prod".into(), policy_id: policy.clone(), ..Default::default() };
    assert_eq!(api.policies.deploy(slash).await.unwrap_err().code(), Code::InvalidArgument);
    let unknown = DeployRequest {
        name: "x@prod".into(),
        policy_id: "pol_01ARZ3NDEKTSV4RRFFQ69G5FAV".into(),
        ..Default::default()
    };
    assert_eq!(api.policies.deploy(unknown).await.unwrap_err().code(), Code::NotFound);
    let again = DeployRequest { name: "x@prod".into(), policy_id: policy.clone(), ..Default::default() };
    let deployment = api.policies.deploy(again).await.unwrap().into_inner().deployment.unwrap();
    assert_eq!(deployment.policy_id, policy);
}

/// The error names both versions of the format.
#[tokio::test]
async fn checkpoint_of_another_version_is_rejected() {
    let (mut server, mut api, _) = lab::with_episodes(&[]).await;
    let (encoder, policy) = api.train_policy(2).await;
    assert!(server.stop().await);
    make_checkpoints_newer(server.data_dir());
    server.start_again().await;
    let mut api = Api::connect(&server).await;
    let error = api
        .policies
        .deploy(DeployRequest { name: "old@prod".into(), policy_id: policy, ..Default::default() })
        .await
        .unwrap_err();
    assert_eq!(error.code(), Code::FailedPrecondition, "{error}");
    assert!(error.message().contains("version") && error.message().contains('9'), "{error}");
    let job = api.submit(lab::TASK, lab::score(&encoder)).await.unwrap();
    let job = api.watch(&job.id).await;
    assert_eq!(job.state(), JobState::Failed);
    assert!(job.error.contains("version"), "{}", job.error);
    assert_eq!(job.attempt, 1, "the job is not retried");
}

/// Changes the format version of every checkpoint to 9, and its digest accordingly in files and rows.
fn make_checkpoints_newer(data_dir: &std::path::Path) {
    let database = data_dir.join("gleaner.db");
    let mut rows = std::fs::read(&database).unwrap();
    let mut changed = 0;
    for blob in files::files(&data_dir.join("blobs")) {
        let mut bytes = std::fs::read(&blob).unwrap();
        let mark = b"\\\"format_version\\\":";
        let Some(at) = bytes.windows(mark.len()).position(|part| part == mark) else { continue };
        let old = blake3::hash(&bytes).to_hex();
        bytes[at + mark.len()] = b'9';
        let new = blake3::hash(&bytes).to_hex();
        let place = files::blob(data_dir, &new);
        std::fs::create_dir_all(place.parent().unwrap()).unwrap();
        std::fs::write(place, bytes).unwrap();
        while let Some(row) = rows.windows(64).position(|part| part == old.as_bytes()) {
            rows[row..row + 64].copy_from_slice(new.as_bytes());
            changed += 1;
        }
    }
    assert!(changed >= 2, "an encoder and a policy");
    std::fs::write(database, rows).unwrap();
}

/// The simulator as a robot in real time: the loop keeps its rate, executes the actions of the policy, and ends with the
/// episode.
#[tokio::test]
async fn control_loop_keeps_its_rate() {
    let shared = shared().await;
    let client = gleaner_client::Client::connect(shared.server.url(), None).await.unwrap();
    let config = gleaner_sim::SimConfig { max_steps: 5, ..lab::sim_config() };
    let mut robot = gleaner_client::robot::SimRobot::new(SimTask::PickCube, config, 99);
    // Slower than the simulator's own rate, for machines that are busy with other tests.
    let plan = gleaner_client::robot::ControlPlan::new(NAME, 2.0).unwrap();
    let begun = std::time::Instant::now();
    let report = client.control(&mut robot, &plan, std::future::pending()).await.unwrap();
    assert!(begun.elapsed() >= std::time::Duration::from_secs(2), "five ticks are four periods at least");
    assert!(robot.sim().done() && report.acted > 0, "{report:?}");
    assert_eq!(report.acted + report.held, 5, "{report:?}");
    assert_eq!((report.ticks, report.policy_id.as_str()), (5 + report.rested, shared.policy.as_str()));

    let unknown = gleaner_client::robot::ControlPlan::new("absent@test", 2.0).unwrap();
    let error = client.control(&mut robot, &unknown, std::future::pending()).await.unwrap_err();
    assert!(error.to_string().contains("absent@test"), "{error}");
}
