//! Access: tokens, roles, TLS, the audit log; secrets stay out of logs and files.

mod certificates;
mod paths;
mod reload;
mod revocation;
mod workers;

use gleaner_client::Client;
use gleaner_proto::{
    Rpc,
    inference::{ModelInferRequest, grpc_inference_service_client::GrpcInferenceServiceClient},
    v1::*,
};
use tonic::{Code, Request, transport::Channel};

use crate::support::{
    errors::{ABSENT_ID, expect_error},
    lab, rpc,
    secure::SecureServer,
    wait::within,
};

/// Lists the tasks; returns the code of the status.
async fn list(client: &Client) -> Code {
    client.tasks().list_tasks(ListTasksRequest::default()).await.map_or_else(|status| status.code(), |_| Code::Ok)
}

#[tokio::test]
async fn token_is_valid_until_it_is_revoked() {
    let server = SecureServer::start(&["--workers", "0"], &[]).await;
    let anonymous = server.client(None).await;
    let status = anonymous.tasks().list_tasks(ListTasksRequest::default()).await.unwrap_err();
    expect_error(&status, Code::Unauthenticated, &["--token", "GLEANER_TOKEN", "token create"]);
    assert_eq!(list(&server.client(Some("gleaner_0000")).await).await, Code::Unauthenticated);

    let token = server.token("contributor", &["--name", "anna", "--expires", "1h"]).await;
    let anna = server.client(Some(&token)).await;
    create_task(&anna).await;
    let status = anna.jobs().submit_job(SubmitJobRequest::default()).await.unwrap_err();
    expect_error(&status, Code::PermissionDenied, &["trainer", "anna", "contributor"]);
    let listed = server.command(&["token", "list"]).await.unwrap();
    assert!(listed.contains("anna") && listed.contains("live") && !listed.contains(&token), "{listed}");

    // An open stream ends with its token even if it is idle.
    let session = anna.policies().session(tokio_stream::pending::<SessionRequest>()).await.unwrap().into_inner();
    server.command(&["token", "revoke", "anna"]).await.unwrap();
    let ended = within("the session ends", end(session)).await;
    assert_eq!(ended, Code::Unauthenticated);
    assert_eq!(list(&anna).await, Code::Unauthenticated);

    let log = server.command(&["audit", "--since", "1h"]).await.unwrap();
    for words in [
        ["command line", "token create", "name=anna"],
        ["anna", "TaskService/CreateTask", "spec.name=pick_cube"],
        ["anna", "JobService/SubmitJob", "PermissionDenied"],
        ["anna", "PolicyService/Session", "Unauthenticated"],
        ["command line", "token revoke", "name=anna"],
    ] {
        let line = log.lines().find(|line| words.iter().all(|word| line.contains(word)));
        assert!(line.is_some(), "{words:?}: {log}");
    }
    assert!(!log.contains(&token) && !log.contains("ListTasks"), "{log}");
}

/// Reads a session to its end; returns the code of its status.
async fn end(mut session: tonic::Streaming<SessionResponse>) -> Code {
    loop {
        match session.message().await {
            Ok(Some(_)) => {}
            Ok(None) => return Code::Ok,
            Err(status) => return status.code(),
        }
    }
}

async fn create_task(client: &Client) {
    client.tasks().create_task(CreateTaskRequest { spec: Some(lab::spec_message()) }).await.unwrap();
}

/// Every rpc without a token over a real connection, and a few with one. The guard's own tests call every rpc with every
/// role.
#[tokio::test]
async fn callers_without_a_token_reach_health_only() {
    let server = SecureServer::start(&["--workers", "0"], &[]).await;
    let channel = rpc::connect(&server).await;
    for rpc in Rpc::ALL {
        let code = rpc::call(&channel, rpc.path(), None, Vec::new()).await;
        let expected = match rpc.path().rsplit(['/', '.']).next().unwrap() {
            "ServerLive" | "ServerReady" => Code::Ok,
            _ if rpc.path().contains(".WorkerService/") => Code::Unimplemented,
            _ => Code::Unauthenticated,
        };
        assert_eq!(code, expected, "{}", rpc.path());
    }
    let health = "/grpc.health.v1.Health/Check";
    // The message that requests the list of services.
    const LIST_SERVICES: [u8; 2] = [0x3a, 0];
    assert_eq!(rpc::call(&channel, health, None, Vec::new()).await, Code::Ok);
    let viewer = server.token("viewer", &[]).await;
    for reflection in [
        "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo",
        "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo",
    ] {
        assert_eq!(rpc::call(&channel, reflection, None, Vec::new()).await, Code::Unauthenticated, "{reflection}");
        assert_eq!(
            rpc::call(&channel, reflection, Some(&viewer), LIST_SERVICES.to_vec()).await,
            Code::Ok,
            "{reflection}"
        );
    }
    assert_eq!(
        rpc::call(&channel, "/gleaner.v1.TaskService/Nothing", Some(&viewer), Vec::new()).await,
        Code::Unimplemented
    );
}

