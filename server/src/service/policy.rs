//! PolicyService: policies, deployments, evaluations, and robots' access to them.

use std::sync::{Arc, OnceLock};

use futures::StreamExt as _;
use gleaner_proto::v1::{self, policy_service_server::PolicyService};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Streaming};

use super::{
    Services,
    answer::{Reply, Responses, answer, change, responses},
};
use crate::{
    access::{AuditDraft, Caller},
    domain::{evaluation::Evaluation, id::EvaluationId, observation::SessionInput, time::Millis},
    telemetry::metrics::SessionMetrics,
    wire::{self, status::from_peer},
};

/// Serves policies.
pub(crate) struct PolicyApi(pub(crate) Services);

#[tonic::async_trait]
impl PolicyService for PolicyApi {
    async fn list_policies(&self, request: Request<v1::ListPoliciesRequest>) -> Reply<v1::ListPoliciesResponse> {
        answer(async {
            let (task, page) = wire::policy::list_request(request.into_inner())?;
            let task = self.0.store.task(&task).await?;
            let (policies, next) = self.0.store.policies_page(&task.id, &page).await?;
            let policies = policies.into_iter().map(wire::policy::policy).collect();
            Ok(v1::ListPoliciesResponse { policies, next_page_token: wire::page::token(next) })
        })
        .await
    }

    async fn register_policy(&self, request: Request<v1::RegisterPolicyRequest>) -> Reply<v1::RegisterPolicyResponse> {
        change(request, async |request| {
            let (task, remote) = wire::remote::register_request(request)?;
            let policy = self.0.policies.register(&self.0.store.task(&task).await?, remote).await?;
            Ok(v1::RegisterPolicyResponse { policy: Some(wire::policy::policy(policy)) })
        })
        .await
    }

    async fn deploy(&self, request: Request<v1::DeployRequest>) -> Reply<v1::DeployResponse> {
        change(request, async |request| {
            let (name, assignment) = wire::policy::deploy_request(request)?;
            let deployment = self.0.policies.deploy(&name, assignment).await?;
            Ok(v1::DeployResponse { deployment: Some(wire::policy::deployment(deployment)) })
        })
        .await
    }

    async fn roll_back(&self, request: Request<v1::RollBackRequest>) -> Reply<v1::RollBackResponse> {
        change(request, async |request| {
            let deployment = self.0.policies.roll_back(&wire::policy::roll_back_request(request)?).await?;
            Ok(v1::RollBackResponse { deployment: Some(wire::policy::deployment(deployment)) })
        })
        .await
    }

    async fn delete_deployment(
        &self,
        request: Request<v1::DeleteDeploymentRequest>,
    ) -> Reply<v1::DeleteDeploymentResponse> {
        change(request, async |request| {
            self.0.policies.delete(&wire::policy::delete_request(request)?).await?;
            Ok(v1::DeleteDeploymentResponse {})
        })
        .await
    }

    async fn report_evaluation(
        &self,
        request: Request<v1::ReportEvaluationRequest>,
    ) -> Reply<v1::ReportEvaluationResponse> {
        change(request, async |request| {
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
        })
        .await
    }

    async fn list_evaluations(
        &self,
        request: Request<v1::ListEvaluationsRequest>,
    ) -> Reply<v1::ListEvaluationsResponse> {
        answer(async {
            let (policy, page) = wire::evaluation::list_request(request.into_inner())?;
            let policy = self.0.store.policy(&policy).await?;
            let (evaluations, next) = self.0.store.evaluations_page(&policy.id, &page).await?;
            let evaluations = evaluations.into_iter().map(wire::evaluation::evaluation).collect();
            Ok(v1::ListEvaluationsResponse { evaluations, next_page_token: wire::page::token(next) })
        })
        .await
    }

    async fn get_evaluation(&self, request: Request<v1::GetEvaluationRequest>) -> Reply<v1::GetEvaluationResponse> {
        answer(async {
            let id = wire::evaluation::evaluation_id(&request.get_ref().evaluation_id)?;
            let evaluation = wire::evaluation::evaluation(self.0.store.evaluation(&id).await?);
            Ok(v1::GetEvaluationResponse { evaluation: Some(evaluation) })
        })
        .await
    }

    async fn list_deployments(
        &self,
        request: Request<v1::ListDeploymentsRequest>,
    ) -> Reply<v1::ListDeploymentsResponse> {
        answer(async {
            let caller = Caller::of(&request)?;
            let (task, page) = wire::policy::deployments_request(request.into_inner())?;
            let task = self.0.task_or_all(&task).await?;
            let (deployments, next) = self.0.store.deployments_page(task.as_ref(), caller.bound(), &page).await?;
            let deployments = deployments.into_iter().map(wire::policy::deployment).collect();
            Ok(v1::ListDeploymentsResponse { deployments, next_page_token: wire::policy::deployments_token(next) })
        })
        .await
    }

    async fn act(&self, request: Request<v1::ActRequest>) -> Reply<v1::ActResponse> {
        answer(async {
            let caller = Caller::of(&request)?;
            let (deployment, observations) = wire::policy::act_request(request.into_inner())?;
            caller.uses(&deployment)?;
            Ok(wire::policy::act_response(self.0.policies.act(&deployment, observations).await?))
        })
        .await
    }

    type SessionStream = Responses<v1::SessionResponse>;

    /// The audit entry of a session names the first message of each direction. The guard writes it when the response ends.
    async fn session(&self, request: Request<Streaming<v1::SessionRequest>>) -> Reply<Self::SessionStream> {
        let (caller, audit) = (Caller::of(&request), AuditDraft::of(&request));
        answer(async {
            let (caller, audit) = (caller?, audit?);
            let metrics = Arc::new(OnceLock::new());
            let (opened, draft) = (Arc::clone(&metrics), audit.clone());
            let inputs = request.into_inner().enumerate().map(move |(at, message)| {
                let message = message.map_err(from_peer)?;
                if at == 0 {
                    draft.about(&message);
                }
                let input = wire::session::session_input(message)?;
                if let SessionInput::Open(settings) = &input {
                    caller.uses(&settings.deployment)?;
                    if let Some(cohort) = &settings.record {
                        caller.records_as(&settings.deployment, cohort)?;
                    }
                    opened.get_or_init(|| SessionMetrics::new(settings.deployment.clone()));
                }
                Ok(input)
            });
            let outputs = self.0.policies.session(inputs.boxed(), self.0.stopping.clone());
            Ok(responses(ReceiverStream::new(outputs).enumerate().map(move |(at, output)| {
                let output = output?;
                if let Some(metrics) = metrics.get() {
                    metrics.record(&output);
                }
                let response = wire::session::session_response(output);
                if at == 0 {
                    audit.about(&response);
                }
                Ok(response)
            })))
        })
        .await
    }
}
