"""A score job in one process and over several, on the same episodes: its time, the processor time of each process, and a
digest of the rows that it writes, which must not depend on their number.

Each process has one thread of its own, so that two of them use two processors where one uses one. With --slurm they run on
as many nodes of the Slurm that SLURM_CONF names; the time then has the seconds of Slurm's queue, and the workers, which are
not children of the server, have neither processor time nor peak.
"""

import argparse
import hashlib
import json
import os
import pathlib
import shutil
import socket
import tempfile
import time

import lab
from process import Server, client
from rows import connect

TICKS = os.sysconf("SC_CLK_TCK")


def processor_seconds(server: Server) -> dict[int, float]:
    """The processor time of each worker of the server, by its process id."""
    seconds = {}
    threads = pathlib.Path(f"/proc/{server.process.pid}/task").glob("*/children")
    for pid in " ".join(thread.read_text() for thread in threads).split():
        try:
            name, fields = pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)
        except OSError:
            continue  # It has ended.
        if "gleaner-worker" in name:
            user, system = fields.split()[11:13]
            seconds[int(pid)] = (int(user) + int(system)) / TICKS
    return seconds


def free_port() -> int:
    """For workers on nodes, whose server has a fixed port."""
    with socket.create_server(("127.0.0.1", 0)) as closed:
        return closed.getsockname()[1]


def digest(data: pathlib.Path, run: str) -> str:
    """Of every row of the run but its ids and times."""
    hasher = hashlib.sha256()
    with connect(data) as rows:
        frozen = rows.execute("select lo, hi, quantiles, expert_ids from score_runs where id = ?", [run]).fetchone()
        hasher.update(repr(frozen).encode())
        scored = rows.execute(
            "select position, episode_id, role, w, q, match_episode, match_step, distances from episode_scores"
            " where score_run_id = ? order by position",
            [run],
        )
        for row in scored:
            hasher.update(repr(row).encode())
    return hasher.hexdigest()[:16]


def score(given: argparse.Namespace, folder: pathlib.Path, ranks: int, words: list[str]) -> dict[str, object]:
    """Runs one score job on a server with this number of processes."""
    bin, data = given.bin.resolve(), folder / "data"
    # Features of an earlier run would spare this one their computation.
    for kept in (data / "cache").glob("*.features"):
        kept.unlink()
    flags = ["--score-ranks", str(ranks), "--worker-threads", "1", "--worker-nice", "0", "--worker-idle", "false"]
    if given.slurm:
        flags += ["--engine", "slurm", "--worker-listen", f"127.0.0.1:{free_port()}", "--slurm-poll-seconds", "1"]
        flags += ["--slurm-options", given.slurm_options]
    seconds, peak = {}, 0.0
    with Server(bin, data, 1, *flags) as server:
        job = json.loads(client(bin, server, folder, "score", *words))
        while True:
            seconds |= processor_seconds(server)
            peak = max(peak, server.child_peak_mib("gleaner-worker"))
            now = json.loads(client(bin, server, folder, "job", job["id"]))["job"]
            if now["state"] not in ("queued", "running"):
                break
            time.sleep(0.5)
    if now["state"] != "succeeded":
        raise SystemExit(now["error"])
    with connect(data) as rows:
        begun, ended = rows.execute("select started_at, ended_at from jobs where id = ?", [job["id"]]).fetchone()
    return {
        "ranks": ranks,
        "seconds": (ended - begun) / 1000,
        "processor_seconds": sorted(seconds.values(), reverse=True),
        "peak_mib": peak,
        "digest": digest(data, now["result_id"]),
    }


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--bin", type=pathlib.Path, required=True, help="where the programs are")
    arguments.add_argument("--recordings", type=pathlib.Path, required=True, help="the example that writes recordings")
    arguments.add_argument("--episodes", type=int, default=1000)
    arguments.add_argument("--steps", type=int, default=100)
    arguments.add_argument("--processes", type=int, default=2, help="that write recordings")
    arguments.add_argument("--scratch", type=pathlib.Path, default=pathlib.Path("/dev/shm"), help="a folder in memory")
    arguments.add_argument("--folder", type=pathlib.Path, help="use the lab in this folder, or make it there and keep it")
    arguments.add_argument("--ranks", type=int, nargs="+", default=[1, 2], help="numbers of processes to compare")
    arguments.add_argument("--scorers", nargs="+", default=["raw", "ssdf"])
    arguments.add_argument("--preset", default="small", help="of the encoder")
    arguments.add_argument("--slurm", action="store_true", help="processes on nodes of Slurm")
    arguments.add_argument("--slurm-options", default="--cpus-per-task=1", help="options of sbatch")
    arguments.add_argument("--repeat", type=int, default=3, help="runs of each; the fastest is shown")
    given = arguments.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.folder or pathlib.Path(temporary)
        folder.mkdir(exist_ok=True)
        if not (folder / "data").exists():
            lab.make(given, folder)
        words = ["--task", lab.TASK, "--preset", given.preset, "--steps", "1", "--batch", "8", "--wait"]
        with Server(given.bin.resolve(), folder / "data", 1) as server:
            encoder = json.loads(client(given.bin.resolve(), server, folder, "pretrain", *words))["result_id"]
        print("| scorer | processes | time | speed-up | processor time of each | peak of one | digest |")
        print("|---|---:|---:|---:|---|---:|---|", flush=True)
        for scorer in given.scorers:
            runs: dict[int, list[dict[str, object]]] = {ranks: [] for ranks in given.ranks}
            for _ in range(given.repeat):
                # In turn, so that other load on the machine meets each number.
                for ranks in given.ranks:
                    runs[ranks].append(score(given, folder, ranks, ["--encoder", encoder, "--scorer", scorer]))
            if len({run["digest"] for made in runs.values() for run in made}) != 1:
                raise SystemExit(f"{scorer}: the rows differ: {runs}")
            alone = min(run["seconds"] for run in runs[given.ranks[0]])
            for ranks, made in runs.items():
                best = min(made, key=lambda run: run["seconds"])
                busy = ", ".join(f"{seconds:.1f} s" for seconds in best["processor_seconds"])
                print(
                    f"| {scorer} | {ranks} | {best['seconds']:.1f} s | {alone / best['seconds']:.2f} | {busy} |"
                    f" {best['peak_mib']:.0f} MiB | {best['digest']} |",
                    flush=True,
                )
        if given.folder is None:
            shutil.rmtree(folder / "data")


if __name__ == "__main__":
    main()
