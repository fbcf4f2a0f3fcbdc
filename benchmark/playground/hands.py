"""Hands that somebody moves: which controllers are one hand, where each is now, and the keys that move it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...methods.continuum.hands import groups_of

__all__ = ["KEYS", "Hand", "follow", "hands_in", "moved"]

# the playground of PhysTwin: (hand, direction) by key, directions x (right), y (away), z (up) of who looks at the body
KEYS = {
    **dict(W=(0, (0, 1, 0)), S=(0, (0, -1, 0)), A=(0, (-1, 0, 0)), D=(0, (1, 0, 0)), E=(0, (0, 0, 1)), Q=(0, (0, 0, -1))),
    **dict(I=(1, (0, 1, 0)), K=(1, (0, -1, 0)), J=(1, (-1, 0, 0)), L=(1, (1, 0, 0)), O=(1, (0, 0, 1)), U=(1, (0, 0, -1))),
}


@dataclass(frozen=True)
class Hand:
    """``members`` (c,) of the controllers, once at ``home`` (c, 3) m; ``position`` (3,) m of their middle, ``rotation`` (3, 3) since."""

    members: np.ndarray
    home: np.ndarray
    position: np.ndarray
    rotation: np.ndarray

    @property
    def points(self) -> np.ndarray:
        """(c, 3) m, where its controllers are."""
        return (self.home - self.home.mean(0)) @ self.rotation.T + self.position


def hands_in(path, at=None) -> tuple[Hand, ...]:
    """The hands of controllers that go along ``path`` (T, C, 3) m, while they are at ``at`` (C, 3) m, or in its first frame."""
    path = np.asarray(path, float)
    at = path[0] if at is None else np.asarray(at, float)
    found = [Hand(own, at[own], at[own].mean(0), np.eye(3)) for own in (groups_of(path) if path.shape[1] else ())]
    return tuple(found)


def moved(hands, controllers) -> np.ndarray:
    """(C, 3) m of all controllers, those of each hand where it carries them."""
    found = np.array(controllers, float)
    for hand in hands:
        found[hand.members] = hand.points
    return found


def follow(hands, controllers) -> tuple[Hand, ...]:
    """``hands`` holding controllers as they are now at ``controllers`` (C, 3) m."""
    return tuple(replace(h, home=controllers[h.members], position=controllers[h.members].mean(0), rotation=np.eye(3)) for h in hands)
