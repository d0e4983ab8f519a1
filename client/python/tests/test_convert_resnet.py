"""scripts/convert_resnet.py as a program, and its file in a server; only where torch and safetensors are installed."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import gleaner
from programs import ROOT, Server, cli

torch = pytest.importorskip("torch")
load_file = pytest.importorskip("safetensors.torch").load_file

SCRIPT = ROOT / "scripts" / "convert_resnet.py"
FILE = "resnet18.safetensors"
# As torchvision's documentation gives it.
PARAMETERS = 11_689_512


def norm(name: str, channels: int) -> Iterator[tuple[str, tuple[int, ...]]]:
    for part in ("weight", "bias", "running_mean", "running_var"):
        yield f"{name}.{part}", (channels,)
    yield f"{name}.num_batches_tracked", ()


def sizes() -> Iterator[tuple[str, tuple[int, ...]]]:
    """The names and shapes of torchvision's ResNet-18."""
    yield "conv1.weight", (64, 3, 7, 7)
    yield from norm("bn1", 64)
    inputs = 64
    for stage, channels in enumerate((64, 128, 256, 512), 1):
        for block in range(2):
            path = f"layer{stage}.{block}"
            yield f"{path}.conv1.weight", (channels, inputs, 3, 3)
            yield from norm(f"{path}.bn1", channels)
            yield f"{path}.conv2.weight", (channels, channels, 3, 3)
            yield from norm(f"{path}.bn2", channels)
            if inputs != channels:
                yield f"{path}.downsample.0.weight", (channels, inputs, 1, 1)
                yield from norm(f"{path}.downsample.1", channels)
            inputs = channels
    yield "fc.weight", (1000, 512)
    yield "fc.bias", (1000,)


def is_used(name: str) -> bool:
    return not name.startswith("fc.") and not name.endswith(".num_batches_tracked")


def convert(*args: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(SCRIPT), *map(str, args)]
    return subprocess.run(command, check=False, capture_output=True, text=True)


