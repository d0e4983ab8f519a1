"""Generates the messages from the server's own .proto files when the package is built.

An sdist carries the .proto files; a wheel, and an editable install, carry what was generated from them.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from importlib.resources import files
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PACKAGE = "gleaner._proto"
# The generator names modules after the .proto's path; inside this package they live one deeper.
IMPORT = re.compile(r"^from gleaner\.v1 import", flags=re.MULTILINE)


class ProtoHook(BuildHookInterface):  # type: ignore[type-arg]
    """Puts .proto files into an sdist and generated modules into everything else."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Runs before the files of a target are collected."""
        del version
        protos = find_protos(Path(self.root))
        if self.target_name == "sdist":
            build_data["force_include"][str(protos / "gleaner")] = "proto/gleaner"
        else:
            generate(protos, Path(self.root) / "src" / Path(*PACKAGE.split(".")))


def find_protos(root: Path) -> Path:
    """The folder of .proto files: beside us in an sdist, at the repository's root in a checkout."""
    for folder in (root / "proto", root / ".." / ".." / "proto"):
        if (folder / "gleaner" / "v1").is_dir():
            return folder.resolve()
    raise FileNotFoundError(f"no proto/gleaner/v1 in {root} or two levels above; build from a checkout or an sdist")


def generate(protos: Path, into: Path) -> None:
    """Writes one module and one stub for each .proto, as modules of our package."""
    from grpc_tools import protoc

    sources = sorted(str(path.relative_to(protos)) for path in protos.glob("gleaner/v1/*.proto"))
    includes = [f"-I{protos}", f"-I{files('grpc_tools') / '_proto'}"]
    with tempfile.TemporaryDirectory() as made:
        if protoc.main(["protoc", *includes, f"--python_out={made}", f"--pyi_out={made}", *sources]) != 0:
            raise RuntimeError("protoc failed; what it said is above")
        shutil.rmtree(into, ignore_errors=True)
        (into / "v1").mkdir(parents=True)
        for folder in (into, into / "v1"):
            (folder / "__init__.py").write_text('"""Generated from the .proto files; do not edit."""\n')
        for path in Path(made, "gleaner", "v1").iterdir():
            text = IMPORT.sub(f"from {PACKAGE}.v1 import", path.read_text())
            (into / "v1" / path.name).write_text(text)
