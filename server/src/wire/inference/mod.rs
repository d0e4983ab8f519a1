//! The Open Inference Protocol on the wire: a deployment as a model, a task's shape as tensors.
//!
//! Every message names the tensor by `inputs.<its name>`. Must not depend on how policies run.

mod contents;
mod metadata;
mod parameters;
mod request;
mod response;
mod tensors;

pub(crate) use self::{
    metadata::{model_metadata, repository_index, server_metadata},
    request::{Request, model, observation, repository, request},
    response::infer_response,
    tensors::{PATH, Tensors},
};

/// The output of a policy: `[chunk, A]`.
const ACTION: &str = "action";

/// A client's text within a message: short, without control characters.
fn quoted(text: &str) -> String {
    format!("{:?}", text.chars().take(64).collect::<String>())
}
