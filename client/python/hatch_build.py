"""Generates the messages from the server's own .proto files, and the types of settings from its schema, at build time.

An sdist carries the .proto files and the schema; a wheel, and an editable install, carry what was generated from them.
"""

from __future__ import annotations

import json
import re
import shutil
import tempfile
from importlib.resources import files
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PACKAGE = "gleaner._proto"
# Settings of jobs; policies, weightings, objectives and scorers with their own.
SCHEMA = ("jobs.json", "kinds.json")
# The generator names modules after the .proto's path; inside this package they live one deeper.
IMPORT = re.compile(r"^from gleaner\.v1 import", flags=re.MULTILINE)


class ProtoHook(BuildHookInterface):  # type: ignore[type-arg]
    """Puts .proto files into an sdist and generated modules into everything else."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Runs before the files of a target are collected."""
        del version
        protos = find_protos(Path(self.root))
        schema = find_schema(Path(self.root))
        if self.target_name == "sdist":
            build_data["force_include"][str(protos / "gleaner")] = "proto/gleaner"
            for name in SCHEMA:
                build_data["force_include"][str(schema / name)] = f"schema/{name}"
        else:
            into = Path(self.root) / "src" / Path(*PACKAGE.split("."))
            generate(protos, into)
            (into / "kinds.py").write_text(settings_module(schema))


def find_protos(root: Path) -> Path:
    """The folder of .proto files: beside us in an sdist, at the repository's root in a checkout."""
    for folder in (root / "proto", root / ".." / ".." / "proto"):
        if (folder / "gleaner" / "v1").is_dir():
            return folder.resolve()
    raise FileNotFoundError(f"no proto/gleaner/v1 in {root} or two levels above; build from a checkout or an sdist")


def find_schema(root: Path) -> Path:
    """The folder of the settings' schema: beside us in an sdist, in the crate of values in a checkout."""
    for folder in (root / "schema", root / ".." / ".." / "crates" / "core"):
        if all((folder / name).is_file() for name in SCHEMA):
            return folder.resolve()
    raise FileNotFoundError(
        f"no {' and '.join(SCHEMA)} in {root}/schema or crates/core; build from a checkout or an sdist"
    )


def settings_module(schema: Path) -> str:
    """A module with one typed dictionary for the settings of each kind of job."""
    jobs, kinds = (json.loads((schema / name).read_text()) for name in SCHEMA)
    families = {
        "train": [("policy", kinds["policies"]), ("weighting", kinds["weightings"])],
        "score": [("scorer", kinds["scorers"])],
    }
    lines = [
        '"""Settings of jobs, generated from the server\'s schema; do not edit."""',
        "",
        "from __future__ import annotations",
        "",
        "from collections.abc import Sequence",
        "from typing import Literal, TypedDict",
    ]
    for job, settings in jobs.items():
        lines += [
            "",
            "",
            f"class {job.capitalize()}Values(TypedDict, total=False):",
            f'    """Settings of a {job} job."""',
            "",
        ]
        shown = [(setting, "") for setting in settings]
        if job == "pretrain":
            shown.append((chosen_of("objectives", "words", kinds["objectives"]), ""))
        for name, family in families.get(job, []):
            shown.append((chosen_of(name, "word", family), ""))
            shown += own_settings(family)
        for setting, only in shown:
            lines += setting_lines(setting, only)
    return "\n".join(lines) + "\n"


def chosen_of(name: str, kind: str, family: list[dict[str, Any]]) -> dict[str, Any]:
    """The setting that chooses kinds of a family."""
    words = [{"word": one["name"], "about": one["about"]} for one in family]
    default = words[0]["word"] if kind == "word" else [one["word"] for one in words]
    about = " ".join(f"{one['word']}: {one['about']}" for one in words)
    return {"name": name, "about": about, "shape": {"type": kind, "words": words}, "default": default}


def own_settings(family: list[dict[str, Any]]) -> list[tuple[dict[str, Any], str]]:
    """The settings of a family's kinds, each once, with the kinds that it is limited to and their other defaults."""
    found: dict[str, list[tuple[str, dict[str, Any]]]] = {}
    for kind in family:
        for setting in kind.get("settings", []):
            found.setdefault(setting["name"], []).append((kind["name"], setting))

    def only(uses: list[tuple[str, dict[str, Any]]]) -> str:
        first = uses[0][1]["default"]
        others = ((name, setting["default"]) for name, setting in uses if setting["default"] != first)
        defaults = "".join(f" Default of {name}: {json.dumps(default)}." for name, default in others)
        limit = f" Only for {', '.join(name for name, _ in uses)}." if len(uses) < len(family) else ""
        return defaults + limit

    return [(uses[0][1], only(uses)) for uses in found.values()]


def setting_lines(setting: dict[str, Any], only: str) -> list[str]:
    """A key of the dictionary with its type and documentation. A word of Python's own gets an underscore."""
    shape = setting["shape"]
    words = ", ".join(json.dumps(one["word"]) for one in shape.get("words", []))
    types = {
        "integer": "int",
        "number": "float",
        "flag": "bool",
        "word": f"Literal[{words}]",
        "words": f"Sequence[Literal[{words}]]",
        "numbers": "Sequence[float]",
        "integers": "Sequence[int]",
        "text": "str",
    }
    name = "lambda_" if setting["name"] == "lambda" else setting["name"]
    about = f"{setting['about']}{only} Default: {json.dumps(setting['default'])}."
    return [f"    {name}: {types[shape['type']]}", f'    """{about}"""']


def generate(protos: Path, into: Path) -> None:
    """Writes one module and one stub for each .proto, as modules of our package."""
    from grpc_tools import protoc

    sources = sorted(str(path.relative_to(protos)) for path in protos.glob("gleaner/v1/*.proto"))
    includes = [f"-I{protos}", f"-I{files('grpc_tools') / '_proto'}"]
    with tempfile.TemporaryDirectory() as made:
        if protoc.main(["protoc", *includes, f"--python_out={made}", f"--pyi_out={made}", *sources]) != 0:
            raise RuntimeError("protoc failed; its output is above")
        shutil.rmtree(into, ignore_errors=True)
        (into / "v1").mkdir(parents=True)
        for folder in (into, into / "v1"):
            (folder / "__init__.py").write_text('"""Generated from the .proto files; do not edit."""\n')
        for path in Path(made, "gleaner", "v1").iterdir():
            text = IMPORT.sub(f"from {PACKAGE}.v1 import", path.read_text())
            (into / "v1" / path.name).write_text(text)
