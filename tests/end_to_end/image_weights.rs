//! Weights of an image encoder, from a folder of the server through a job's submission to its worker.

use std::fs;

use gleaner_proto::v1::*;
use serde_json::{Map, Value, json};
use tempfile::TempDir;
use tonic::Code;

use crate::support::{
    api::Api,
    errors::expect_error,
    lab::{self, RECORDINGS},
    server::TestServer,
};

const NAME: &str = "resnet18.safetensors";

/// The sizes of ResNet-18's tensors by torchvision's names.
fn sizes() -> Vec<(String, Vec<u64>)> {
    let mut sizes = vec![("conv1.weight".to_owned(), vec![64, 3, 7, 7])];
    let norm = |name: &str, channels| {
        ["weight", "bias", "running_mean", "running_var"].map(|part| (format!("{name}.{part}"), vec![channels]))
    };
    sizes.extend(norm("bn1", 64));
    for (stage, channels) in [(1, 64), (2, 128), (3, 256), (4, 512)] {
        for block in [0, 1] {
            let path = format!("layer{stage}.{block}");
            let inputs = if block == 0 && stage > 1 { channels / 2 } else { channels };
            sizes.push((format!("{path}.conv1.weight"), vec![channels, inputs, 3, 3]));
            sizes.push((format!("{path}.conv2.weight"), vec![channels, channels, 3, 3]));
            sizes.extend(["bn1", "bn2"].iter().flat_map(|part| norm(&format!("{path}.{part}"), channels)));
            if inputs != channels {
                sizes.push((format!("{path}.downsample.0.weight"), vec![channels, inputs, 1, 1]));
                sizes.extend(norm(&format!("{path}.downsample.1"), channels));
            }
        }
    }
    sizes
}

/// A safetensors file of ResNet-18 whose weights are all zero.
fn zeros() -> Vec<u8> {
    let (mut header, mut end) = (Map::new(), 0);
    for (name, size) in sizes() {
        let begin = end;
        end += 4 * size.iter().product::<u64>();
        header.insert(name, json!({"dtype": "F32", "shape": size, "data_offsets": [begin, end]}));
    }
    let header = Value::Object(header).to_string();
    let mut bytes = u64::try_from(header.len()).unwrap().to_le_bytes().to_vec();
    bytes.extend(header.bytes());
    bytes.resize(bytes.len() + usize::try_from(end).unwrap(), 0);
    bytes
}

/// A server with an expert and a failure, and its folder of weights.
async fn server() -> (TempDir, TestServer, Api) {
    let folder = tempfile::tempdir().unwrap();
    let flags = ["--image-weights-dir", folder.path().to_str().unwrap()];
    let (server, mut api) = lab::with_task(&flags).await;
    for recording in [&RECORDINGS[0], &RECORDINGS[6]] {
        lab::push(&mut api, lab::TASK, recording).await.unwrap();
    }
    (folder, server, api)
}

fn pretrain() -> job_spec::Spec {
    let settings = json!({"image_encoder": "resnet18", "image_weights": NAME, "batch": 2, "preset": "tiny"});
    lab::with(lab::pretrain(1), settings)
}

#[tokio::test]
async fn a_worker_begins_with_the_weights_that_a_job_names() {
    let (folder, _server, mut api) = server().await;
    let missing = api.submit(lab::TASK, pretrain()).await.unwrap_err();
    expect_error(&missing, Code::FailedPrecondition, &["image_weights", NAME, "--image-weights-dir"]);
    let bytes = zeros();
    fs::write(folder.path().join(NAME), &bytes).unwrap();
    let job = api.succeed(lab::TASK, pretrain()).await;
    let Some(job_spec::Spec::Pretrain(spec)) = job.spec.unwrap().spec else { panic!("not pretrain") };
    let weights = lab::given(&spec.settings)["image_weights"].clone();
    assert_eq!(weights, json!(format!("{NAME}@{}", blake3::hash(&bytes).to_hex())));
}

#[tokio::test]
async fn a_file_that_is_not_of_the_network_fails_the_job_without_a_retry() {
    let (folder, _server, mut api) = server().await;
    fs::write(folder.path().join(NAME), b"PK\x03\x04 a .pth file").unwrap();
    let job = api.submit(lab::TASK, pretrain()).await.unwrap();
    let job = api.watch(&job.id).await;
    assert_eq!((job.state(), job.attempt), (JobState::Failed, 1));
    assert!(job.error.contains("image_weights: the file is not a whole safetensors file"), "{}", job.error);
    assert!(job.error.contains("scripts/convert_resnet.py"), "{}", job.error);
}
