//! PolicyService: deployments, and robots' access to them.

use std::sync::{Arc, OnceLock};

use futures::{StreamExt as _, stream::BoxStream};
use gleaner_proto::v1::{self, policy_service_server::PolicyService};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Streaming};

use super::Services;
use crate::{
    access::Caller,
    domain::{
        evaluation::Evaluation,
        id::EvaluationId,
        observation::{SessionInput, SessionOutput},
        time::Millis,
    },
    error::Result,
    telemetry::metrics::SessionMetrics,
    wire::{
        self,
        status::{from_error, from_peer},
    },
};

/// Serves policies.
pub(crate) struct PoliciesFace(pub(crate) Services);

impl PoliciesFace {
    async fn list(&self, task: &str) -> Result<v1::ListPoliciesResponse> {
        let task = self.0.store.task(task).await?;
        let policies = self.0.store.policies(&task.id).await?;
        Ok(v1::ListPoliciesResponse { policies: policies.into_iter().map(wire::policy::policy).collect() })
    }

    async fn point(&self, request: v1::DeployRequest) -> Result<v1::DeployResponse> {
        let (name, policy, score_run) = wire::policy::deploy_request(request)?;
        let deployment = self.0.policies.deploy(&name, &policy, score_run.as_ref()).await?;
        Ok(v1::DeployResponse { deployment: Some(wire::policy::deployment(deployment)) })
    }

    async fn point_back(&self, request: v1::RollBackRequest) -> Result<v1::RollBackResponse> {
        let name = wire::policy::roll_back_request(request)?;
        let deployment = self.0.policies.roll_back(&name).await?;
        Ok(v1::RollBackResponse { deployment: Some(wire::policy::deployment(deployment)) })
    }

    async fn list_names(&self, caller: &Caller, task: &str) -> Result<v1::ListDeploymentsResponse> {
        let task = if task.is_empty() { None } else { Some(self.0.store.task(task).await?.id) };
        let mut deployments = self.0.store.deployments(task.as_ref()).await?;
        deployments.retain(|deployment| caller.sees(&deployment.name));
        Ok(v1::ListDeploymentsResponse { deployments: deployments.into_iter().map(wire::policy::deployment).collect() })
    }

    async fn report(&self, request: v1::ReportEvaluationRequest) -> Result<v1::ReportEvaluationResponse> {
        let (policy, simulation, seeds) = wire::evaluation::report_request(request)?;
        let evaluation = Evaluation {
            id: EvaluationId::new(),
            policy_id: self.0.store.policy(&policy).await?.id,
            job_id: None,
            simulation,
            seeds,
            created_at: Millis::now(),
        };
        self.0.store.insert_evaluation(&evaluation).await?;
        Ok(v1::ReportEvaluationResponse { evaluation: Some(wire::evaluation::evaluation(evaluation)) })
    }

    async fn evaluations(&self, policy: &str) -> Result<v1::ListEvaluationsResponse> {
        let policy = self.0.store.policy(&wire::evaluation::policy_id(policy)?).await?;
        let evaluations = self.0.store.evaluations(&policy.id).await?;
        let evaluations = evaluations.into_iter().map(wire::evaluation::evaluation).collect();
        Ok(v1::ListEvaluationsResponse { evaluations })
    }

    async fn evaluation(&self, id: &str) -> Result<v1::GetEvaluationResponse> {
        let evaluation = self.0.store.evaluation(&wire::evaluation::evaluation_id(id)?).await?;
        Ok(v1::GetEvaluationResponse { evaluation: Some(wire::evaluation::evaluation(evaluation)) })
    }

    async fn answer(&self, caller: &Caller, request: v1::ActRequest) -> Result<v1::ActResponse> {
        let (deployment, observations) = wire::policy::act_request(request)?;
        caller.uses(&deployment)?;
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

    async fn roll_back(&self, request: Request<v1::RollBackRequest>) -> tonic::Result<Response<v1::RollBackResponse>> {
        self.point_back(request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    async fn report_evaluation(
        &self,
        request: Request<v1::ReportEvaluationRequest>,
    ) -> tonic::Result<Response<v1::ReportEvaluationResponse>> {
        self.report(request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    async fn list_evaluations(
        &self,
        request: Request<v1::ListEvaluationsRequest>,
    ) -> tonic::Result<Response<v1::ListEvaluationsResponse>> {
        let v1::ListEvaluationsRequest { policy_id } = request.into_inner();
        self.evaluations(&policy_id).await.map(Response::new).map_err(from_error)
    }

    async fn get_evaluation(
        &self,
        request: Request<v1::GetEvaluationRequest>,
    ) -> tonic::Result<Response<v1::GetEvaluationResponse>> {
        let v1::GetEvaluationRequest { evaluation_id } = request.into_inner();
        self.evaluation(&evaluation_id).await.map(Response::new).map_err(from_error)
    }

    async fn list_deployments(
        &self,
        request: Request<v1::ListDeploymentsRequest>,
    ) -> tonic::Result<Response<v1::ListDeploymentsResponse>> {
        let caller = Caller::of(&request).map_err(from_error)?;
        let v1::ListDeploymentsRequest { task } = request.into_inner();
        self.list_names(&caller, &task).await.map(Response::new).map_err(from_error)
    }

    async fn act(&self, request: Request<v1::ActRequest>) -> tonic::Result<Response<v1::ActResponse>> {
        let caller = Caller::of(&request).map_err(from_error)?;
        self.answer(&caller, request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    async fn session(
        &self,
        request: Request<Streaming<v1::SessionRequest>>,
    ) -> tonic::Result<Response<Self::SessionStream>> {
        let caller = Caller::of(&request).map_err(from_error)?;
        let metrics = Arc::new(OnceLock::new());
        let opened = Arc::clone(&metrics);
        let read = move |message: tonic::Result<v1::SessionRequest>| {
            let input = message.map_err(from_peer).and_then(wire::session::session_input)?;
            if let SessionInput::Open(settings) = &input {
                caller.uses(&settings.deployment)?;
                if let Some(cohort) = &settings.record {
                    caller.records_as(&settings.deployment, cohort)?;
                }
                opened.get_or_init(|| SessionMetrics::new(settings.deployment.clone()));
            }
            Ok(input)
        };
        let inputs = request.into_inner().map(read).boxed();
        let answers = self.0.policies.session(inputs, self.0.stopping.clone());
        let say = move |answer: Result<SessionOutput>| {
            if let (Ok(answer), Some(metrics)) = (&answer, metrics.get()) {
                metrics.say(answer);
            }
            answer.map(wire::session::session_response).map_err(from_error)
        };
        Ok(Response::new(ReceiverStream::new(answers).map(say).boxed()))
    }
}
