"""Tasks of LIBERO, such as libero_spatial/0 (suite and number), as its own evaluations run them.

A seed is one of the task's initial states; ten steps without motion follow, in which objects settle. Pictures are
turned by 180°, as policies for LIBERO expect them. Values are the keys of robosuite, and `state`: position and axis
angle of the hand, and both fingers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from libero.libero import benchmark
from libero.libero.envs.env_wrapper import OffScreenRenderEnv
from numpy.typing import NDArray

from gleaner.errors import invalid
from gleaner.simulators._base import Camera, Seen, Simulator

# Steps before an episode, with the gripper open.
_SETTLING = 10
# Steps of the environment in an episode, the settling ones included, as by LIBERO's own default.
_HORIZON = 1000
_STILL = np.array([0, 0, 0, 0, 0, 0, -1], np.float32)
_ACTION = 7
# Below this a rotation has no axis.
_NO_ROTATION = 1e-8


def make(env_id: str, cameras: list[Camera], **options: Any) -> Libero:
    """The task with cameras that it renders itself. `options` are those of LIBERO's `OffScreenRenderEnv`.

    Of the steps of `horizon` (1000) the first ten are for settling; with `ignore_done` episodes have no such limit.
    """
    suites = benchmark.get_benchmark_dict()
    suite, _, number = env_id.partition("/")
    if suite not in suites:
        raise invalid("env", f"LIBERO has no {env_id!r}; it has {', '.join(sorted(suites))}, each with /NUMBER")
    tasks = suites[suite]()
    if not number.isdecimal() or int(number) >= tasks.get_num_tasks():
        raise invalid("env", f"LIBERO has no {env_id!r}; it has {suite}/0 to {suite}/{tasks.get_num_tasks() - 1}")
    for camera in cameras:
        if camera.depth:
            raise invalid(f"camera {camera.name}", "depth of LIBERO is not supported; use a task without")
    given = {
        "bddl_file_name": tasks.get_task_bddl_file_path(int(number)),
        "camera_names": [camera.name for camera in cameras] or ["agentview"],
        "camera_heights": [camera.height for camera in cameras] or [128],
        "camera_widths": [camera.width for camera in cameras] or [128],
        "horizon": _HORIZON,
        **options,
    }
    if given["horizon"] <= _SETTLING:
        raise invalid("horizon", f"must be above {_SETTLING}, the steps for settling, got {given['horizon']}")
    most = None if given.get("ignore_done") else given["horizon"] - _SETTLING
    env = OffScreenRenderEnv(**given)
    return Libero(env, np.asarray(tasks.get_task_init_states(int(number))), env_id, cameras, most=most)


class Libero(Simulator):
    """One task, whose loop has a step of four values and no seeds.

    Its rate is not compared: widely used copies of its demonstrations, taken at 20 Hz, state 10 Hz.
    """

    def __init__(
        self, env: Any, states: NDArray[np.float64], env_id: str, cameras: list[Camera], *, most: int | None
    ) -> None:
        self._env, self._states, self._cameras, self.name = env, states, cameras, f"libero/{env_id}"
        self._most, self._steps = most, 0
        self.low, self.high = np.full(_ACTION, -1, np.float32), np.full(_ACTION, 1, np.float32)

    def reset(self, *, seed: int | None = None) -> tuple[Seen, dict[str, Any]]:
        """Starts the episode of an initial state; numbers beyond the last state begin at the first again."""
        # A reset places fixtures, which are not in the state, by random numbers of its own.
        self._env.seed(seed or 0)
        self._env.reset()
        self._env.set_init_state(self._states[(seed or 0) % len(self._states)])
        self._steps = 0
        for _ in range(_SETTLING):
            observed, _, _, _ = self._env.step(_STILL)
        return self._seen(observed), {"success": False}

    def step(self, action: NDArray[np.float32], /) -> tuple[Seen, float, bool, bool, dict[str, Any]]:
        """Acts; an episode is over when it is solved, or by the horizon.

        LIBERO's tasks put success in the place of robosuite's `done`, which would show that no step may follow.
        """
        observed, reward, done, _ = self._env.step(action)
        self._steps += 1
        return self._seen(observed), float(reward), bool(done), self._steps == self._most, {"success": bool(done)}

    def close(self) -> None:
        """Frees what renders."""
        self._env.close()

    def _seen(self, observed: dict[str, Any]) -> Seen:
        images = {camera.name: observed[f"{camera.name}_image"][::-1, ::-1].copy() for camera in self._cameras}
        values = {name: value for name, value in observed.items() if np.ndim(value) < 2}  # noqa: PLR2004  (pictures)
        hand = [observed["robot0_eef_pos"], _axis_angle(observed["robot0_eef_quat"]), observed["robot0_gripper_qpos"]]
        return Seen({**values, "state": np.concatenate(hand)}, images)


def _axis_angle(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """A rotation (x, y, z, w) as its axis, as long as its angle in radians."""
    axis, real = quaternion[:3], float(np.clip(quaternion[3], -1, 1))
    length = float(np.linalg.norm(axis))
    found: NDArray[np.float64] = axis * (2 * np.arccos(real) / length) if length > _NO_ROTATION else np.zeros(3)
    return found
