//! The Open Inference Protocol: the shared policy with every form of request, and invalid requests.

use std::collections::HashMap;

use bytes::Bytes;
use gleaner_proto::{
    inference::{
        InferParameter, InferTensorContents, ModelInferRequest, ModelInferResponse, ModelMetadataRequest,
        ModelReadyRequest, RepositoryIndexRequest, ServerLiveRequest, ServerMetadataRequest, ServerReadyRequest,
        grpc_inference_service_client::GrpcInferenceServiceClient, infer_parameter::ParameterChoice,
        model_infer_request::InferInputTensor,
    },
    v1::{ActRequest, Observation},
};
use tonic::{Code, Status, transport::Channel};

use crate::support::{
    api::Api,
    robot::{close, observe, start_sim},
    server::TestServer,
    shared::{NAME, shared},
};

type Client = GrpcInferenceServiceClient<Channel>;

async fn connect(server: &TestServer) -> Client {
    Client::connect(server.url().to_owned()).await.unwrap()
}

/// An observation as raw tensors.
fn request(observation: &Observation) -> ModelInferRequest {
    let mut request = ModelInferRequest { model_name: NAME.into(), id: "a request".into(), ..Default::default() };
    let mut push = |name: String, datatype: &str, shape: Vec<i64>, data: Bytes| {
        request.inputs.push(InferInputTensor { name, datatype: datatype.into(), shape, ..Default::default() });
        request.raw_input_contents.push(data);
    };
    for frame in &observation.cameras {
        push(frame.camera.clone(), "UINT8", vec![16, 16, 3], frame.color.clone().unwrap().data);
        push(format!("{}.depth", frame.camera), "UINT16", vec![1, 16, 16], frame.depth.clone().unwrap().data);
    }
    for (name, values) in
        [("proprioception", &observation.proprioception), ("executed_action", &observation.executed_action)]
    {
        if !values.is_empty() {
            let data = values.iter().flat_map(|value| value.to_le_bytes()).collect();
            push(name.into(), "FP32", vec![i64::try_from(values.len()).unwrap()], data);
        }
    }
    request
}

/// The same request as a part of a sequence.
fn at(mut request: ModelInferRequest, id: ParameterChoice, start: bool, end: bool) -> ModelInferRequest {
    let flags = [("sequence_start", start), ("sequence_end", end)];
    let choices = flags.map(|(name, value)| (name, ParameterChoice::BoolParam(value)));
    for (name, choice) in choices.into_iter().chain([("sequence_id", id)]) {
        request.parameters.insert(name.into(), InferParameter { parameter_choice: Some(choice) });
    }
    request
}

/// The action of a response with a valid form.
fn action(response: ModelInferResponse) -> Vec<f32> {
    let [output] = response.outputs.as_slice() else { panic!("{response:?}") };
    assert_eq!((output.name.as_str(), output.datatype.as_str()), ("action", "FP32"));
    assert!(output.contents.is_none() && response.raw_output_contents.len() == 1);
    let raw = &response.raw_output_contents[0];
    let values: Vec<f32> = raw.chunks_exact(4).map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap())).collect();
    assert_eq!(output.shape, [1, i64::try_from(values.len()).unwrap()]);
    values
}

async fn infer(client: &mut Client, request: ModelInferRequest) -> Result<Vec<f32>, Status> {
    Ok(action(client.model_infer(request).await?.into_inner()))
}

#[tokio::test]
async fn server_and_models_have_metadata() {
    let shared = shared().await;
    let mut client = connect(&shared.server).await;
    assert!(client.server_live(ServerLiveRequest {}).await.unwrap().into_inner().live);
    assert!(client.server_ready(ServerReadyRequest {}).await.unwrap().into_inner().ready);
    let server = client.server_metadata(ServerMetadataRequest {}).await.unwrap().into_inner();
    assert_eq!((server.name.as_str(), server.extensions[0].as_str()), ("gleaner", "sequence"));

    let current = shared.policy.clone();
    for (name, version, ready) in [
        (NAME, "", true),
        (NAME, current.as_str(), true),
        (NAME, "pol_01ARZ3NDEKTSV4RRFFQ69G5FAV", false),
        ("absent", "", false),
    ] {
        let request = ModelReadyRequest { name: name.into(), version: version.into() };
        assert_eq!(client.model_ready(request).await.unwrap().into_inner().ready, ready, "{name} {version}");
    }
    let request = ModelMetadataRequest { name: NAME.into(), version: String::new() };
    let model = client.model_metadata(request).await.unwrap().into_inner();
    assert_eq!((model.name.as_str(), model.versions.as_slice()), (NAME, std::slice::from_ref(&current)));
    let inputs: HashMap<&str, (&str, &[i64])> =
        model.inputs.iter().map(|input| (input.name.as_str(), (input.datatype.as_str(), &input.shape[..]))).collect();
    assert_eq!(inputs["table"], ("UINT8", &[16i64, 16, 3][..]));
    assert_eq!(inputs["hand.depth"], ("UINT16", &[16i64, 16][..]));
    assert_eq!(inputs.len(), 6);
    assert_eq!((model.outputs[0].name.as_str(), model.outputs[0].shape[0]), ("action", -1));
    let models = client.repository_index(RepositoryIndexRequest::default()).await.unwrap().into_inner().models;
    assert!(models.iter().any(|model| model.name == NAME && model.version == current && model.state == "READY"));
}

