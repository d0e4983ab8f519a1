//! Deadlines, rollbacks, and sessions on a server that stops.

use gleaner_proto::v1::{session_request::Message as SessionMessage, session_response::Message as SessionReply, *};
use tonic::Code;

use crate::support::{
    api::Api,
    lab,
    robot::{Robot, observe, start_sim},
    server::TestServer,
    shared::{NAME, shared},
    wait::within,
};

#[tokio::test]
async fn late_action_is_reported_as_missed() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let mut robot = Robot::connect(&mut api).await;
    robot
        .send(SessionMessage::Open(SessionOpen { deployment: NAME.into(), deadline_us: 1, ..SessionOpen::default() }))
        .await;
    let SessionReply::Opened(_) = robot.receive().await.unwrap() else { panic!("not opened") };
    let observation = observe(&start_sim());
    robot.send(SessionMessage::Observation(observation.clone())).await;
    let SessionReply::Missed(missed) = robot.receive().await.unwrap() else { panic!("not missed") };
    assert_eq!((missed.observation_stamp_ns, missed.dropped), (observation.stamp_ns, 0));
    assert!(missed.timings.unwrap().total_us >= 1);

    let relaxed = Observation { deadline_us: 60_000_000, ..observation.clone() };
    let timings = robot.act(relaxed).await.unwrap().timings.unwrap();
    // Sessions of other tests use the same policy.
    assert!(timings.batch_size >= 1);
    assert!(timings.decode_us + timings.queue_us + timings.batch_us + timings.model_us <= timings.total_us);
    let closed = robot.close().await;
    assert_eq!((closed.observations, closed.dropped, closed.missed), (1, 0, 1));

    let late = Observation { deadline_us: 1, ..observation };
    let request = ActRequest { deployment: NAME.into(), observations: vec![late] };
    assert_eq!(api.policies.act(request).await.unwrap_err().code(), Code::DeadlineExceeded);
}

#[tokio::test]
async fn observation_with_an_earlier_stamp_is_rejected() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let mut robot = Robot::open(&mut api, NAME).await.unwrap();
    let observation = observe(&start_sim());
    robot.act(observation.clone()).await.unwrap();
    let earlier = Observation { stamp_ns: observation.stamp_ns - 1, ..observation };
    let error = robot.act(earlier).await.unwrap_err();
    assert_eq!(error.code(), Code::InvalidArgument);
    assert!(error.message().starts_with("observation.stamp_ns: "), "{error}");
}

/// On servers of its own, which stop with an open session: one while the robot acts and closes, one until the drain ends.
#[tokio::test]
async fn deployments_roll_back_and_sessions_drain() {
    let (mut server, mut api, _) = lab::with_episodes(&["--drain-seconds", "3600"]).await;
    let encoder = api.succeed(lab::TASK, lab::pretrain(2)).await.result_id;
    let mut policies = Vec::new();
    for steps in [1, 2] {
        let order = lab::train(train_spec::Data::ExpertsOf(encoder.clone()), steps);
        policies.push(api.succeed(lab::TASK, order).await.result_id);
    }
    for policy in &policies {
        api.deploy("arm@prod", policy).await;
    }
    let back = |name: &str| RollBackRequest { name: name.into() };
    let deployment = api.policies.roll_back(back("arm@prod")).await.unwrap().into_inner().deployment.unwrap();
    assert_eq!((&deployment.policy_id, deployment.history.len()), (&policies[0], 3));
    let error = api.policies.roll_back(back("arm@prod")).await.unwrap_err();
    assert_eq!(error.code(), Code::FailedPrecondition, "{error}");
    assert_eq!(api.policies.roll_back(back("leg@prod")).await.unwrap_err().code(), Code::NotFound);

    let mut robot = Robot::open(&mut api, "arm@prod").await.unwrap();
    let drained = async {
        let SessionReply::Draining(draining) = robot.receive().await.unwrap() else { panic!("not draining") };
        assert!(draining.close_time.is_some());
        robot.act(observe(&start_sim())).await.unwrap();
        assert_eq!(robot.close().await.observations, 1);
        robot.expect_end().await;
    };
    let (stopped, ()) = within("the server stops", async { tokio::join!(server.stop(), drained) }).await;
    assert!(stopped, "a stop with a session open is a success");

    let mut server = TestServer::start_over(server.data_dir(), &["--drain-seconds", "1"]).await;
    let mut api = Api::connect(&server).await;
    let mut robot = Robot::open(&mut api, "arm@prod").await.unwrap();
    let drained = async {
        let SessionReply::Draining(_) = robot.receive().await.unwrap() else { panic!("not draining") };
        assert_eq!(robot.receive().await.unwrap_err().code(), Code::Unavailable, "the session ends with a status");
    };
    let (stopped, ()) = tokio::join!(server.stop(), drained);
    assert!(stopped, "a stop that ends a session is a success");
}
