"""The adapter of simulators without one of others and without a server: control rates, and tasks without values."""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import gleaner
from gleaner.simulators import Seen, SimulatorAdapter, SimulatorVector, __main__
from test_simulators import Counted, Far, spec_of


class Timed(Counted):
    """A simulator of a known rate."""

    rate_option = "--option control_freq={hz:g}"

    def __init__(self, rate_hz: float | None) -> None:
        self.rate_hz = rate_hz


def far() -> Far:
    """A policy of a task at 20 Hz."""
    return Far(spec_of("counted", "eye", {"arm": 3}, 2, depth=False))


@pytest.mark.parametrize("rate_hz", [None, 20.0, 18.5, 21.9])
def test_the_rate_of_the_task_and_an_unknown_one_are_taken(rate_hz: float | None) -> None:
    assert gleaner.evaluate(Timed(rate_hz), far(), SimulatorAdapter(), episodes=1).successes == 1


def test_an_action_beyond_the_bounds_is_reported_as_it_is_executed() -> None:
    adapter, sim = SimulatorAdapter(), Timed(20.0)
    adapter.spec = far().spec
    within = np.asarray(sim.low, np.float32)
    assert adapter.executed(sim, within) is None
    np.testing.assert_array_equal(adapter.executed(sim, within - 3), within)


@pytest.mark.parametrize("rate_hz", [10.0, 22.1, 80.0])
def test_another_rate_is_refused(rate_hz: float) -> None:
    problem = f"rate_hz: counted/one takes actions at {rate_hz:g} Hz, the task's are at 20 Hz"
    problem += "; change it with --option control_freq=20$"
    sim, policy = Timed(rate_hz), far()
    with pytest.raises(gleaner.InvalidArgument, match=problem):
        gleaner.evaluate(sim, policy, SimulatorAdapter(), episodes=1)
    assert not policy.seen
    sim.rate_option = ""
    with pytest.raises(gleaner.InvalidArgument, match=r"the task's are at 20 Hz$"):
        SimulatorAdapter().check(sim, far().spec)
    with SimulatorVector(partial(Timed, rate_hz), 2) as envs, pytest.raises(gleaner.InvalidArgument, match=problem):
        SimulatorAdapter().check(envs, far().spec)


@pytest.mark.parametrize("envs", [1, 2])
def test_the_command_refuses_another_rate_before_any_attempt(monkeypatch: pytest.MonkeyPatch, envs: int) -> None:
    class Deployed(Far):
        def __enter__(self) -> Far:
            return self

        def __exit__(self, *of: object) -> None:
            pass

    def deployed(*given: Any, **options: Any) -> Deployed:
        return Deployed(far().spec)

    monkeypatch.setattr(__main__, "Policy", deployed)
    monkeypatch.setattr(__main__, "VectorPolicy", deployed)
    monkeypatch.setattr(__main__, "make", made)
    given = SimpleNamespace(
        simulator="counted", env="one", deployment="d", envs=envs, episodes=2, seed=0, max_steps=None, execute=1
    )
    vars(given).update(video=None, record=False, cohort="")
    act: Any = __main__._one if envs == 1 else __main__._several
    with pytest.raises(gleaner.InvalidArgument, match="takes actions at 80 Hz"):
        act(None, given, SimulatorAdapter(), {})


class Unstarted(Timed):
    def reset(self, *, seed: int | None = None) -> tuple[Seen, dict[str, Any]]:
        raise AssertionError("an attempt")


def made(*given: Any, **options: Any) -> Timed:
    return Unstarted(80.0)


def test_a_task_without_proprioception_has_no_values() -> None:
    adapter = SimulatorAdapter()
    adapter.spec = spec_of("counted", "eye", {}, 2, depth=False)
    values = adapter.proprioception(None, Seen({}))
    assert values.shape == (0,)
    assert values.dtype == np.float32
