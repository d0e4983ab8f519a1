"""A task of ManiSkill2 (SAPIEN, Panda arm) at 20 Hz. Independent of the server.

SAPIEN draws by Vulkan: on a GPU, or on the processor by a software driver that VK_ICD_FILENAMES names.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import mani_skill2.envs  # noqa: F401 - registers the tasks
import numpy as np
from mani_skill2.utils.sapien_utils import vectorize_pose
from numpy.typing import NDArray

from simulator_example.agent import Action, Agent, Demonstrator, State
from simulator_example.mani_skill2_expert import Expert
from simulator_example.simulator import ActionField, Depths, Frames, Simulator

# Twice what the scripted expert needs at most.
MAX_STEPS = {"PickCube-v0": 80, "StackCube-v0": 120}
# The task's name of a camera, and ManiSkill2's.
CAMERAS = {"base": "base_camera", "hand": "hand_camera"}
MOST_MM = 65_535


def make(task: str, size: int) -> ManiSkill2:
    """The task with cameras of this height and width."""
    return ManiSkill2(task, size)


class ManiSkill2(Simulator):
    """PickCube-v0 or StackCube-v0. A seed is a placement of cube and goal, or of both cubes.

    An observation is what the robot feels: 9 joint positions, 9 velocities, tool position and quaternion, and, if the
    task has a goal, its position and its distance from the tool along each axis. An action is seven numbers in
    [-1, 1]: motion of the tool (1 is 10 cm) and its rotation vector (1 is 0.1 rad), both in the tool's frame, and the
    gripper (1 opens, -1 closes).
    """

    simulator = "maniskill2"
    rate_hz = 20.0
    cameras = tuple(CAMERAS)
    has_depth = True
    imperfect = (Agent("noise", "noise", 0.6), Agent("wrong_goal", "goal", 1.0), Agent("early_release", "release", 1.0))

    def __init__(self, task: str, size: int = 128) -> None:
        if task not in MAX_STEPS:
            raise ValueError(f"task {task}: the example has {' and '.join(MAX_STEPS)}")
        self.task, self.size = task, size
        self._has_goal = task.startswith("Pick")
        goal = {"goal": 3, "to_goal": 3} if self._has_goal else {}
        self.proprioception = {"joints": 9, "velocities": 9, "tool": 7} | goal
        bounds = (-1.0, 1.0)
        self.action = {"motion": ActionField(6, bounds), "gripper": ActionField(1, bounds, binary=True)}
        # Episodes end here, not after ManiSkill2's own limit.
        env = gymnasium.make(
            task,
            obs_mode="rgbd",
            control_mode="pd_ee_delta_pose",
            camera_cfgs={"width": size, "height": size},
            shader_dir="trivial",
            max_episode_steps=10 * MAX_STEPS[task],
            disable_env_checker=True,
        )
        # Its wrappers make the images; what is under them has the poses.
        self._env: Any = env
        self._scene: Any = env.unwrapped
        self.action_space = env.action_space
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (sum(self.proprioception.values()),), np.float64)
        self._seen: dict[str, Any] = {}
        self._steps = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[State, dict[str, Any]]:
        """Starts the episode of a seed: the same seed always gives the same episode."""
        observed, _ = self._env.reset(seed=seed)
        self._steps = 0
        return self._observe(observed), {"success": False}

    def step(self, action: Action) -> tuple[State, float, bool, bool, dict[str, Any]]:
        """Moves for one control period."""
        observed, reward, _, _, info = self._env.step(np.clip(np.asarray(action, np.float32), -1.0, 1.0))
        self._steps += 1
        success = bool(info["success"])
        over = self._steps >= MAX_STEPS[self.task]
        return self._observe(observed), float(reward), success, over, {"success": success}

    def _observe(self, observed: dict[str, Any]) -> State:
        self._seen = observed["image"]
        robot = self._scene.agent.robot
        tool = vectorize_pose(self._scene.tcp.pose)
        goal = [self._scene.goal_pos, self._scene.goal_pos - tool[:3]] if self._has_goal else []
        return np.concatenate([robot.get_qpos(), robot.get_qvel(), tool, *goal])

    def images(self) -> Frames:
        """The current images of the cameras: size × size × RGB each."""
        return {name: np.ascontiguousarray(self._seen[camera]["rgb"], np.uint8) for name, camera in CAMERAS.items()}

    def depths(self) -> Depths:
        """The current depth of the cameras: size × size millimetres each."""

        def millimetres(camera: str) -> NDArray[np.uint16]:
            metres: NDArray[np.float32] = self._seen[camera]["depth"][..., 0]
            depth: NDArray[np.uint16] = np.clip(metres * 1_000.0, 0.0, MOST_MM).astype(np.uint16)
            return depth

        return {name: millimetres(camera) for name, camera in CAMERAS.items()}

    def felt(self, state: State) -> dict[str, NDArray[np.float32]]:
        """The proprioception in a state, by field."""
        ends = np.cumsum([*self.proprioception.values()])[:-1]
        return dict(zip(self.proprioception, np.split(state.astype(np.float32), ends), strict=True))

    def demonstrator(self, agent: Agent, seed: int) -> Demonstrator:
        """The agent of the episode that `reset` has begun."""
        return Expert(self._scene, agent, seed)

    def close(self) -> None:
        """Frees the renderer."""
        self._env.close()
