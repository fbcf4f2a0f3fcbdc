"""What the hand does: where the body lies, where it is gripped, and the path of the grip. z is up here, the table is z = 0."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["DRAG", "LIFT", "Interaction"]


@dataclass(frozen=True)
class Interaction:
    """A hand closes on a body that lies on the table, and moves.

    position, heading  of the body before the hand comes [m], [rad about z]
    grip               centre of the grip in the body's rest axes [m], or None: nobody holds it
    grip_radius        vertices that close to the centre are held [m]
    times              (K,) of the key poses [s], rising, the first 0
    moves              (K, 3) displacement of the grip from its start [m]
    turns              (K, 3) rotation of the hand about the grip, a rotation vector [rad]
    arm                direction from which the forearm reaches in [rad about z]
    settle             how long the body may come to rest before the first frame [s]

    Between key poses the path is a cubic spline that starts from rest.
    """

    name: str
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    heading: float = 0.0
    grip: tuple[float, float, float] | None = None
    grip_radius: float = 0.03
    times: tuple[float, ...] = (0.0, 1.0)
    moves: tuple[tuple[float, float, float], ...] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    turns: tuple[tuple[float, float, float], ...] = ()
    arm: float = np.pi
    settle: float = 0.5

    def __post_init__(self):
        if self.times[0] != 0 or len(self.times) < 2 or min(np.diff(self.times)) <= 0:
            raise ValueError(f"interaction {self.name}: times must start at 0 and rise, got {self.times}")
        for name in ("moves", "turns"):
            keys = getattr(self, name)
            if np.shape(keys) != (len(self.times), 3) and not (name == "turns" and keys == ()):
                raise ValueError(f"interaction {self.name}: {name} must have shape ({len(self.times)}, 3), got {np.shape(keys)}")

    def path(self, time) -> tuple[np.ndarray, np.ndarray]:
        """Displacements (S, 3) [m] and rotations (S, 3, 3) of the hand at ``time`` (S,) seconds; it holds its last pose afterwards."""
        from scipy.spatial.transform import Rotation

        time = np.clip(np.asarray(time, float), 0, self.times[-1])
        turns = _spline(self.times, self.turns or np.zeros((len(self.times), 3)), time)
        return _spline(self.times, self.moves, time), Rotation.from_rotvec(turns).as_matrix()

    def place(self, rest: np.ndarray) -> np.ndarray:
        """Rest coordinates (..., 3) of the body as it is laid down, z up [m]."""
        c, s = np.cos(self.heading), np.sin(self.heading)
        return rest @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]).T + np.array(self.position)


def _spline(times, keys, at):
    from scipy.interpolate import CubicSpline

    return CubicSpline(times, np.asarray(keys, float), bc_type=((1, np.zeros(3)), (2, np.zeros(3))))(at)


# Up by the head until the tail hangs free, then shaken to and fro at about the pendulum's own pace.
LIFT = Interaction(
    "lift",
    heading=0.3,
    grip=(-0.1, 0.0, 0.011),
    times=(0.0, 0.35, 0.6, 0.95, 1.3, 1.65),
    moves=(
        (0.0, 0.0, 0.0),
        (0.02, 0.0, 0.15),
        (0.08, 0.03, 0.24),
        (-0.02, -0.04, 0.22),
        (0.08, 0.04, 0.24),
        (-0.04, 0.02, 0.23),
    ),
    turns=((0, 0, 0), (0, 0.2, 0), (0.1, 0.4, 0.0), (-0.1, 0.1, 0.2), (0.1, 0.4, -0.2), (0, 0.1, 0.1)),
)

# Across the table by the tail from side to side, so that the head slides and swings behind, now and then half lifted.
DRAG = Interaction(
    "drag",
    heading=2.4,
    arm=2.4,
    grip=(0.1, 0.0, 0.008),
    times=(0.0, 0.3, 0.6, 0.9, 1.2, 1.5, 1.8),
    moves=(
        (0.0, 0.0, 0.0),
        (-0.06, -0.07, 0.02),
        (-0.12, -0.08, 0.05),
        (-0.04, 0.04, 0.03),
        (0.04, 0.12, 0.06),
        (-0.02, 0.02, 0.04),
        (-0.12, -0.06, 0.07),
    ),
    turns=((0, 0, 0), (0, 0, 0.3), (0, 0, 0.5), (0, 0, 0.1), (0, 0, -0.4), (0, 0, 0.1), (0, 0, 0.5)),
)
