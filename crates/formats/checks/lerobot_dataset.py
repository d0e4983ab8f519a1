#!/usr/bin/env python3
"""Opens an exported LeRobot dataset with the `lerobot` package itself, offline, and trains ACT on it for a few steps:
with the weights of its frames, and by the program `lerobot-train`.

    python lerobot_dataset.py FOLDER [--episodes N] [--frames N] [--steps N] [--pictures FOLDER]

Prints one line of JSON with what was found, and exits with 1 and one line if the folder is not what LeRobot expects.
Works with lerobot 0.4 and 0.6.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
from pathlib import Path

# Before the libraries are imported: nothing is looked up on the Hub, and no cache of this run remains.
CACHE = tempfile.TemporaryDirectory(prefix="lerobot_dataset_")
os.environ |= {
    "HF_HUB_OFFLINE": "1",
    "HF_DATASETS_OFFLINE": "1",
    "HF_HOME": CACHE.name,
    "HF_DATASETS_CACHE": CACHE.name,
}

import torch  # noqa: E402

# Seconds by which a stamp in single precision may be off.
STAMP_TOLERANCE = 1e-3
# Longest time of `lerobot-train`.
TRAIN_SECONDS = 900
# Decibels between a picture of a video and its image.
LEAST_RATIO = 20


class Unfit(Exception):
    """What is wrong with the folder."""


def expect(holds: bool, problem: str) -> None:
    """Raises `Unfit` with the problem unless the condition holds."""
    if not holds:
        raise Unfit(problem)


def dataset_class() -> type:
    """LeRobot's dataset, which versions have in different modules."""
    try:
        from lerobot.datasets.lerobot_dataset import LeRobotDataset
    except ImportError:
        from lerobot.datasets import LeRobotDataset
    return LeRobotDataset


def policy_features(features: dict) -> dict:
    """The features as policies see them."""
    try:
        from lerobot.datasets.utils import dataset_to_policy_features
    except ImportError:
        from lerobot.utils.feature_utils import dataset_to_policy_features
    return dataset_to_policy_features(features)


def look(dataset, info: dict) -> None:
    """Every frame as a training gets it."""
    expect(len(dataset) == info["total_frames"], f"{len(dataset)} frames, info.json has {info['total_frames']}")
    experts = [row["gleaner.role"] == "expert" for row in dataset.meta.episodes]
    for index in range(len(dataset)):
        item = dataset[index]
        where = f"frame {index}"
        expect(int(item["index"]) == index, f"{where}: its index is {int(item['index'])}")
        expect(isinstance(item["task"], str), f"{where}: its task is {item['task']!r}, not a text")
        number = int(item["episode_index"])
        episode = dataset.meta.episodes[number]
        frame = index - episode["dataset_from_index"]
        expect(0 <= frame < episode["length"], f"{where}: is not in its episode")
        expect(int(item["frame_index"]) == frame, f"{where}: frame_index is {int(item['frame_index'])}, not {frame}")
        expect(abs(float(item["timestamp"]) - frame / info["fps"]) < STAMP_TOLERANCE, f"{where}: timestamp is off")
        expect(int(item["gleaner.step"]) == episode["gleaner.first_step"] + frame, f"{where}: gleaner.step is off")
        q, weight = float(item["gleaner.q"]), float(item["gleaner.weight"])
        expect(0 <= q <= 1 and weight in (q, 0.0), f"{where}: q is {q} and the weight {weight}")
        expect(not experts[number] or weight == 1, f"{where}: an expert with weight {weight}")
        match = int(item["gleaner.match_episode"])
        expect(match == -1 or experts[match], f"{where}: matches episode {match}, which is not an expert")
        for camera in dataset.meta.camera_keys:
            height, width, channels = info["features"][camera]["shape"]
            picture = item[camera]
            expect(tuple(picture.shape) == (channels, height, width), f"{where}: {camera} is {tuple(picture.shape)}")
            expect(channels == 1 or 0 <= float(picture.min()) <= float(picture.max()) <= 1, f"{where}: {camera}")
        for name, value in item.items():
            finite = not isinstance(value, torch.Tensor) or bool(torch.isfinite(value.float()).all())
            expect(finite, f"{where}: {name} has a value that is not a number")


def compare(dataset, other) -> float:
    """The lowest signal to noise ratio of a picture beside that of the same dataset with images, in decibels.

    A video that is off by a frame has other pictures.
    """
    expect(len(dataset) == len(other), f"{len(dataset)} frames, and {len(other)} in the dataset with images")
    lowest = math.inf
    for index in range(len(dataset)):
        item, wanted = dataset[index], other[index]
        for camera in dataset.meta.camera_keys:
            error = float(((item[camera].float() - wanted[camera].float()) ** 2).mean())
            ratio = 10 * math.log10(1 / max(error, 1e-12))
            expect(ratio > LEAST_RATIO, f"frame {index}: {camera} is another picture than its image: {ratio:.1f} dB")
            lowest = min(lowest, ratio)
    return lowest


