"""Jobs as runs of MLflow, by its REST interface: parameters, curves and end state. Needs no package of MLflow.

`python -m gleaner.track JOB --mlflow URL` sends what there is, with `--follow` until the job ends; `--all` sends every
job. Sending a job again adds to its run what is new.
"""

from __future__ import annotations

import argparse
import base64
import json
import os
import sys
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator
from typing import Any

from google.protobuf.json_format import MessageToDict

from gleaner._client import Client
from gleaner._command import add_connection, connected, ended
from gleaner.errors import GleanerError
from gleaner.types import Job, Metric, word

# MLflow's limit on one request, of metrics, parameters and tags together.
_BATCH = 1000
# MLflow's limit on the value of a parameter, in characters.
_LONGEST = 6000
# Seconds between requests while a job runs, and for one request.
_PERIOD, _TIMEOUT = 2.0, 30.0
_STATES = {"succeeded": "FINISHED", "failed": "FAILED", "cancelled": "KILLED"}
_TAG = "gleaner.job"


class TrackerError(GleanerError):
    """MLflow is unreachable or rejected a request."""


class _NoRedirects(urllib.request.HTTPRedirectHandler):
    """Credentials are of the address alone."""

    def redirect_request(self, *_: object) -> None:
        """Follows none, so that the redirect is an error."""


_OPENER = urllib.request.build_opener(_NoRedirects)


class MLflow:
    """MLflow's REST interface at a URL, with the credentials of its own variables (MLFLOW_TRACKING_USERNAME, …)."""

    def __init__(self, url: str) -> None:
        self._url = url.rstrip("/")
        parts = urllib.parse.urlsplit(self._url)
        if "@" in parts.netloc:
            # Errors and logs show the address.
            raise TrackerError(
                f"--mlflow: the address of {parts.hostname} has a name or password in it; give them as "
                "MLFLOW_TRACKING_USERNAME and MLFLOW_TRACKING_PASSWORD"
            )
        if parts.scheme not in ("http", "https"):
            raise TrackerError(f"--mlflow {url}: expected the address of a server, such as http://lab:5000")
        read = os.environ.get
        self._headers = {"Content-Type": "application/json"}
        if token := read("MLFLOW_TRACKING_TOKEN"):
            self._headers["Authorization"] = f"Bearer {token}"
        elif name := read("MLFLOW_TRACKING_USERNAME"):
            pair = f"{name}:{read('MLFLOW_TRACKING_PASSWORD', '')}".encode()
            self._headers["Authorization"] = f"Basic {base64.b64encode(pair).decode()}"

    def call(self, path: str, body: dict[str, Any] | None = None, **query: str) -> dict[str, Any]:
        """POST of a body, or GET with a query. Raises `TrackerError` with MLflow's own message."""
        url = f"{self._url}/api/2.0/mlflow/{path}"
        if query:
            url += f"?{urllib.parse.urlencode(query)}"
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(url, data, self._headers)
        try:
            with _OPENER.open(request, timeout=_TIMEOUT) as reply:
                found: dict[str, Any] = json.load(reply)
        except urllib.error.HTTPError as error:
            raise _rejected(path, error) from None
        except (OSError, ValueError) as error:
            raise TrackerError(f"MLflow at {self._url} does not answer {path}: {error}") from None
        return found

    def experiment(self, name: str) -> str:
        """The id of the experiment of this name, created if it is missing."""
        try:
            created: str = self.call("experiments/create", {"name": name})["experiment_id"]
        except TrackerError as error:
            if "RESOURCE_ALREADY_EXISTS" not in str(error):
                raise
            found = self.call("experiments/get-by-name", experiment_name=name)
            created = found["experiment"]["experiment_id"]
        return created

    def run(self, experiment: str, job: Job) -> dict[str, Any]:
        """The run of a job in an experiment, created if it is missing."""
        wanted = {"experiment_ids": [experiment], "filter": f"tags.`{_TAG}` = '{job.id}'", "max_results": 1}
        runs: list[dict[str, Any]] = self.call("runs/search", wanted).get("runs", [])
        if runs:
            return runs[0]
        begun = job.start_time if job.HasField("start_time") else job.create_time
        tags = [{"key": _TAG, "value": job.id}]
        order = {"experiment_id": experiment, "run_name": f"{word(job, 'kind')} {job.id}", "tags": tags}
        created: dict[str, Any] = self.call("runs/create", {**order, "start_time": begun.ToMilliseconds()})["run"]
        return created


def _rejected(path: str, error: urllib.error.HTTPError) -> TrackerError:
    text = error.read(10_000).decode(errors="replace")
    try:
        found = json.loads(text)
        text = f"{found['error_code']}: {found['message']}"
    except (ValueError, KeyError, TypeError):
        text = text.strip()[:200]
    return TrackerError(f"MLflow rejected {path} ({error.code}): {text}")


def track(client: Client, job: str | Job, url: str, *, experiment: str = "gleaner", follow: bool = False) -> str:
    """Sends a job to MLflow at `url`; returns the id of its run. With `follow` returns when the job has ended.

    Raises `TrackerError` when MLflow is unreachable or rejects a request.
    """
    found = client.jobs.get(job)
    mlflow = MLflow(url)
    run = mlflow.run(mlflow.experiment(experiment), found)
    sender = _Sender(mlflow, run)
    sender.describe(client, found)
    # Past metrics have no time of their own.
    past = [Metric(name=name, step=int(step), value=value) for name, step, value in _curves(client, found)]
    sender.send(past, _spread(found, past))
    if follow:
        found = sender.follow(client, found)
    sender.end(found)
    return sender.run_id


