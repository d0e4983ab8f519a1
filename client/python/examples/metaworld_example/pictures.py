"""Pictures: what a policy saw on the way to success and to failure, and q along imperfect episodes."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib import pyplot
from numpy.typing import NDArray
from PIL import Image

import gleaner
from gleaner.types import Episode
from metaworld_example.demonstrator import IMPERFECT
from metaworld_example.lab import MetaWorldAdapter
from metaworld_example.simulator import Frames, MetaWorld, State

matplotlib.use("Agg")
FRAMES = 10
ENLARGED = 2


class Watching(MetaWorldAdapter):
    """Keeps what the cameras see."""

    def __init__(self) -> None:
        self.seen: list[Frames] = []

    def cameras(self, env: MetaWorld, observation: State) -> Frames:
        """Both pictures."""
        self.seen.append(env.images())
        return self.seen[-1]


def strips(
    client: gleaner.Client, env: MetaWorld, deployment: str, trials: gleaner.Trials, folder: Path
) -> dict[str, Path]:
    """A strip of a solved and one of a failed episode, run again for it; without such an episode there is none."""
    made = {}
    for outcome, success in (("success", True), ("failure", False)):
        seed = next((trial.seed for trial in trials.trials if trial.success == success), None)
        path = folder / f"{deployment.split('@')[1]}-{outcome}.png"
        if seed is None:
            continue
        made[f"{outcome}, seed {seed}"] = path
        if not path.exists():
            watching = Watching()
            with gleaner.Policy(client, deployment) as policy:
                gleaner.evaluate(env, policy, watching, episodes=1, seed=seed)
            _strip(watching.seen).save(path)
    return made


def _strip(seen: list[Frames]) -> Image.Image:
    picked = [seen[place] for place in np.linspace(0, len(seen) - 1, min(FRAMES, len(seen))).round().astype(int)]
    columns: list[NDArray[np.uint8]] = [np.vstack([*frames.values()]) for frames in picked]
    strip = Image.fromarray(np.hstack(columns))
    return strip.resize((strip.width * ENLARGED, strip.height * ENLARGED), Image.Resampling.NEAREST)


def curves(client: gleaner.Client, run: str, episodes: list[Episode], path: Path) -> Path:
    """The quality q along one failed episode of each imperfect agent."""
    figure, axes = pyplot.subplots(1, len(IMPERFECT), figsize=(4 * len(IMPERFECT), 2.6), sharey=True)
    for axis, agent in zip(axes, IMPERFECT, strict=True):
        of_agent = [episode for episode in episodes if episode.cohort == agent.name]
        failed = [episode for episode in of_agent if gleaner.word(episode, "outcome") == "failure"]
        scores = client.scores.episode(run, (failed or of_agent)[0].id)
        axis.plot(scores.q, linewidth=1.5)
        axis.set(title=agent.name.replace("_", " "), xlabel="step", ylim=(0, 1))
    axes[0].set_ylabel("q")
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    pyplot.close(figure)
    return path
