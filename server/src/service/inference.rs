//! GRPCInferenceService: the same deployments for clients of the Open Inference Protocol.

use gleaner_proto::inference::{grpc_inference_service_server::GrpcInferenceService, *};
use tonic::{Request, Response};

use super::{
    Services,
    answer::{Reply, answer},
};
use crate::{
    access::Caller,
    error::Kind,
    wire::inference::{self, PATH, Tensors},
};

/// Serves the Open Inference Protocol.
pub(crate) struct InferenceApi(pub(crate) Services);

#[tonic::async_trait]
impl GrpcInferenceService for InferenceApi {
    async fn server_live(&self, _: Request<ServerLiveRequest>) -> Reply<ServerLiveResponse> {
        Ok(Response::new(ServerLiveResponse { live: true }))
    }

    async fn server_ready(&self, _: Request<ServerReadyRequest>) -> Reply<ServerReadyResponse> {
        Ok(Response::new(ServerReadyResponse { ready: !self.0.stopping.is_cancelled() }))
    }

    /// A policy is loaded and has answered before a name points at it, so an existing name is ready.
    async fn model_ready(&self, request: Request<ModelReadyRequest>) -> Reply<ModelReadyResponse> {
        answer(async {
            let caller = Caller::of(&request)?;
            let ModelReadyRequest { name, version } = request.into_inner();
            let (name, version) = inference::model("", name, &version)?;
            caller.uses(&name)?;
            let ready = match self.0.store.deployment(&name).await {
                Ok(deployment) => version.is_none_or(|version| deployment.policy_id() == Some(&version)),
                Err(error) if error.kind() == Kind::NotFound => false,
                Err(error) => return Err(error),
            };
            Ok(ModelReadyResponse { ready: ready && !self.0.stopping.is_cancelled() })
        })
        .await
    }

    async fn server_metadata(&self, _: Request<ServerMetadataRequest>) -> Reply<ServerMetadataResponse> {
        Ok(Response::new(inference::server_metadata()))
    }

    async fn model_metadata(&self, request: Request<ModelMetadataRequest>) -> Reply<ModelMetadataResponse> {
        answer(async {
            let caller = Caller::of(&request)?;
            let ModelMetadataRequest { name, version } = request.into_inner();
            let (name, version) = inference::model("", name, &version)?;
            caller.uses(&name)?;
            let endpoint = self.0.policies.endpoint(&name, version.as_ref(), None).await?;
            Ok(inference::model_metadata(name, endpoint.policy_id(), &Tensors::of(&endpoint.shape())?))
        })
        .await
    }

    async fn model_infer(&self, request: Request<ModelInferRequest>) -> Reply<ModelInferResponse> {
        answer(async {
            let caller = Caller::of(&request)?;
            let inference::Request { deployment, version, id, place, inputs } =
                inference::request(request.into_inner())?;
            caller.uses(&deployment)?;
            let endpoint = self.0.policies.endpoint(&deployment, version.as_ref(), place).await?;
            let (policy, tensors) = (endpoint.policy_id().clone(), Tensors::of(&endpoint.shape())?);
            let observation = inference::observation(&tensors, inputs)?;
            let actions = endpoint.act(PATH, observation).await.map_err(|error| tensors.name(error))?;
            inference::infer_response((deployment, id), &policy, &tensors, &actions)
        })
        .await
    }

    async fn repository_index(&self, request: Request<RepositoryIndexRequest>) -> Reply<RepositoryIndexResponse> {
        answer(async {
            let caller = Caller::of(&request)?;
            inference::repository(request.into_inner())?;
            let mut deployments = self.0.store.deployments(None).await?;
            deployments.retain(|deployment| caller.sees(&deployment.name));
            Ok(inference::repository_index(deployments))
        })
        .await
    }
}