def track_all(client: Client, url: str, *, task: str = "", experiment: str = "gleaner") -> Iterator[tuple[str, str]]:
    """Sends every job, or those of one task, to MLflow at `url`, oldest first; yields the ids of each job and its run.

    Raises `TrackerError` when MLflow is unreachable or rejects a request.
    """
    jobs = sorted(client.jobs.list(task), key=lambda job: job.create_time.ToNanoseconds())
    for job in jobs:
        yield job.id, track(client, job, url, experiment=experiment)


def _curves(client: Client, job: Job) -> Iterator[tuple[str, int, float]]:
    for name, curve in client.jobs.metrics(job).items():
        for step, value in zip(curve.steps, curve.values, strict=True):
            yield name, int(step), float(value)


def _spread(job: Job, metrics: list[Metric]) -> list[int]:
    """Milliseconds of metrics, as if steps took equal times from the start of the job to its end, or until now."""
    begun = (job.start_time if job.HasField("start_time") else job.create_time).ToMilliseconds()
    over = job.end_time.ToMilliseconds() if job.HasField("end_time") else round(time.time() * 1e3)
    last = max((metric.step for metric in metrics), default=0) or 1
    return [begun + (over - begun) * metric.step // last for metric in metrics]


class _Sender:
    """One run, and the newest step of each metric that it has."""

    def __init__(self, mlflow: MLflow, run: dict[str, Any]) -> None:
        self._mlflow = mlflow
        self.run_id: str = run["info"]["run_id"]
        data = run.get("data", {})
        self._params = {param["key"] for param in data.get("params", [])}
        self._newest = {metric["key"]: int(metric["step"]) for metric in data.get("metrics", [])}

    def describe(self, client: Client, job: Job) -> None:
        """The settings of a job as parameters, and what identifies it as tags."""
        kind = word(job, "kind")
        spec = MessageToDict(getattr(job.spec, kind), preserving_proto_field_name=True)
        settings = spec.pop("settings", {})
        # A parameter of a run never changes, and is not sent twice.
        params = {name: str(value)[:_LONGEST] for name, value in {**spec, **settings}.items()}
        tags = {
            _TAG: job.id,
            "gleaner.kind": kind,
            "gleaner.task": client.tasks.get(job.task_id).spec.name,
            "gleaner.result": job.result_id,
        }
        self._log(
            params=_pairs({name: value for name, value in params.items() if name not in self._params}),
            tags=_pairs(tags),
        )

    def send(self, metrics: list[Metric], times: list[int]) -> None:
        """Metrics that the run does not have yet, with their times in milliseconds."""
        rows: list[dict[str, Any]] = [
            {"key": metric.name, "value": metric.value, "timestamp": stamp, "step": metric.step}
            for metric, stamp in zip(metrics, times, strict=True)
            if metric.step > self._newest.get(metric.name, -1)
        ]
        for at in range(0, len(rows), _BATCH):
            self._log(metrics=rows[at : at + _BATCH])
        for row in rows:
            self._newest[row["key"]] = max(row["step"], self._newest.get(row["key"], -1))

    def follow(self, client: Client, job: Job) -> Job:
        """Sends new metrics until the job ends; returns it as it ended."""
        waiting: list[Metric] = []
        sent = time.monotonic()
        for event in client.jobs.watch(job):
            job = event.job
            waiting += event.metrics
            if time.monotonic() - sent >= _PERIOD:
                self.send(waiting, [round(time.time() * 1e3)] * len(waiting))
                waiting, sent = [], time.monotonic()
        self.send(waiting, [round(time.time() * 1e3)] * len(waiting))
        # Those of before the watch, and of a broken connection.
        missed = [Metric(name=name, step=step, value=value) for name, step, value in _curves(client, job)]
        self.send(missed, _spread(job, missed))
        return job

    def end(self, job: Job) -> None:
        """The state of the run, if the job has ended."""
        if (status := _STATES.get(word(job, "state"))) is not None:
            update = {"run_id": self.run_id, "status": status, "end_time": job.end_time.ToMilliseconds()}
            self._mlflow.call("runs/update", update)
            if job.error:
                self._log(tags=_pairs({"gleaner.error": job.error}))

    def _log(self, **rows: list[dict[str, Any]]) -> None:
        self._mlflow.call("runs/log-batch", {"run_id": self.run_id, **rows})


def _pairs(values: dict[str, str]) -> list[dict[str, Any]]:
    return [{"key": key, "value": value} for key, value in values.items()]


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m gleaner.track", description=__doc__.splitlines()[0])
    jobs = parser.add_mutually_exclusive_group(required=True)
    jobs.add_argument("job", nargs="?", help="id of the job")
    jobs.add_argument(
        "--all", action="store_true", help="every job that the server has, or with --task those of a task"
    )
    parser.add_argument("--task", default="", metavar="NAME", help="with --all: only the jobs of this task")
    parser.add_argument("--mlflow", required=True, metavar="URL", help="address of MLflow's server")
    parser.add_argument("--experiment", default="gleaner", help="experiment of the run, created if missing")
    parser.add_argument("--follow", action="store_true", help="send new metrics until the job ends")
    add_connection(parser)
    given = parser.parse_args()
    for flag, value, wanted in [("--follow", given.follow, not given.all), ("--task", given.task, given.all)]:
        if value and not wanted:
            parser.error(f"{flag} applies to {'one job' if given.all else '--all'} only")

    def run() -> int:
        with connected(given) as client:
            if given.all:
                for job, sent in track_all(client, given.mlflow, task=given.task, experiment=given.experiment):
                    print(job, sent, flush=True)
                return 0
            print(track(client, given.job, given.mlflow, experiment=given.experiment, follow=given.follow))
        return 0

    return ended(run)


if __name__ == "__main__":
    sys.exit(main())
