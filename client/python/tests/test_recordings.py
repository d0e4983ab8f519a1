"""Recordings before they are sent: what they state about themselves, and what the server says to that."""

from __future__ import annotations

from pathlib import Path

import pytest

import gleaner
from conftest import TASK, Lab
from gleaner._proto.v1 import episode_pb2 as pb
from gleaner._summary import summarize


def test_summary_is_that_of_the_file(recordings: dict[str, list[Path]], client: gleaner.Client, lab: Lab) -> None:
    summary = summarize(recordings["expert"][0])
    report = client.episodes.report(lab.experts[0])
    assert summary is not None
    assert (summary.messages, sum(summary.topics.values())) == (report.messages, report.messages)
    assert summary.topics["/robot/action"] == report.steps
    assert summary.channels == len(summary.topics)
    assert summary.duration_ns > 0
    assert summary.largest_chunk_bytes > 0


def test_files_without_a_sound_summary_have_none(recordings: dict[str, list[Path]], tmp_path: Path) -> None:
    whole = recordings["expert"][0].read_bytes()
    path = tmp_path / "a.mcap"
    for damaged in [b"", b"no recording at all", whole[:-1], whole[:-40], whole[: len(whole) // 2]]:
        path.write_bytes(damaged)
        assert summarize(path) is None
    for at in range(2, 400, 7):
        changed = bytearray(whole)
        changed[-at] ^= 0x10
        path.write_bytes(changed)
        assert summarize(path) is None, f"{at} bytes before the end"
    assert summarize(tmp_path / "nowhere.mcap") is None


def test_check_sends_nothing(recordings: dict[str, list[Path]], client: gleaner.Client, lab: Lab) -> None:
    path = recordings["wrong_goal"][0]
    task = client.tasks.get(TASK).spec
    task.name = "checked"
    name = client.tasks.create(task).id
    estimate = client.episodes.check(path, task=name, outcome="failure")
    assert estimate is not None
    assert estimate.steps == client.episodes.get(lab.failures[0]).steps
    assert list(client.episodes.list(name)) == []
    with pytest.raises(gleaner.AlreadyExists):
        client.episodes.check(path, task=TASK, outcome="success")


def test_recording_that_states_too_much_is_rejected_before_it_is_sent(
    recordings: dict[str, list[Path]], client: gleaner.Client, lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    endless = pb.RecordingSummary(messages=10**12)
    monkeypatch.setattr("gleaner.episodes.summarize", lambda path: endless)
    sent: list[int] = []
    path = recordings["wrong_goal"][0]
    with pytest.raises(gleaner.ResourceExhausted, match="--max-records"):
        client.episodes.push(path, task=TASK, outcome="failure", cohort="new", progress=sent.append)
    assert sent == []
