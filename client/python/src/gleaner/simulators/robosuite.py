"""Environments of robosuite 1.5, such as Lift; values are its observation keys (robot0_eef_pos, …)."""

from __future__ import annotations

from typing import Any

import numpy as np
import robosuite
from numpy.typing import NDArray
from robosuite.environments.base import REGISTERED_ENVS

from gleaner.errors import invalid
from gleaner.simulators._base import Camera, Seen, Simulator


def make(env_id: str, cameras: list[Camera], **options: Any) -> Robosuite:
    """The environment with cameras that it renders itself. `options` are those of `robosuite.make`."""
    if env_id not in REGISTERED_ENVS:
        raise invalid("env", f"robosuite has no {env_id!r}; it has {', '.join(sorted(REGISTERED_ENVS))}")
    given = {
        "robots": "Panda",
        "has_renderer": False,
        "has_offscreen_renderer": bool(cameras),
        "use_camera_obs": bool(cameras),
        "camera_names": [camera.name for camera in cameras] or "agentview",
        "camera_heights": [camera.height for camera in cameras] or 256,
        "camera_widths": [camera.width for camera in cameras] or 256,
        "camera_depths": [camera.depth for camera in cameras] or False,
        "control_freq": 20,
        "horizon": 500,
    }
    return Robosuite(robosuite.make(env_id, **{**given, **options}), env_id, cameras)


class Robosuite(Simulator):
    """One environment. robosuite gives pictures from the lowest row to the highest, and depth of its own scale."""

    rate_option = "--option control_freq={hz:g}"

    def __init__(self, env: Any, env_id: str, cameras: list[Camera]) -> None:
        self._env, self._cameras, self.name = env, cameras, f"robosuite/{env_id}"
        self.rate_hz = float(env.control_freq)
        low, high = env.action_spec
        self.low, self.high = low.astype(np.float32), high.astype(np.float32)

    def reset(self, *, seed: int | None = None) -> tuple[Seen, dict[str, Any]]:
        """Starts the episode of a seed."""
        if seed is not None:
            # Samplers of placements share this generator, so that it is set and not replaced.
            self._env.rng.bit_generator.state = np.random.default_rng(seed).bit_generator.state
        return self._seen(self._env.reset()), {"success": False}

    def step(self, action: NDArray[np.float32], /) -> tuple[Seen, float, bool, bool, dict[str, Any]]:
        """Acts; an episode ends by its horizon."""
        observed, reward, done, _ = self._env.step(action)
        return self._seen(observed), float(reward), False, bool(done), {"success": bool(self._env._check_success())}

    def close(self) -> None:
        """Frees what renders."""
        self._env.close()

    def _seen(self, observed: dict[str, Any]) -> Seen:
        images = {camera.name: observed[f"{camera.name}_image"][::-1].copy() for camera in self._cameras}
        depth = {}
        for camera in self._cameras:
            if camera.depth:
                depth[camera.name] = self._millimetres(observed[f"{camera.name}_depth"][::-1, :, 0])
        values = {name: value for name, value in observed.items() if np.ndim(value) < 2}  # noqa: PLR2004  (pictures)
        return Seen(values, images, depth)

    def _millimetres(self, depth: NDArray[np.float32]) -> NDArray[np.uint16]:
        """Depth of the renderer's buffer, from 0 at the near plane to 1 at the far one, as distance."""
        model = self._env.sim.model
        near, far = (plane * model.stat.extent for plane in (model.vis.map.znear, model.vis.map.zfar))
        metres: NDArray[np.float64] = near / (1 - depth * (1 - near / far))
        return (metres * 1000).clip(0, 65535).astype(np.uint16)