def train(folder: Path, info: dict, steps: int) -> list[float]:
    """The losses of ACT's first steps, made and normalised as `lerobot-train` does."""
    from lerobot.configs.types import FeatureType
    from lerobot.policies.act.configuration_act import ACTConfig
    from lerobot.policies.act.modeling_act import ACTPolicy
    from lerobot.policies.act.processor_act import make_act_pre_post_processors

    chunk = 4
    dataset = dataset_class()(
        "local/check", root=folder, delta_timestamps={"action": [at / info["fps"] for at in range(chunk)]}
    )
    features = policy_features(dataset.meta.features)
    config = ACTConfig(
        input_features={name: one for name, one in features.items() if one.type is not FeatureType.ACTION},
        output_features={name: one for name, one in features.items() if one.type is FeatureType.ACTION},
        chunk_size=chunk,
        n_action_steps=chunk,
        dim_model=32,
        n_heads=2,
        dim_feedforward=64,
        n_encoder_layers=1,
        n_vae_encoder_layers=1,
        pretrained_backbone_weights=None,
        device="cpu",
    )
    torch.manual_seed(1)
    policy = ACTPolicy(config)
    before, _ = make_act_pre_post_processors(config, dataset_stats=dataset.meta.stats)
    optimizer = torch.optim.AdamW(policy.parameters(), lr=1e-3)
    # Frames are drawn by the weights of the score run.
    weights = torch.as_tensor(dataset.hf_dataset["gleaner.weight"][:], dtype=torch.float64)
    sampler = torch.utils.data.WeightedRandomSampler(weights, 4 * steps)
    losses = []
    for batch in torch.utils.data.DataLoader(dataset, batch_size=4, sampler=sampler):
        loss, _ = policy.forward(before(batch))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    expect(all(math.isfinite(loss) for loss in losses), f"the losses are {losses}")
    return losses


def train_by_program(folder: Path, steps: int) -> int:
    """Trains by `lerobot-train`, as a user does; the size of its last checkpoint in bytes."""
    small = {"chunk_size": 4, "n_action_steps": 4, "dim_model": 32, "n_heads": 2, "dim_feedforward": 64}
    policy = {"type": "act", "device": "cpu", "push_to_hub": "false", "pretrained_backbone_weights": "null", **small}
    with tempfile.TemporaryDirectory(prefix="lerobot_train_") as scratch:
        out = Path(scratch) / "out"
        command = [str(Path(sys.executable).with_name("lerobot-train")), "--dataset.repo_id=local/check"]
        command += [f"--dataset.root={folder.resolve()}", f"--output_dir={out}", f"--steps={steps}", "--batch_size=2"]
        command += [
            "--num_workers=0",
            "--wandb.enable=false",
            *(f"--policy.{key}={value}" for key, value in policy.items()),
        ]
        environment = os.environ | {"OMP_NUM_THREADS": "1"}
        try:
            done = subprocess.run(
                command, check=False, capture_output=True, text=True, env=environment, timeout=TRAIN_SECONDS
            )
        except (OSError, subprocess.TimeoutExpired) as problem:
            raise Unfit(f"lerobot-train: {problem}") from problem
        expect(done.returncode == 0, f"lerobot-train ended with {done.returncode}: {done.stderr[-2000:]}")
        checkpoints = sorted(out.glob("checkpoints/*/pretrained_model/model.safetensors"))
        expect(bool(checkpoints), "lerobot-train left no checkpoint")
        return checkpoints[-1].stat().st_size


def main() -> None:
    """Opens, iterates and trains."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--episodes", type=int, help="number of episodes that there must be")
    parser.add_argument("--frames", type=int, help="number of frames that there must be")
    parser.add_argument("--pictures", type=Path, help="the same dataset with images, to compare those of a video with")
    parser.add_argument("--steps", type=int, default=5, help="steps of training; 0 does not train")
    given = parser.parse_args()
    torch.set_num_threads(1)
    try:
        info = json.loads((given.folder / "meta/info.json").read_text())
        dataset = dataset_class()("local/check", root=given.folder)
        look(dataset, info)
        ratio = compare(dataset, dataset_class()("local/pictures", root=given.pictures)) if given.pictures else None
        expect(given.episodes in (None, dataset.num_episodes), f"there are {dataset.num_episodes} episodes")
        expect(given.frames in (None, len(dataset)), f"there are {len(dataset)} frames")
        found = {"episodes": dataset.num_episodes, "frames": len(dataset), "cameras": dataset.meta.camera_keys}
        if ratio is not None:
            found["lowest_ratio_db"] = round(ratio, 1)
        if given.steps:
            found["losses"] = [round(loss, 4) for loss in train(given.folder, info, given.steps)]
            found["lerobot_train_bytes"] = train_by_program(given.folder, given.steps)
    except Unfit as problem:
        sys.exit(f"lerobot_dataset: {problem}")
    print(json.dumps(found))


if __name__ == "__main__":
    main()
