"""A task of Meta-World as a Gymnasium environment at 40 Hz, with fast rendering on a CPU. Independent of the server."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from metaworld.env_dict import ALL_V3_ENVIRONMENTS
from numpy.typing import NDArray

from simulator_example.agent import Action, Agent, Demonstrator, State
from simulator_example.meta_world_expert import Expert
from simulator_example.simulator import ActionField, Frames, Simulator

# The task's name of a camera, and Meta-World's. Both move with the hand, whose position is in the proprioception, so
# that their images show the position of the object.
CAMERAS = {"behind": "behindGripper", "wrist": "gripperPOV"}
# Meta-World moves at 80 Hz.
REPEAT = 2


def make(task: str, size: int) -> MetaWorld:
    """The task with cameras of this height and width."""
    return MetaWorld(task, size)


class MetaWorld(Simulator):
    """One task, `pick-place-v3` for example. A seed is a placement of object and goal.

    An observation is Meta-World's own state of 39 numbers: 0:3 hand, 3 gripper opening, 4:11 object, 36:39 goal.
    An action is four numbers in [-1, 1]: hand motion in x, y, z (1 is 1 cm in a step of 80 Hz) and closing.
    """

    simulator = "metaworld"
    rate_hz = 80.0 / REPEAT
    cameras = tuple(CAMERAS)
    imperfect = (Agent("noise", "noise", 0.5), Agent("wrong_goal", "goal", 1.0), Agent("early_release", "release", 1.0))

    def __init__(self, task: str, size: int = 64, max_steps: int = 90) -> None:
        if task not in ALL_V3_ENVIRONMENTS:
            raise ValueError(f"task {task}: Meta-World has none of this name; it has {', '.join(ALL_V3_ENVIRONMENTS)}")
        self.task, self.size = task, size
        # The position of the object is not among them: a policy must use the images.
        self.proprioception = {"joints": 7, "hand": 3, "gripper": 1, "goal": 3}
        self.action = {"motion": ActionField(3), "closing": ActionField(1)}
        env: Any = ALL_V3_ENVIRONMENTS[task]()
        # Placements come from the seed, and the goal is part of the state, because the scripted expert needs it.
        env._partially_observable = False
        env._freeze_rand_vec = False
        env.seeded_rand_vec = True
        env._set_task_called = True
        del env.sawyer_observation_space
        self._env = env
        self.observation_space = env.sawyer_observation_space
        self.action_space = env.action_space
        self._max_steps = min(max_steps, env.max_path_length // REPEAT)
        self._steps = 0
        # Multisampling, shadows and reflections cost ten times the rest on a CPU.
        env.model.vis.quality.offsamples = 0
        self._renderer = mujoco.Renderer(env.model, size, size)
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self._renderer.scene.flags[flag] = 0
        arm = [f"right_j{joint}" for joint in range(7)]
        self._arm = [int(env.model.joint(name).qposadr[0]) for name in arm]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[State, dict[str, Any]]:
        """Starts the episode of a seed: the same seed always gives the same episode."""
        super().reset(seed=seed)
        if seed is not None:
            self._env.seed(seed)
        self._steps = 0
        state, _ = self._env.reset()
        return state, {"success": False}

    def step(self, action: Action) -> tuple[State, float, bool, bool, dict[str, Any]]:
        """Moves for one control period, or until the task is solved."""
        action = np.clip(np.asarray(action, np.float32), -1.0, 1.0)
        for _ in range(REPEAT):
            state, reward, _, _, info = self._env.step(action)
            if info["success"] > 0:
                break
        self._steps += 1
        success = bool(info["success"] > 0)
        return state, float(reward), success, self._steps >= self._max_steps, {"success": success}

    def images(self) -> Frames:
        """The current images of the cameras: size × size × RGB each."""
        seen = {}
        for name, camera in CAMERAS.items():
            self._renderer.update_scene(self._env.data, camera)
            seen[name] = self._renderer.render().copy()
        return seen

    def felt(self, state: State) -> dict[str, NDArray[np.float32]]:
        """The proprioception, by field: the arm's seven angles in radians, and parts of Meta-World's state."""
        angles = self._env.data.qpos[self._arm]
        parts = {"joints": angles, "hand": state[:3], "gripper": state[3:4], "goal": state[36:39]}
        return {name: values.astype(np.float32) for name, values in parts.items()}

    def demonstrator(self, agent: Agent, seed: int) -> Demonstrator:
        """The agent of the episode that `reset` has begun."""
        return Expert(self.task, agent, seed)

    def close(self) -> None:
        """Frees the renderer."""
        self._renderer.close()
