//! Servers of the Open Inference Protocol: one that answers, and those that answer with something else, too much, or
//! nothing.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

mod support;

use std::{
    sync::{Arc, Mutex, atomic::Ordering::SeqCst},
    time::{Duration, Instant},
};

use gleaner_core::{
    error::Kind,
    remote::{Protocol, RemotePolicy},
};
use gleaner_proto::inference::{
    infer_parameter::ParameterChoice, model_infer_response::InferOutputTensor, model_metadata_response::TensorMetadata,
    *,
};
use gleaner_remote::Outgoing;
use support::{
    act, acts, outgoing, policy, remote,
    scripted::{Answer, Scripted},
};
use tokio::net::TcpListener;
use tonic::{
    Code, Status,
    transport::{Identity, ServerTlsConfig},
};

fn output(name: &str, datatype: &str, shape: &[i64], raw: Vec<u8>) -> ModelInferResponse {
    let output = InferOutputTensor {
        name: name.into(),
        datatype: datatype.into(),
        shape: shape.to_vec(),
        ..InferOutputTensor::default()
    };
    ModelInferResponse { outputs: vec![output], raw_output_contents: vec![raw], ..ModelInferResponse::default() }
}

/// Answers with the state as the only action.
fn echo(request: ModelInferRequest) -> Answer {
    let at = request.inputs.iter().position(|input| input.name == "proprioception").unwrap();
    Ok(output("action", "FP32", &[1, 2], request.raw_input_contents[at].to_vec()))
}

fn of(address: &str) -> RemotePolicy {
    policy(Protocol::OpenInference, address)
}

async fn refusal(scripted: Scripted) -> (Kind, String) {
    let address = scripted.serve().await;
    let error = act(&mut remote(of(&address), outgoing()).episode(), 1.0).await.unwrap_err();
    assert!(error.message().contains(&address), "{error} names no address");
    (error.kind(), error.message().to_owned())
}

#[tokio::test]
async fn every_observation_is_answered_and_sessions_are_sequences() {
    let seen: Arc<Mutex<Vec<(i64, bool, bool)>>> = Arc::default();
    let noted = Arc::clone(&seen);
    let scripted = Scripted::new(move |request| {
        let parameter = |name: &str| request.parameters.get(name).and_then(|found| found.parameter_choice.clone());
        let flag = |name: &str| matches!(parameter(name), Some(ParameterChoice::BoolParam(true)));
        if let Some(ParameterChoice::Int64Param(id)) = parameter("sequence_id") {
            noted.lock().unwrap().push((id, flag("sequence_start"), flag("sequence_end")));
        }
        echo(request)
    });
    let address = scripted.serve().await;
    let single = remote(of(&address), outgoing());
    single.check().await.unwrap();
    assert_eq!(act(&mut single.episode(), 3.0).await.unwrap(), [[3.0, 0.5]]);
    assert!(seen.lock().unwrap().is_empty());

    let stateful = remote(RemotePolicy { sequences: true, ..of(&address) }, outgoing());
    stateful.check().await.unwrap();
    let (mut one, mut other) = (stateful.episode(), stateful.episode());
    for value in [1.0, 2.0] {
        assert_eq!(act(&mut one, value).await.unwrap(), [[value, 0.5]]);
    }
    act(&mut other, 1.0).await.unwrap();
    let seen = seen.lock().unwrap().clone();
    let [check, first, second, another] = seen[..] else { panic!("{seen:?}") };
    assert_eq!((check.1, check.2), (true, true), "the check ends its sequence");
    assert_eq!((first.1, second.1, first.0 == second.0), (true, false, true));
    assert!(another.1 && another.0 != first.0 && first.0 > 0);
}

