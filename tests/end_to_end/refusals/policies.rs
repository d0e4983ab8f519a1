//! PolicyService, and the rpcs of the Open Inference Protocol that describe models. Invalid observations are in `serving`,
//! invalid tensors in `inference`.

use gleaner_proto::{
    inference::{
        ModelMetadataRequest, ModelReadyRequest, RepositoryIndexRequest,
        grpc_inference_service_client::GrpcInferenceServiceClient,
    },
    v1::*,
};

use crate::support::{
    api::Api,
    errors::{absent_id, expect_alive, expect_errors},
    lab,
    shared::{NAME, shared},
};

#[tokio::test]
async fn invalid_policy_requests_are_rejected() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let deploy = |name: &str, policy: &str, run: &str| DeployRequest {
        name: name.to_owned(),
        policy_id: policy.to_owned(),
        score_run_id: run.to_owned(),
        ..DeployRequest::default()
    };
    let (policy, unknown) = (shared.policy.as_str(), absent_id("pol"));
    let roll_back = |name: &str| RollBackRequest { name: name.to_owned() };
    let delete = |name: &str| DeleteDeploymentRequest { name: name.to_owned() };
    let act = |deployment: &str| ActRequest { deployment: deployment.to_owned(), observations: vec![] };
    let evaluations = |page_size, token: &str| ListEvaluationsRequest {
        policy_id: policy.to_owned(),
        page_size,
        page_token: token.to_owned(),
    };
    expect_errors!(api.policies:
        list_policies(ListPoliciesRequest { task: "absent".into(), ..Default::default() }) => NotFound ["absent"];
        list_policies(ListPoliciesRequest { page_size: 1001, ..Default::default() }) => InvalidArgument ["page_size: "];
        list_policies(ListPoliciesRequest { page_token: absent_id("eval"), ..Default::default() }) => InvalidArgument ["page_token: is not a page token"];
        deploy(deploy("", policy, "")) => InvalidArgument ["name: "];
        deploy(deploy("../prod", policy, "")) => InvalidArgument ["name: "];
        deploy(deploy(&"x".repeat(129), policy, "")) => InvalidArgument ["name: "];
        deploy(deploy("x@prod", "pol_7", "")) => InvalidArgument ["policy_id: "];
        deploy(deploy("x@prod", &unknown, "")) => NotFound [&unknown];
        deploy(deploy("x@prod", policy, "run_7")) => InvalidArgument ["score_run_id: "];
        deploy(deploy("x@prod", policy, &absent_id("run"))) => NotFound [&absent_id("run")];
        roll_back(roll_back("a b")) => InvalidArgument ["name: "];
        roll_back(roll_back("absent@prod")) => NotFound ["absent@prod"];
        roll_back(roll_back(NAME)) => FailedPrecondition [NAME];
        delete_deployment(delete("a b")) => InvalidArgument ["name: "];
        delete_deployment(delete("absent@prod")) => NotFound ["absent@prod"];
        list_deployments(ListDeploymentsRequest { task: "absent".into(), ..Default::default() }) => NotFound ["absent"];
        list_deployments(ListDeploymentsRequest { page_size: 1001, ..Default::default() }) => InvalidArgument ["page_size: "];
        list_deployments(ListDeploymentsRequest { page_token: unknown.clone(), ..Default::default() }) => InvalidArgument ["page_token: is not a page token"];
        act(act("../x")) => InvalidArgument ["deployment: "];
        act(act("absent@prod")) => NotFound ["absent@prod"];
        act(act(NAME)) => InvalidArgument ["observations: "];
        list_evaluations(ListEvaluationsRequest { policy_id: "x".into(), ..Default::default() }) => InvalidArgument ["policy_id: "];
        list_evaluations(ListEvaluationsRequest { policy_id: unknown.clone(), ..Default::default() }) => NotFound [&unknown];
        list_evaluations(evaluations(1001, "")) => InvalidArgument ["page_size: "];
        list_evaluations(evaluations(5, &unknown)) => InvalidArgument ["page_token: is not a page token"];
        get_evaluation(GetEvaluationRequest { evaluation_id: "x".into() }) => InvalidArgument ["evaluation_id: "];
        get_evaluation(GetEvaluationRequest { evaluation_id: absent_id("eval") }) => NotFound [&absent_id("eval")];
    );
    // Never trained with its history hidden.
    let train = lab::train(train_spec::Data::ExpertsOf(shared.encoder.clone()), 1);
    let job = api.succeed(lab::TASK, lab::with(train, serde_json::json!({"history_dropout": 0.0}))).await;
    let hidden = DeployRequest { hide_history: true, ..deploy("x@prod", &job.result_id, "") };
    expect_errors!(api.policies: deploy(hidden) => InvalidArgument ["hide_history: "];);
    expect_alive(&mut api).await;
}

