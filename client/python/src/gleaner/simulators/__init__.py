"""Simulators of others in which a deployment can be evaluated: one file each, loaded when it is used.

`python -m gleaner.simulators robosuite Lift --deployment lift@prod` is the command, `make` and `SimulatorAdapter` its
parts for a loop in Python. Each needs the package of its simulator.
"""

from __future__ import annotations

import importlib
from typing import Any

from gleaner.errors import invalid
from gleaner.simulators._base import Camera, Seen, Simulator, SimulatorAdapter
from gleaner.simulators._vector import SimulatorVector

# Their packages do not fit into one Python environment.
NAMES = ("robosuite", "metaworld", "libero")

__all__ = ["NAMES", "Camera", "Seen", "Simulator", "SimulatorAdapter", "SimulatorVector", "make"]


def make(simulator: str, env_id: str, cameras: list[Camera], **options: Any) -> Simulator:
    """An environment of a simulator that renders these cameras, which have the simulator's names.

    `options` are those of the simulator's own constructor. Raises `InvalidArgument` for an unknown simulator or
    environment, and when the simulator's package is missing.
    """
    if simulator not in NAMES:
        raise invalid("simulator", f"{simulator!r} is unknown; supported: {', '.join(NAMES)}")
    try:
        module = importlib.import_module(f"gleaner.simulators.{simulator}")
    except ImportError as error:
        raise invalid("simulator", f"{simulator} cannot be loaded: {error}") from error
    made: Simulator = module.make(env_id, cameras, **options)
    return made
