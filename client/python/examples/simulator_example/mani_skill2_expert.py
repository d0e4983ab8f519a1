"""A scripted expert for ManiSkill2's cubes, from the true poses, and its faults. Independent of cameras and files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from simulator_example.agent import Action, Agent, State

Vector = NDArray[np.float64]

OPEN, CLOSED = 1.0, -1.0
# Of an action's numbers: metres and radians of 1, and the fastest motion used.
REACH_M, TURN_RAD, SPEED = 0.1, 0.1, 0.5
ABOVE = np.array([0.0, 0.0, 0.1])
# Heights above the table of a cube that is carried, of one that lies on another, and of the hand afterwards.
CARRIED_M, STACKED_M, AWAY_M = 0.16, 0.043, 0.2
FOREVER = 1_000_000
# Steps of the carry before an early release.
RELEASE_STEPS = (1, 8)


@dataclass(frozen=True)
class Waypoint:
    """Where the tool goes next, and until when."""

    place: Vector
    grip: float
    near_m: float = 0.0  # the next one follows once the tool is this near,
    steps: int = FOREVER  # or after this many steps
    carries: bool = False  # whether it depends on the goal
    still: bool = False  # stand still: the fingers move


class Expert:
    """The scripted expert, with the fault of an agent and its size `amount`.

    noise    white noise of deviation 0.4 · amount on the motion, and a grasp beside the cube by N(0, amount · 1 cm)
    goal     a goal that is off by N(0, amount · 5 cm)
    release  in this share of the episodes the gripper opens for good at some step of the carry
    """

    def __init__(self, env: Any, agent: Agent, seed: int) -> None:
        self._env = env
        self._stacks = hasattr(env, "cubeB")
        self._agent = agent
        self._random = np.random.default_rng([seed, 1])
        self._grasp_off, self._goal_off = np.zeros(3), np.zeros(3)
        self._releases_after: int | None = None
        if agent.spoiled == "noise":
            self._grasp_off[:2] = self._random.normal(0.0, 0.01 * agent.amount, 2)
        elif agent.spoiled == "goal":
            self._goal_off = self._random.normal(0.0, 0.05 * agent.amount, 3)
            self._goal_off[2] = abs(self._goal_off[2])
        elif self._random.random() < agent.amount:
            self._releases_after = int(self._random.integers(*RELEASE_STEPS))
        self._phase, self._spent, self._carried = 0, 0, 0
        self._stands = self._tool.p
        self._down = self._nearest_turn()

    def __call__(self, state: State) -> tuple[Action, Action]:
        """The agent's action, and what the expert would do in the same phase."""
        plan = self._plan(self._grasp_off, self._goal_off)
        at = plan[self._phase]
        while self._phase + 1 < len(plan) and self._reached(at):
            self._phase, self._spent = self._phase + 1, 0
            at = plan[self._phase]
            self._stands = self._tool.p
        right = self._plan(np.zeros(3), np.zeros(3))[self._phase]
        self._spent += 1
        self._carried += at.carries
        action = self._towards(at)
        if self._agent.spoiled == "noise":
            action[:6] += self._random.normal(0.0, 0.4 * self._agent.amount, 6)
        if self._releases_after is not None and self._carried >= self._releases_after:
            action[6] = OPEN
        return _bounded(action), _bounded(self._towards(right))

    @property
    def _tool(self) -> Any:
        return self._env.tcp.pose

    @property
    def _cube(self) -> Any:
        return (self._env.cubeA if self._stacks else self._env.obj).pose

    def _reached(self, at: Waypoint) -> bool:
        return self._spent >= at.steps or bool(np.linalg.norm(at.place - self._tool.p) < at.near_m)

    def _plan(self, grasp_off: Vector, goal_off: Vector) -> list[Waypoint]:
        cube = self._cube.p + grasp_off
        # The cube goes to the goal, not the tool that holds it.
        held = self._tool.p - self._cube.p
        plan = [
            Waypoint(cube + ABOVE, OPEN, 0.015, 25),
            Waypoint(cube, OPEN, 0.006, 20),
            Waypoint(cube, CLOSED, 0.0, 4, still=True),
        ]
        if not self._stacks:
            return [*plan, Waypoint(self._env.goal_pos + held + goal_off, CLOSED, carries=True)]
        over = self._env.cubeB.pose.p + goal_off + np.array([held[0], held[1], 0.0])
        lies = _at_height(over, over[2] + STACKED_M + np.clip(held[2], -0.01, 0.01))
        return [
            *plan,
            Waypoint(_at_height(cube, CARRIED_M), CLOSED, 0.03, 15, carries=True),
            Waypoint(_at_height(over, CARRIED_M), CLOSED, 0.008, 25, carries=True),
            Waypoint(lies, CLOSED, 0.004, 20, carries=True),
            Waypoint(lies, OPEN, 0.0, 4, still=True),
            Waypoint(_at_height(over, AWAY_M), OPEN),
        ]

    def _towards(self, at: Waypoint) -> Vector:
        turned = _rotation(self._tool)
        way = (self._stands if at.still else at.place) - self._tool.p
        motion = turned.inv().apply(way) / REACH_M
        turn = (turned.inv() * self._down).as_rotvec() / TURN_RAD
        return np.concatenate([_at_most(motion, SPEED), _at_most(turn, 1.0), [at.grip]])

    def _nearest_turn(self) -> Rotation:
        """The rotation of a tool that points down along the cube's sides: the one of four that is nearest."""
        yaw = _rotation(self._cube).as_euler("ZYX")[0]
        quarters = [Rotation.from_euler("ZX", [yaw + quarter * np.pi / 2, np.pi]) for quarter in range(4)]
        return min(quarters, key=lambda turn: (_rotation(self._tool).inv() * turn).magnitude())


def _rotation(pose: Any) -> Rotation:
    w, *xyz = pose.q
    return Rotation.from_quat([*xyz, w])


def _at_height(place: Vector, height: Any) -> Vector:
    return np.array([place[0], place[1], height])


def _at_most(vector: Vector, length: float) -> Vector:
    return vector * min(1.0, length / (float(np.linalg.norm(vector)) + 1e-9))


def _bounded(action: Vector) -> Action:
    return np.clip(action, -1.0, 1.0).astype(np.float32)