#[tokio::test]
async fn answers_that_are_not_actions_are_refused() {
    let floats = |values: &[f32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    let cases: Vec<(Answer, &str)> = vec![
        (Ok(ModelInferResponse::default()), "no output action"),
        (Ok(output("other\u{1b}", "FP32", &[1, 2], vec![0; 8])), "it has other\\u{1b}"),
        (Ok(output("action", "FP16", &[1, 2], vec![0; 4])), "datatype FP16"),
        (Ok(output("action", "FP32", &[1, 3], vec![0; 12])), "shape [1, 3]"),
        (Ok(output("action", "FP32", &[-1, 2], vec![0; 8])), "shape below 0"),
        (Ok(output("action", "FP32", &[i64::MAX, 2], vec![0; 8])), "the policy is registered with 1 to 4"),
        (Ok(output("action", "FP32", &[5, 2], vec![0; 40])), "has 5 actions"),
        (Ok(output("action", "FP32", &[1, 2], vec![0; 7])), "not whole numbers"),
        (Ok(output("action", "FP32", &[1, 2], vec![0; 12])), "has 3 values"),
        (Ok(output("action", "FP32", &[1, 2], floats(&[0.0, f32::NAN]))), "is NaN"),
        (Ok(output("action", "FP32", &[1, 2], vec![0; 1 << 20])), "OutOfRange"),
        (Err(Status::invalid_argument("inputs.top: is missing\u{7}")), "inputs.top: is missing\\u{7}"),
        (Err(Status::not_found("no deployment arm")), "no deployment arm"),
    ];
    for (answer, words) in cases {
        let (kind, message) = refusal(Scripted::new(move |_| answer.clone())).await;
        assert_eq!(kind, Kind::Precondition, "{message}");
        assert!(message.contains(words) && message.len() < 800, "{words} expected: {message}");
    }
    for code in [Code::Unavailable, Code::Internal, Code::ResourceExhausted] {
        let (kind, message) = refusal(Scripted::new(move |_| Err(Status::new(code, "x".repeat(4000))))).await;
        assert_eq!(kind, Kind::Unavailable, "{message}");
        assert!(message.len() < 800, "{message}");
    }
}

#[tokio::test]
async fn a_model_with_other_tensors_is_refused_before_any_observation() {
    let tensor = |name: &str, datatype: &str, shape: &[i64]| TensorMetadata {
        name: name.into(),
        datatype: datatype.into(),
        shape: shape.to_vec(),
    };
    let inputs = vec![
        tensor("top", "UINT8", &[-1, 1, 2, 3]),
        tensor("proprioception", "FP32", &[-1, 2]),
        tensor("executed_action", "FP64", &[2]),
    ];
    let model =
        ModelMetadataResponse { inputs, outputs: vec![tensor("action", "FP32", &[-1, 2])], ..Default::default() };
    let described = |model: &ModelMetadataResponse| {
        let model = model.clone();
        Scripted { metadata: Arc::new(move || Ok(model.clone())), ..Scripted::new(echo) }
    };
    let address = described(&model).serve().await;
    remote(of(&address), outgoing()).check().await.unwrap();

    let mut other = model.clone();
    other.inputs[0].shape = vec![3, 1, 2];
    let mut missing = model.clone();
    missing.inputs.remove(1);
    let mut named = model.clone();
    named.outputs[0].name = "actions".into();
    let mut large = model.clone();
    large.platform = "x".repeat(1 << 20);
    for (model, words) in [
        (other, "input top has shape [3, 1, 2]"),
        (missing, "no input proprioception"),
        (named, "no output action; it has actions"),
        (large, "OutOfRange"),
    ] {
        let (kind, message) = refusal(described(&model)).await;
        assert_eq!(kind, Kind::Precondition, "{message}");
        assert!(message.contains(words), "{words} expected: {message}");
    }
}

/// A server that hangs costs one call; while no attempt is due, calls fail at once.
#[tokio::test]
async fn a_silent_server_is_left_in_time_and_others_are_not_delayed() {
    const LIMIT: Duration = Duration::from_millis(500);
    let scripted = Scripted::new(echo);
    let address = scripted.serve().await;
    let other = Scripted::new(echo).serve().await;
    let limited = RemotePolicy { answer_within_ms: 500, ..of(&address) };
    let (slow, quick) = (remote(limited, outgoing()), remote(of(&other), outgoing()));
    let mut episode = slow.episode();
    acts(&mut episode, 1.0).await;
    scripted.silent.store(true, SeqCst);
    let hanging = tokio::spawn(async move {
        let error = act(&mut episode, 2.0).await.unwrap_err();
        (episode, error)
    });
    for _ in 0..10 {
        assert_eq!(act(&mut quick.episode(), 1.0).await.unwrap(), [[1.0, 0.5]]);
    }
    let (mut episode, error) = hanging.await.unwrap();
    assert_eq!(error.kind(), Kind::Unavailable);
    assert!(error.message().contains("no answer within 500 ms"), "{error}");
    // On a busy machine the next attempt may be due. It takes the whole limit, and each interval is twice the one before.
    let mut times = Vec::new();
    while times.iter().all(|time| *time >= LIMIT) && times.len() < 6 {
        let begun = Instant::now();
        let next = act(&mut episode, 3.0).await.unwrap_err();
        assert_eq!(next.message(), error.message());
        times.push(begun.elapsed());
    }
    assert!(times.iter().any(|time| *time < LIMIT), "no call failed at once: {times:?}");
    scripted.silent.store(false, SeqCst);
    acts(&mut episode, 4.0).await;
}

#[tokio::test]
async fn servers_of_another_kind_are_named() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = format!("http://{}", listener.local_addr().unwrap());
    tokio::spawn(async move {
        while let Ok((mut stream, _)) = listener.accept().await {
            use tokio::io::AsyncWriteExt as _;
            let _ = stream.write_all(b"HTTP/1.1 200 OK\r\ncontent-length: 0\r\n\r\n").await;
        }
    });
    let error = remote(of(&address), outgoing()).check().await.unwrap_err();
    assert_eq!(error.kind(), Kind::Unavailable, "{error}");
    assert!(error.message().contains(&address), "{error}");
}

#[tokio::test]
async fn an_encrypted_server_gets_its_token() {
    let key = rcgen::KeyPair::generate().unwrap();
    let certificate = rcgen::CertificateParams::new(vec!["localhost".to_owned()]).unwrap().self_signed(&key).unwrap();
    let tls = ServerTlsConfig::new().identity(Identity::from_pem(certificate.pem(), key.serialize_pem()));
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = format!("https://localhost:{}", listener.local_addr().unwrap().port());
    let scripted = Scripted::new(echo);
    scripted.serve_on(listener, Some(tls));
    let folder = tempfile::tempdir().unwrap();
    let (ca, tokens) = (folder.path().join("ca.pem"), folder.path().join("tokens"));
    std::fs::write(&ca, certificate.pem()).unwrap();
    std::fs::write(&tokens, "localhost a-secret\n").unwrap();
    let trusted = Outgoing { tokens: Some(tokens), ca: Some(ca), ..outgoing() };
    let remote_of = |outgoing| remote(of(&address), outgoing);
    remote_of(trusted.clone()).check().await.unwrap();
    assert_eq!(*scripted.authorization.lock().unwrap(), ["Bearer a-secret"]);
    let untrusted = remote_of(outgoing()).check().await.unwrap_err();
    assert!(
        untrusted.message().contains("--policy-server-ca") && !untrusted.message().contains("secret"),
        "{untrusted}"
    );
}
