"""The Open Inference Protocol with an unchanged tritonclient."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import tritonclient.grpc as triton
from numpy.typing import NDArray
from tritonclient.utils import InferenceServerException

DTYPES = {"UINT8": np.uint8, "UINT16": np.uint16, "FP32": np.float32}
Observation = dict[str, NDArray[Any]]


@pytest.fixture
def infer_client(server: str, deployment: str) -> Iterator[triton.InferenceServerClient]:
    del deployment
    client = triton.InferenceServerClient(server.rsplit("://", maxsplit=1)[-1])
    yield client
    client.close()


@pytest.fixture
def specs(infer_client: triton.InferenceServerClient, deployment: str) -> dict[str, Any]:
    """The input tensors of the deployment's metadata."""
    return {tensor.name: tensor for tensor in infer_client.get_model_metadata(deployment).inputs}


def observation(specs: dict[str, Any], seed: int) -> Observation:
    """One that the deployment takes, different for every seed."""
    random = np.random.default_rng(seed)
    arrays: Observation = {}
    for name, tensor in specs.items():
        if name != "executed_action":
            most = {"UINT8": 256, "UINT16": 900, "FP32": 1}[tensor.datatype]
            arrays[name] = (random.random(tuple(tensor.shape)) * most).astype(DTYPES[tensor.datatype])
    return arrays


def tensors(arrays: Observation) -> list[triton.InferInput]:
    inputs = []
    for name, array in arrays.items():
        datatype = {"uint8": "UINT8", "uint16": "UINT16", "float32": "FP32", "float64": "FP64"}.get(array.dtype.name)
        tensor = triton.InferInput(name, list(array.shape), datatype or "BYTES")
        inputs.append(tensor.set_data_from_numpy(array))
    return inputs


def png(rgb: NDArray[np.uint8]) -> bytes:
    """An image as the smallest PNG writer there is."""
    height, width, _ = rgb.shape

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = b"".join(b"\0" + row.tobytes() for row in rgb)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    parts = [chunk(b"IHDR", header), chunk(b"IDAT", zlib.compress(rows)), chunk(b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def test_the_server_and_its_models_are_found(infer_client: triton.InferenceServerClient, deployment: str) -> None:
    assert infer_client.is_server_live()
    assert infer_client.is_server_ready()
    assert infer_client.get_server_metadata().name == "gleaner"
    assert infer_client.is_model_ready(deployment)
    assert not infer_client.is_model_ready("missing")
    metadata = infer_client.get_model_metadata(deployment)
    assert infer_client.is_model_ready(deployment, metadata.versions[0])
    assert [output.name for output in metadata.outputs] == ["action"]
    index = infer_client.get_model_repository_index()
    assert deployment in [model.name for model in index.models]


def test_one_request_gives_actions(
    infer_client: triton.InferenceServerClient, deployment: str, specs: dict[str, Any]
) -> None:
    seen = observation(specs, 1)
    wanted = [triton.InferRequestedOutput("action")]
    result = infer_client.infer(deployment, tensors(seen), request_id="7", outputs=wanted)
    action = result.as_numpy("action")
    assert action.dtype == np.float32
    assert action.shape[1:] == tuple(specs["executed_action"].shape)
    assert np.isfinite(action).all()
    assert result.get_response().id == "7"

    batched = {name: array[None] for name, array in seen.items()}
    again = infer_client.infer(deployment, tensors(batched)).as_numpy("action")
    np.testing.assert_allclose(again, action, atol=1e-4)
    cameras = [name for name, array in seen.items() if array.ndim == 3]
    assert cameras
    encoded = dict(seen)
    for camera in cameras:
        encoded[camera] = np.array([png(seen[camera])], dtype=np.object_)
    again = infer_client.infer(deployment, tensors(encoded)).as_numpy("action")
    np.testing.assert_allclose(again, action, atol=1e-4)


def test_sequence_keeps_its_history(
    infer_client: triton.InferenceServerClient, deployment: str, specs: dict[str, Any]
) -> None:
    first, second = observation(specs, 1), observation(specs, 2)

    def act(seen: Observation, **place: Any) -> NDArray[np.float32]:
        result: NDArray[np.float32] = infer_client.infer(deployment, tensors(seen), **place).as_numpy("action")
        return result

    for sequence in (5, "robot five"):
        begun = act(first, sequence_id=sequence, sequence_start=True)
        np.testing.assert_allclose(begun, act(first), atol=1e-4)
        act(second, sequence_id=99, sequence_start=True)  # another client's, in between
        after = act(second, sequence_id=sequence, sequence_end=True)
        assert not np.allclose(after, act(second), atol=1e-6), "the history makes a difference"
        with pytest.raises(InferenceServerException, match=r"parameters\.sequence_id"):
            act(second, sequence_id=sequence)


def test_invalid_arguments_are_named(
    infer_client: triton.InferenceServerClient, deployment: str, specs: dict[str, Any]
) -> None:
    seen = observation(specs, 1)
    camera = next(name for name, array in seen.items() if array.ndim == 3)

    def refused(arrays: Observation, name: str = deployment, **more: Any) -> str:
        with pytest.raises(InferenceServerException) as caught:
            infer_client.infer(name, tensors(arrays), **more)
        return f"{caught.value.status()} {caught.value.message()}"

    proprioception = seen["proprioception"].copy()
    proprioception[1] = math.nan
    cases = {
        f"inputs.{camera}: has shape": seen | {camera: seen[camera][:-1]},
        "inputs.proprioception: has datatype": seen | {"proprioception": seen["proprioception"].astype(np.float64)},
        "inputs.proprioception[1]: is NaN": seen | {"proprioception": proprioception},
        f"inputs.{camera}: is missing": {name: array for name, array in seen.items() if name != camera},
        f"inputs.{camera}: ": seen | {camera: np.array([b"\xff\xd8\xff broken"], dtype=np.object_)},
        "ceiling": seen | {"ceiling": seen[camera]},
    }
    for words, arrays in cases.items():
        error = refused(arrays)
        assert "INVALID_ARGUMENT" in error
        assert words in error
    assert "NOT_FOUND" in refused(seen, "missing")
    assert "priority" in refused(seen, priority=1)
