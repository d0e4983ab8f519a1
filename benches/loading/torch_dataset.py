"""Samples a second of `torch_dataset` beside LeRobot's dataset of the same steps, each with one worker process.

LeRobot reads gleaner's own export, which has the very pictures of the segments, and videos of the recorded size. Takes
turns in one run and prints medians and ratios; ends with 1 if a target is missed.
"""

import argparse
import pathlib
import statistics
import sys
import tempfile
import time

import gleaner
from process import Server

import scenes
from peer import peer

TASK = "loading"
# At least as fast as the faster of LeRobot's.
TARGET = 1.0
OURS = "segments"
PEERS = {"LeRobot, gleaner's export (PNG of 128 × 128)": "images", "LeRobot, AV1 video of 480 × 640": "videos"}


def prepare(client: gleaner.Client, recordings: list[pathlib.Path], window: int) -> str:
    """A dataset of every step of the recordings: its segments have `window` steps."""
    client.tasks.create(scenes.specification(TASK))
    for at, path in enumerate(recordings):
        client.episodes.push(path, task=TASK, outcome="failure" if at % 2 else "success")
    encoder = client.jobs.pretrain(TASK, preset="tiny", steps=2, batch=8, segment_length=window - 1)
    run = client.jobs.wait(client.jobs.score(TASK, client.jobs.wait(encoder).result_id)).result_id
    return client.datasets.create(run, top_fraction=1.0).id


def export(client: gleaner.Client, dataset: str, folder: pathlib.Path) -> None:
    job = client.jobs.submit(TASK, {"export": {"dataset_id": dataset, "format": "lerobot"}})
    client.datasets.download_export(client.jobs.wait(job).result_id, folder)


def measured(folders: dict[str, pathlib.Path], window: int, given: argparse.Namespace) -> bool:
    """Prints the table of one length; whether the target was met."""
    kinds = [OURS, *PEERS.values()]
    rates = {kind: [] for kind in kinds}
    for _ in range(given.rounds):
        for kind in kinds:
            rates[kind].append(peer(kind, folders[kind], window, given.seconds))
    print(f"\nSamples of {window} step{'s' if window > 1 else ''}, {len(scenes.CAMERAS)} cameras, one worker each:\n")
    print("| | samples a second | steps a second | gleaner over it |\n|---|---:|---:|---:|")
    row = lambda name, value, ratio: print(f"| {name} | {value:.0f} | {value * window:.0f} | {ratio} |", flush=True)
    row("gleaner, `torch_dataset`", statistics.median(rates[OURS]), "")
    ratios = {}
    for name, kind in PEERS.items():
        ratios[kind] = statistics.median(a / b for a, b in zip(rates[OURS], rates[kind], strict=True))
        row(name, statistics.median(rates[kind]), f"{ratios[kind]:.1f}")
    worst = min(ratios.values())
    print(f"\nover the faster of LeRobot's: {worst:.1f}, at least {TARGET}: {'met' if worst >= TARGET else 'MISSED'}")
    return worst >= TARGET


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bin", type=pathlib.Path, required=True, help="where the programs are")
    parser.add_argument("--episodes", type=int, default=8)
    parser.add_argument("--steps", type=int, default=64, help="of each episode")
    parser.add_argument("--windows", type=int, nargs="+", default=[1, 7], help="steps of a sample")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=10, help="of each loader in each round")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = pathlib.Path(temporary)
        made = [scenes.episode(seed, given.steps) for seed in range(given.episodes)]
        scenes.write_videos(made, folder / "videos")
        recordings = scenes.write_recordings(made, folder / "recordings")
        with (
            Server(given.bin.resolve(), folder / "data", 1, "--worker-threads", "1") as server,
            gleaner.connect(server.url) as client,
        ):
            dataset = prepare(client, recordings, max(given.windows))
            export(client, dataset, folder / "images")
            begun = time.perf_counter()
            segments = client.datasets.torch_dataset(dataset, frames=True, cache=folder / "cache")
            seconds = time.perf_counter() - begun
        folders = {OURS: segments.cache.folder, "images": folder / "images", "videos": folder / "videos"}
        size = sum(path.stat().st_size for path in segments.cache.folder.iterdir()) / 1e6
        count = len(segments)
        print(f"{given.episodes} episodes of {given.steps} steps; the first use of `torch_dataset` fetched {count} segments")
        print(f"of up to {max(given.windows)} steps in {seconds:.1f} s ({count / seconds:.0f} a second) into {size:.0f} MB")
        met = [measured(folders, window, given) for window in given.windows]
    sys.exit(0 if all(met) else 1)


if __name__ == "__main__":
    main()
