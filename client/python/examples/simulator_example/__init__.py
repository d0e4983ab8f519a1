"""The modules of the example; `../simulators.py` is the command."""

import os
from ctypes.util import find_library

# Rendering without a screen; mujoco reads the variable once, when it is loaded. Without OSMesa, EGL renders on a GPU
# or, with Mesa, on the processor.
os.environ.setdefault("MUJOCO_GL", "osmesa" if find_library("OSMesa") else "egl")
