"""Synthetic RGB-D recordings of a soft body that a hand manipulates.

Quadratic finite elements simulate them (``resolved``), which converge under refinement and share no code with the engine that twins are
made of, so that no method is tested on data of its own discretisation. MuJoCo simulates the virtual studio (``studio``).
"""

from .generate import Recording, generate, write

__all__ = ["Recording", "generate", "write"]