@pytest.fixture(scope="module")
def state() -> dict[str, Any]:
    """Random weights, small as those of a network, with counters as integers."""
    random = torch.Generator().manual_seed(0)
    found = {}
    for name, size in sizes():
        is_counter = name.endswith(".num_batches_tracked")
        found[name] = torch.tensor(7) if is_counter else torch.rand(size, generator=random) / 10
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of image weights."""
    return tmp_path_factory.mktemp("weights")


@pytest.fixture(scope="module")
def converted(state: dict[str, Any], folder: Path) -> Path:
    source, target = folder / "resnet18.pth", folder / FILE
    torch.save(state, source)
    done = convert(source, target)
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{target}: 100 tensors, 11,186,112 numbers\n"
    return target


def test_made_weights_have_the_size_of_the_network(state: dict[str, Any]) -> None:
    buffers = ("running_mean", "running_var", "num_batches_tracked")
    assert len(state) == 122
    assert sum(tensor.numel() for name, tensor in state.items() if not name.endswith(buffers)) == PARAMETERS


def test_tensors_keep_names_shapes_and_values_without_the_classifier(state: dict[str, Any], converted: Path) -> None:
    found = load_file(converted)
    assert set(found) == {name for name in state if is_used(name)}
    for name, tensor in found.items():
        assert tensor.dtype == torch.float32, name
        assert tensor.shape == state[name].shape, name
        assert torch.equal(tensor, state[name]), name


def test_a_server_trains_from_the_converted_weights(converted: Path, tmp_path: Path) -> None:
    recordings = tmp_path / "recordings"
    cli("record", "--out", str(recordings), "--agent", "expert:1", "--agent", "wrong_goal:1")
    server = Server(tmp_path / "server", "--image-weights-dir", str(converted.parent))
    try:
        cli("--server", server.address, "task", "create", "--sim", "pick_cube")
        with gleaner.connect(server.address) as client:
            for path in recordings.glob("*.mcap"):
                outcome = "success" if "expert" in path.name else "failure"
                client.episodes.push(path, task="pick_cube", outcome=outcome)
            job = client.jobs.pretrain(
                "pick_cube", steps=1, batch=2, image_encoder="resnet18", image_weights=FILE, seed=7
            )
            assert client.jobs.wait(job, timeout=120).result_id
    finally:
        server.stop()


@pytest.mark.parametrize("inner", ["state_dict", "model"])
def test_weights_within_a_checkpoint_lose_their_prefix(inner: str, state: dict[str, Any], tmp_path: Path) -> None:
    source, target = tmp_path / "checkpoint.pth", tmp_path / FILE
    small = {name: state[name] for name in ("conv1.weight", "bn1.weight", "bn1.num_batches_tracked", "fc.bias")}
    weights = {f"module.{name}": tensor for name, tensor in small.items()}
    torch.save({inner: {**weights, "head.weight": torch.ones(1)}, "epoch": 3}, source)
    done = convert(source, target)
    assert done.returncode == 1
    assert "no tensor is named conv1.weight" in done.stderr
    assert "--prefix" in done.stderr
    assert not target.exists()
    done = convert(source, target, "--prefix", "module.")
    assert done.returncode == 0, done.stderr
    found = load_file(target)
    assert set(found) == {"conv1.weight", "bn1.weight"}
    assert torch.equal(found["conv1.weight"], small["conv1.weight"])


def test_other_types_and_layouts_become_single_precision(tmp_path: Path) -> None:
    source, target = tmp_path / "half.pth", tmp_path / FILE
    kernel = torch.rand(8, 3, 7, 7).half().to(memory_format=torch.channels_last)
    shared = torch.nn.Parameter(torch.rand(8, dtype=torch.float64))
    torch.save({"conv1.weight": kernel, "bn1.weight": shared, "bn1.bias": shared}, source)
    done = convert(source, target)
    assert done.returncode == 0, done.stderr
    found = load_file(target)
    assert {tensor.dtype for tensor in found.values()} == {torch.float32}
    assert torch.equal(found["conv1.weight"], kernel.float())
    assert torch.equal(found["bn1.bias"], shared.detach().float())


def other_bytes(path: Path) -> None:
    path.write_bytes(b"not weights")


def other_text(path: Path) -> None:
    path.write_text("<html>404</html>\n")


def no_bytes(path: Path) -> None:
    path.touch()


def half_a_file(path: Path) -> None:
    torch.save({"conv1.weight": torch.ones(64, 3, 7, 7)}, path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def whole_model(path: Path) -> None:
    torch.save(torch.nn.Linear(1, 1), path)


def one_tensor(path: Path) -> None:
    torch.save(torch.ones(1), path)


def weights_by_number(path: Path) -> None:
    torch.save({0: torch.ones(1)}, path)


def number(path: Path) -> None:
    torch.save({"conv1.weight": 3}, path)


def other_network(path: Path) -> None:
    torch.save({"stem.weight": torch.ones(1), "head.weight": torch.ones(1)}, path)


def no_file(path: Path) -> None:
    del path


WRONG = {
    other_bytes: "{path}: is not a whole file of weights alone; store model.state_dict() by torch.save",
    other_text: "{path}: is not a whole file of weights alone; store model.state_dict() by torch.save",
    no_bytes: "{path}: is not a whole file of weights alone; store model.state_dict() by torch.save",
    half_a_file: "{path}: is not a whole file of weights alone; store model.state_dict() by torch.save",
    whole_model: "{path}: is not a whole file of weights alone; store model.state_dict() by torch.save",
    one_tensor: "{path}: has a Tensor, not weights by name; store model.state_dict() instead",
    weights_by_number: "{path}: has a dict, not weights by name; store model.state_dict() instead",
    number: "conv1.weight: is a int, not a tensor; store model.state_dict() instead",
    other_network: "no tensor is named conv1.weight; the file has head.weight, stem.weight …; "
    "name what comes before it by --prefix",
    no_file: "{path}: cannot be read: No such file or directory",
}


@pytest.mark.parametrize("make", WRONG, ids=lambda make: make.__name__)
def test_other_files_are_rejected_with_the_reason(make: Any, tmp_path: Path) -> None:
    source, target = tmp_path / "resnet18.pth", tmp_path / FILE
    make(source)
    done = convert(source, target)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == WRONG[make].format(path=source)
    assert "Traceback" not in done.stderr
    assert not target.exists()