#[tokio::test]
async fn invalid_policies_of_other_servers_are_rejected() {
    use gleaner_proto::v1::remote_input::Value;
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let right = || RemotePolicy {
        protocol: RemoteProtocol::OpenInference.into(),
        address: "http://127.0.0.1:9".into(),
        model: "arm".into(),
        ..RemotePolicy::default()
    };
    let register =
        |task: &str, remote: RemotePolicy| RegisterPolicyRequest { task: task.to_owned(), remote: Some(remote) };
    let of = |remote: RemotePolicy| register(lab::TASK, remote);
    let sends = |name: &str, value: Option<Value>| RemoteInput { name: name.to_owned(), value };
    let input = |name: &str, value| of(RemotePolicy { inputs: vec![sends(name, value)], ..right() });
    let twice = vec![sends("x", Some(Value::Proprioception(true))); 2];
    let openpi =
        RemotePolicy { protocol: RemoteProtocol::Openpi.into(), address: "ws://127.0.0.1:9".into(), ..right() };
    expect_errors!(api.policies:
        register_policy(register("absent", right())) => NotFound ["absent"];
        register_policy(RegisterPolicyRequest { task: lab::TASK.into(), remote: None }) => InvalidArgument ["remote: "];
        register_policy(of(RemotePolicy { protocol: 0, ..right() })) => InvalidArgument ["remote.protocol: "];
        register_policy(of(RemotePolicy { address: "127.0.0.1:9".into(), ..right() })) => InvalidArgument ["remote.address: "];
        register_policy(of(RemotePolicy { address: "file:///etc/passwd".into(), ..right() })) => InvalidArgument ["remote.address: "];
        register_policy(of(RemotePolicy { address: "http://a:b@127.0.0.1:9".into(), ..right() })) => InvalidArgument ["remote.address: "];
        register_policy(of(RemotePolicy { address: "http://169.254.169.254:80".into(), ..right() })) => FailedPrecondition ["--policy-servers"];
        register_policy(of(RemotePolicy { model: String::new(), ..right() })) => InvalidArgument ["remote.model: "];
        register_policy(of(RemotePolicy { model_version: "x".repeat(256), ..right() })) => InvalidArgument ["remote.model_version: "];
        register_policy(of(openpi.clone())) => InvalidArgument ["remote.model: "];
        register_policy(of(RemotePolicy { model: String::new(), sequences: true, ..openpi })) => InvalidArgument ["remote.sequences: "];
        register_policy(of(RemotePolicy { output: "a\n".into(), ..right() })) => InvalidArgument ["remote.output: "];
        register_policy(of(RemotePolicy { chunk_length: 1025, ..right() })) => InvalidArgument ["remote.chunk_length: "];
        register_policy(of(RemotePolicy { execute_length: 2, ..right() })) => InvalidArgument ["remote.execute_length: "];
        register_policy(of(RemotePolicy { answer_within_ms: 60_001, ..right() })) => InvalidArgument ["remote.answer_within_ms: "];
        register_policy(of(RemotePolicy { source: "x".repeat(256), ..right() })) => InvalidArgument ["remote.source: "];
        register_policy(of(RemotePolicy { inputs: twice, ..right() })) => InvalidArgument ["remote.inputs[1].name: "];
        register_policy(input("", Some(Value::Proprioception(true)))) => InvalidArgument ["remote.inputs[0].name: "];
        register_policy(input("x", None)) => InvalidArgument ["remote.inputs[0].value: "];
        register_policy(input("x", Some(Value::Camera("absent".into())))) => InvalidArgument ["remote.inputs[0].camera: "];
        register_policy(input("x", Some(Value::CameraPlanes("absent".into())))) => InvalidArgument ["remote.inputs[0].camera_planes: "];
        register_policy(input("x", Some(Value::Depth("absent".into())))) => InvalidArgument ["remote.inputs[0].depth: "];
        register_policy(input("x", Some(Value::Field("absent".into())))) => InvalidArgument ["remote.inputs[0].field: "];
        register_policy(input("x", Some(Value::Proprioception(false)))) => InvalidArgument ["remote.inputs[0].proprioception: "];
        register_policy(input("x", Some(Value::ExecutedAction(false)))) => InvalidArgument ["remote.inputs[0].executed_action: "];
        register_policy(input("x", Some(Value::Text("x".repeat(1001))))) => InvalidArgument ["remote.inputs[0].text: "];
    );
    expect_alive(&mut api).await;
}

