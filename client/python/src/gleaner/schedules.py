"""Schedules: pipelines that the server starts by time or after new labels."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from gleaner import settings
from gleaner._pipeline import pipeline_spec
from gleaner._proto.v1 import schedule_pb2 as pb
from gleaner._rpc import Rpc
from gleaner.types import Schedule

if TYPE_CHECKING:
    from typing_extensions import Unpack

_PAGE = 500


class Schedules:
    """`client.schedules`. A schedule is named by its id or by the `Schedule` itself."""

    def __init__(self, rpc: Rpc) -> None:
        self._rpc = rpc

    def create(
        self,
        task: str,
        name: str,
        *,
        cron: str | None = None,
        labelled_episodes: int | None = None,
        engine_options: str = "",
        **stages: Unpack[settings.PipelineStages],
    ) -> Schedule:
        """Creates a schedule of a pipeline, with stages as those of `client.jobs.pipeline`.

        It runs at the times of `cron`, five fields in UTC such as `"0 2 * * *"`, or after each `labelled_episodes`
        newly labelled episodes. `engine_options` are those of every job that it starts.

        Raises `InvalidArgument` naming the field, `AlreadyExists` when the task has a schedule of this name.
        """
        if (cron is None) == (labelled_episodes is None):
            raise ValueError("cron, labelled_episodes: give one of the two")
        request = pb.CreateScheduleRequest(
            task=task,
            name=name,
            cron=cron,
            labelled_episodes=labelled_episodes,
            pipeline=pipeline_spec(stages),
            engine_options=engine_options,
        )
        return self._rpc.unary("ScheduleService/CreateSchedule", request, pb.CreateScheduleResponse).schedule

    def list(self, task: str = "") -> Iterator[Schedule]:
        """Schedules with their next run, oldest first, of one task or of all. Fetched lazily, page by page."""
        request = pb.ListSchedulesRequest(task=task, page_size=_PAGE)
        while True:
            reply = self._rpc.safe("ScheduleService/ListSchedules", request, pb.ListSchedulesResponse)
            yield from reply.schedules
            if not reply.next_page_token:
                return
            request.page_token = reply.next_page_token

    def pause(self, schedule: str | Schedule) -> Schedule:
        """Pauses a schedule; its running jobs continue. Raises `NotFound`."""
        return self._pause(schedule, paused=True)

    def resume(self, schedule: str | Schedule) -> Schedule:
        """Resumes a schedule; runs and labels during the pause are not caught up. Raises `NotFound`."""
        return self._pause(schedule, paused=False)

    def delete(self, schedule: str | Schedule) -> None:
        """Deletes a schedule; its jobs stay. Raises `NotFound`."""
        request = pb.DeleteScheduleRequest(schedule_id=_id(schedule))
        self._rpc.unary("ScheduleService/DeleteSchedule", request, pb.DeleteScheduleResponse)

    def _pause(self, schedule: str | Schedule, *, paused: bool) -> Schedule:
        request = pb.PauseScheduleRequest(schedule_id=_id(schedule), paused=paused)
        return self._rpc.unary("ScheduleService/PauseSchedule", request, pb.PauseScheduleResponse).schedule


def _id(schedule: str | Schedule) -> str:
    return schedule if isinstance(schedule, str) else schedule.id