#[tokio::test]
async fn single_request_equals_act() {
    let shared = shared().await;
    let (mut client, mut api) = (connect(&shared.server).await, Api::connect(&shared.server).await);
    let observation = observe(&start_sim());
    let act = ActRequest { deployment: NAME.into(), observations: vec![observation.clone()] };
    let expected = api.policies.act(act).await.unwrap().into_inner().actions[0].values.clone();

    let raw = request(&observation);
    let reply = client.model_infer(raw.clone()).await.unwrap().into_inner();
    assert_eq!((reply.model_name.as_str(), reply.id.as_str()), (NAME, "a request"));
    assert_eq!(reply.model_version, shared.policy);
    assert!(close(&action(reply), &expected));

    let mut typed = raw;
    for (input, raw) in typed.inputs.iter_mut().zip(std::mem::take(&mut typed.raw_input_contents)) {
        let mut contents = InferTensorContents::default();
        match input.datatype.as_str() {
            "UINT8" => contents.uint_contents = raw.iter().map(|&byte| byte.into()).collect(),
            "UINT16" => {
                let pair = |bytes: &[u8]| u16::from_le_bytes(bytes.try_into().unwrap()).into();
                contents.uint_contents = raw.chunks_exact(2).map(pair).collect();
            }
            _ => contents.fp32_contents.clone_from(&observation.proprioception),
        }
        input.contents = Some(Box::new(contents));
    }
    assert!(close(&infer(&mut client, typed).await.unwrap(), &expected));
}

#[tokio::test]
async fn sequence_uses_its_own_history_only() {
    let shared = shared().await;
    let (mut client, mut api) = (connect(&shared.server).await, Api::connect(&shared.server).await);
    let mut sim = start_sim();
    let mut window: Vec<Observation> = Vec::new();
    let mut last: Vec<f32> = Vec::new();
    let (id, other) = (ParameterChoice::Uint64Param(41), ParameterChoice::StringParam("41".into()));
    for step in 0..5 {
        let seen = observe(&sim);
        window.push(Observation { executed_action: last.clone(), ..seen.clone() });
        let acted = infer(&mut client, at(request(&seen), id.clone(), step == 0, step == 4)).await.unwrap();
        infer(&mut client, at(request(&seen), other.clone(), true, false)).await.unwrap();
        let act = ActRequest { deployment: NAME.into(), observations: window.clone() };
        let expected = api.policies.act(act).await.unwrap().into_inner().actions[0].values.clone();
        assert!(close(&acted, &expected), "{acted:?} and {expected:?} at {step}");
        sim.step(acted.as_slice().try_into().unwrap());
        last = acted;
    }
    let ended = infer(&mut client, at(request(&window[0]), id, false, false)).await.unwrap_err();
    assert_eq!(ended.code(), Code::InvalidArgument, "{ended}");
    assert!(ended.message().starts_with("parameters.sequence_id: "), "{ended}");
}

type Change = fn(&mut ModelInferRequest);

#[tokio::test]
async fn invalid_inference_requests_are_rejected() {
    let shared = shared().await;
    let mut client = connect(&shared.server).await;
    let good = request(&observe(&start_sim()));
    assert_eq!(good.inputs.len(), 5, "the cases below count on it");
    let cases: [(Code, &str, Change); 12] = [
        (Code::NotFound, "absent", |r| r.model_name = "absent".into()),
        (Code::NotFound, NAME, |r| r.model_version = "pol_01ARZ3NDEKTSV4RRFFQ69G5FAV".into()),
        (Code::InvalidArgument, "model_version: ", |r| r.model_version = "1".into()),
        (Code::InvalidArgument, "inputs[0].name: ", |r| r.inputs[0].name = "ceiling".into()),
        (Code::InvalidArgument, "inputs.proprioception: is missing", |r| {
            r.inputs.pop();
            r.raw_input_contents.pop();
        }),
        (Code::InvalidArgument, "inputs.table: has datatype", |r| r.inputs[0].datatype = "FP32".into()),
        (Code::InvalidArgument, "inputs.table: has shape", |r| r.inputs[0].shape = vec![i64::MAX; 9]),
        (Code::InvalidArgument, "inputs.hand.depth: has 2 bytes", |r| r.raw_input_contents[3] = vec![0; 2].into()),
        (Code::InvalidArgument, "inputs.hand: ", |r| {
            (r.inputs[2].datatype, r.inputs[2].shape) = ("BYTES".into(), vec![1]);
            r.raw_input_contents[2] = [&9u32.to_le_bytes()[..], b"\xff\xd8\xff broke"].concat().into();
        }),
        (Code::InvalidArgument, "inputs.proprioception[0]: is NaN", |r| {
            let mut raw = r.raw_input_contents[4].to_vec();
            raw[..4].copy_from_slice(&f32::NAN.to_le_bytes());
            r.raw_input_contents[4] = raw.into();
        }),
        (Code::InvalidArgument, "outputs[0].name: ", |r| {
            r.outputs.push(gleaner_proto::inference::model_infer_request::InferRequestedOutputTensor::default());
        }),
        (Code::InvalidArgument, "parameters: ", |r| {
            r.parameters.insert("priority".into(), InferParameter::default());
        }),
    ];
    for (code, words, change) in cases {
        let mut request = good.clone();
        change(&mut request);
        let status = infer(&mut client, request).await.unwrap_err();
        assert_eq!(status.code(), code, "{status}");
        assert!(status.message().contains(words), "{words:?} is not in {:?}", status.message());
    }
    infer(&mut client, good).await.unwrap();
}
