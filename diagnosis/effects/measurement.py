"""What was measured wrongly: hands on another clock, points in another frame than hands, gravity and ground."""

from collections.abc import Mapping

import numpy as np

from ...methods.continuum.scene import Scene
from ...physics import terms
from .effect import Amount, Effect

__all__ = ["EFFECTS"]

ALL = ("solid", "rope", "sheet")
SHIFT = tuple(Amount(f"camera_shift_{axis}", 0.01, -0.1, 0.1, "m", 1e-3) for axis in "xyz")
TURN = tuple(Amount(f"camera_turn_{axis}", 0.02, -0.3, 0.3, "rad", 3e-3) for axis in "xyz")


def _moved(scene: Scene, values: Mapping[str, float]) -> Scene:
    shift, turn = (np.array([values.get(a.name, 0.0) for a in amounts]) for amounts in (SHIFT, TURN))
    return scene.seen_from(turn, shift) if shift.any() or turn.any() else scene


EFFECTS = (
    Effect.of_term("measurement", terms.ControllerDelay, ALL, usual={"controller_delay": 2e-3}),
    Effect(
        "camera_pose",
        "measurement",
        "points were reported in another frame than hands and gravity",
        None,
        ALL,
        (*SHIFT, *TURN),
        seen=_moved,
        motion="turning it in the hand, and laying it down",
    ),
)
