"""Samples a second that reach a training, from the same pictures: gleaner beside PyTorch's DataLoader and LeRobot.

Takes turns in one run and prints medians and ratios; ends with 1 if a target is missed.
"""

import argparse
import pathlib
import statistics
import sys
import tempfile

import gleaner
from process import Server

import scenes
from peer import peer

TASK = "loading"
BATCH = 64
# At least this many times the samples of the faster peer.
TARGET = 2.0
PEERS = {
    "PyTorch's DataLoader, JPEG files": "files",
    "LeRobot, AV1 video": "videos",
    "PyTorch's DataLoader, JPEG files made 128 × 128 beforehand": "small-files",
}
# Those that a target is set against: they read what was recorded.
RIVALS = ("files", "videos")
# Steps of a training that are measured, after the first ones.
STEPS, WARM_UP = 24, 4


class Gleaner:
    """The recordings on a server, and an encoder whose experts a policy trains on."""

    def __init__(self, robots: gleaner.Client, recordings: list[pathlib.Path]):
        self.robots = robots
        self.robots.tasks.create(scenes.specification(TASK))
        for at, path in enumerate(recordings):
            self.robots.episodes.push(path, task=TASK, outcome="failure" if at % 2 else "success")
        self.snapshot = self.robots.snapshots.create(TASK).id
        job = self.robots.jobs.pretrain(TASK, snapshot_id=self.snapshot, preset="tiny", steps=2, batch=8)
        self.encoder = self.robots.jobs.wait(job).result_id

    def take(self, window: int, stretch: int) -> dict[str, float]:
        """The samples a second of a training and of its thread of batches, and the share of its time it waited."""
        common = {"preset": "tiny", "steps": STEPS, "batch": BATCH, "stretch": stretch}
        if window == 1:
            job = self.robots.jobs.train(TASK, experts_of=self.encoder, policy="bc", **common)
        else:
            common |= {"snapshot_id": self.snapshot, "segment_length": window - 1}
            job = self.robots.jobs.pretrain(TASK, **common)
        self.robots.jobs.wait(job)
        metrics = self.robots.jobs.metrics(job)
        # The peers' rates are of all their time, so slow batches count here too.
        mean = lambda name: statistics.fmean(metrics[name].values[WARM_UP:])
        return {
            "assembled": BATCH / mean("ms_per_batch") * 1e3,
            "trained": BATCH / mean("ms_per_step") * 1e3,
            "waited": mean("waited_share"),
        }


def measured(ours: Gleaner, folder: pathlib.Path, window: int, given: argparse.Namespace) -> bool:
    """Prints the table of one kind of sample; whether the target was met."""
    stretches = {"": 1} if window == 1 else {"": 1, ", stretches of 8": 8}
    rates: dict[str, list[float]] = {}
    add = lambda name, value: rates.setdefault(name, []).append(value)
    for _ in range(given.rounds):
        for name, stretch in stretches.items():
            for what, value in ours.take(window, stretch).items():
                add(f"{what}{name}", value)
        for name, kind in PEERS.items():
            add(kind, peer(kind, folder / kind.removeprefix("small-"), window, given.seconds))
    median = {name: statistics.median(values) for name, values in rates.items()}
    print(f"\nSamples of {window} step{'s' if window > 1 else ''}, {len(scenes.CAMERAS)} cameras; one thread each:\n")
    print("| | samples a second | gleaner's batches over it |\n|---|---:|---:|")
    for name in stretches:
        waited = f"{median[f'waited{name}']:.1%} of its time waiting"
        print(f"| gleaner, batches{name} | {median[f'assembled{name}']:.0f} | |")
        print(f"| gleaner, a training with `tiny`{name}, {waited} | {median[f'trained{name}']:.0f} | |")
    ratios = {}
    for name, kind in PEERS.items():
        pairs = zip(rates["assembled"], rates[kind], strict=True)
        ratios[kind] = statistics.median(a / b for a, b in pairs)
        print(f"| {name} | {median[kind]:.1f} | {ratios[kind]:.1f} |", flush=True)
    worst = min(ratios[kind] for kind in RIVALS)
    met = worst >= TARGET
    print(f"\nover the faster of what reads the recorded size: {worst:.1f}, at least {TARGET}: {'met' if met else 'MISSED'}")
    return met


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bin", type=pathlib.Path, required=True, help="where the programs are")
    parser.add_argument("--episodes", type=int, default=8)
    parser.add_argument("--steps", type=int, default=64, help="of each episode")
    parser.add_argument("--windows", type=int, nargs="+", default=[1, 7], help="steps of a sample")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=10, help="of each peer in each round")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = pathlib.Path(temporary)
        made = [scenes.episode(seed, given.steps) for seed in range(given.episodes)]
        scenes.write_files(made, folder / "files")
        scenes.write_videos(made, folder / "videos")
        recordings = scenes.write_recordings(made, folder / "recordings")
        recorded = sum(path.stat().st_size for path in recordings) / 1e6
        with (
            Server(given.bin.resolve(), folder / "data", 1, "--worker-threads", "1") as server,
            gleaner.connect(server.url) as robots,
        ):
            ours = Gleaner(robots, recordings)
            print(f"{given.episodes} episodes of {given.steps} steps, {recorded:.0f} MB of recordings")
            met = [measured(ours, folder, window, given) for window in given.windows]
    sys.exit(0 if all(met) else 1)


if __name__ == "__main__":
    main()
