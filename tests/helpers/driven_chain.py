"""Chains that hang from two held markers and that motors bend: statics of joints, solved by iteration."""

import numpy as np
from scipy.spatial.transform import Rotation
from twinbench.datasets.markers import Cable
from twinbench.datasets.scenario import Scenario, Split

LENGTHS = (0.106, 0.097, 0.1195)  # m
STIFFNESS = (8.0, 4.0, 2.0)  # N m/rad
DOWN = np.array([0.0, -1.0, 0.0])
AXES = np.array([[1.0, 0, 0], [0, 0, 1.0]])
FPS = 10.0


def commands(frames, *, seed=0):
    """(T, J, 2) N m about axes across the part before a joint: what motors do, slowly and at random."""
    t, rng = np.arange(frames) / FPS, np.random.default_rng(seed)
    rates, phases = rng.uniform(0.1, 0.6, (2, 3, 2, 6)) * [[[[1.0]]], [[[10.0]]]]
    waves = np.sin(2 * np.pi * rates * t[:, None, None, None] + phases).sum(-1) / np.sqrt(3)
    return 0.25 * np.array(STIFFNESS)[:, None] * waves


def placed(bends):
    """((T, J + 1, 3) m, markers from the last held one on, (T, J, 2, 3), the axes of joints that bend about them by ``bends`` (T, J, 2)).

    A part turns with its joint, and with it the axes of the next: x and z of the part that hangs straight.
    """
    turned, places, axes = Rotation.identity(len(bends)), [np.zeros((len(bends), 3))], []
    for j, length in enumerate(LENGTHS):
        own = np.stack([turned.apply(axis) for axis in AXES], 1)
        turned = Rotation.from_rotvec(np.einsum("tc,tci->ti", bends[:, j], own)) * turned
        places.append(places[-1] + length * turned.apply(DOWN))
        axes.append(own)
    return np.stack(places, 1), np.stack(axes, 1)


def rested(moments, *, weights=(0.0, 0.0, 0.0), stiffness=STIFFNESS):
    """(T, J + 1, 3) m where ``moments`` (T, J, 2) of motors and the ``weights`` [N] at markers balance what joints resist with."""
    bends = np.zeros_like(moments)
    for _ in range(60):
        places, axes = placed(bends)
        pull = np.zeros_like(moments)
        for j in range(3):
            for k in range(j, 3):
                pull[:, j] += weights[k] * np.einsum("ti,tci->tc", np.cross(places[:, k + 1] - places[:, j], DOWN), axes[:, j])
        bends = 0.5 * bends + 0.5 * (moments + pull) / np.array(stiffness)[:, None]
    return placed(bends)[0]


def driven(name, moments, *, wander=0.0, seed=0, motors=0.0, **body):
    """A recording under ``moments`` (T, J, 2). Joints stray by ``wander`` [rad] for half a second; ``motors`` are measured so far off, of
    how far they vary."""
    rng = np.random.default_rng(seed)
    strays = np.zeros_like(moments)
    kept = np.exp(-1 / (0.5 * FPS))
    for t in range(1, len(moments)):
        strays[t] = kept * strays[t - 1] + wander * np.sqrt(1 - kept**2) * rng.normal(size=(3, 2))
    stiffness = np.array(body.get("stiffness", STIFFNESS))
    rows = rested(moments + strays * stiffness[:, None], **body)
    points = np.concatenate([np.broadcast_to([0.0, 0.03, 0.0], (len(rows), 1, 3)), rows], axis=1)
    visible = np.ones(points.shape[:2], bool)
    turned = moments.reshape(len(moments), -1)
    return Scenario(
        name=name,
        points=points,
        visible=visible,
        motion_valid=np.concatenate([visible[:-1] & visible[1:], np.zeros_like(visible[:1])]),
        controllers=points[:, :2],
        interior=Cable("chain", (tuple(range(5)),), np.array([0.03, *LENGTHS]), (0, 1), (0.0, -1.0, 0.0)).between(points[0]),
        fps=FPS,
        gravity=9.81 * DOWN,
        grips=np.array([0, 1]),
        object="chain",
        session=name,
        split=Split(int(0.7 * len(points)), len(points)),
        start_frames=2,
        actuation=turned + motors * turned.std(0) * rng.normal(size=turned.shape),
    )
