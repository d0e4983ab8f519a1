"""The rooms of the Meta-World example; `../metaworld.py` is the command."""

import os
from ctypes.util import find_library

# Pictures without a screen; mujoco asks once, when it is loaded. Where OSMesa is missing, EGL, which draws on a GPU or,
# as Mesa has it, on the processor too.
os.environ.setdefault("MUJOCO_GL", "osmesa" if find_library("OSMesa") else "egl")
