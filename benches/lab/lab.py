"""A lab of 100,000 episodes: made in minutes, then walked, with the time and the peak memory of each piece of work.

The files are written by the recording library (`recordings`, an example of gleaner-worker), the rows in bulk, and the
score run is imported by the client's own command. Everything else runs through a real server and real workers.
"""

import argparse
import contextlib
import json
import pathlib
import random
import resource
import shutil
import statistics
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Iterator

import gleaner
from process import Server, client
from rows import add_episodes, connect
from table import Table, shown

# One success in twenty is an expert.
FEW_EXPERTS = ["success"] + ["failure"] * 19
TASK = "pick_cube"
# How long a first optimiser step is waited for.
PATIENCE_SECONDS = 600
# The targets.
FIRST_STEP_SECONDS = 10.0
PAGE_SECONDS = 0.2


def specification() -> dict:
    """The simulator's task with one camera of 8 by 8 pixels, so that 100,000 episodes fit into a few GB."""
    fields = [("tool_position", 3), ("gripper_width", 1)], [("delta_position", 3), ("gripper", 1)]
    sources = [
        {"field": name, "topic": topic, "paths": [name]}
        for topic, named in zip(("/robot/state", "/robot/action"), fields, strict=True)
        for name, _ in named
    ]
    return {
        "name": TASK,
        "rate_hz": 10.0,
        "cameras": [{"name": "table", "height": 8, "width": 8, "depth": False}],
        "proprioception": [{"name": name, "size": size} for name, size in fields[0]],
        "action": [{"name": name, "size": size} for name, size in fields[1]],
        "mappings": [
            {
                "name": "gleaner",
                "clock": "/robot/action",
                "cameras": [{"camera": "table", "color": "/camera/table/color"}],
                "fields": sources,
            }
        ],
    }


def make(given: argparse.Namespace, folder: pathlib.Path) -> None:
    """Makes the data folder: a server makes the database, and the files and rows are added once it is stopped."""
    bin, data = given.bin.resolve(), folder / "data"
    (folder / "task.json").write_text(json.dumps(specification()))
    with Server(bin, data, 0) as server:
        task = json.loads(client(bin, server, folder, "task", "create", "task.json"))["task"]["id"]
    with connect(data) as rows:
        (spec,) = rows.execute("select spec from tasks").fetchone()
        (folder / "spec.json").write_text(spec)
        report = json.dumps({"mapping": "gleaner", "steps": given.steps})
        chance = random.Random(7)
        for _ in add_episodes(rows, task, report, files(given, folder), given.steps, FEW_EXPERTS, chance):
            pass
        # A lab of this size has its sidecars already.
        rows.execute("delete from sidecar_queue")


def keep(folder: pathlib.Path) -> None:
    """Keeps the database and its stamp as they are, so that each walk begins with the same rows."""
    (folder / "made").mkdir()
    for name in ("gleaner.db", "blobs/stamp.json"):
        shutil.copy(folder / "data" / name, folder / "made")


def restore(folder: pathlib.Path) -> None:
    """Puts the kept database in the place of the one that was walked."""
    data = folder / "data"
    for walked in data.glob("gleaner.db*"):
        walked.unlink()
    shutil.copy(folder / "made" / "gleaner.db", data)
    shutil.copy(folder / "made" / "stamp.json", data / "blobs")


