//! Who is let in: tokens, roles, TLS, the audit log, and that no secret is told.

mod certificates;
mod ending;
mod guarded;
mod paths;
mod raw;
mod reload;
mod workers;

use std::time::Duration;

use gleaner_client::Client;
use gleaner_proto::{
    Rpc,
    inference::{ModelInferRequest, grpc_inference_service_client::GrpcInferenceServiceClient},
    v1::*,
};
use tonic::{Code, Request, transport::Channel};

pub use self::guarded::Guarded;
use crate::{bad_input::refused, lab, refusals::NOBODY};

/// No event in these tests takes longer.
const PATIENCE: Duration = Duration::from_secs(120);

/// What lists the tasks, and says how that went.
async fn list(client: &Client) -> Code {
    client.tasks().list_tasks(ListTasksRequest {}).await.map_or_else(|status| status.code(), |_| Code::Ok)
}

#[tokio::test]
async fn a_token_is_good_at_once_until_it_is_revoked() {
    let server = Guarded::start(&["--workers", "0"], &[]).await;
    let nobody = server.client(None).await;
    let status = nobody.tasks().list_tasks(ListTasksRequest {}).await.unwrap_err();
    refused(&status, Code::Unauthenticated, &["--token", "GLEANER_TOKEN", "token create"]);
    assert_eq!(list(&server.client(Some("gleaner_0000")).await).await, Code::Unauthenticated);

    let token = server.token("contributor", &["--name", "anna", "--expires", "1h"]).await;
    let anna = server.client(Some(&token)).await;
    lab_task(&anna).await;
    let status = anna.jobs().submit_job(SubmitJobRequest::default()).await.unwrap_err();
    refused(&status, Code::PermissionDenied, &["trainer", "anna", "contributor"]);
    let listed = server.command(&["token", "list"]).await.unwrap();
    assert!(listed.contains("anna") && listed.contains("live") && !listed.contains(&token), "{listed}");

    // An open stream ends with its token, though nothing is said on it.
    let (_keep, silent) = tokio::sync::mpsc::channel::<SessionRequest>(1);
    let requests = tokio_stream::wrappers::ReceiverStream::new(silent);
    let session = anna.policies().session(requests).await.unwrap().into_inner();
    server.command(&["token", "revoke", "anna"]).await.unwrap();
    let ended = tokio::time::timeout(PATIENCE, end(session)).await.unwrap();
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

async fn end(mut session: tonic::Streaming<SessionResponse>) -> Code {
    loop {
        match session.message().await {
            Ok(Some(_)) => {}
            Ok(None) => return Code::Ok,
            Err(status) => return status.code(),
        }
    }
}

async fn lab_task(client: &Client) {
    let spec = gleaner_core::proto::task::spec_to_proto(gleaner_sim::task_spec(
        gleaner_sim::Task::PickCube,
        &lab::sim_config(),
    ));
    client.tasks().create_task(CreateTaskRequest { spec: Some(spec) }).await.unwrap();
}

/// The whole of the table over a real connection, for who has no token; a handful for who has one. (Every rpc with every
/// role is walked in the guard's own tests.)
#[tokio::test]
async fn nothing_but_its_health_is_told_to_who_has_no_token() {
    let server = Guarded::start(&["--workers", "0"], &[]).await;
    let channel = raw::connect(&server).await;
    for rpc in Rpc::ALL {
        let code = raw::call(&channel, rpc.path(), None, Vec::new()).await;
        let expected = match rpc.path().rsplit(['/', '.']).next().unwrap() {
            "ServerLive" | "ServerReady" => Code::Ok,
            _ if rpc.path().contains(".WorkerService/") => Code::Unimplemented,
            _ => Code::Unauthenticated,
        };
        assert_eq!(code, expected, "{}", rpc.path());
    }
    let health = "/grpc.health.v1.Health/Check";
    // The message that asks reflection for the list of services.
    const LIST_SERVICES: [u8; 2] = [0x3a, 0];
    assert_eq!(raw::call(&channel, health, None, Vec::new()).await, Code::Ok);
    let viewer = server.token("viewer", &[]).await;
    for reflection in [
        "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo",
        "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo",
    ] {
        assert_eq!(raw::call(&channel, reflection, None, Vec::new()).await, Code::Unauthenticated, "{reflection}");
        assert_eq!(
            raw::call(&channel, reflection, Some(&viewer), LIST_SERVICES.to_vec()).await,
            Code::Ok,
            "{reflection}"
        );
    }
    assert_eq!(
        raw::call(&channel, "/gleaner.v1.TaskService/Nothing", Some(&viewer), Vec::new()).await,
        Code::Unimplemented
    );
}

#[tokio::test]
async fn a_robot_has_its_own_deployments_and_no_others() {
    let server = Guarded::start(&["--workers", "0"], &[]).await;
    let token = server.token("robot", &["--name", "arm", "--deployment", "arm@prod"]).await;
    let robot = server.client(Some(&token)).await;
    let channel = raw::connect(&server).await;
    // Nothing is deployed: its own is not found, any other is not its business.
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
    // Its episodes have the cohort of its deployment, so that it cannot put them among the experts.
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
    let server = Guarded::start(&["--workers", "0"], &[]).await;
    for (role, code) in
        [("contributor", Code::PermissionDenied), ("trainer", Code::PermissionDenied), ("admin", Code::NotFound)]
    {
        let client = server.client(Some(&server.token(role, &[]).await)).await;
        let delete = |force| DeleteEpisodesRequest { episode_ids: vec![format!("ep_{NOBODY}")], force };
        let forced = client.episodes().delete_episodes(delete(true)).await.unwrap_err();
        assert_eq!(forced.code(), code, "{role}: {forced}");
        let usual = client.episodes().delete_episodes(delete(false)).await.unwrap_err();
        assert_eq!(usual.code(), Code::NotFound, "{role}: {usual}");
    }
}

async fn infer(channel: &Channel, token: &str, model: &str) -> Code {
    let mut request = Request::new(ModelInferRequest { model_name: model.into(), ..Default::default() });
    request.metadata_mut().insert("authorization", format!("Bearer {token}").parse().unwrap());
    GrpcInferenceServiceClient::new(channel.clone()).model_infer(request).await.unwrap_err().code()
}

/// All levels of the log are on.
#[tokio::test]
async fn no_log_and_no_file_tells_a_token() {
    let server = Guarded::start(&["--workers", "0"], &[]).await;
    let (good, gone) = (server.token("admin", &[]).await, server.token("admin", &["--name", "gone"]).await);
    server.command(&["token", "revoke", "gone"]).await.unwrap();
    let unknown = "gleaner_a_token_of_another_server";
    let channel = raw::connect(&server).await;
    for token in [good.as_str(), gone.as_str(), unknown] {
        for rpc in [Rpc::TaskServiceListTasks, Rpc::TaskServiceCreateTask, Rpc::WorkerServiceGetAssignment] {
            raw::call(&channel, rpc.path(), Some(token), Vec::new()).await;
        }
    }
    assert_eq!(list(&server.client(Some(&good)).await).await, Code::Ok);
    let log = server.log();
    assert!(log.contains("ListTasks") && log.contains("TRACE"), "the log was not at its most talkative");
    let key = std::fs::read_to_string(server.data_dir().parent().unwrap().join("key")).unwrap();
    server.tells_nobody([good.as_str(), gone.as_str(), unknown, key.lines().nth(1).unwrap()]);
}
