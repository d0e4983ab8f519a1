"""Converts the weights of a torchvision ResNet-18 or ResNet-34 from a .pth file to a safetensors file.

    python scripts/convert_resnet.py resnet18.pth resnet18.safetensors

Put the result into the server's folder `--image-weights-dir`; jobs then begin with it by
`--image-encoder resnet18 --image-weights resnet18.safetensors`. Needs the packages torch and safetensors, and no
torchvision. The .pth file is read without running code from it.
"""

from __future__ import annotations

import argparse
import errno
import pickle
import sys
from collections.abc import Mapping
from pathlib import Path

try:
    import torch
    from safetensors.torch import save_file
except ImportError as missing:
    sys.exit(f"{missing}; install the packages: pip install torch safetensors")

# The classifier of photographs and the counters of training have no use here.
DROPPED_START = "fc."
DROPPED_END = ".num_batches_tracked"
FIRST = "conv1.weight"


def read(path: Path) -> Mapping[str, object]:
    """The weights by name: the file's own, or those under `state_dict` or `model`, as training scripts store them."""
    broken = f"{path}: is not a whole file of weights alone; store model.state_dict() by torch.save"
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except OSError as error:
        # Of a file that is cut off, PyTorch's reader raises "Invalid argument" without the name of a file.
        sys.exit(broken if error.errno == errno.EINVAL else f"{path}: cannot be read: {error.strerror}")
    except (RuntimeError, pickle.UnpicklingError, EOFError):
        sys.exit(broken)
    for inner in ("state_dict", "model"):
        if isinstance(content, Mapping) and isinstance(content.get(inner), Mapping):
            content = content[inner]
    if not isinstance(content, Mapping) or not all(isinstance(name, str) for name in content):
        sys.exit(f"{path}: has a {type(content).__name__}, not weights by name; store model.state_dict() instead")
    return content


def converted(weights: Mapping[str, object], prefix: str) -> dict[str, torch.Tensor]:
    """The tensors that a server reads: in single precision, without `prefix` and without what has no use."""
    tensors = {}
    for name, tensor in weights.items():
        short = name.removeprefix(prefix)
        if not name.startswith(prefix) or short.startswith(DROPPED_START) or short.endswith(DROPPED_END):
            continue
        if not isinstance(tensor, torch.Tensor):
            sys.exit(f"{name}: is a {type(tensor).__name__}, not a tensor; store model.state_dict() instead")
        tensors[short] = tensor.detach().to(torch.float32).contiguous().clone()
    if FIRST not in tensors:
        known = ", ".join(sorted(weights)[:3])
        sys.exit(f"no tensor is named {prefix}{FIRST}; the file has {known} …; name what comes before it by --prefix")
    return tensors


def main() -> None:
    """Reads the arguments and writes the file."""
    parser = argparse.ArgumentParser(description="Convert torchvision's ResNet weights from .pth to safetensors.")
    parser.add_argument("source", type=Path, metavar="IN.pth")
    parser.add_argument("target", type=Path, metavar="OUT.safetensors")
    parser.add_argument(
        "--prefix",
        default="",
        help="What the names of the network begin with in the file, such as `module.`; other tensors are left out.",
    )
    args = parser.parse_args()
    tensors = converted(read(args.source), args.prefix)
    save_file(tensors, args.target)
    print(f"{args.target}: {len(tensors)} tensors, {sum(tensor.numel() for tensor in tensors.values()):,} numbers")


if __name__ == "__main__":
    main()
