#!/usr/bin/env python3
"""Opens an exported HDF5 file with robomimic's own SequenceDataset, every filter key, as its training does.

    python robomimic_file.py FILE [--demos N]

Prints one line of JSON, and exits with 1 and one line if the file is not what robomimic expects.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
from pathlib import Path

import h5py
import numpy as np

# Dimensions of the rows of a vector.
VECTORS = 2


def expect(holds: bool, problem: str) -> None:
    """Ends the program with the problem unless the condition holds."""
    if not holds:
        sys.exit(f"robomimic_file: {problem}")


def look(path: Path) -> dict:
    """What h5py finds."""
    with h5py.File(path, "r", swmr=True, libver="latest") as file:
        demos = sorted(file["data"], key=lambda name: int(name.removeprefix("demo_")))
        total = 0
        for name in demos:
            demo = file["data"][name]
            steps = int(demo.attrs["num_samples"])
            total += steps
            for key in ("actions", "rewards", "dones", "q", "weights"):
                expect(demo[key].shape[0] == steps, f"{name}/{key} has {demo[key].shape[0]} rows, not {steps}")
            actions = demo["actions"][()]
            expect(bool(np.abs(actions).max() <= 1), f"{name}/actions leave [-1, 1]")
            expect(set(demo["obs"]) == set(demo["next_obs"]), f"{name}: obs and next_obs differ")
            for key, rows in demo["obs"].items():
                expect(np.array_equal(rows[1:], demo["next_obs"][key][:-1]), f"{name}/next_obs/{key} is not one later")
        expect(total == int(file["data"].attrs["total"]), f"data.total is not {total}")
        first = file["data"][demos[0]]["obs"]
        kinds: dict[str, list[str]] = {"low_dim": [], "rgb": [], "depth": []}
        for key, rows in first.items():
            kinds["low_dim" if rows.ndim == VECTORS else "rgb" if rows.dtype == np.uint8 else "depth"].append(key)
        masks = {key: len(names) for key, names in file["mask"].items()}
    return {"demos": len(demos), "samples": total, "kinds": kinds, "masks": masks}


def train_like(path: Path, found: dict) -> dict:
    """The demonstrations and a batch of each filter key."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        import torch
        from robomimic.utils import file_utils, obs_utils
        from robomimic.utils.dataset import SequenceDataset

        obs_utils.initialize_obs_utils_with_obs_specs({"obs": found["kinds"]})
        environment = file_utils.get_env_metadata_from_dataset(str(path))
        keys = [key for kind in found["kinds"].values() for key in kind]
        demos = {}
        for mask in (None, *found["masks"]):
            dataset = SequenceDataset(
                hdf5_path=str(path),
                obs_keys=keys,
                dataset_keys=["actions", "rewards", "dones", "weights"],
                seq_length=4,
                frame_stack=1,
                filter_by_attribute=mask,
            )
            batch = next(iter(torch.utils.data.DataLoader(dataset, batch_size=min(4, len(dataset)))))
            expect(batch["weights"].shape[1] == batch["actions"].shape[1], "weights are not beside actions")
            demos[mask or "all"] = dataset.n_demos
    return {"environment": environment["env_name"], "loaded": demos}


def main() -> None:
    """Opens the file with h5py and with robomimic."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("--demos", type=int, help="number of demonstrations that there must be")
    given = parser.parse_args()
    found = look(given.file)
    expect(given.demos in (None, found["demos"]), f"there are {found['demos']} demonstrations")
    print(json.dumps(found | train_like(given.file, found)))


if __name__ == "__main__":
    main()
