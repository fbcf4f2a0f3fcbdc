"""What the turning of a held limp body says of forces from outside, without any simulation.

Inner forces, however a body folds, have no torque together. About the point where a hand holds it

    sum_i r_i x m_i (a_i - g) = sum_i r_i x f_i

with only the forces f from outside on the right: the air's, a wind's, or a gravity that is not as it is told. Both sides are known from
where the points were seen. What the hand itself turns is that of a force, M (a - g) together, that acts a little beside its middle. Two
hands may turn a body about all axes but the line through both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..methods.continuum.hands import labels_of
from .replica import Replica

__all__ = ["TURNS", "Balance", "balance"]

TURNS = {  # what speaks for which effects: whatever else touches the body brakes or pulls it too
    "braked": ("quadratic_drag", "plate_drag", "wind", "hidden_tether", "hidden_obstacle"),
    "leaning": ("wind", "gravity_tilt", "hidden_tether"),
}
STRIKING = 1.0  # from which on it does
SMOOTH = 0.067  # s, standard deviation of the window through which positions are differentiated
EDGE = 0.13  # s at either end that a window does not fill
CLEAR = 0.012  # m above the ground, of the lowest node, from which on a body hangs free
LEAST = 12  # frames in the air below which a recording says nothing
REACH = 0.05  # m from the hand, or from the line between two, that a body must reach
GAP = 6  # frames without a sighting that are bridged in time; longer ones by the neighbours
ALIKE = 20.0  # frames and directions whose errors are one
USUAL = 0.8  # 1/s by which the drag of limp things in still air differs
LEAN = 0.6  # m/s^2 that is found where nothing pulls aside
DRAG, LEANS, BESIDE = (0.8, 3.0), 1.5, 0.03  # priors: drag of the air [1/s], a gravity beside the one told [m/s^2], a hand's force [m]


@dataclass(frozen=True)
class Balance:
    """Of one or more recordings of a body together: ``drag`` [1/s], the force of the air on its points over their mass and velocity, and
    its standard deviation ``doubt``; ``lean`` [m/s^2], a steady level force over the mass.
    """

    drag: float
    doubt: float
    lean: float

    @property
    def braked(self) -> float:
        """How much more the air brakes than is usual, over what that is uncertain by."""
        return (self.drag - DRAG[0]) / float(np.hypot(USUAL, self.doubt))

    @property
    def leaning(self) -> float:
        """How much more a steady force pulls aside than what errors bring, over that."""
        return self.lean / LEAN - 1

    @property
    def speaks_for(self) -> tuple[str, ...]:
        """Effects that would turn the body so."""
        return tuple({effect: None for name, effects in TURNS.items() if getattr(self, name) > STRIKING for effect in effects})


def balance(replicas: Sequence[Replica]) -> Balance | None:
    """The balance of what one or two hands hold; None of bodies that stand up to a hand, or where none of the recordings has enough frames
    in the air. What these do not tell stays at what is usual: a Gaussian prior on every number.
    """
    left, right = [], []
    for index, replica in enumerate(replicas):
        turns = None if len(replica.recording.interior) else _turns(replica)
        if turns is None:
            continue
        torque, columns, beside = turns
        width = 3 * len(replicas)
        own = np.zeros((*torque.shape, width))
        own[..., 3 * index : 3 * index + 3] = beside
        left.append(torque.ravel())
        right.append(np.concatenate([columns, own], axis=-1).reshape(torque.size, -1))
    if not left:
        return None
    torque, columns = np.concatenate(left), np.concatenate(right)
    mean = np.zeros(columns.shape[1])
    mean[0] = DRAG[0]
    spread = np.array([DRAG[1], LEANS, LEANS] + [BESIDE] * (len(mean) - 3))
    found = np.linalg.lstsq(columns, torque, rcond=1e-8)[0]
    noise = ALIKE * float(np.mean(np.square(torque - columns @ found)))
    precision = columns.T @ columns / noise + np.diag(spread**-2.0)
    covariance = np.linalg.inv(precision)
    found = covariance @ (columns.T @ torque / noise + mean / spread**2)
    return Balance(float(found[0]), float(np.sqrt(covariance[0, 0])), float(np.hypot(*found[1:3])))


def _turns(replica):
    """Torques about the hand (F, A) while the body is in the air; what a drag of 1/s and steady forces of 1 m/s^2 along two level axes
    would turn (F, A, 3); and what a hand's force 1 m beside its middle along each axis would (F, A, 3). All over weight times size.
    """
    from scipy.ndimage import gaussian_filter1d

    recording = replica.recording
    hands, fps = _hands(replica), recording.fps
    gravity = np.asarray(recording.gravity, float)
    weight = np.linalg.norm(gravity)
    most = 1 if replica.system.chains else 2  # a rope between two hands is its own axis
    if not 1 <= len(hands) <= most or not weight:
        return None
    frames = min(replica.frames, len(hands[0]))
    raw = _filled(replica.sightings.position[:frames], replica.nodes)

    def smooth(x):
        return gaussian_filter1d(x[:frames], SMOOTH * fps, axis=0, mode="nearest")

    position, hands = smooth(raw), [smooth(h) for h in hands]
    velocity = np.gradient(position, 1 / fps, axis=0)
    push = np.gradient(velocity, 1 / fps, axis=0) - gravity
    arm = position - hands[0][:, None]
    mass = np.asarray(replica.system.masses, float)
    share = (mass / mass.sum())[:, None]
    line = None
    if len(hands) == 2:
        line = hands[1] - hands[0]
        line /= np.linalg.norm(line, axis=1, keepdims=True)
        arm = arm - (arm * line[:, None]).sum(axis=-1, keepdims=True) * line[:, None]
    size = np.sqrt((share * arm**2).sum(axis=(1, 2)))
    edge = round(EDGE * fps)
    air = np.zeros(frames, bool)
    air[edge : frames - edge] = True
    if recording.ground is not None:
        air &= recording.ground.height(raw).min(axis=1) > CLEAR
    air &= size > REACH
    if air.sum() < LEAST:
        return None

    def torque(force):
        return (share * np.cross(arm, np.broadcast_to(force, arm.shape))).sum(axis=1)

    level = _level(gravity)
    columns = np.stack([torque(push), torque(-velocity), *(torque(axis) for axis in level)], axis=-1)
    pull = (share * push).sum(axis=1)
    beside = np.stack([np.cross(axis, pull) for axis in np.eye(3)], axis=-1)
    both = np.concatenate([columns, beside], axis=-1)
    if line is not None:
        both = np.einsum("fa,fac->fc", line, both)[:, None]
    both = both[air] / (weight * size[air, None, None])
    return both[..., 0], both[..., 1:4], both[..., 4:]


def _hands(replica) -> list[np.ndarray]:
    """(T, 3) middles of what hands hold, each."""
    recording = replica.recording
    controllers = np.asarray(recording.controllers, float)
    if not controllers.shape[1]:
        return []
    hand = labels_of(controllers[:1])
    return [controllers[:, hand == label].mean(axis=1) for label in np.unique(hand)]


def _filled(position, nodes) -> np.ndarray:
    """``position`` (T, n, 3) without gaps: short ones bridged in time, long ones by what the seen neighbours did."""
    from scipy.spatial import cKDTree

    moved = position - nodes
    frames = np.arange(len(moved))
    seen = np.isfinite(position[..., 0])
    away = np.full(seen.shape, len(frames))
    for n in np.flatnonzero(seen.any(axis=0)):
        when = frames[seen[:, n]]
        away[:, n] = np.abs(frames[:, None] - when).min(axis=1)
        for axis in range(3):
            moved[:, n, axis] = np.interp(frames, when, moved[when, n, axis])
    for t in frames:
        far = away[t] > GAP
        if far.any() and (~far).sum() >= 3:
            distance, near = cKDTree(nodes[~far]).query(nodes[far], k=3)
            near_by = 1 / (distance + 1e-3)
            moved[t, far] = np.einsum("nk,nkc->nc", near_by / near_by.sum(axis=1, keepdims=True), moved[t, ~far][near])
    return nodes + np.nan_to_num(moved)


def _level(gravity) -> np.ndarray:
    """(2, 3) unit vectors across gravity."""
    return np.linalg.svd(gravity[None])[2][1:]
