"""Policies: trained models, their deployments and evaluations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gleaner._messages import build
from gleaner._pages import PAGE, pages
from gleaner._proto.v1 import policy_pb2 as pb
from gleaner._rpc import Rpc
from gleaner.types import Deployment, Evaluation, PolicyRecord, SeedResult


class Policies:
    """`client.policies`. To act with one, see `gleaner.Policy`."""

    def __init__(self, rpc: Rpc) -> None:
        self._rpc = rpc

    def register(
        self,
        task: str,
        protocol: str,
        address: str,
        *,
        model: str = "",
        model_version: str = "",
        inputs: Mapping[str, Mapping[str, Any]] | None = None,
        output: str = "",
        chunk_length: int = 1,
        execute_length: int = 1,
        sequences: bool = False,
        answer_within_ms: int = 0,
        source: str = "",
    ) -> PolicyRecord:
        """Registers a policy that another server runs, for example your own PyTorch model.

        `protocol` is `open-inference` (Triton, gleaner) or `openpi`. `inputs` maps each tensor or key to a value of the
        task: `{"observation/image": {"camera": "top"}, "prompt": {"text": "pick"}}`, with one of `camera`,
        `camera_planes`, `depth`, `field`, `text`, `proprioception: True`, `executed_action: True`; None: every camera
        and the proprioception under the names of gleaner's servers. `chunk_length` is the most actions of an answer,
        `execute_length` how many are executed before the next is requested (0: the mean of all predictions for a step).
        Needs the role admin, and a server that allows the host (`--policy-servers`).
        """
        request = pb.RegisterPolicyRequest(
            task=task,
            remote=build(
                pb.RemotePolicy,
                {
                    "protocol": protocol.replace("-", "_"),
                    "address": address,
                    "model": model,
                    "model_version": model_version,
                    "inputs": [{"name": name, **value} for name, value in (inputs or {}).items()],
                    "output": output,
                    "chunk_length": chunk_length,
                    "execute_length": execute_length,
                    "sequences": sequences,
                    "answer_within_ms": answer_within_ms,
                    "source": source,
                },
            ),
        )
        return self._rpc.unary("PolicyService/RegisterPolicy", request, pb.RegisterPolicyResponse).policy

    def deploy(self, name: str, policy_id: str, *, score_run: str = "", hide_history: bool = False) -> Deployment:
        """Points a deployment's name at a policy, once it is loaded and warmed up.

        Sessions are scored by the score run, a finished one of the same task and of ssdf; empty: no live scores. With
        `hide_history` the policy acts on the newest step alone, or without its past actions if it was trained with
        hidden_history "actions"; it must have been trained with history_dropout above 0.
        """
        request = pb.DeployRequest(name=name, policy_id=policy_id, score_run_id=score_run, hide_history=hide_history)
        return self._rpc.unary("PolicyService/Deploy", request, pb.DeployResponse).deployment

    def rollback(self, name: str) -> Deployment:
        """Points a deployment's name back at its previous policy; calling it twice goes back two."""
        request = pb.RollBackRequest(name=name)
        return self._rpc.unary("PolicyService/RollBack", request, pb.RollBackResponse).deployment

    def undeploy(self, name: str) -> None:
        """Deletes a deployment with its history. Running sessions keep their policy until they end."""
        self._rpc.unary(
            "PolicyService/DeleteDeployment", pb.DeleteDeploymentRequest(name=name), pb.DeleteDeploymentResponse
        )

    def deployments(self, task: str = "") -> list[Deployment]:
        """Deployments with their history, of one task or of all."""
        request = pb.ListDeploymentsRequest(task=task, page_size=PAGE)
        found = pages(self._rpc, "PolicyService/ListDeployments", request, pb.ListDeploymentsResponse)
        return [deployment for page in found for deployment in page.deployments]

    def report(self, policy_id: str, simulation: str, seeds: Sequence[SeedResult]) -> Evaluation:
        """Stores the result of trials that ran elsewhere; `simulation` is for example metaworld/pick-place-v3."""
        request = pb.ReportEvaluationRequest(policy_id=policy_id, simulation=simulation, seeds=seeds)
        return self._rpc.unary("PolicyService/ReportEvaluation", request, pb.ReportEvaluationResponse).evaluation

    def evaluations(self, policy_id: str) -> list[Evaluation]:
        """A policy's evaluations, newest first."""
        request = pb.ListEvaluationsRequest(policy_id=policy_id, page_size=PAGE)
        found = pages(self._rpc, "PolicyService/ListEvaluations", request, pb.ListEvaluationsResponse)
        return [evaluation for page in found for evaluation in page.evaluations]

    def evaluation(self, evaluation_id: str) -> Evaluation:
        """Returns an evaluation. Raises `FailedPrecondition` while its job has not succeeded."""
        request = pb.GetEvaluationRequest(evaluation_id=evaluation_id)
        return self._rpc.safe("PolicyService/GetEvaluation", request, pb.GetEvaluationResponse).evaluation

    def list(self, task: str) -> list[PolicyRecord]:
        """A task's policies, newest first."""
        request = pb.ListPoliciesRequest(task=task, page_size=PAGE)
        found = pages(self._rpc, "PolicyService/ListPolicies", request, pb.ListPoliciesResponse)
        return [policy for page in found for policy in page.policies]
