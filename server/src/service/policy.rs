//! PolicyService: deployments, and robots' access to them.

use futures::{StreamExt as _, stream::BoxStream};
use gleaner_proto::v1::{self, policy_service_server::PolicyService};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Streaming};

use super::Rooms;
use crate::{
    error::Result,
    wire::{
        self,
        status::{from_error, from_peer},
    },
};

/// Serves policies.
pub(crate) struct PoliciesFace(pub(crate) Rooms);

impl PoliciesFace {
    async fn list(&self, task: &str) -> Result<v1::ListPoliciesResponse> {
        let task = self.0.store.task(task).await?;
        let policies = self.0.store.policies(&task.id).await?;
        Ok(v1::ListPoliciesResponse { policies: policies.into_iter().map(wire::policy::policy).collect() })
    }

    async fn point(&self, request: v1::DeployRequest) -> Result<v1::DeployResponse> {
        let (name, policy) = wire::policy::deploy_request(request)?;
        let deployment = self.0.policies.deploy(&name, &policy).await?;
        Ok(v1::DeployResponse { deployment: Some(wire::policy::deployment(deployment)) })
    }

    async fn list_names(&self, task: &str) -> Result<v1::ListDeploymentsResponse> {
        let task = if task.is_empty() { None } else { Some(self.0.store.task(task).await?.id) };
        let deployments = self.0.store.deployments(task.as_ref()).await?;
        Ok(v1::ListDeploymentsResponse { deployments: deployments.into_iter().map(wire::policy::deployment).collect() })
    }

    async fn answer(&self, request: v1::ActRequest) -> Result<v1::ActResponse> {
        let (deployment, observations) = wire::policy::act_request(request)?;
        Ok(wire::policy::act_response(self.0.policies.act(&deployment, observations).await?))
    }
}

#[tonic::async_trait]
impl PolicyService for PoliciesFace {
    type SessionStream = BoxStream<'static, tonic::Result<v1::SessionResponse>>;

    async fn list_policies(
        &self,
        request: Request<v1::ListPoliciesRequest>,
    ) -> tonic::Result<Response<v1::ListPoliciesResponse>> {
        let v1::ListPoliciesRequest { task } = request.into_inner();
        self.list(&task).await.map(Response::new).map_err(from_error)
    }

    async fn deploy(&self, request: Request<v1::DeployRequest>) -> tonic::Result<Response<v1::DeployResponse>> {
        self.point(request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    async fn list_deployments(
        &self,
        request: Request<v1::ListDeploymentsRequest>,
    ) -> tonic::Result<Response<v1::ListDeploymentsResponse>> {
        let v1::ListDeploymentsRequest { task } = request.into_inner();
        self.list_names(&task).await.map(Response::new).map_err(from_error)
    }

    async fn act(&self, request: Request<v1::ActRequest>) -> tonic::Result<Response<v1::ActResponse>> {
        self.answer(request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    async fn session(
        &self,
        request: Request<Streaming<v1::SessionRequest>>,
    ) -> tonic::Result<Response<Self::SessionStream>> {
        let inputs = request
            .into_inner()
            .map(|message| message.map_err(from_peer).and_then(wire::policy::session_input))
            .boxed();
        let answers = self.0.policies.session(inputs, self.0.stopping.clone());
        let stream =
            ReceiverStream::new(answers).map(|answer| answer.map(wire::policy::session_response).map_err(from_error));
        Ok(Response::new(stream.boxed()))
    }
}
