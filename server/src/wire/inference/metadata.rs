//! The metadata of this server and its models.

use gleaner_proto::inference::{
    ModelMetadataResponse, RepositoryIndexResponse, ServerMetadataResponse, model_metadata_response::TensorMetadata,
    repository_index_response::ModelIndex,
};

use super::{ACTION, tensors::Tensors};
use crate::domain::{id::PolicyId, policy::Deployment};

pub(crate) fn server_metadata() -> ServerMetadataResponse {
    ServerMetadataResponse {
        name: "gleaner".to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        extensions: vec!["sequence".to_owned(), "model_repository".to_owned()],
    }
}

pub(crate) fn model_metadata(deployment: String, policy: &PolicyId, tensors: &Tensors) -> ModelMetadataResponse {
    let metadata = |name: &str, datatype: &str, shape: &[i64]| TensorMetadata {
        name: name.to_owned(),
        datatype: datatype.to_owned(),
        shape: shape.to_vec(),
    };
    ModelMetadataResponse {
        name: deployment,
        versions: vec![policy.to_string()],
        platform: "gleaner".to_owned(),
        inputs: tensors.inputs.iter().map(|tensor| metadata(&tensor.name, tensor.datatype(), &tensor.shape)).collect(),
        // The policy determines the number of actions in a chunk.
        outputs: vec![metadata(ACTION, "FP32", &[-1, tensors.action])],
    }
}

pub(crate) fn repository_index(deployments: Vec<Deployment>) -> RepositoryIndexResponse {
    let models = deployments.into_iter().map(|deployment| ModelIndex {
        version: deployment.policy_id().map(ToString::to_string).unwrap_or_default(),
        name: deployment.name,
        state: "READY".to_owned(),
        reason: String::new(),
    });
    RepositoryIndexResponse { models: models.collect() }
}
