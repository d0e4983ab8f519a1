"""Prints the numbers that `tests.rs` beside this file expects, as torchvision computes them.

Weights and image are hashes of names and places, so that both sides make the same ones. Needs torch, torchvision and
numpy: `python reference.py`.
"""

import math

import numpy as np
import torch
import torchvision

HEIGHT, WIDTH = 64, 96


def uniform(name: str, count: int) -> np.ndarray:
    """`count` numbers in 0 … 1, in double precision."""
    mask = np.uint64(0xFFFFFFFF)
    start = np.uint64(sum(name.encode()) * 97)
    x = (np.arange(count, dtype=np.uint64) * np.uint64(2654435761) + start) & mask
    x ^= x >> np.uint64(15)
    x = (x * np.uint64(2246822519)) & mask
    x ^= x >> np.uint64(13)
    return x.astype(np.float64) / 2.0**32


def bounds(name: str, size: list[int]) -> tuple[float, float]:
    """The least and the largest value of a tensor."""
    if len(size) > 1:
        bound = math.sqrt(6 / math.prod(size[1:]))
        return -bound, bound
    if name.endswith((".weight", ".running_var")):
        return 0.5, 1.5
    return -0.2, 0.2


def weights(model: torch.nn.Module) -> dict[str, torch.Tensor]:
    """The state of a model, made of names and places."""
    state = {}
    for name, tensor in model.state_dict().items():
        size = list(tensor.shape)
        if name.startswith("fc.") or name.endswith(".num_batches_tracked"):
            state[name] = tensor
            continue
        low, high = bounds(name, size)
        values = low + (high - low) * uniform(name, tensor.numel())
        state[name] = torch.from_numpy(values.astype(np.float32)).view(size)
    return state


def image() -> torch.Tensor:
    """`[1, 3, H, W]` in 0 … 1, from bytes in rows of pixels."""
    bytes_ = np.floor(uniform("image", HEIGHT * WIDTH * 3) * 256)
    pixels = torch.from_numpy(bytes_.astype(np.float32)).view(1, HEIGHT, WIDTH, 3)
    return pixels.permute(0, 3, 1, 2) / 255


def summary(x: torch.Tensor) -> list[float]:
    """Mean, deviation, the channels' mean at the first and the last place, and the mean of channel 7."""
    x = x[0].double()
    return [v.item() for v in (x.mean(), x.std(correction=0), x[:, 0, 0].mean(), x[:, -1, -1].mean(), x[7].mean())]


def stages(model: torch.nn.Module) -> list[list[float]]:
    """The numbers of each stage."""
    model.load_state_dict(weights(model))
    model.eval()
    mean = torch.tensor([0.485, 0.456, 0.406]).view(3, 1, 1)
    deviation = torch.tensor([0.229, 0.224, 0.225]).view(3, 1, 1)
    x = (image() - mean) / deviation
    x = model.maxpool(model.relu(model.bn1(model.conv1(x))))
    found = []
    for layer in (model.layer1, model.layer2, model.layer3, model.layer4):
        x = layer(x)
        found.append(summary(x))
    return found


torch.set_grad_enabled(False)
for make in (torchvision.models.resnet18, torchvision.models.resnet34):
    print(make.__name__)
    for stage in stages(make(weights=None)):
        print("  [" + ", ".join(f"{number:.6g}" for number in stage) + "],")
