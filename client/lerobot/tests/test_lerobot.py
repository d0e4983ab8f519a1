"""LeRobot's own factories and its own evaluation loop drive a deployment."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import gleaner
import numpy as np
import pytest
import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.policies.factory import make_policy_config, make_pre_post_processors

from conftest import DEPLOYMENT, SIDE
from lerobot_policy_gleaner import GleanerConfig, GleanerPolicy


def config(server: str, deployment: str = DEPLOYMENT) -> GleanerConfig:
    made = make_policy_config("gleaner", server=server, deployment=deployment, device="cpu")
    assert isinstance(made, GleanerConfig)
    return made


def batch(rows: int, seed: int = 0) -> tuple[dict[str, torch.Tensor], list[dict[str, object]]]:
    """A batch as LeRobot makes it, and the same as the client takes it."""
    random = np.random.default_rng(seed)
    images = random.integers(0, 256, (rows, SIDE, SIDE, 3), np.uint8)
    states = random.uniform(0, 512, (rows, 2)).astype(np.float32)
    tensors = {
        "observation.image": torch.from_numpy(images).permute(0, 3, 1, 2).float() / 255,
        "observation.state": torch.from_numpy(states),
    }
    return tensors, [{"images": {"top": images[at]}, "proprioception": states[at]} for at in range(rows)]


def test_action_is_that_of_the_deployment(server: str) -> None:
    policy = GleanerPolicy(config(server))
    tensors, seen = batch(3)
    actions = policy.select_action(tensors)
    chunk = policy.predict_action_chunk(batch(3, seed=1)[0])
    policy.reset()
    assert (actions.shape, actions.dtype, chunk.shape) == ((3, 2), torch.float32, (3, 1, 2))
    with gleaner.connect(server) as client:
        for row, one in enumerate(seen):
            with gleaner.Policy(client, DEPLOYMENT) as direct:
                np.testing.assert_allclose(actions[row].numpy(), direct(one), rtol=1e-5)
    assert not torch.equal(actions[0], actions[1])


def test_row_that_misses_its_deadline_repeats_its_action_and_the_others_keep_theirs(
    server: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = config(server)
    made.deadline = 60.0
    policy = GleanerPolicy(made)
    first = policy.select_action(batch(2)[0])

    def missed() -> gleaner.Chunk:
        raise gleaner.Missed("no action by the deadline")

    monkeypatch.setattr(policy._sessions.rows[0], "_answer", missed)
    second = policy.select_action(batch(2, seed=1)[0])
    assert torch.equal(second[0], first[0])
    assert not torch.equal(second[1], first[1])
    policy.reset()


def test_missed_deadline_before_the_first_action_ends_the_rollout(server: str) -> None:
    made = config(server)
    made.deadline = 1e-6
    policy = GleanerPolicy(made)
    with pytest.raises(gleaner.Missed, match="no action of the last 1 s to repeat"):
        policy.select_action(batch(1)[0])
    policy.reset()


def test_saved_folder_is_a_policy_without_weights(server: str, tmp_path: Path) -> None:
    made = config(server)
    made.save_pretrained(tmp_path)
    before, after = make_pre_post_processors(made)
    before.save_pretrained(tmp_path)
    after.save_pretrained(tmp_path)
    assert not list(tmp_path.glob("*.safetensors"))
    read = PreTrainedConfig.from_pretrained(tmp_path)
    assert isinstance(read, GleanerConfig)
    assert (read.server, read.deployment) == (server, DEPLOYMENT)
    policy = GleanerPolicy.from_pretrained(tmp_path)
    assert policy.select_action(batch(1)[0]).shape == (1, 2)
    policy.reset()


def test_what_cannot_work_is_refused_in_words(server: str) -> None:
    with pytest.raises(ValueError, match=r"policy\.deployment: is empty"):
        GleanerPolicy(config(server, deployment=""))
    with pytest.raises(gleaner.NotFound, match=rf"no deployment other; existing: {DEPLOYMENT}"):
        GleanerPolicy(config(server, deployment="other"))
    policy = GleanerPolicy(config(server))
    for refuses in (policy.get_optim_params, lambda: policy.forward({})):
        with pytest.raises(NotImplementedError, match=r"training is a job of the server"):
            refuses()
    with pytest.raises(ValueError, match=r"observation\.state: is missing; the batch has observation\.image"):
        policy.select_action({"observation.image": torch.zeros(1, 3, SIDE, SIDE)})


def test_evaluation_loop_of_lerobot_drives_a_deployment(server: str, tmp_path: Path) -> None:
    """Two environments at once, each with a session of its own, recorded."""
    command = [
        str(Path(sys.executable).parent / "lerobot-eval"),
        "--policy.type=gleaner",
        f"--policy.server={server}",
        f"--policy.deployment={DEPLOYMENT}",
        "--policy.device=cpu",
        "--policy.record=true",
        "--policy.cohort=lerobot",
        "--env.type=pusht",
        "--env.episode_length=5",
        "--eval.n_episodes=2",
        "--eval.batch_size=2",
        "--eval.use_async_envs=false",
        f"--output_dir={tmp_path / 'out'}",
    ]
    without_a_screen = {**os.environ, "SDL_VIDEODRIVER": "dummy"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=240, env=without_a_screen)
    assert done.returncode == 0, done.stderr[-3000:]
    result = json.loads(next((tmp_path / "out").glob("**/eval_info.json")).read_text())
    assert result["overall"]["n_episodes"] == 2
    with gleaner.connect(server) as client:
        recorded = [episode for episode in client.episodes.list("push_t") if episode.cohort == "lerobot"]
        assert [client.episodes.report(episode.id).steps for episode in recorded] == [5, 5]
