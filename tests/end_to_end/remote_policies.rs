//! Policies that other servers run: real servers of the Open Inference Protocol, which are other gleaner servers. openpi's
//! own packages are in `client/python/tests`.

use gleaner_proto::v1::*;
use tonic::Code;

use crate::support::{
    api::Api,
    command, http, lab,
    robot::{Robot, close, observe, start_sim, values},
    server::TestServer,
    shared::{NAME, shared},
    wait::within,
};

/// The deployment of a server as a policy of another one. The shared policy has a history.
fn on(server: &TestServer) -> RemotePolicy {
    RemotePolicy {
        protocol: RemoteProtocol::OpenInference.into(),
        address: server.url().to_owned(),
        model: NAME.to_owned(),
        sequences: true,
        chunk_length: 1,
        execute_length: 1,
        source: "trained in another lab".to_owned(),
        ..RemotePolicy::default()
    }
}

async fn register(api: &mut Api, remote: RemotePolicy) -> Policy {
    let request = RegisterPolicyRequest { task: lab::TASK.into(), remote: Some(remote) };
    api.policies.register_policy(request).await.unwrap().into_inner().policy.unwrap()
}

#[tokio::test]
async fn a_policy_of_another_server_gives_the_actions_of_that_server() {
    let shared = shared().await;
    let mut there = Api::connect(&shared.server).await;
    let (_server, mut here) = lab::with_task(&["--workers", "0", "--policy-servers", shared.server.address()]).await;
    let policy = register(&mut here, on(&shared.server)).await;
    assert_eq!((policy.kind.as_str(), policy.job_id.as_str()), ("remote", ""));
    assert_eq!(register(&mut here, on(&shared.server)).await.id, policy.id, "it is registered once");
    here.deploy("elsewhere@test", &policy.id).await;

    let mut own = Robot::open(&mut there, NAME).await.unwrap();
    let mut remote = Robot::open(&mut here, "elsewhere@test").await.unwrap();
    assert_eq!((&remote.opened.policy_id, remote.opened.execute_length), (&policy.id, 1));
    let mut sim = start_sim();
    for step in 0..6 {
        let expected = own.act(observe(&sim)).await.unwrap();
        let found = remote.act(observe(&sim)).await.unwrap();
        let (expected, found) = (values(&expected.actions), values(&found.actions));
        assert!(close(&expected, &found), "step {step}: {expected:?} and {found:?}");
        sim.step(found[..7].try_into().unwrap());
    }
    assert_eq!(remote.close().await.observations, 6);

    let act = |deployment: &str| ActRequest { deployment: deployment.into(), observations: vec![observe(&sim)] };
    let expected = there.policies.act(act(NAME)).await.unwrap().into_inner().actions;
    let found = here.policies.act(act("elsewhere@test")).await.unwrap().into_inner().actions;
    assert!(close(&values(&expected), &values(&found)));
}

/// A session of a remote policy is scored and recorded as any other, and its results are on its page. The server is its own
/// remote.
#[tokio::test]
async fn sessions_of_a_remote_policy_are_scored_recorded_and_evaluated() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let policy = register(&mut api, on(&shared.server)).await;
    let deploy = DeployRequest {
        name: "loop@test".into(),
        policy_id: policy.id.clone(),
        score_run_id: shared.run.clone(),
        ..DeployRequest::default()
    };
    api.policies.deploy(deploy).await.unwrap();
    let open = SessionOpen { deployment: "loop@test".into(), record: true, ..SessionOpen::default() };
    let mut robot = Robot::open_with(&mut api, open).await.unwrap();
    let mut sim = start_sim();
    let scored = async {
        loop {
            let reply = robot.act(observe(&sim)).await.unwrap();
            sim.step(reply.actions[0].values.as_slice().try_into().unwrap());
            if let Some(score) = reply.score {
                return score;
            }
        }
    };
    let score = within("a reply has a score", scored).await;
    assert!((0.0..=1.0).contains(&score.q));
    let episode = robot.close().await.episode_id;
    let kept = api.episodes().await.into_iter().find(|kept| kept.id == episode).unwrap();
    assert_eq!(kept.cohort, "loop@test");

    // A job has no way to the other server; sessions have.
    let subject = Some(evaluate_spec::Subject::PolicyId(policy.id.clone()));
    let spec = job_spec::Spec::Evaluate(EvaluateSpec { subject, settings: None });
    let refused = api.submit(lab::TASK, spec).await.unwrap_err();
    assert_eq!(refused.code(), Code::FailedPrecondition);
    for word in [policy.id.as_str(), "gleaner drive", "gleaner.evaluate", "report-evaluation"] {
        assert!(refused.message().contains(word), "{word}: {refused}");
    }
    let hinted = command::gleaner(shared.server.url(), &["evaluations", &policy.id]).await.errors;
    assert!(hinted.contains("then gleaner drive NAME --report"), "{hinted}");
    let words = ["drive", "loop@test", "--episodes", "2", "--image", "16", "--report"];
    let driven = command::gleaner(shared.server.url(), &words).await;
    assert!(driven.success, "{}", driven.text());
    let request = ListEvaluationsRequest { policy_id: policy.id.clone(), ..Default::default() };
    let evaluations = api.policies.list_evaluations(request).await.unwrap().into_inner().evaluations;
    assert_eq!((evaluations.len(), evaluations[0].episodes, evaluations[0].simulation.as_str()), (1, 2, "pick_cube"));

    let page = http::get(&format!("{}/policies/{}", shared.server.pages(), policy.id)).await;
    for word in ["trained in another lab", shared.server.url(), "loop@test", "pick_cube", "cohort loop@test"] {
        assert!(page.contains(word), "{word} is not in {page}");
    }
    let listed = command::gleaner(shared.server.url(), &["policies", "--task", lab::TASK]).await;
    assert!(listed.out.contains(shared.server.url()) && listed.out.contains("remote"), "{}", listed.text());
}

