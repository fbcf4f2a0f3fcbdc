"""What may be missing: every effect in one object, found in the modules of this folder (``EFFECTS``)."""

from .effect import Amount, Candidate, Effect
from .registry import effects

__all__ = ["Amount", "Candidate", "Effect", "effects"]
