"""How long each page takes on a database of a large lab.

A real server makes the schema, takes a few recordings of the embedded simulator and scores them; then rows are added
until there are as many episodes and scored segments as asked for, and every page is asked for over a socket, one after
the other. Nothing but Python's own library is needed.
"""

import argparse
import array
import json
import pathlib
import random
import shutil
import statistics
import sys
import tempfile
import time
import urllib.request

sys.path.insert(0, str(pathlib.Path(__file__).parent.parent / "lab"))
from process import Server, client  # noqa: E402
from rows import OUTCOMES, add_episodes, connect, ulid  # noqa: E402


def lab(bin: pathlib.Path, folder: pathlib.Path) -> None:
    """A few real episodes with a score run."""
    with Server(bin, folder / "data", workers=1) as server:

        def run(*words):
            return client(bin, server, folder, *words)

        run("record", "--task", "pick_cube", "--out", "recordings", "--agent", "expert:6", "--agent", "early_release:1.0:6")
        run("task", "create", "--sim", "pick_cube")
        run("push", "recordings/", "--labels", "recordings/labels.csv")
        run("pretrain", "--steps", "3", "--wait")
        with connect(folder / "data") as rows:
            (encoder,) = rows.execute("select id from encoders").fetchone()
        run("score", "--encoder", encoder, "--wait")


def fill(data: pathlib.Path, episodes: int, steps: int) -> None:
    """Adds episodes, their labels, and their scores in the run there is."""
    chance = random.Random(7)
    rows = connect(data)
    task, report = rows.execute("select task_id, report from episodes limit 1").fetchone()
    run, snapshot = rows.execute("select id, snapshot_id from score_runs").fetchone()
    (position,) = rows.execute("select count(*) from snapshot_episodes where snapshot_id = ?", [snapshot]).fetchone()
    recordings = ((f"{chance.getrandbits(256):064x}", 3_000_000) for _ in range(episodes))
    with rows:
        added = add_episodes(rows, task, report, recordings, steps, OUTCOMES, chance)
        for place, (episode, outcome, cohort) in enumerate(added, position):
            rows.execute(
                "insert into snapshot_episodes values (?, ?, ?, ?, ?, 'imperfect')",
                [snapshot, place, episode, outcome, cohort],
            )
            scored(rows, run, place, episode, steps, chance)
        # The server stores these counts with the rows that never change.
        rows.execute("update snapshots set imperfect = imperfect + ? where id = ?", [episodes, snapshot])
        rows.execute(
            "update score_runs set imperfect_episodes = imperfect_episodes + ?, imperfect_segments = imperfect_segments + ?"
            " where id = ?",
            [episodes, episodes * steps, run],
        )
    rows.close()


def add_tasks(data: pathlib.Path, tasks: int, each: int) -> None:
    """Adds tasks like the one there is, with a few episodes each."""
    chance = random.Random(8)
    rows = connect(data)
    spec, report = rows.execute("select spec, report from tasks join episodes on task_id = tasks.id limit 1").fetchone()
    begin = int(time.time() * 1000) - 40 * 86_400_000
    with rows:
        for number in range(tasks):
            at = begin + number * 60_000
            task, name = f"task_{ulid(at, chance)}", f"{chance.choice(['pick', 'push', 'fold', 'pour'])}_{number:04}"
            rows.execute(
                "insert into tasks (id, name, spec, created_at) values (?, ?, ?, ?)",
                [task, name, json.dumps({**json.loads(spec), "name": name}), at],
            )
            for episode in range(each):
                rows.execute(
                    "insert into episodes (id, task_id, file_name, recording, size_bytes, steps, duration_s, mapping,"
                    " warnings, report, outcome, cohort, created_at) values (?, ?, ?, ?, ?, 200, 20, 'gleaner', 0, ?, ?, ?, ?)",
                    [f"ep_{ulid(at, chance)}", task, f"{episode:06}.mcap", f"{chance.getrandbits(256):064x}", 3_000_000,
                     report, chance.choice(OUTCOMES), f"cohort_{chance.randrange(12)}", at],
                )
    rows.close()


