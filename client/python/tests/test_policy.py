"""A deployed policy against a real server, as robots and simulators use it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
import pytest
from numpy.typing import NDArray

import gleaner
from conftest import IMAGE, TASK, Lab
from gleaner.observation import size
from gleaner.types import TaskSpec
from programs import Server


def observation(spec: TaskSpec, seed: int = 0) -> dict[str, Any]:
    """One that the task takes, different for every seed."""
    random = np.random.default_rng(seed)
    shape = (IMAGE, IMAGE)
    return {
        "images": {camera.name: random.integers(0, 256, (*shape, 3), np.uint8) for camera in spec.cameras},
        "depth": {camera.name: random.integers(0, 900, shape, np.uint16) for camera in spec.cameras if camera.depth},
        "proprioception": random.normal(size=size(spec.proprioception)),
    }


def test_a_policy_answers_with_an_action_of_the_tasks_size(client: gleaner.Client, deployment: str, lab: Lab) -> None:
    with gleaner.Policy(client, deployment) as policy:
        spec = policy.spec
        action = policy(observation(spec))
        assert action.shape == (size(spec.action),)
        assert action.dtype == np.float32
        assert np.isfinite(action).all()
        assert policy.policy_id == lab.policy
        assert policy.last is not None
        assert policy.last.timings.total_us >= policy.last.timings.model_us > 0
        chunk = policy.chunk(observation(spec, 1))
        assert chunk.actions.shape == (1, size(spec.action))
        assert chunk.stamp_ns == round(1e9 / spec.rate_hz)
        assert (policy.dropped, policy.missed, policy.draining) == (0, 0, False)


def test_an_episode_has_a_history_and_reset_forgets_it(client: gleaner.Client, deployment: str) -> None:
    with gleaner.Policy(client, deployment, rate_hz=20.0) as policy:
        seen = [observation(policy.spec, seed) for seed in range(3)]
        first = [policy(step) for step in seen]
        policy.reset()
        second = [policy(step) for step in seen]
        policy.reset()
        alone = policy(seen[2])
    np.testing.assert_array_equal(first, second)
    assert not np.array_equal(first[2], alone)


def test_executed_action_is_sent(client: gleaner.Client, deployment: str) -> None:
    with gleaner.Policy(client, deployment) as policy:
        seen = [observation(policy.spec, seed) for seed in range(2)]
        given = policy(seen[0])
        plain = policy(seen[1])
        for executed, same in ((given, True), (given + 1, False)):
            policy.reset()
            policy(seen[0])
            acted = policy({**seen[1], "executed_action": executed})
            assert np.array_equal(acted, plain) == same


def test_two_policies_are_independent(client: gleaner.Client, deployment: str) -> None:
    with gleaner.Policy(client, deployment) as one, gleaner.Policy(client, deployment) as other:
        seen = [observation(one.spec, seed) for seed in range(4)]
        one(seen[0])
        other(seen[2])
        mixed = one(seen[1])
        one.reset()
        one(seen[0])
        np.testing.assert_array_equal(one(seen[1]), mixed)


def test_invalid_observations_are_rejected_locally_and_the_episode_continues(
    client: gleaner.Client, deployment: str
) -> None:
    with gleaner.Policy(client, deployment) as policy:
        right = observation(policy.spec)
        policy(right)
        name = policy.spec.cameras[0].name
        image = right["images"][name]
        wrong: list[tuple[dict[str, Any], str]] = [
            ({"images": {}}, f"images.{name}: is missing"),
            ({"images": {**right["images"], "roof": image}}, r"images\.roof: the task has no such camera"),
            ({"images": {**right["images"], name: image / 255.0}}, f"images.{name}: is of float64, must be uint8"),
            ({"images": {**right["images"], name: image[1:]}}, "is 15 × 16 × 3, the task has 16 × 16 × 3"),
            ({"proprioception": [1.0]}, r"proprioception: expected \d+ values, got 1"),
            ({"proprioception": right["proprioception"] * np.inf}, r"proprioception\[0\]: is .*inf, must be finite"),
            ({"executed_action": [0.0]}, "executed_action: expected 7 values, got 1"),
            ({"pose": [0.0]}, "supported: images, proprioception, depth"),
        ]
        for change, message in wrong:
            with pytest.raises(gleaner.InvalidArgument, match=message):
                policy({**right, **change})
        policy(right)
        assert policy.last is not None
        assert policy.last.stamp_ns == round(1e9 / policy.spec.rate_hz)


def test_rejection_by_the_server_ends_the_episode(client: gleaner.Client, deployment: str) -> None:
    with gleaner.Policy(client, deployment) as policy:
        right = observation(policy.spec)
        name = policy.spec.cameras[0].name
        with pytest.raises(gleaner.InvalidArgument, match="color"):
            policy({**right, "images": {**right["images"], name: b"\xff\xd8 no picture"}})
        assert policy(right).shape == (size(policy.spec.action),)


def test_invalid_policies_are_rejected(client: gleaner.Client, deployment: str) -> None:
    with pytest.raises(gleaner.NotFound, match=f"no deployment nothing; existing: .*{deployment}"):
        gleaner.Policy(client, "nothing")
    with pytest.raises(gleaner.InvalidArgument, match="deadline"):
        gleaner.Policy(client, deployment, deadline=0.0)


def test_deployments_have_a_history(client: gleaner.Client, deployment: str, lab: Lab) -> None:
    made = client.deploy("second", lab.policy)
    assert [change.policy_id for change in made.history] == [lab.policy]
    assert {known.name for known in client.deployments(TASK)} >= {deployment, "second"}
    assert lab.policy in [policy.id for policy in client.policies.list(TASK)]


def test_a_deployment_is_rolled_back(client: gleaner.Client, lab: Lab) -> None:
    snapshot = client.snapshots.create(TASK)
    newer = client.jobs.train(TASK, experts_in=snapshot.id, policy="bc", steps=2, batch=4, warmup_steps=1)
    client.jobs.wait(newer, timeout=120)
    client.deploy("rolled", lab.policy)
    client.deploy("rolled", newer.result_id)
    with gleaner.Policy(client, "rolled") as policy:
        seen = observation(policy.spec)
        policy(seen)
        assert policy.policy_id == newer.result_id
        assert client.rollback("rolled").policy_id == lab.policy
        policy(seen)
        assert policy.policy_id == newer.result_id, "a running session keeps its policy"
        policy.reset()
        policy(seen)
        assert policy.policy_id == lab.policy
    with pytest.raises(gleaner.FailedPrecondition, match="rolled"):
        client.rollback("rolled")

    client.undeploy("rolled")
    assert "rolled" not in [deployment.name for deployment in client.deployments(TASK)]
    with pytest.raises(gleaner.NotFound, match="rolled"):
        client.undeploy("rolled")


def test_late_actions_are_missed(client: gleaner.Client, deployment: str) -> None:
    with gleaner.Policy(client, deployment, deadline=1e-6) as policy:
        policy.open()
        for _ in range(2):
            with pytest.raises(gleaner.Missed, match=deployment):
                policy(observation(policy.spec))
        assert policy.missed == 2
    with gleaner.Policy(client, deployment, deadline=60.0) as policy:
        policy.open()
        policy(observation(policy.spec))
        assert policy.missed == 0


def test_stopping_server_announces_the_drain_and_the_episode_finishes(
    client: gleaner.Client, deployment: str, running: Server
) -> None:
    with gleaner.Policy(client, deployment) as policy:
        seen = observation(policy.spec)
        policy(seen)
        running.process.terminate()
        try:
            for _ in range(10_000):
                policy(seen)
                if policy.draining:
                    break
            assert policy.draining
            policy(seen)
            policy.reset()
            assert running.process.wait(20) == 0
        finally:
            running.stop()
            running.start()
        # The same client reconnects to the server and its deployment.
        assert policy(seen).shape == (size(policy.spec.action),)
        assert not policy.draining


def test_the_servers_own_simulator_evaluates_it_too(client: gleaner.Client, deployment: str, lab: Lab) -> None:
    job = client.jobs.evaluate(TASK, deployment=deployment, simulation="pick_cube", episodes=2, seeds=[3], max_steps=2)
    done = client.jobs.wait(job, timeout=120)
    evaluation = client.policies.evaluation(done.result_id)
    assert (evaluation.policy_id, evaluation.episodes, evaluation.seeds[0].seed) == (lab.policy, 2, 3)


class Reach(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """Solved on the third step from an even seed; ends unsolved after five otherwise."""

    observation_space = gymnasium.spaces.Box(-1, 1, (3,), np.float32)
    action_space = gymnasium.spaces.Box(-1, 1, (3,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        super().reset(seed=seed)
        assert seed is not None
        self.even, self.steps = seed % 2 == 0, 0
        return self.np_random.random(3, np.float32), {}

    def step(self, action: NDArray[np.float32]) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        assert action.shape == (2,)
        self.steps += 1
        info = {"success": self.even and self.steps == 3}
        return self.np_random.random(3, np.float32), 0.0, False, self.steps == 5, info


class ReachAdapter(gleaner.Adapter):
    def cameras(self, env: Reach, observation: NDArray[np.float32]) -> dict[str, NDArray[np.uint8]]:
        level = np.uint8(255 * observation[0])
        return {camera.name: np.full((camera.height, camera.width, 3), level) for camera in self.spec.cameras}

    def depth(self, env: Reach, observation: NDArray[np.float32]) -> dict[str, NDArray[np.uint16]]:
        with_depth = [camera for camera in self.spec.cameras if camera.depth]
        return {camera.name: np.zeros((camera.height, camera.width), np.uint16) for camera in with_depth}

    def proprioception(self, env: Reach, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.resize(observation, size(self.spec.proprioception))

    def action(self, env: Reach, action: NDArray[np.float32]) -> NDArray[np.float32]:
        return action[:2]


def test_an_evaluation_runs_in_any_environment_and_is_kept(client: gleaner.Client, deployment: str, lab: Lab) -> None:
    seen: list[gleaner.Trial] = []
    with gleaner.Policy(client, deployment) as policy:
        trials = gleaner.evaluate(Reach(), policy, ReachAdapter(), episodes=4, seed=10, on_trial=seen.append)
    assert [(trial.seed, trial.success, trial.steps) for trial in trials.trials] == [
        (10, True, 3),
        (11, False, 5),
        (12, True, 3),
        (13, False, 5),
    ]
    assert seen == list(trials.trials)
    assert (trials.success_rate, trials.mean_steps, trials.policy_id) == (0.5, 4.0, lab.policy)
    assert str(trials).startswith("2 of 4 solved: 0.50 [")

    kept = trials.report(client, "reach-v0")
    assert kept.id in [evaluation.id for evaluation in client.policies.evaluations(lab.policy)]
    assert (kept.simulation, kept.episodes, kept.successes, kept.seeds[0].seed) == ("reach-v0", 4, 2, 10)
    # The server calculates the same interval.
    assert (kept.low, kept.high) == pytest.approx(trials.interval)
    assert client.policies.evaluation(kept.id).seeds[0].mean_steps == 4.0


class Blind(gleaner.Adapter):
    def cameras(self, env: Any, observation: Any) -> Mapping[str, NDArray[np.uint8] | bytes]:
        return {}

    def proprioception(self, env: Any, observation: Any) -> list[float]:
        return []


def test_an_evaluation_takes_any_controller_and_a_limit() -> None:
    class Still:
        def __call__(self, observation: gleaner.Observation, /) -> NDArray[np.float32]:
            return np.zeros(2, np.float32)

        def reset(self) -> None:
            pass

    trials = gleaner.evaluate(Reach(), Still(), Blind(), episodes=2, max_steps=2)
    assert [(trial.success, trial.steps) for trial in trials.trials] == [(False, 2), (False, 2)]
    with pytest.raises(NotImplementedError, match=r"Adapter\.cameras"):
        gleaner.evaluate(Reach(), Still(), gleaner.Adapter(), episodes=1)
    with pytest.raises(gleaner.InvalidArgument, match="episodes"):
        gleaner.evaluate(Reach(), Still(), Blind(), episodes=0)
    with pytest.raises(gleaner.InvalidArgument, match="execute: the policy has no method `chunk`"):
        gleaner.evaluate(Reach(), Still(), Blind(), episodes=1, execute=2)


def test_wilson_matches_the_published_example() -> None:
    # 81 of 263: (0.2553, 0.3662), Newcombe 1998.
    assert gleaner.wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert gleaner.wilson(0, 0) == (0.0, 1.0)