#[tokio::test]
async fn invalid_evaluations_are_rejected() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let seed = SeedResult { seed: 1, episodes: 10, successes: 3, mean_steps: 20.0 };
    let report = |policy: &str, simulation: &str, seeds: Vec<SeedResult>| ReportEvaluationRequest {
        policy_id: policy.to_owned(),
        simulation: simulation.to_owned(),
        seeds,
    };
    let of = |seeds| report(&shared.policy, "lab/bench", seeds);
    expect_errors!(api.policies:
        report_evaluation(report("x", "lab", vec![seed])) => InvalidArgument ["policy_id: "];
        report_evaluation(report(&absent_id("pol"), "lab", vec![seed])) => NotFound [&absent_id("pol")];
        report_evaluation(report(&shared.policy, "", vec![seed])) => InvalidArgument ["simulation: "];
        report_evaluation(report(&shared.policy, &"x".repeat(201), vec![seed])) => InvalidArgument ["simulation: "];
        report_evaluation(of(vec![])) => InvalidArgument ["seeds: "];
        report_evaluation(of(vec![seed, seed])) => InvalidArgument ["seeds[1].seed: "];
        report_evaluation(of(vec![SeedResult { episodes: 0, ..seed }])) => InvalidArgument ["seeds[0].episodes: "];
        report_evaluation(of(vec![SeedResult { successes: 11, ..seed }])) => InvalidArgument ["seeds[0].successes: "];
        report_evaluation(of(vec![SeedResult { mean_steps: f64::NAN, ..seed }])) => InvalidArgument ["seeds[0].mean_steps: "];
    );
    expect_alive(&mut api).await;
}

#[tokio::test]
async fn unknown_models_are_rejected() {
    struct Clients {
        models: GrpcInferenceServiceClient<tonic::transport::Channel>,
    }
    let shared = shared().await;
    let mut clients =
        Clients { models: GrpcInferenceServiceClient::connect(shared.server.url().to_owned()).await.unwrap() };
    let describe =
        |name: &str, version: &str| ModelMetadataRequest { name: name.to_owned(), version: version.to_owned() };
    let ready = |name: &str, version: &str| ModelReadyRequest { name: name.to_owned(), version: version.to_owned() };
    expect_errors!(clients.models:
        model_metadata(describe("../x", "")) => InvalidArgument ["name: "];
        model_metadata(describe("absent", "")) => NotFound ["absent"];
        model_metadata(describe(NAME, "7")) => InvalidArgument ["version: "];
        model_metadata(describe(NAME, &absent_id("pol"))) => NotFound [NAME];
        model_ready(ready("", "")) => InvalidArgument ["name: "];
        model_ready(ready(NAME, "x")) => InvalidArgument ["version: "];
        repository_index(RepositoryIndexRequest { repository_name: "x".into(), ready: false }) => InvalidArgument ["repository_name: "];
    );
    let response = clients.models.model_ready(ready("absent", "")).await.unwrap().into_inner();
    assert!(!response.ready, "an unknown model is not ready");
}
