"""Tasks, episodes, jobs, scores and datasets, against a real server."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import gleaner
from conftest import IMAGE, TASK, Lab, half_an_upload
from gleaner._download import inside, save

SPEC = {
    "name": "pour",
    "rate_hz": 12.5,
    "alignment": "nearest",
    "cameras": [{"name": "top", "height": 48, "width": 64, "depth": True}],
    "proprioception": [{"name": "joints", "size": 2}],
    "action": [{"name": "delta", "size": 3}],
    "mappings": [
        {
            "name": "ros",
            "cameras": [{"camera": "top", "color": "/rgb", "depth": "/d"}],
            "fields": [
                {"field": "joints", "topic": "/joint_states", "paths": ["position"]},
                {"field": "delta", "topic": "/cmd", "paths": ["linear.x", "linear.y", "linear.z"]},
            ],
        }
    ],
}


def test_a_task_is_made_from_plain_values(client: gleaner.Client) -> None:
    made = client.tasks.create(SPEC)
    assert client.tasks.get("pour").spec == made.spec
    assert gleaner.word(made.spec, "alignment") == "nearest"
    assert "pour" in [task.spec.name for task in client.tasks.list()]
    with pytest.raises(gleaner.AlreadyExists, match="pour"):
        client.tasks.create(SPEC)


def test_message_of_the_server_is_unchanged(client: gleaner.Client) -> None:
    with pytest.raises(gleaner.NotFound, match='no task "nothing"') as raised:
        client.tasks.get("nothing")
    assert isinstance(raised.value, gleaner.GleanerError)
    with pytest.raises(gleaner.InvalidArgument, match="rate_hz"):
        client.tasks.create({**SPEC, "name": "still", "rate_hz": 0.0})
    with pytest.raises(gleaner.InvalidArgument, match=r"cameras\[0\]\.hight: is unknown; supported: depth, height"):
        client.tasks.create({**SPEC, "cameras": [{"name": "top", "hight": 4}]})
    with pytest.raises(gleaner.InvalidArgument, match="'closest' is unknown; supported: latest_before, nearest"):
        client.tasks.create({**SPEC, "alignment": "closest"})


def test_engine_options_are_of_a_cluster_alone(client: gleaner.Client, lab: Lab) -> None:
    del lab  # The task has episodes to pretrain on.
    with pytest.raises(gleaner.FailedPrecondition, match=r"engine_options: .*--engine slurm"):
        client.jobs.pretrain(TASK, engine_options="--partition=gpu --gres=gpu:1")
    with pytest.raises(gleaner.InvalidArgument, match="engine_options: --output=/x"):
        client.jobs.pretrain(TASK, engine_options="--output=/x")


def test_pushed_episodes_are_listed_and_pushed_again_they_are_the_same(
    client: gleaner.Client, lab: Lab, recordings: dict[str, list[Path]]
) -> None:
    listed = list(client.episodes.list(TASK, outcome="success"))
    assert [episode.id for episode in listed][: len(lab.experts)] == list(lab.experts)
    assert {gleaner.word(episode, "outcome") for episode in listed} == {"success"}
    again = client.episodes.push(recordings["expert"][0], task=TASK, outcome="success", cohort="expert")
    assert again.id == lab.experts[0]
    with pytest.raises(gleaner.AlreadyExists):
        client.episodes.push(recordings["expert"][0], task=TASK, outcome="failure")
    assert client.episodes.report(again.id).steps == again.steps > 0


def test_interrupted_upload_resumes(
    client: gleaner.Client, task: str, recordings: dict[str, list[Path]], tmp_path: Path
) -> None:
    spec = client.tasks.get(task).spec
    spec.name = "resumed"
    upload = half_an_upload(client, client.tasks.create(spec).id, recordings["wrong_goal"][0])
    sent: list[int] = []
    upload.progress = sent.append
    episode = upload.run()
    assert sent == [episode.size_bytes], "only the second half was sent"
    assert client.episodes.download(episode.id, tmp_path).read_bytes() == upload.path.read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == [upload.path.name]


def test_file_that_is_not_a_recording_is_rejected(client: gleaner.Client, task: str, tmp_path: Path) -> None:
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"no recording at all")
    with pytest.raises(gleaner.InvalidArgument, match="recording"):
        client.episodes.push(broken, task=task, outcome="success")
    with pytest.raises(gleaner.InvalidArgument, match="'good' is unknown; supported: success, failure, unknown"):
        client.episodes.push(broken, task=task, outcome="good")
    with pytest.raises(FileNotFoundError):
        client.episodes.push(tmp_path / "nowhere.mcap", task=task, outcome="success")


def test_labels_change_and_are_kept(client: gleaner.Client, lab: Lab) -> None:
    episode = lab.failures[0]
    before = len(client.episodes.labels(episode))
    changed = client.episodes.label(episode, "unknown", reason="seen again", author="ada")
    assert [gleaner.word(one, "outcome") for one in changed] == ["unknown"]
    client.episodes.label([episode], "failure")
    labels = client.episodes.labels(episode)[before:]
    assert [(gleaner.word(label, "outcome"), label.author) for label in labels] == [("unknown", "ada"), ("failure", "")]
    assert client.episodes.get(episode).cohort == "wrong_goal"
    [kept] = client.episodes.label(episode, cohort="wrong_goal", reason="its outcome stays")
    assert gleaner.word(kept, "outcome") == "failure"
    with pytest.raises(gleaner.InvalidArgument, match="outcome: or cohort must be set"):
        client.episodes.label(episode)


def test_deleted_episode_can_be_restored(client: gleaner.Client, task: str, recordings: dict[str, list[Path]]) -> None:
    spec = client.tasks.get(task).spec
    spec.name = "deleted"
    name = client.tasks.create(spec).id
    episode = client.episodes.push(recordings["expert"][0], task=name, outcome="success")
    assert client.episodes.delete(episode.id)[0].HasField("delete_time")
    assert not [*client.episodes.list(name)]
    assert [one.id for one in client.episodes.list(name, deleted=True)] == [episode.id]
    with pytest.raises(gleaner.AlreadyExists, match="trash"):
        client.episodes.push(recordings["expert"][0], task=name, outcome="success")
    assert not client.episodes.undelete([episode.id])[0].HasField("delete_time")
    assert [one.id for one in client.episodes.list(name)] == [episode.id]
    with pytest.raises(gleaner.NotFound):
        client.episodes.delete("ep_01ARZ3NDEKTSV4RRFFQ69G5FAV")


def test_episode_of_a_snapshot_is_deleted_by_force_only(client: gleaner.Client, lab: Lab) -> None:
    with pytest.raises(gleaner.FailedPrecondition, match="snap_"):
        client.episodes.delete(lab.experts[0])
    client.episodes.delete(lab.experts[0], force=True)
    client.episodes.undelete(lab.experts[0])


def test_a_job_is_followed_to_its_end(client: gleaner.Client, lab: Lab) -> None:
    events = list(client.jobs.watch(lab.pretrain))
    assert gleaner.word(events[-1].job, "state") == "succeeded"
    loss = client.jobs.metrics(lab.pretrain)["loss"]
    assert len(loss.steps) == len(loss.values) > 0
    assert np.isfinite(loss.values).all()
    assert lab.train.id in [job.id for job in client.jobs.list(TASK, state="succeeded")]


def test_a_job_with_a_key_is_queued_once_and_can_be_cancelled(client: gleaner.Client, lab: Lab) -> None:
    again = {"experts_of": lab.pretrain.result_id, "steps": 100_000, "batch": 8, "key": "long"}
    job = client.jobs.train(TASK, **again)  # type: ignore[arg-type]
    assert client.jobs.train(TASK, **again).id == job.id  # type: ignore[arg-type]
    with pytest.raises(gleaner.DeadlineExceeded, match=r"not ended after 0\.2 s; it continues"):
        client.jobs.wait(job, timeout=0.2)
    client.jobs.cancel(job)
    with pytest.raises(gleaner.JobFailed, match="was cancelled") as raised:
        client.jobs.wait(job.id)
    assert raised.value.job.id == job.id


def test_kinds_have_their_settings(client: gleaner.Client) -> None:
    kinds = client.jobs.kinds()
    scorers = {kind.name: {setting.name for setting in kind.settings} for kind in kinds.scorers}
    assert "lookahead" in scorers["raw"]
    assert "lookahead" not in scorers["classifier"]
    assert {kind.name for kind in kinds.policies} >= {"bc", "act", "flow"}


def test_a_scoring_needs_no_encoder(client: gleaner.Client, lab: Lab) -> None:
    job = client.jobs.wait(client.jobs.score(TASK), timeout=120)
    chosen = job.spec.score
    assert chosen.encoder_id.startswith("enc_")
    scored = {score.episode_id for score in client.scores.all(job.result_id, role="imperfect")}
    assert scored >= set(lab.failures)


def test_invalid_settings_of_a_job_are_named(client: gleaner.Client, lab: Lab) -> None:
    with pytest.raises(
        gleaner.InvalidArgument, match=r"settings\.preset: unknown value \"huge\"; supported: tiny, small, base"
    ):
        client.jobs.pretrain(TASK, preset="huge")  # type: ignore[arg-type]
    with pytest.raises(gleaner.InvalidArgument, match=r"pretrain\.stepps: is unknown; supported: .*steps"):
        client.jobs.pretrain(TASK, stepps=3)  # type: ignore[call-arg]
    with pytest.raises(gleaner.InvalidArgument, match="encoder_id"):
        client.jobs.score(TASK, "enc_missing")
    with pytest.raises(gleaner.InvalidArgument, match="lambda"):
        client.jobs.train(TASK, experts_of=lab.pretrain.result_id, lambda_=-1.0)


def test_scores_are_arrays_with_a_value_a_step(client: gleaner.Client, lab: Lab) -> None:
    failures = list(client.scores.all(lab.run, "imperfect"))
    assert {scores.episode_id for scores in failures} == set(lab.failures)
    for scores in failures:
        steps = client.episodes.get(scores.episode_id).steps
        for values in (scores.q, scores.w, scores.match_episode, scores.match_step, scores.distance_o):
            assert values.shape == (steps,)
        assert scores.q.min() >= 0
        assert scores.q.max() <= 1
        assert set(scores.match_episode) <= set(lab.experts)
    every = list(client.scores.all(lab.run))
    assert len(every) == len(lab.experts) + len(lab.failures)
    assert client.scores.episode(lab.run, lab.experts[0]).role == "expert"


def test_the_histogram_counts_the_same_segments(client: gleaner.Client, lab: Lab) -> None:
    q = np.concatenate([scores.q for scores in client.scores.all(lab.run, "imperfect")])
    histogram = client.scores.histogram(lab.run, bins=10, betas=[0.25, 0.75])
    assert histogram.counts.sum() == histogram.segments == len(q)
    assert np.sum([*histogram.cohorts.values()], axis=0).tolist() == histogram.counts.tolist()
    experts = np.concatenate([scores.q for scores in client.scores.all(lab.run, "expert")])
    assert histogram.experts.sum() == len(experts)
    pairs = (experts[:, None] > q).mean() + (experts[:, None] == q).mean() / 2
    assert histogram.expert_auroc == pytest.approx(pairs)
    assert histogram.edges[[0, -1]].tolist() == [0.0, 1.0]
    assert histogram.kept == {0.25: int((q > 0.25).sum()), 0.75: int((q > 0.75).sum())}
    (count,) = client.scores.what_if(lab.run, [{"beta": 0.25}])
    assert count.total.segments == histogram.kept[0.25]
    assert lab.run in [run.id for run in client.scores.list(TASK)]


def test_scores_made_elsewhere_become_a_run(client: gleaner.Client, lab: Lab) -> None:
    snapshot = client.scores.get(lab.run).snapshot_id
    steps = {episode: client.episodes.get(episode).steps for episode in lab.failures}
    names = [lab.failures[0], *(client.episodes.get(episode).blake3 for episode in lab.failures[1:])]
    table = {
        "episode": np.repeat(names, list(steps.values())),
        "step": np.concatenate([np.arange(count) for count in steps.values()]),
        "q": np.concatenate([np.linspace(0.0, 1.0, count) for count in steps.values()]),
    }
    run = client.scores.import_scores(snapshot, table, source="an oracle")
    assert dict(run.settings) == {"scorer": "imported", "source": "an oracle"}
    backwards = {name: column[::-1] for name, column in table.items()}
    assert client.scores.import_scores(snapshot, backwards, source="an oracle").id == run.id
    scores = client.scores.episode(run.id, lab.failures[1])
    np.testing.assert_array_equal(scores.w, np.linspace(0.0, 1.0, steps[lab.failures[1]]))
    assert len(scores.match_episode) == 0
    dataset = client.datasets.create(run.id, beta=0.5)
    assert dataset.kept_segments == int((table["q"].astype(np.float32) > 0.5).sum())
    with pytest.raises(gleaner.InvalidArgument, match="is missing"):
        client.scores.import_scores(snapshot, {name: column[: steps[names[0]]] for name, column in table.items()})
    with pytest.raises(ValueError, match=f"step 3 of {names[0]} is missing"):
        client.scores.import_scores(snapshot, {name: np.delete(column, 3) for name, column in table.items()})
    twice = {**table, "step": np.where(table["step"] == 1, 0, table["step"])}
    with pytest.raises(ValueError, match=r"step 0 of \w+ is listed twice"):
        client.scores.import_scores(snapshot, twice)
    with pytest.raises(ValueError, match="column 'q' is missing"):
        client.scores.import_scores(snapshot, {"episode": [], "step": []})
    with pytest.raises(ValueError, match=r"a\.mcap: no episode"):
        client.scores.import_scores(snapshot, {"episode": ["a.mcap"], "step": [0], "q": [0.5]})


def test_a_dataset_streams_weighted_segments(client: gleaner.Client, lab: Lab) -> None:
    dataset = client.datasets.get(lab.dataset)
    assert client.datasets.create(lab.run, top_fraction=0.5).id == dataset.id
    segments = list(client.datasets.stream(dataset.id, frames=True))
    experts = [segment for segment in segments if segment.role == "expert"]
    kept = [segment for segment in segments if segment.role == "imperfect"]
    assert (len(experts), len(kept)) == (dataset.expert_segments, dataset.kept_segments)
    assert {segment.weight for segment in experts} == {1.0}
    q = {episode: client.scores.episode(lab.run, episode).q for episode in lab.failures}
    assert all(segment.weight == q[segment.episode_id][segment.end_step] for segment in kept)
    spec = client.tasks.get(TASK).spec
    for segment in segments:
        steps = segment.end_step - segment.first_step + 1
        assert segment.action.shape == (steps, sum(field.size for field in spec.action))
        assert {name: image.shape for name, image in segment.images.items()} == {
            camera.name: (steps, IMAGE, IMAGE, 3) for camera in spec.cameras
        }
        assert {name: depth.shape for name, depth in segment.depth.items()} == {
            camera.name: (steps, IMAGE, IMAGE) for camera in spec.cameras if camera.depth
        }
    # A step's frames are the same in every segment that holds it.
    first, second = experts[4], experts[5]
    for name, image in first.images.items():
        np.testing.assert_array_equal(image[-1], second.images[name][-2])
        assert image.any()


def test_a_snapshot_freezes_roles(client: gleaner.Client, lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    # Smaller pages than there are episodes.
    monkeypatch.setattr("gleaner.snapshots._PAGE", 2)
    # By cohort: other tests record rollouts of the same task.
    cohorts = {"expert_cohorts": ["expert"], "imperfect_cohorts": ["wrong_goal"]}
    made = client.snapshots.create(TASK, {**cohorts, "max_experts": 2, "seed": 5})
    assert (made.expert_episodes, made.imperfect_episodes) == (2, len(lab.failures))
    roles = {episode.episode_id: gleaner.word(episode, "role") for episode in client.snapshots.episodes(made.id)}
    assert {episode for episode, role in roles.items() if role == "imperfect"} == set(lab.failures)
    assert made.id in [snapshot.id for snapshot in client.snapshots.list(TASK)]
    with pytest.raises(gleaner.InvalidArgument, match="cohort"):
        client.snapshots.create(TASK, {"expert_cohorts": ["a"], "imperfect_cohorts": ["a"]})


def test_missing_torch_is_named_with_the_fix(client: gleaner.Client, lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "gleaner.torch", raising=False)
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(ImportError, match="install torch"):
        client.datasets.torch_dataset(lab.dataset)


def test_export_is_downloaded_completely(client: gleaner.Client, lab: Lab, tmp_path: Path) -> None:
    job = client.jobs.submit(TASK, {"export": {"dataset_id": lab.dataset, "format": "mcap"}}, key="export")
    client.jobs.wait(job, timeout=120)
    paths = client.datasets.download_export(job.result_id, tmp_path / "out")
    files = client.datasets.export_files(job.result_id)
    assert [(path.name, path.stat().st_size) for path in paths] == [(file.name, file.size_bytes) for file in files]
    assert "manifest.jsonl" in {path.name for path in paths}


def test_damaged_download_is_removed(tmp_path: Path) -> None:
    with pytest.raises(gleaner.Damaged, match="download it again"):
        save([b"some", b"thing"], tmp_path / "x.mcap", SimpleNamespace(blake3="0" * 64, size_bytes=9))
    assert list(tmp_path.iterdir()) == []
    assert inside(tmp_path, "../..", "y") == tmp_path / "y"
    assert inside(tmp_path, "../../etc/passwd", "y") == tmp_path / "passwd"


def test_a_shaped_dataset_keeps_what_was_counted(client: gleaner.Client, lab: Lab) -> None:
    shape = {"context_before": 1, "phases": 1, "max_per_phase": 3}
    (count,) = client.scores.what_if(lab.run, [{"top_fraction": 0.5, "shape": shape}])
    dataset = client.datasets.create(lab.run, top_fraction=0.5, shape=shape)
    assert dataset.kept_segments == count.total.segments == 3
    assert (dataset.selection.shape.context_before, dataset.selection.shape.phases) == (1, 1)
    assert client.datasets.create(lab.run, top_fraction=0.5, shape=shape).id == dataset.id != lab.dataset
    with pytest.raises(gleaner.InvalidArgument, match=r"shape\.min_runs: is unknown"):
        client.datasets.create(lab.run, beta=0.5, shape={"min_runs": 3})
    with pytest.raises(gleaner.InvalidArgument, match=r"selection\.shape\.phases: is 0"):
        client.datasets.create(lab.run, beta=0.5, shape={"phases": 0})


def test_dataset_has_one_rule_or_the_default_of_its_run(client: gleaner.Client, lab: Lab) -> None:
    default = client.scores.get(lab.run).default_beta
    assert default > 0
    assert client.datasets.create(lab.run).id == client.datasets.create(lab.run, beta=default).id
    with pytest.raises(ValueError, match="give one of the two"):
        client.datasets.create(lab.run, beta=0.5, top_fraction=0.5)
