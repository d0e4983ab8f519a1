"""Several environments of a simulator at once, each in a process of its own. Knows no simulator."""

from __future__ import annotations

import multiprocessing
import pickle
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gleaner.errors import invalid
from gleaner.simulators._base import Seen, Simulator


class SimulatorVector:
    """`count` environments that `make` makes, in the form that `evaluate_vector` takes. A context manager.

    `make` is called in each process, so it must be importable there: a function of a module, or a `functools.partial`
    of one. An environment that has ended stays as it is, without reward, until the next reset. What fails in a process
    is raised here and ends them all.
    """

    def __init__(self, make: Callable[[], Simulator], count: int) -> None:
        if count < 1:
            raise invalid("envs", "must be at least 1")
        self.num_envs = count
        # Renderers do not survive a fork.
        context = multiprocessing.get_context("spawn")
        self._rows: list[tuple[multiprocessing.process.BaseProcess, Connection]] = []
        try:
            for _ in range(count):
                ours, theirs = context.Pipe()
                process = context.Process(target=_run, args=(make, theirs), daemon=True)
                process.start()
                theirs.close()
                self._rows.append((process, ours))
            self.name, self.low, self.high, self.rate_hz, self.rate_option = self._answers()[0]
        except BaseException:
            self.close()
            raise

    def reset(self, *, seed: Sequence[int] | None = None) -> tuple[list[Seen], dict[str, Any]]:
        """Starts the episode of its seed in each: the first observations, and info by its keys."""
        self._ask([("reset", one) for one in ([None] * self.num_envs if seed is None else seed)])
        answers = self._answers()
        return [seen for seen, _ in answers], _by_key([info for _, info in answers])

    def step(
        self, actions: NDArray[np.float32], /
    ) -> tuple[list[Seen], list[float], list[bool], list[bool], dict[str, Any]]:
        """Acts in each: observations, rewards, terminated, truncated, info by its keys."""
        self._ask([("step", action) for action in actions])
        seen, rewards, terminated, truncated, info = map(list, zip(*self._answers(), strict=True))
        return seen, rewards, terminated, truncated, _by_key(info)

    def close(self) -> None:
        """Ends every process."""
        for _, pipe in self._rows:
            pipe.close()
        for process, _ in self._rows:
            process.join(10)
            if process.is_alive():
                process.kill()
                process.join()
        self._rows.clear()

    def __enter__(self) -> SimulatorVector:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def _ask(self, requests: Sequence[tuple[str, Any]]) -> None:
        if not self._rows:
            raise RuntimeError("the environments are closed")
        if len(requests) != self.num_envs:
            raise invalid("envs", f"there are {self.num_envs} environments, got {len(requests)} seeds or actions")
        for (_, pipe), request in zip(self._rows, requests, strict=True):
            # That of a process that has ended is noticed where its answer is missing.
            with suppress(OSError):
                pipe.send(request)

    def _answers(self) -> list[Any]:
        try:
            return [self._answer(process, pipe) for process, pipe in self._rows]
        except BaseException:
            # The answers that are left would be taken for those to the next question.
            self.close()
            raise

    @staticmethod
    def _answer(process: multiprocessing.process.BaseProcess, pipe: Connection) -> Any:
        try:
            answer, failure = pipe.recv()
        except (EOFError, OSError):
            process.join(10)
            raise RuntimeError(f"the process of an environment ended with {process.exitcode}") from None
        if failure is not None:
            error, text = failure
            raise RuntimeError(text) if error is None else error from RuntimeError(text)
        return answer


def _by_key(infos: list[dict[str, Any]]) -> dict[str, Any]:
    # In the form of Gymnasium's vectors: a mask names the environments that have a key.
    found: dict[str, Any] = {}
    for key in {key for info in infos for key in info}:
        found[key] = [info.get(key) for info in infos]
        found[f"_{key}"] = [key in info for info in infos]
    return found


class _GoneError(Exception):
    """The other end of the pipe is closed."""


def _run(make: Callable[[], Simulator], pipe: Connection) -> None:
    # One environment, until the other end of the pipe is closed.
    try:
        sim = make()
        try:
            _serve(sim, pipe)
        finally:
            sim.close()
    except _GoneError:
        pass
    except Exception as error:  # Reported where the environments are used.
        with suppress(_GoneError):
            _send(pipe, None, (_portable(error), traceback.format_exc()))


def _serve(sim: Simulator, pipe: Connection) -> None:
    _send(pipe, (sim.name, sim.low, sim.high, sim.rate_hz, sim.rate_option))
    ended: Any = None
    while True:
        try:
            act, value = pipe.recv()
        except (EOFError, OSError):
            raise _GoneError from None
        if act == "reset":
            ended = None
            _send(pipe, sim.reset(seed=value))
            continue
        seen, reward, terminated, truncated, info = ended or sim.step(value)
        if terminated or truncated:
            ended = (seen, 0.0, terminated, truncated, info)
        _send(pipe, (seen, reward, terminated, truncated, info))


def _send(pipe: Connection, answer: Any, failure: Any = None) -> None:
    try:
        pipe.send((answer, failure))
    except OSError:
        raise _GoneError from None


def _portable(error: Exception) -> Exception | None:
    # The exception, if it arrives as it is.
    try:
        return error if type(pickle.loads(pickle.dumps(error))) is type(error) else None
    except Exception:  # Whatever its class does.
        return None