/// The simulator never runs: the refusal names what to do.
#[tokio::test]
async fn drive_of_a_task_without_a_simulator_is_refused() {
    let shared = shared().await;
    let flags = ["--workers", "0", "--policy-servers", shared.server.address()];
    let (server, mut api) = lab::with_task(&flags).await;
    let spec = TaskSpec { name: "drawer".into(), rate_hz: 15.0, ..lab::spec_message() };
    api.tasks.create_task(CreateTaskRequest { spec: Some(spec) }).await.unwrap();
    let request = RegisterPolicyRequest { task: "drawer".into(), remote: Some(on(&shared.server)) };
    let policy = api.policies.register_policy(request).await.unwrap().into_inner().policy.unwrap();
    api.deploy("drawer@test", &policy.id).await;
    let output = command::gleaner(server.url(), &["drive", "drawer@test", "--record"]).await;
    assert!(!output.success, "{}", output.text());
    for part in ["serves the task drawer", "rate_hz", "Your own simulator", "report-evaluation", policy.id.as_str()] {
        assert!(output.errors.contains(part), "{part}: {}", output.errors);
    }
    let hinted = command::gleaner(server.url(), &["evaluations", &policy.id]).await.errors;
    for part in ["gleaner deploy NAME", "Your own simulator", "report-evaluation"] {
        assert!(hinted.contains(part), "{part}: {hinted}");
    }
}

/// The other server is killed and comes back: robots with deadlines miss them meanwhile, each with the reason.
#[tokio::test]
async fn a_robot_survives_a_restart_of_the_other_server() {
    let (mut there, mut api, _) = lab::with_episodes(&[]).await;
    let (_, policy) = api.train_policy(2).await;
    api.deploy(NAME, &policy).await;
    let (_here, mut api) = lab::with_task(&["--workers", "0", "--policy-servers", "127.0.0.1"]).await;
    let policy = register(&mut api, on(&there)).await;
    api.deploy("elsewhere@test", &policy.id).await;
    let open = SessionOpen { deployment: "elsewhere@test".into(), deadline_us: 60_000_000, ..SessionOpen::default() };
    let mut robot = Robot::open_with(&mut api, open).await.unwrap();
    let sim = start_sim();
    let mut stamp_ns = 0;
    let mut next = || {
        stamp_ns += 50_000_000;
        session_request::Message::Observation(Observation { stamp_ns, ..observe(&sim) })
    };
    robot.send(next()).await;
    assert!(matches!(robot.receive().await.unwrap(), session_response::Message::Action(_)));
    there.kill().await;
    let missing = async {
        loop {
            robot.send(next()).await;
            if let session_response::Message::Missed(missed) = robot.receive().await.unwrap() {
                return missed.reason;
            }
        }
    };
    let reason = within("an observation is missed", missing).await;
    assert!(reason.contains(there.url()) && reason.contains("start it"), "{reason}");
    assert!(there.start_where_it_was(None).await);
    let acting = async {
        loop {
            robot.send(next()).await;
            if let session_response::Message::Action(_) = robot.receive().await.unwrap() {
                return;
            }
        }
    };
    within("the robot acts again", acting).await;
}
