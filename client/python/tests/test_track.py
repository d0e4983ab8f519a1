"""Jobs as runs of MLflow: against its own server where it is installed (make check-mlflow), else against its rules."""

from __future__ import annotations

import json
import re
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, ClassVar

import pytest

import gleaner
from conftest import TASK, Lab
from gleaner._proto.v1 import job_pb2
from gleaner.track import MLflow, TrackerError, _Sender, track
from gleaner.types import Metric


class Rules(BaseHTTPRequestHandler):
    """The part of MLflow's rules that a client can break: names, batches of 1,000, parameters that never change."""

    experiments: ClassVar[dict[str, str]] = {}
    runs: ClassVar[dict[str, dict[str, Any]]] = {}
    batches: ClassVar[list[int]] = []

    def do_GET(self) -> None:
        name = self.path.partition("experiment_name=")[2]
        self.answer(200, {"experiment": {"experiment_id": self.experiments[name]}})

    def do_POST(self) -> None:
        path = self.path.removeprefix("/api/2.0/mlflow/")
        body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        if self.headers.get("Authorization") != "Bearer secret":
            self.answer(401, {"error_code": "UNAUTHENTICATED", "message": "no token"})
        elif path == "experiments/create" and body["name"] in self.experiments:
            self.answer(400, {"error_code": "RESOURCE_ALREADY_EXISTS", "message": "it exists"})
        else:
            self.answer(*getattr(self, path.replace("/", "_").replace("-", "_"))(body))

    def experiments_create(self, body: dict[str, Any]) -> tuple[int, dict[str, Any]]:
        self.experiments[body["name"]] = str(len(self.experiments))
        return 200, {"experiment_id": self.experiments[body["name"]]}

    def runs_search(self, body: dict[str, Any]) -> tuple[int, dict[str, Any]]:
        job = re.fullmatch(r"tags\.`gleaner\.job` = '(\w+)'", body["filter"])
        assert job is not None
        return 200, {"runs": [run for run in self.runs.values() if run["tags"]["gleaner.job"] == job[1]]}

    def runs_create(self, body: dict[str, Any]) -> tuple[int, dict[str, Any]]:
        tags = {tag["key"]: tag["value"] for tag in body["tags"]}
        run: dict[str, Any] = {
            "info": {"run_id": f"r{len(self.runs)}"},
            "data": {"metrics": [], "params": []},
            "tags": tags,
            "all": [],
        }
        self.runs[run["info"]["run_id"]] = run
        return 200, {"run": run}

    def runs_update(self, body: dict[str, Any]) -> tuple[int, dict[str, Any]]:
        self.runs[body["run_id"]]["info"]["status"] = body["status"]
        return 200, {}

    def runs_log_batch(self, body: dict[str, Any]) -> tuple[int, dict[str, Any]]:
        run = self.runs[body["run_id"]]
        size = sum(len(body.get(kind, [])) for kind in ("metrics", "params", "tags"))
        self.batches.append(size)
        if size > 1000:
            return 400, {"error_code": "INVALID_PARAMETER_VALUE", "message": "too many"}
        run["all"] += body.get("metrics", [])
        run["data"]["params"] += body.get("params", [])
        newest = {row["key"]: row for row in run["data"]["metrics"] + body.get("metrics", [])}
        run["data"]["metrics"] = [*newest.values()]
        return 200, {}

    def answer(self, status: int, body: dict[str, Any]) -> None:
        data = json.dumps(body).encode()
        self.send_response(status)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002  (the name is the base class's)
        del format, args


@contextmanager
def serving(handler: type[BaseHTTPRequestHandler]) -> Iterator[str]:
    """The address of a server with this handler."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.fixture
def rules(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    Rules.experiments.clear()
    Rules.runs.clear()
    Rules.batches.clear()
    monkeypatch.setenv("MLFLOW_TRACKING_TOKEN", "secret")
    with serving(Rules) as address:
        yield address


def test_a_job_becomes_a_run_and_a_second_time_adds_nothing(client: gleaner.Client, lab: Lab, rules: str) -> None:
    run_id = track(client, lab.pretrain, rules)
    run = Rules.runs[run_id]
    curves = client.jobs.metrics(lab.pretrain)
    found = {(row["key"], row["step"]): row["value"] for row in run["all"]}
    assert found == {
        (name, int(step)): value
        for name, curve in curves.items()
        for step, value in zip(curve.steps, curve.values, strict=True)
    }
    assert run["info"]["status"] == "FINISHED"
    params = {param["key"]: param["value"] for param in run["data"]["params"]}
    assert float(params["steps"]) == 3
    logged, batches = len(run["all"]), len(run["data"]["params"])
    assert track(client, lab.pretrain, rules, follow=True) == run_id
    assert (len(run["all"]), len(run["data"]["params"])) == (logged, batches)
    assert track(client, lab.train, rules) != run_id


def test_a_running_job_is_followed_to_its_end(client: gleaner.Client, lab: Lab, rules: str) -> None:
    del lab
    job = client.jobs.pretrain(TASK, steps=6, batch=8, warmup_steps=2, segment_length=3)
    run = Rules.runs[track(client, job, rules, follow=True)]
    assert run["info"]["status"] == "FINISHED"
    sent = [(row["key"], row["step"]) for row in run["all"]]
    assert len(sent) == len(set(sent))
    expected = {(name, int(step)) for name, curve in client.jobs.metrics(job).items() for step in curve.steps}
    assert set(sent) == expected


def test_batches_have_at_most_a_thousand_rows(rules: str) -> None:
    mlflow = MLflow(rules)
    run = mlflow.run(mlflow.experiment("many"), job_pb2.Job(id="job_many", kind=job_pb2.JOB_KIND_PRETRAIN))
    metrics = [Metric(name="loss", step=step, value=1.0) for step in range(2500)]
    _Sender(mlflow, run).send(metrics, [0] * len(metrics))
    assert Rules.batches == [1000, 1000, 500]


def test_refusals_name_the_call_and_keep_the_token_out(
    client: gleaner.Client, lab: Lab, rules: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MLFLOW_TRACKING_TOKEN", "wrong")
    with pytest.raises(TrackerError, match=r"MLflow rejected experiments/create \(401\): UNAUTHENTICATED") as refused:
        track(client, lab.pretrain, rules)
    assert "wrong" not in str(refused.value)
    with socket.create_server(("127.0.0.1", 0)) as closed:
        free = closed.getsockname()[1]
    with pytest.raises(TrackerError, match="does not answer experiments/create"):
        track(client, lab.pretrain, f"http://127.0.0.1:{free}")
    with pytest.raises(TrackerError, match="expected the address of a server"):
        track(client, lab.pretrain, "sqlite:///runs.db")


def test_a_password_in_the_address_is_refused_and_not_shown() -> None:
    with pytest.raises(TrackerError, match="MLFLOW_TRACKING_PASSWORD") as refused:
        MLflow("http://ada:hunter2@lab:5000")
    assert "hunter2" not in str(refused.value)


def test_credentials_are_not_sent_to_another_address(rules: str) -> None:
    class Elsewhere(Rules):
        def do_GET(self) -> None:
            self.send_response(302)
            self.send_header("Location", f"{rules}{self.path}")
            self.send_header("Content-Length", "0")
            self.end_headers()

    Rules.experiments["known"] = "7"
    with serving(Elsewhere) as address, pytest.raises(TrackerError, match=r"rejected experiments/get-by-name \(302\)"):
        MLflow(address).call("experiments/get-by-name", experiment_name="known")
    assert MLflow(rules).call("experiments/get-by-name", experiment_name="known")["experiment"] == {
        "experiment_id": "7"
    }


def test_the_command_prints_the_run_or_one_line(server: str, lab: Lab, rules: str) -> None:
    def run(*given: str) -> subprocess.CompletedProcess[str]:
        words = [sys.executable, "-m", "gleaner.track", *given, "--mlflow", rules, "--server", server]
        return subprocess.run(words, check=False, capture_output=True, text=True)

    assert run(lab.score.id).stdout.strip() in Rules.runs
    missing = run("job_01ARZ3NDEKTSV4RRFFQ69G5FAV")
    assert missing.returncode == 1
    assert missing.stderr.startswith("error: ")
    assert missing.stderr.count("\n") == 1

    every = run("--all", "--task", TASK).stdout.split()
    sent = dict(zip(every[::2], every[1::2], strict=True))
    assert {lab.pretrain.id, lab.score.id, lab.train.id} <= sent.keys()
    assert len(set(sent.values())) == len(sent)
    assert set(sent.values()) <= Rules.runs.keys()
    for words in [("--all", "--follow"), (lab.score.id, "--task", TASK), (lab.score.id, "--all"), ()]:
        assert run(*words).returncode == 2, words


@pytest.fixture
def mlflow_server(tmp_path: Path) -> Iterator[str]:
    """MLflow's own server over a folder."""
    pytest.importorskip("mlflow")
    with socket.create_server(("127.0.0.1", 0)) as closed:
        port = closed.getsockname()[1]
    words = ["--backend-store-uri", f"sqlite:///{tmp_path}/runs.db", "--host", "127.0.0.1", "--port", str(port)]
    words += ["--artifacts-destination", str(tmp_path / "artifacts"), "--workers", "1"]
    process = subprocess.Popen(
        [sys.executable, "-m", "mlflow", "server", *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    assert process.stdout is not None
    try:
        lines: list[str] = []
        while not any("Application startup complete" in line for line in lines):
            lines.append(process.stdout.readline())
            assert lines[-1], f"MLflow ended before it listened: {lines}"
        yield f"http://127.0.0.1:{port}"
    finally:
        process.terminate()
        process.wait()


def test_mlflow_reads_the_run_of_a_job(client: gleaner.Client, lab: Lab, mlflow_server: str) -> None:
    import mlflow

    reader = mlflow.MlflowClient(mlflow_server)
    for job in (lab.pretrain, lab.score, lab.train):
        run_id = track(client, job, mlflow_server)
        assert track(client, job, mlflow_server) == run_id
        run = reader.get_run(run_id)
        assert run.info.status == "FINISHED"
        assert run.data.tags["gleaner.result"] == job.result_id
        assert run.data.tags["gleaner.task"] == TASK
        for name, curve in client.jobs.metrics(job).items():
            history = reader.get_metric_history(run_id, name)
            # A step may have several values, in an order of MLflow.
            found = sorted((row.step, row.value) for row in history)
            assert found == sorted(zip(curve.steps, curve.values, strict=True))
    assert float(reader.get_run(track(client, lab.pretrain, mlflow_server)).data.params["steps"]) == 3
