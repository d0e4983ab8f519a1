"""One real server for all tests: built from the repository, started on a free port over a temporary folder."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import pytest

import gleaner
from fake_ros import EXAMPLE
from fake_server import Answer, Play, Start
from gleaner._proto.v1 import episode_pb2
from gleaner._upload import Upload, digest
from gleaner.types import Job
from programs import Server, cli

TASK = "pick_small"
IMAGE = 16
DEPLOYMENT = "pick_small@test"


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
    process = Server(tmp_path_factory.mktemp("server"), "--openpi-listen", "127.0.0.1:0")
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
    train = client.jobs.train(
        task, experts_of=pretrain.result_id, policy="finetune", steps=3, batch=8, warmup_steps=2, seed=7
    )
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


@pytest.fixture
def play() -> Iterator[Start]:
    """Starts a fake server that answers as given, and connects to it."""
    stack: list[Callable[[], object]] = []

    def start(answer: Answer) -> tuple[Play, gleaner.Client]:
        shown = Play(answer)
        server, address = shown.serve()
        client = gleaner.connect(address)
        stack.extend((lambda: server.stop(0).wait(), client.close))
        return shown, client

    yield start
    while stack:
        stack.pop()()


@pytest.fixture
def modules(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, ModuleType]]:
    """The own modules of the ROS 2 example."""
    monkeypatch.syspath_prepend(str(EXAMPLE))
    names = ("messages", "transforms", "control")
    yield {name: importlib.import_module(name) for name in names}
    for name in (*names, "gleaner_node"):
        sys.modules.pop(name, None)


@pytest.fixture
def monotonic(modules: dict[str, ModuleType], monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time that its node reads, set by tests."""
    del modules
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    return now
