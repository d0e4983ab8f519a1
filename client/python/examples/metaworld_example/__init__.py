"""The rooms of the Meta-World example; `../metaworld.py` is the command."""

import os

# Pictures without a screen, drawn by the processor. mujoco asks once, when it is loaded; with a GPU, `egl` is faster.
os.environ.setdefault("MUJOCO_GL", "osmesa")
