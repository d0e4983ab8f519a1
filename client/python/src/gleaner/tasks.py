"""Tasks: named robot skills, and the place of their steps in recordings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gleaner._messages import build
from gleaner._pages import PAGE, pages
from gleaner._proto.v1 import task_pb2 as pb
from gleaner._rpc import Rpc
from gleaner.types import Task, TaskSpec


class Tasks:
    """`client.tasks`."""

    def __init__(self, rpc: Rpc) -> None:
        self._rpc = rpc

    def create(self, spec: TaskSpec | Mapping[str, Any]) -> Task:
        """Creates a task from its spec, for example from a TOML file read with `tomllib`.

        Raises `InvalidArgument` naming the field, `AlreadyExists` when the name is taken.
        """
        if not isinstance(spec, TaskSpec):
            spec = build(TaskSpec, spec)
        return self._rpc.unary("TaskService/CreateTask", pb.CreateTaskRequest(spec=spec), pb.CreateTaskResponse).task

    def get(self, task: str) -> Task:
        """Returns a task by name or id. Raises `NotFound`."""
        return self._rpc.safe("TaskService/GetTask", pb.GetTaskRequest(task=task), pb.GetTaskResponse).task

    def list(self) -> list[Task]:
        """Every task, oldest first."""
        request = pb.ListTasksRequest(page_size=PAGE)
        found = pages(self._rpc, "TaskService/ListTasks", request, pb.ListTasksResponse)
        return [task for page in found for task in page.tasks]

    def update(self, task: str, spec: TaskSpec | Mapping[str, Any]) -> Task:
        """Replaces the spec of a task: anything without episodes and results, afterwards mappings that read no episode.

        Raises `FailedPrecondition` naming the field that cannot change, `NotFound`, `InvalidArgument`.
        """
        if not isinstance(spec, TaskSpec):
            spec = build(TaskSpec, spec)
        request = pb.UpdateTaskRequest(task=task, spec=spec)
        return self._rpc.unary("TaskService/UpdateTask", request, pb.UpdateTaskResponse).task

    def delete(self, task: str) -> None:
        """Deletes a task that has no episodes and results. Raises `FailedPrecondition` while it has, `NotFound`."""
        self._rpc.unary("TaskService/DeleteTask", pb.DeleteTaskRequest(task=task), pb.DeleteTaskResponse)