def files(given: argparse.Namespace, folder: pathlib.Path) -> Iterator[tuple[str, int]]:
    """Writes the recordings, in as many processes as asked for, and yields their digests and sizes."""
    each = -(-given.episodes // given.processes)
    with contextlib.ExitStack() as stack:
        running = []
        for first in range(0, given.episodes, each):
            scratch = stack.enter_context(tempfile.TemporaryDirectory(dir=given.scratch))
            out = stack.enter_context((folder / f"recordings-{first}").open("w+"))
            count = min(each, given.episodes - first)
            command = [given.recordings.resolve(), folder / "data", folder / "spec.json", scratch, first, count, given.steps]
            process = stack.enter_context(subprocess.Popen([str(word) for word in command], stdout=out))
            stack.callback(process.kill)
            running.append((process, out))
        for process, out in running:
            if process.wait() != 0:
                raise SystemExit("the recordings could not be written")
            out.seek(0)
            for line in out:
                digest, size = line.split()
                yield digest, int(size)


def scores(folder: pathlib.Path, steps: int) -> int:
    """Writes a quality for every step of every episode as CSV, and returns their number."""
    chance = random.Random(8)
    lines = [f"{step}," for step in range(steps)]
    count = 0
    with connect(folder / "data") as rows, (folder / "scores.csv").open("w") as out:
        out.write("episode,step,q\n")
        for episode, outcome in rows.execute("select id, outcome from episodes order by id"):
            base = 0.9 if outcome == "success" else chance.random()
            q = [min(1.0, max(0.0, base + chance.gauss(0, 0.2))) for _ in range(steps)]
            out.writelines(f"{episode},{line}{value:.4f}\n" for line, value in zip(lines, q, strict=True))
            count += steps
    return count


def listed(robots: gleaner.Client) -> tuple[int, float]:
    """The number of all episodes, and the longest time between two pages of a thousand."""
    count, longest, before = 0, 0.0, time.perf_counter()
    for _ in robots.episodes.list(TASK):
        count += 1
        now = time.perf_counter()
        longest, before = max(longest, now - before), now
    return count, longest


def get(url: str) -> int:
    with urllib.request.urlopen(urllib.request.Request(url, headers={"accept": "text/html"})) as answer:
        return len(answer.read())


def first_step(server: Server, robots: gleaner.Client, job: str) -> tuple[float, float]:
    """Seconds from the start of a job to its first optimiser step, and the peak memory of its worker in MiB."""
    begun, started, peak = time.perf_counter(), None, 0.0
    while time.perf_counter() - begun < PATIENCE_SECONDS:
        now = robots.jobs.get(job)
        peak = max(peak, server.child_peak_mib("gleaner-worker"))
        if started is None and now.attempt > 0:
            started = time.perf_counter()
        if now.error:
            raise RuntimeError(f"{peak:.0f} MiB: {now.error}")
        if now.done > 0 and now.message.startswith(("training", "pretraining")) or robots.jobs.metrics(job):
            robots.jobs.cancel(job)
            return time.perf_counter() - (started or begun), peak
        time.sleep(0.05)
    robots.jobs.cancel(job)
    raise RuntimeError(f"no step within {PATIENCE_SECONDS} s; {peak:.0f} MiB: {now.message}")


def walk_pages(table: Table, server: Server, run: str, snapshot: str, episode: str) -> None:
    episodes = f"/tasks/{TASK}/episodes"
    for name, path in [
        ("overview", "/"),
        ("episodes", episodes),
        ("episodes by mean q", f"{episodes}?sort=mean_q"),
        ("episodes, filtered", f"{episodes}?outcome=failure&cohort=cohort_3&q_from=0.2&q_to=0.8"),
        ("episodes, page 500", f"{episodes}?page=500"),
        ("one episode", f"/episodes/{episode}?run={run}"),
        ("a frame", f"/episodes/{episode}/frames/table/3"),
        ("score runs", f"/tasks/{TASK}/runs"),
        ("score run", f"/runs/{run}?beta=0.8"),
        ("β moved", f"/runs/{run}/what-if?beta=0.7&format=html"),
        ("best tenth", f"/runs/{run}/what-if?top_fraction=0.1&format=html"),
        ("snapshot", f"/snapshots/{snapshot}"),
        ("jobs", "/jobs"),
    ]:
        server.forget_peak()
        took, size = [], 0
        for _ in range(8):
            begun = time.perf_counter()
            try:
                size = get(server.pages + path)
            except OSError as error:
                table.fail(f"page: {name}", time.perf_counter() - begun, server.peak_mib(), str(error))
                break
            took.append(time.perf_counter() - begun)
        else:
            note = f"first {shown(took[0])}, worst of the rest {shown(max(took[1:]))}, {size / 1024:.0f} KiB"
            table.add(f"page: {name}", statistics.median(took[1:]), server.peak_mib(), note)
            table.within(f"page: {name}, the first", took[0], PAGE_SECONDS)
            table.within(f"page: {name}", statistics.median(took[1:]), PAGE_SECONDS)


def train(bin: pathlib.Path, server: Server, folder: pathlib.Path, *words: str) -> str:
    return json.loads(client(bin, server, folder, *words, "--steps", "1000000"))["id"]


def walk(table: Table, given: argparse.Namespace, folder: pathlib.Path) -> None:
    bin, data = given.bin.resolve(), folder / "data"
    begun = time.perf_counter()
    with Server(bin, data, 1, *given.flag) as server:
        get(server.pages + "/")
        table.add("start of the server, to its first page", time.perf_counter() - begun, server.peak_mib())
        with gleaner.connect(server.url) as robots:
            walk_work(table, bin, server, robots, folder)
    begun = time.perf_counter()
    with Server(bin, data, 0, *given.flag) as server:
        get(server.pages + "/")
        table.add("second start, to its first page", time.perf_counter() - begun, server.peak_mib())


def walk_work(table: Table, bin: pathlib.Path, server: Server, robots: gleaner.Client, folder: pathlib.Path) -> None:
    pages = lambda found: f"{found[0]} episodes; longest wait for a page of 1,000 {shown(found[1])}"  # noqa: E731
    table.measured(server, "list of all episodes", lambda: listed(robots), pages)
    snapshot = table.measured(
        server, "snapshot created", lambda: robots.snapshots.create(TASK),
        lambda found: f"{found.expert_episodes} experts, {found.imperfect_episodes} imperfect",
    )
    table.measured(server, "snapshot read", lambda: robots.snapshots.episodes(snapshot.id), lambda found: f"{len(found)} episodes")

    def imported() -> str:
        return json.loads(client(bin, server, folder, "import-scores", snapshot.id, "scores.csv"))["id"]

    run = table.measured(server, "scores imported", imported, lambda run: run)
    table.add("… the client", 0.0, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024)
    table.measured(server, "score run", lambda: robots.scores.get(run), lambda found: f"{found.imperfect_segments} segments")
    table.measured(server, "histogram", lambda: robots.scores.histogram(run), lambda found: f"{found.segments} segments")
    for name, selection in [
        ("what-if, β 0.7", {"beta": 0.7}),
        ("what-if, best tenth", {"top_fraction": 0.1}),
        ("what-if, best tenth in runs of 5", {"top_fraction": 0.1, "shape": {"min_run": 5}}),
    ]:
        for again in ("first", "again"):
            table.measured(
                server, f"{name}, {again}", lambda selection=selection: robots.scores.what_if(run, [selection]),
                lambda found: f"{found[0].segments} kept" if hasattr(found[0], "segments") else "",
            )
    few = table.measured(server, "dataset created, β 0.9", lambda: robots.datasets.create(run, beta=0.9), lambda found: f"{found.kept_segments} kept")
    most = table.measured(server, "dataset created, β 0.1", lambda: robots.datasets.create(run, beta=0.1), lambda found: f"{found.kept_segments} kept")
    table.measured(server, "datasets listed", lambda: robots.datasets.list(TASK), lambda found: f"{len(found)} datasets")
    episode = next(robots.episodes.list(TASK)).id
    walk_pages(table, server, run, snapshot.id, episode)
    for name, words in [
        ("pretrain", ("pretrain", "--task", TASK, "--snapshot", snapshot.id)),
        ("train, β 0.9", ("train", "--dataset", few.id, "--policy", "bc")),
        ("train, β 0.1", ("train", "--dataset", most.id, "--policy", "bc")),
    ]:
        note = lambda found: f"{shown(found[0])} from the job's start; worker {found[1]:.0f} MiB"  # noqa: E731
        found = table.measured(
            server, f"{name}: first optimiser step",
            lambda words=words: first_step(server, robots, train(bin, server, folder, *words)), note,
        )
        if found is not None:
            table.within(f"{name}: first optimiser step", found[0], FIRST_STEP_SECONDS)


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--bin", type=pathlib.Path, required=True, help="where the programs are")
    arguments.add_argument("--recordings", type=pathlib.Path, required=True, help="the example that writes recordings")
    arguments.add_argument("--episodes", type=int, default=100_000)
    arguments.add_argument("--steps", type=int, default=100)
    arguments.add_argument("--processes", type=int, default=2, help="that write recordings")
    arguments.add_argument("--scratch", type=pathlib.Path, default=pathlib.Path("/dev/shm"), help="a folder in memory")
    arguments.add_argument("--folder", type=pathlib.Path, help="use the lab in this folder, or make it there and keep it")
    arguments.add_argument("--json", type=pathlib.Path, help="write the numbers here too")
    arguments.add_argument("--flag", action="append", default=[], help="a further flag of the server, as --flag=--x=y")
    given = arguments.parse_args()
    table = Table()
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.folder or pathlib.Path(temporary)
        folder.mkdir(exist_ok=True)
        print("| what | time | peak, MiB | |\n|---|---:|---:|---|", flush=True)
        if (folder / "made").exists():
            restore(folder)
        else:
            begun = time.perf_counter()
            make(given, folder)
            count = scores(folder, given.steps)
            keep(folder)
            bytes = sum(file.stat().st_blocks * 512 for file in folder.rglob("*") if file.is_file())
            table.add("lab made", time.perf_counter() - begun, 0, f"{count} segments, {bytes / 1e9:.1f} GB")
        walk(table, given, folder)
    if given.json:
        given.json.write_text(json.dumps(table.rows, indent=2, ensure_ascii=False))
    ended = [f"{what}: {'; '.join(which)}" for what, which in (("failed", table.failed), ("missed", table.missed)) if which]
    if ended:
        raise SystemExit("\n".join(ended))


if __name__ == "__main__":
    main()
