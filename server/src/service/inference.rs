//! GRPCInferenceService: the same deployments for clients of the Open Inference Protocol.

use gleaner_proto::inference::{grpc_inference_service_server::GrpcInferenceService, *};
use tonic::{Request, Response};

use super::Services;
use crate::{
    access::Caller,
    error::{Kind, Result},
    wire::{
        inference::{self, PATH, Tensors},
        status::from_error,
    },
};

/// Serves the Open Inference Protocol.
pub(crate) struct InferenceFace(pub(crate) Services);

impl InferenceFace {
    /// A policy is loaded and has answered before a name points at it, so a name that is there is ready.
    async fn ready(&self, caller: &Caller, request: ModelReadyRequest) -> Result<ModelReadyResponse> {
        let ModelReadyRequest { name, version } = request;
        let (name, version) = inference::model("", name, &version)?;
        caller.uses(&name)?;
        let ready = match self.0.store.deployment(&name).await {
            Ok(deployment) => version.is_none_or(|version| deployment.policy_id() == Some(&version)),
            Err(error) if error.kind() == Kind::NotFound => false,
            Err(error) => return Err(error),
        };
        Ok(ModelReadyResponse { ready: ready && !self.0.stopping.is_cancelled() })
    }

    async fn describe(&self, caller: &Caller, request: ModelMetadataRequest) -> Result<ModelMetadataResponse> {
        let ModelMetadataRequest { name, version } = request;
        let (name, version) = inference::model("", name, &version)?;
        caller.uses(&name)?;
        let endpoint = self.0.policies.endpoint(&name, version.as_ref(), None).await?;
        Ok(inference::model_metadata(name, endpoint.policy_id(), &Tensors::of(&endpoint.shape())?))
    }

    async fn infer(&self, caller: &Caller, request: ModelInferRequest) -> Result<ModelInferResponse> {
        let inference::Request { deployment, version, id, place, inputs } = inference::request(request)?;
        caller.uses(&deployment)?;
        let endpoint = self.0.policies.endpoint(&deployment, version.as_ref(), place).await?;
        let (policy, tensors) = (endpoint.policy_id().clone(), Tensors::of(&endpoint.shape())?);
        let observation = inference::observation(&tensors, inputs)?;
        let actions = endpoint.act(PATH, observation).await.map_err(|error| tensors.name(error))?;
        inference::infer_response((deployment, id), &policy, &tensors, &actions)
    }

    async fn index(&self, caller: &Caller, request: RepositoryIndexRequest) -> Result<RepositoryIndexResponse> {
        inference::repository(request)?;
        let mut deployments = self.0.store.deployments(None).await?;
        deployments.retain(|deployment| caller.sees(&deployment.name));
        Ok(inference::repository_index(deployments))
    }
}

#[tonic::async_trait]
impl GrpcInferenceService for InferenceFace {
    async fn server_live(&self, _: Request<ServerLiveRequest>) -> tonic::Result<Response<ServerLiveResponse>> {
        Ok(Response::new(ServerLiveResponse { live: true }))
    }

    async fn server_ready(&self, _: Request<ServerReadyRequest>) -> tonic::Result<Response<ServerReadyResponse>> {
        Ok(Response::new(ServerReadyResponse { ready: !self.0.stopping.is_cancelled() }))
    }

    async fn model_ready(&self, request: Request<ModelReadyRequest>) -> tonic::Result<Response<ModelReadyResponse>> {
        let caller = Caller::of(&request).map_err(from_error)?;
        self.ready(&caller, request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    async fn server_metadata(
        &self,
        _: Request<ServerMetadataRequest>,
    ) -> tonic::Result<Response<ServerMetadataResponse>> {
        Ok(Response::new(inference::server_metadata()))
    }

    async fn model_metadata(
        &self,
        request: Request<ModelMetadataRequest>,
    ) -> tonic::Result<Response<ModelMetadataResponse>> {
        let caller = Caller::of(&request).map_err(from_error)?;
        self.describe(&caller, request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    async fn model_infer(&self, request: Request<ModelInferRequest>) -> tonic::Result<Response<ModelInferResponse>> {
        let caller = Caller::of(&request).map_err(from_error)?;
        self.infer(&caller, request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    async fn repository_index(
        &self,
        request: Request<RepositoryIndexRequest>,
    ) -> tonic::Result<Response<RepositoryIndexResponse>> {
        let caller = Caller::of(&request).map_err(from_error)?;
        self.index(&caller, request.into_inner()).await.map(Response::new).map_err(from_error)
    }
}
