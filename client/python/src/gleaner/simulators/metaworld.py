"""Tasks of Meta-World 3, such as pick-place-v3; values are state, hand, gripper, object, goal and joints."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from metaworld.env_dict import ALL_V3_ENVIRONMENTS
from numpy.typing import NDArray

from gleaner.errors import invalid
from gleaner.simulators._base import Camera, Seen, Simulator

# Meta-World moves at 80 Hz.
_RATE_HZ = 80
# The parts of its state.
_PARTS = {"hand": slice(0, 3), "gripper": slice(3, 4), "object": slice(4, 11), "goal": slice(36, 39)}


def make(env_id: str, cameras: list[Camera], *, repeat: int = 1, max_steps: int = 0) -> MetaWorld:
    """The task; each action is repeated `repeat` times, so that 2 is 40 Hz. `max_steps` 0: Meta-World's own limit."""
    if env_id not in ALL_V3_ENVIRONMENTS:
        raise invalid("env", f"Meta-World has no {env_id!r}; it has {', '.join(ALL_V3_ENVIRONMENTS)}")
    if repeat < 1:
        raise invalid("repeat", f"must be from 1 to {_RATE_HZ}, got {repeat}")
    return MetaWorld(env_id, cameras, repeat, max_steps)


class MetaWorld(Simulator):
    """One task. A seed is a placement of object and goal."""

    rate_option = f"--option repeat=N, which makes it {_RATE_HZ}/N Hz"

    def __init__(self, env_id: str, cameras: list[Camera], repeat: int, max_steps: int) -> None:
        env: Any = ALL_V3_ENVIRONMENTS[env_id]()
        # Placements come from the seed, and the goal is part of the state.
        env._partially_observable = False
        env._freeze_rand_vec = False
        env.seeded_rand_vec = True
        env._set_task_called = True
        self._env, self._repeat, self.name = env, repeat, f"metaworld/{env_id}"
        self.rate_hz = _RATE_HZ / repeat
        self._most = min(max_steps or env.max_path_length, env.max_path_length // repeat)
        self._steps = 0
        self.low, self.high = env.action_space.low.astype(np.float32), env.action_space.high.astype(np.float32)
        known = [env.model.camera(at).name for at in range(env.model.ncam)]
        self._renderers: dict[str, mujoco.Renderer] = {}
        for camera in cameras:
            if camera.name not in known:
                raise invalid(f"camera {camera.name}", f"{env_id} has none of this name; it has {', '.join(known)}")
            if camera.depth:
                raise invalid(f"camera {camera.name}", "depth of Meta-World is not supported; use a task without")
            self._renderers[camera.name] = mujoco.Renderer(env.model, camera.height, camera.width)
        self._joints = [int(env.model.joint(f"right_j{joint}").qposadr[0]) for joint in range(7)]

    def reset(self, *, seed: int | None = None) -> tuple[Seen, dict[str, Any]]:
        """Starts the episode of a seed."""
        if seed is not None:
            self._env.seed(seed)
        self._steps = 0
        state, _ = self._env.reset()
        return self._seen(state), {"success": False}

    def step(self, action: NDArray[np.float32], /) -> tuple[Seen, float, bool, bool, dict[str, Any]]:
        """Acts for one control period, or until the task is solved."""
        for _ in range(self._repeat):
            state, reward, _, _, info = self._env.step(action)
            if info["success"] > 0:
                break
        self._steps += 1
        success = bool(info["success"] > 0)
        return self._seen(state), float(reward), False, self._steps >= self._most, {"success": success}

    def close(self) -> None:
        """Frees what renders."""
        for renderer in self._renderers.values():
            renderer.close()

    def _seen(self, state: NDArray[np.float64]) -> Seen:
        images = {}
        for name, renderer in self._renderers.items():
            renderer.update_scene(self._env.data, name)
            images[name] = renderer.render().copy()
        parts = {name: state[part] for name, part in _PARTS.items()}
        return Seen({"state": state, "joints": self._env.data.qpos[self._joints], **parts}, images)
