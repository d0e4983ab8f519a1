"""Pictures: the images of a successful and a failed episode, and q along imperfect episodes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib import pyplot
from numpy.typing import NDArray
from PIL import Image

import gleaner
from gleaner.types import Episode
from simulator_example.agent import Agent, State
from simulator_example.simulator import Frames, Simulator
from simulator_example.task import SimulatorAdapter

matplotlib.use("Agg")
FRAMES = 10
ENLARGED = 2


class Watching(SimulatorAdapter):
    """Keeps the images of the cameras, and the live scores of the policy by step."""

    def __init__(self, policy: gleaner.Policy) -> None:
        self._policy = policy
        self.seen: list[Frames] = []
        self.q: dict[int, float] = {}

    def cameras(self, env: Simulator, observation: State) -> Frames:
        """The images of both cameras."""
        self.seen.append(env.images())
        return self.seen[-1]

    def action(self, env: Simulator, action: NDArray[np.float32]) -> NDArray[np.float32]:
        """The action itself; its reply has the newest score."""
        score = self._policy.score
        if score is not None:
            self.q[round(score.stamp_ns * env.rate_hz / 1e9)] = score.q
        return action


def strips(
    client: gleaner.Client, env: Simulator, deployment: str, trials: gleaner.Trials, folder: Path
) -> dict[str, Path]:
    """Repeats a solved and a failed episode, if there are any; returns a strip of each and both live scores."""
    shown: dict[str, Path] = {}
    curves: dict[str, dict[int, float]] = {}
    for outcome, success in (("success", True), ("failure", False)):
        seed = next((trial.seed for trial in trials.trials if trial.success == success), None)
        if seed is None:
            continue
        with gleaner.Policy(client, deployment) as policy:
            watching = Watching(policy)
            gleaner.evaluate(env, policy, watching, episodes=1, seed=seed)
        title = f"{outcome}, seed {seed}"
        shown[title] = folder / f"{outcome}.png"
        _strip(watching.seen).save(shown[title])
        curves[title] = watching.q
    shown["live quality q of these episodes, as the session heard it"] = _plot(curves, folder / "live-q.png")
    return shown


def _strip(seen: list[Frames]) -> Image.Image:
    picked = [seen[place] for place in np.linspace(0, len(seen) - 1, min(FRAMES, len(seen))).round().astype(int)]
    columns: list[NDArray[np.uint8]] = [np.vstack([*frames.values()]) for frames in picked]
    strip = Image.fromarray(np.hstack(columns))
    return strip.resize((strip.width * ENLARGED, strip.height * ENLARGED), Image.Resampling.NEAREST)


def curves(client: gleaner.Client, run: str, agents: Iterable[Agent], episodes: list[Episode], path: Path) -> Path:
    """The quality q along one failed episode of each imperfect agent."""
    found = {}
    for agent in agents:
        of_agent = [episode for episode in episodes if episode.cohort == agent.name]
        failed = [episode for episode in of_agent if gleaner.word(episode, "outcome") == "failure"]
        scores = client.scores.episode(run, (failed or of_agent)[0].id)
        found[agent.name.replace("_", " ")] = dict(enumerate(scores.q.tolist()))
    return _plot(found, path)


def _plot(curves: Mapping[str, Mapping[int, float]], path: Path) -> Path:
    figure, axes = pyplot.subplots(1, len(curves), figsize=(4 * len(curves), 2.6), sharey=True, squeeze=False)
    for axis, (title, q) in zip(axes[0], curves.items(), strict=True):
        axis.plot([*q], [*q.values()], linewidth=1.5)
        axis.set(title=title, xlabel="step", ylim=(0, 1))
    axes[0][0].set_ylabel("q")
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    pyplot.close(figure)
    return path
