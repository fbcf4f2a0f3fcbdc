"""Chains that hang from two held markers and that motors bend: statics of joints, solved by iteration."""

import numpy as np
from scipy.spatial.transform import Rotation
from twinbench.datasets.markers import Cable
from twinbench.datasets.scenario import Scenario, Split

LENGTHS = (0.106, 0.097, 0.1195)  # m
STIFFNESS = (8.0, 4.0, 2.0)  # N m/rad
DOWN = np.array([0.0, -1.0, 0.0])
FPS = 10.0


def commands(frames, *, seed=0):
    """(T, J, 3) N m about axes across gravity: what motors do, slowly and at random."""
    t, rng = np.arange(frames) / FPS, np.random.default_rng(seed)
    rates, phases = rng.uniform(0.1, 0.6, (2, 3, 2, 6)) * [[[[1.0]]], [[[10.0]]]]
    waves = np.sin(2 * np.pi * rates * t[:, None, None, None] + phases).sum(-1) / np.sqrt(3)
    found = np.zeros((frames, 3, 3))
    found[..., [0, 2]] = 0.25 * np.array(STIFFNESS)[:, None] * waves
    return found


def placed(bends):
    """(..., J + 1, 3) m, markers from the last held one on, of joints that bend by rotation vectors (..., J, 3) from part to part."""
    bends = np.asarray(bends)
    way, places = np.tile(DOWN, (*bends.shape[:-2], 1)), [np.zeros((*bends.shape[:-2], 3))]
    for j, length in enumerate(LENGTHS):
        way = Rotation.from_rotvec(bends[..., j, :].reshape(-1, 3)).apply(way.reshape(-1, 3)).reshape(way.shape)
        places.append(places[-1] + length * way)
    return np.stack(places, -2)


def rested(moments, *, weights=(0.0, 0.0, 0.0), stiffness=STIFFNESS):
    """(T, J + 1, 3) m where ``moments`` (T, J, 3) of motors and the ``weights`` [N] at markers balance what joints resist with."""
    bends = np.zeros_like(moments)
    for _ in range(60):
        places = placed(bends)
        pull = np.zeros_like(moments)
        for j in range(3):
            for k in range(j, 3):
                pull[:, j] += weights[k] * np.cross(places[:, k + 1] - places[:, j], DOWN)
        bends = 0.5 * bends + 0.5 * (moments + pull) / np.array(stiffness)[:, None]
    return placed(bends)


def driven(name, moments, *, wander=0.0, seed=0, motors=0.0, **body):
    """A recording under ``moments`` (T, J, 3). Joints stray by ``wander`` [rad] for half a second; ``motors`` are measured so far off, of
    how far they vary."""
    rng = np.random.default_rng(seed)
    strays = np.zeros_like(moments)
    kept = np.exp(-1 / (0.5 * FPS))
    for t in range(1, len(moments)):
        strays[t, :, [0, 2]] = kept * strays[t - 1, :, [0, 2]] + wander * np.sqrt(1 - kept**2) * rng.normal(size=(2, 3))
    stiffness = np.array(body.get("stiffness", STIFFNESS))
    rows = rested(moments + strays * stiffness[:, None], **body)
    points = np.concatenate([np.broadcast_to([0.0, 0.03, 0.0], (len(rows), 1, 3)), rows], axis=1)
    visible = np.ones(points.shape[:2], bool)
    turned = moments[..., [0, 2]].reshape(len(moments), -1)
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
