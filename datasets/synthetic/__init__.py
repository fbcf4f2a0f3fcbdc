"""Synthetic RGB-D recordings of a soft body that a hand manipulates.

MuJoCo simulates them, not the engine of this project, so that no method is tested on data of its own equations.
"""

from .generate import Recording, generate, write

__all__ = ["Recording", "generate", "write"]
