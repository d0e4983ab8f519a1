"""One real server for all tests: built from the repository, started on a free port over a temporary folder."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

import gleaner
from gleaner._proto.v1 import episode_pb2
from gleaner._upload import Upload, digest
from gleaner.types import Job

ROOT = Path(__file__).parents[3]
TASK = "pick_small"
IMAGE = 16
DEPLOYMENT = "pick_small@test"


def binary(name: str) -> str:
    """A program of the repository: as named by the environment, for example GLEANER_SERVER_BIN, or as built."""
    given = os.environ.get(f"{name.upper().replace('-', '_')}_BIN")
    found = Path(given) if given else ROOT / "target" / "debug" / name
    if not found.exists():
        pytest.exit(f"{found}: not built; run make demo or make test-python", returncode=2)
    return str(found)


def cli(*args: str) -> None:
    """Runs the command line tool."""
    done = subprocess.run([binary("gleaner"), *args], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def certificates(data: Path, *command: str) -> None:
    """Runs `gleaner-server tls …` over a data folder; the files are in its folder `tls`."""
    done = subprocess.run([binary("gleaner-server"), "tls", *command, "--data-dir", str(data)], check=False, text=True)
    assert done.returncode == 0


class Server:
    """A server process; `start` and `stop` can be called repeatedly over the same folder."""

    def __init__(self, data: Path, *flags: str) -> None:
        self.data, self.flags, self.listen = data, flags, "127.0.0.1:0"
        self.start()

    def start(self) -> None:
        """Starts it and waits until it listens: its first lines name its addresses."""
        command = [binary("gleaner-server"), "serve", "--listen", self.listen, "--data-dir", str(self.data)]
        self.process = subprocess.Popen(
            [*command, "--worker-threads", "1", *self.flags],
            stdout=subprocess.PIPE,
            text=True,
            env={"GLEANER_LOG": "warn", "OMP_NUM_THREADS": "1", "OMP_WAIT_POLICY": "PASSIVE", **os.environ},
        )
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if line.startswith("pages on "):
            line = self.process.stdout.readline()
        assert line.startswith("listening on "), f"the server ended before it listened: {line!r}"
        self.address = line.removeprefix("listening on ").strip()
        # Clients reconnect to the same port after a restart.
        self.listen = self.address.rpartition("//")[2]

    def kill(self) -> None:
        """Kills it, as a power cut would."""
        self.process.kill()
        self.process.wait()

    def stop(self) -> None:
        """Stops it with SIGTERM and waits for its end."""
        self.process.terminate()
        try:
            self.process.wait(20)
        except subprocess.TimeoutExpired:
            self.kill()


def half_an_upload(client: gleaner.Client, task: str, path: Path) -> Upload:
    """An upload whose first half is on the server; `run` completes it."""
    start = episode_pb2.StartUploadRequest(
        task=task,
        file_name=path.name,
        size_bytes=path.stat().st_size,
        blake3=digest(path),
        outcome=episode_pb2.OUTCOME_UNKNOWN,
    )
    upload = Upload(client._rpc, path, start, lambda sent: None)
    upload._open()
    piece = path.read_bytes()[: start.size_bytes // 2]
    first = episode_pb2.WriteUploadRequest(upload_id=upload.upload_id, data=piece)
    client._rpc.upload("EpisodeService/WriteUpload", [first], episode_pb2.WriteUploadResponse)
    return upload


@dataclass(frozen=True)
class Lab:
    """The objects of the shared server."""

    experts: tuple[str, ...]  # episode ids
    failures: tuple[str, ...]
    pretrain: Job
    score: Job
    train: Job
    dataset: str  # all but nothing filtered out

    @property
    def run(self) -> str:
        return self.score.result_id

    @property
    def policy(self) -> str:
        return self.train.result_id


@pytest.fixture(scope="session")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server shared by all tests that only read or add."""
    process = Server(tmp_path_factory.mktemp("server"))
    yield process
    process.stop()


@pytest.fixture(scope="session")
def server(running: Server) -> str:
    """The shared server's address."""
    return running.address


@pytest.fixture(scope="session")
def client(server: str) -> Iterator[gleaner.Client]:
    with gleaner.connect(server) as connected:
        yield connected


@pytest.fixture(scope="session")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Path]]:
    """Recordings of the embedded simulator, by cohort: 4 of an expert, 3 of one with a wrong goal."""
    folder = tmp_path_factory.mktemp("recordings")
    agents = ["--agent", "expert:4", "--agent", "wrong_goal:3"]
    cli("record", "--out", str(folder), "--image", str(IMAGE), *agents)
    found: dict[str, list[Path]] = {}
    for path in sorted(folder.glob("*.mcap")):
        cohort = path.stem.split("-")[1]
        found.setdefault(cohort, []).append(path)
    assert {cohort: len(paths) for cohort, paths in found.items()} == {"expert": 4, "wrong_goal": 3}
    return found


@pytest.fixture(scope="session")
def task(client: gleaner.Client, server: str) -> str:
    """The name of the simulator's task at 16 × 16 pixels."""
    cli("--server", server, "task", "create", "--sim", "pick_cube")
    spec = client.tasks.get("pick_cube").spec
    spec.name = TASK
    for camera in spec.cameras:
        camera.height = camera.width = IMAGE
    client.tasks.create(spec)
    return TASK


@pytest.fixture(scope="session")
def lab(client: gleaner.Client, task: str, recordings: dict[str, list[Path]]) -> Lab:
    """Every stage once, with few steps: push, pretrain, score, train, deploy."""
    push = client.episodes.push
    experts = [push(path, task=task, outcome="success", cohort="expert") for path in recordings["expert"]]
    failures = [push(path, task=task, outcome="failure", cohort="wrong_goal") for path in recordings["wrong_goal"]]
    pretrain = client.jobs.pretrain(task, steps=3, batch=8, warmup_steps=2, segment_length=3, seed=7)
    score = client.jobs.score(task, pretrain.result_id)
    train = client.jobs.train(task, experts_of=pretrain.result_id, steps=3, batch=8, warmup_steps=2, seed=7)
    for job in (pretrain, score, train):
        client.jobs.wait(job, timeout=120)
    client.deploy(DEPLOYMENT, train.result_id)
    dataset = client.datasets.create(score.result_id, top_fraction=0.5)
    ids = [tuple(episode.id for episode in episodes) for episodes in (experts, failures)]
    return Lab(ids[0], ids[1], pretrain, score, train, dataset.id)


@pytest.fixture(scope="session")
def deployment(lab: Lab) -> str:
    """The name of a deployed policy of the task."""
    del lab
    return DEPLOYMENT
