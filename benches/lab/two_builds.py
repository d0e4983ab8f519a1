"""The rates of two builds of the server on SQLite, in turn, each time on a new data folder and with the same client.

    python benches/lab/two_builds.py --before FOLDER --after FOLDER

Each folder has the programs of one build; those of `--after` record the episodes and create the task. The table has the
medians of the rounds, and the median, the least and the greatest ratio of neighbouring ones.
"""

import argparse
import functools
import pathlib
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import gleaner
from process import Server, client

TASK = "pick_cube"
EPISODES = 300
CALLERS = 8
UNLIMITED = ("--calls-per-second", "1000000", "--unary-calls-per-second", "1000000")


def rates(bin: pathlib.Path, tools: pathlib.Path, recordings: Sequence[pathlib.Path]) -> dict[str, float]:
    """Calls a second of each kind."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = pathlib.Path(temporary)
        with Server(bin, folder / "data", 1, *UNLIMITED) as server:
            client(tools, server, folder, "task", "create", "--sim", TASK, "--image", "16")
            with gleaner.connect(server.url) as robots, ThreadPoolExecutor(CALLERS) as callers:
                return _measured(robots, callers, recordings)


def _measured(
    robots: gleaner.Client, callers: ThreadPoolExecutor, recordings: Sequence[pathlib.Path]
) -> dict[str, float]:
    found: dict[str, float] = {}

    def timed(name: str, count: int, work: Callable[[int], object], *, at_once: bool = False) -> None:
        begun = time.perf_counter()
        list((callers.map if at_once else map)(work, range(count)))
        found[name] = count / (time.perf_counter() - begun)

    push = functools.partial(robots.episodes.push, task=TASK, outcome="success", cohort="expert")
    timed("uploads, 8 at once", len(recordings), lambda number: push(recordings[number]), at_once=True)
    ids = [episode.id for episode in robots.episodes.list(TASK)]

    def label(number: int) -> None:
        outcome = ("failure", "success")[number // len(ids) % 2]
        robots.episodes.label(ids[number % len(ids)], outcome=outcome, cohort="expert")

    timed("labels", 5 * len(ids), label)
    timed("labels, 8 at once", 10 * len(ids), label, at_once=True)
    timed("reads of an episode", 10 * len(ids), lambda number: robots.episodes.get(ids[number % len(ids)]))
    timed("reads of its labels", 5 * len(ids), lambda number: robots.episodes.labels(ids[number % len(ids)]))
    timed("lists of all", 100, lambda _: list(robots.episodes.list(TASK)))
    for episode in ids[:100]:
        robots.episodes.label(episode, outcome="failure", cohort="weak")
    timed("snapshots", 200, lambda _: robots.snapshots.create(TASK))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", type=pathlib.Path, required=True)
    parser.add_argument("--after", type=pathlib.Path, required=True)
    parser.add_argument("--rounds", type=int, default=6)
    args = parser.parse_args()
    builds = {"before": args.before.resolve(), "after": args.after.resolve()}
    with tempfile.TemporaryDirectory() as folder:
        record = [builds["after"] / "gleaner", "record", "--out", folder, "--agent", f"expert:{EPISODES}", "--image", "16"]
        subprocess.run(record, check=True, stdout=subprocess.DEVNULL)
        recordings = sorted(pathlib.Path(folder).glob("*.mcap"))
        rounds: list[dict[str, dict[str, float]]] = []
        for number in range(args.rounds):
            order = ("before", "after") if number % 2 == 0 else ("after", "before")
            rounds.append({name: rates(builds[name], builds["after"], recordings) for name in order})
    print("| calls a second | before | after | ratio | least and greatest |\n|---|---:|---:|---:|---:|")
    for kind in rounds[0]["before"]:
        middle = {name: statistics.median(found[name][kind] for found in rounds) for name in builds}
        ratios = sorted(found["after"][kind] / found["before"][kind] for found in rounds)
        spread = f"{ratios[0]:.2f} to {ratios[-1]:.2f}"
        print(f"| {kind} | {middle['before']:.0f} | {middle['after']:.0f} | {statistics.median(ratios):.2f} | {spread} |")


if __name__ == "__main__":
    main()