#[tokio::test]
async fn robot_token_reaches_its_own_deployments_only() {
    let server = SecureServer::start(&["--workers", "0"], &[]).await;
    let token = server.token("robot", &["--name", "arm", "--deployment", "arm@prod"]).await;
    let robot = server.client(Some(&token)).await;
    let channel = rpc::connect(&server).await;
    // Neither is deployed: its own is not found, and the other is not permitted.
    for (deployment, code) in [("arm@prod", Code::NotFound), ("leg@prod", Code::PermissionDenied)] {
        let observations = vec![Observation { stamp_ns: 1, ..Default::default() }];
        let act = robot.policies().act(ActRequest { deployment: deployment.into(), observations }).await;
        assert_eq!(act.unwrap_err().code(), code, "{deployment}");
        let open = SessionOpen { deployment: deployment.into(), ..Default::default() };
        let open = SessionRequest { message: Some(session_request::Message::Open(open)) };
        let session = robot.policies().session(tokio_stream::iter([open])).await.unwrap().into_inner();
        assert_eq!(end(session).await, code, "{deployment}");
        assert_eq!(infer(&channel, &token, deployment).await, code, "{deployment}");
    }
    // Its episodes get the cohort of its deployment, so that it cannot add them to the experts.
    let open =
        SessionOpen { deployment: "arm@prod".into(), record: true, cohort: "experts".into(), ..Default::default() };
    let open = SessionRequest { message: Some(session_request::Message::Open(open)) };
    let session = robot.policies().session(tokio_stream::iter([open])).await.unwrap().into_inner();
    assert_eq!(end(session).await, Code::PermissionDenied);
    assert_eq!(list(&robot).await, Code::PermissionDenied);
    let deployments = robot.policies().list_deployments(ListDeploymentsRequest::default()).await.unwrap();
    assert!(deployments.into_inner().deployments.is_empty());
}

#[tokio::test]
async fn only_an_admin_deletes_by_force() {
    let server = SecureServer::start(&["--workers", "0"], &[]).await;
    for (role, code) in
        [("contributor", Code::PermissionDenied), ("trainer", Code::PermissionDenied), ("admin", Code::NotFound)]
    {
        let client = server.client(Some(&server.token(role, &[]).await)).await;
        let delete = |force| DeleteEpisodesRequest { episode_ids: vec![format!("ep_{ABSENT_ID}")], force };
        let forced = client.episodes().delete_episodes(delete(true)).await.unwrap_err();
        assert_eq!(forced.code(), code, "{role}: {forced}");
        let usual = client.episodes().delete_episodes(delete(false)).await.unwrap_err();
        assert_eq!(usual.code(), Code::NotFound, "{role}: {usual}");
    }
}

/// The text goes to sbatch, which is the operator's.
#[tokio::test]
async fn engine_options_need_an_admin() {
    let server = SecureServer::start(&["--workers", "0"], &[]).await;
    create_task(&server.client(Some(&server.token("contributor", &[]).await)).await).await;
    for (role, code) in [("trainer", Code::PermissionDenied), ("admin", Code::FailedPrecondition)] {
        let client = server.client(Some(&server.token(role, &[]).await)).await;
        let request = SubmitJobRequest {
            task: lab::TASK.into(),
            spec: Some(JobSpec { spec: Some(lab::pretrain(2)) }),
            engine_options: "--partition=gpu".into(),
            ..SubmitJobRequest::default()
        };
        let pipeline = PipelineSpec { pretrain: Some(PretrainSpec::default()), ..PipelineSpec::default() };
        let chain = SubmitPipelineRequest {
            task: lab::TASK.into(),
            pipeline: Some(pipeline.clone()),
            engine_options: "--partition=gpu".into(),
            ..SubmitPipelineRequest::default()
        };
        let schedule = CreateScheduleRequest {
            task: lab::TASK.into(),
            name: "often".into(),
            trigger: Some(create_schedule_request::Trigger::LabelledEpisodes(1)),
            pipeline: Some(pipeline),
            engine_options: "--partition=gpu".into(),
        };
        let of_job = client.jobs().submit_job(request).await.unwrap_err();
        let of_pipeline = client.jobs().submit_pipeline(chain).await.unwrap_err();
        let of_schedule = client.schedules().create_schedule(schedule).await.unwrap_err();
        for status in [of_job, of_pipeline, of_schedule] {
            assert_eq!(status.code(), code, "{role}: {status}");
            assert!(code == Code::PermissionDenied || status.message().contains("the engine local"), "{status}");
        }
    }
}

async fn infer(channel: &Channel, token: &str, model: &str) -> Code {
    let mut request = Request::new(ModelInferRequest { model_name: model.into(), ..Default::default() });
    request.metadata_mut().insert("authorization", format!("Bearer {token}").parse().unwrap());
    GrpcInferenceServiceClient::new(channel.clone()).model_infer(request).await.unwrap_err().code()
}

/// At every level of the log.
#[tokio::test]
async fn tokens_and_keys_appear_in_no_log_and_no_database() {
    let server = SecureServer::start(&["--workers", "0"], &[]).await;
    let (good, revoked) = (server.token("admin", &[]).await, server.token("admin", &["--name", "revoked"]).await);
    server.command(&["token", "revoke", "revoked"]).await.unwrap();
    let unknown = "gleaner_a_token_of_another_server";
    let channel = rpc::connect(&server).await;
    for token in [good.as_str(), revoked.as_str(), unknown] {
        for rpc in [Rpc::TaskServiceListTasks, Rpc::TaskServiceCreateTask, Rpc::WorkerServiceGetAssignment] {
            rpc::call(&channel, rpc.path(), Some(token), Vec::new()).await;
        }
    }
    assert_eq!(list(&server.client(Some(&good)).await).await, Code::Ok);
    assert!(server.log().contains("ListTasks"));
    let key = std::fs::read_to_string(server.folder().join("key")).unwrap();
    server.expect_no_secret([good.as_str(), revoked.as_str(), unknown, key.lines().nth(1).unwrap()]);
}
