//! Deadlines, roll-backs, and sessions on a server that stops.

use gleaner_proto::v1::{session_request::Message as Say, session_response::Message as Hear, *};
use tonic::Code;

use crate::{
    api::Api,
    lab,
    live::{Robot, observe, start_sim},
    server::TestServer,
    shared::{NAME, shared},
};

#[tokio::test]
async fn a_late_answer_is_a_miss_and_never_an_action() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let mut robot = Robot::dial(&mut api).await;
    robot.say(Say::Open(SessionOpen { deployment: NAME.into(), deadline_us: 1, ..SessionOpen::default() })).await;
    let Hear::Opened(_) = robot.hear().await.unwrap() else { panic!("not opened") };
    let observation = observe(&start_sim());
    robot.say(Say::Observation(observation.clone())).await;
    let Hear::Missed(missed) = robot.hear().await.unwrap() else { panic!("not missed") };
    assert_eq!((missed.observation_stamp_ns, missed.dropped), (observation.stamp_ns, 0));
    assert!(missed.timings.unwrap().total_us >= 1);

    let minute = Observation { deadline_us: 60_000_000, ..observation.clone() };
    let timings = robot.act(minute).await.unwrap().timings.unwrap();
    assert_eq!(timings.batch_size, 1);
    assert!(timings.decode_us + timings.queue_us + timings.batch_us + timings.model_us <= timings.total_us);
    robot.say(Say::Close(SessionClose::default())).await;
    let Hear::Closed(closed) = robot.hear().await.unwrap() else { panic!("not closed") };
    assert_eq!((closed.observations, closed.dropped, closed.missed), (1, 0, 1));

    let hurried = Observation { deadline_us: 1, ..observation };
    let request = ActRequest { deployment: NAME.into(), observations: vec![hurried] };
    assert_eq!(api.policies.act(request).await.unwrap_err().code(), Code::DeadlineExceeded);
}

#[tokio::test]
async fn stamps_do_not_go_back() {
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

/// A server of its own: its deployment rolls back, then it stops with a session open.
#[tokio::test]
async fn deployments_roll_back_and_sessions_drain() {
    let mut server = TestServer::start_with(&["--drain-seconds", "2"]).await;
    let mut api = Api::connect(&server).await;
    lab::set_up(&mut api).await;
    let encoder = api.succeed(lab::TASK, lab::pretrain(2)).await.result_id;
    let mut policies = Vec::new();
    for steps in [1, 2] {
        let order = lab::train(train_spec::Data::ExpertsOf(encoder.clone()), steps);
        policies.push(api.succeed(lab::TASK, order).await.result_id);
    }
    for policy_id in &policies {
        let request = DeployRequest { name: "arm@prod".into(), policy_id: policy_id.clone(), ..Default::default() };
        api.policies.deploy(request).await.unwrap();
    }
    let back = |name: &str| RollBackRequest { name: name.into() };
    let deployment = api.policies.roll_back(back("arm@prod")).await.unwrap().into_inner().deployment.unwrap();
    assert_eq!((&deployment.policy_id, deployment.history.len()), (&policies[0], 3));
    let error = api.policies.roll_back(back("arm@prod")).await.unwrap_err();
    assert_eq!(error.code(), Code::FailedPrecondition, "{error}");
    assert_eq!(api.policies.roll_back(back("leg@prod")).await.unwrap_err().code(), Code::NotFound);

    let mut robot = Robot::open(&mut api, "arm@prod").await.unwrap();
    let drained = async {
        let Hear::Draining(draining) = robot.hear().await.unwrap() else { panic!("not draining") };
        assert!(draining.close_time.is_some());
        robot.act(observe(&start_sim())).await.unwrap();
        assert_eq!(robot.hear().await.unwrap_err().code(), Code::Unavailable, "the session is ended, not cut off");
    };
    let (stopped, ()) = tokio::join!(server.stop(), drained);
    assert!(stopped, "a stop with a session open is a success");
}