def scored(rows, run, position, episode, steps, chance):
    base = chance.random()
    q = array.array("f", (min(1.0, max(0.0, base + chance.gauss(0, 0.2))) for _ in range(steps)))
    w = array.array("d", (value - 1.0 for value in q))
    match = array.array("I", (chance.randrange(6) for _ in range(steps)))
    step = array.array("I", (chance.randrange(20) for _ in range(steps)))
    distances = array.array("f", (1.0 - value for value in q for _ in range(3)))
    rows.execute(
        "insert into episode_scores values (?, ?, ?, 'imperfect', ?, ?, ?, ?, ?)",
        [run, position, episode, *(part.tobytes() for part in (w, q, match, step, distances))],
    )


def ask(url: str) -> tuple[float, int]:
    begun = time.perf_counter()
    request = urllib.request.Request(url, headers={"accept": "text/html"})
    with urllib.request.urlopen(request) as answer:
        size = len(answer.read())
    return (time.perf_counter() - begun) * 1000, size


def addresses(data: pathlib.Path) -> list[tuple[str, str]]:
    rows = connect(data)
    run, snapshot, encoder = rows.execute("select id, snapshot_id, encoder_id from score_runs").fetchone()
    (task,) = rows.execute("select name from tasks join score_runs on task_id = tasks.id").fetchone()
    real = rows.execute("select id from episodes where file_name not like '0%.mcap'").fetchone()[0]
    (camera,) = rows.execute("select json_extract(spec, '$.cameras[0].name') from tasks where name = ?", [task]).fetchone()
    job = rows.execute("select id from jobs where kind = 'pretrain'").fetchone()[0]
    episodes = f"/tasks/{task}/episodes"
    return [
        ("overview", "/"),
        ("overview, page 10", "/?page=10"),
        ("overview, searched", "/?text=fold"),
        ("overview as JSON", "/?format=json"),
        ("episodes", episodes),
        ("episodes by mean q", f"{episodes}?sort=mean_q"),
        ("episodes, filtered", f"{episodes}?outcome=failure&cohort=cohort_3&q_from=0.2&q_to=0.8"),
        ("episodes, page 50", f"{episodes}?page=50"),
        ("one episode", f"/episodes/{real}?run={run}"),
        ("a frame", f"/episodes/{real}/frames/{camera}/3"),
        ("a thumbnail", f"/episodes/{real}/frames/{camera}/3?size=96"),
        ("score runs", f"/tasks/{task}/runs"),
        ("score run", f"/runs/{run}?beta=0.8"),
        ("β moved", f"/runs/{run}/what-if?beta=0.7&format=html"),
        ("best tenth", f"/runs/{run}/what-if?top_fraction=0.1&format=html"),
        ("snapshot", f"/snapshots/{snapshot}"),
        ("encoder", f"/encoders/{encoder}"),
        ("jobs", "/jobs"),
        ("one job", f"/jobs/{job}"),
        ("deployments", "/deployments"),
        ("kinds", "/kinds"),
    ]


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--bin", type=pathlib.Path, required=True, help="where the programs are")
    arguments.add_argument("--episodes", type=int, default=10_000)
    arguments.add_argument("--steps", type=int, default=200)
    arguments.add_argument("--tasks", type=int, default=0, help="further tasks, with 10 episodes each")
    arguments.add_argument("--keep", type=pathlib.Path, help="leave the data folder here")
    arguments.add_argument("--times", type=int, default=30)
    arguments.add_argument("--json", type=pathlib.Path, help="write the numbers here too")
    given = arguments.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        print("recording, pushing, scoring a few episodes …", flush=True)
        lab(given.bin.resolve(), folder)
        data = folder / "data"
        print(f"adding {given.episodes} episodes of {given.steps} segments …", flush=True)
        fill(data, given.episodes, given.steps)
        add_tasks(data, given.tasks, 10)
        table = {}
        with Server(given.bin.resolve(), folder / "data", workers=0) as server:
            for name, path in addresses(data):
                took = [ask(server.pages + path) for _ in range(given.times + 1)]
                rest = sorted(each for each, _ in took[1:])
                table[name] = {"first": took[0][0], "p50": statistics.median(rest), "worst": rest[-1], "bytes": took[0][1]}
        if given.keep:
            shutil.copytree(folder / "data", given.keep)
    print(f"\n| page | first, ms | p50, ms | worst of {given.times}, ms | KiB |\n|---|---:|---:|---:|---:|")
    for name, row in table.items():
        print(f"| {name} | {row['first']:.0f} | {row['p50']:.1f} | {row['worst']:.0f} | {row['bytes'] / 1024:.0f} |")
    if given.json:
        given.json.write_text(json.dumps(table, indent=2))


if __name__ == "__main__":
    main()
