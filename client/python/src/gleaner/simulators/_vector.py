"""Several environments of a simulator at once, each in a process of its own. Knows no simulator."""

from __future__ import annotations

import multiprocessing
import traceback
from collections.abc import Callable, Sequence
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
    of one. An environment that has ended stays as it is until the next reset. What fails in a process is raised here.
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
            self.name, self.low, self.high = self._answers()[0]
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
        if len(requests) != self.num_envs:
            raise invalid("envs", f"there are {self.num_envs} environments, got {len(requests)} seeds or actions")
        for (_, pipe), request in zip(self._rows, requests, strict=True):
            pipe.send(request)

    def _answers(self) -> list[Any]:
        answers = []
        for process, pipe in self._rows:
            try:
                answer, failure = pipe.recv()
            except EOFError:
                process.join(10)
                raise RuntimeError(f"the process of an environment ended with {process.exitcode}") from None
            if failure is not None:
                error, text = failure
                raise error from RuntimeError(text)
            answers.append(answer)
        return answers


def _by_key(infos: list[dict[str, Any]]) -> dict[str, Any]:
    # In the form of Gymnasium's vectors: a mask names the environments that have a key.
    found: dict[str, Any] = {}
    for key in {key for info in infos for key in info}:
        found[key] = [info.get(key) for info in infos]
        found[f"_{key}"] = [key in info for info in infos]
    return found


def _run(make: Callable[[], Simulator], pipe: Connection) -> None:
    # One environment, until the other end of the pipe is closed.
    try:
        sim = make()
        _serve(sim, pipe)
        sim.close()
    except (EOFError, BrokenPipeError):
        pass
    except Exception as error:  # Reported where the environments are used.
        pipe.send((None, (error, traceback.format_exc())))


def _serve(sim: Simulator, pipe: Connection) -> None:
    pipe.send(((sim.name, sim.low, sim.high), None))
    ended: Any = None
    while True:
        try:
            act, value = pipe.recv()
        except EOFError:
            return
        if act == "reset":
            ended = None
            pipe.send((sim.reset(seed=value), None))
            continue
        answer = ended if ended is not None else sim.step(value)
        if answer[2] or answer[3]:
            ended = answer
        pipe.send((answer, None))
