//! The response of an inference: one tensor with raw values.

use std::collections::BTreeMap;

use gleaner_proto::inference::{ModelInferResponse, model_infer_response::InferOutputTensor};

use super::{ACTION, tensors::Tensors};
use crate::{
    domain::id::PolicyId,
    error::{Error, Result},
};

/// Actions `[chunk, A]`, with the deployment and the id of the request.
pub(crate) fn infer_response(
    (deployment, id): (String, String),
    policy: &PolicyId,
    tensors: &Tensors,
    actions: &[Vec<f32>],
) -> Result<ModelInferResponse> {
    let chunk = i64::try_from(actions.len()).map_err(|error| Error::internal("counting actions", error))?;
    let raw = actions.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
    Ok(ModelInferResponse {
        model_name: deployment,
        model_version: policy.to_string(),
        id,
        parameters: BTreeMap::new(),
        outputs: vec![InferOutputTensor {
            name: ACTION.to_owned(),
            datatype: "FP32".to_owned(),
            shape: vec![chunk, tensors.action],
            parameters: BTreeMap::new(),
            contents: None,
        }],
        raw_output_contents: vec![raw],
    })
}
