"""A foam block that a hand lifts, as a recording without noise."""

import numpy as np
from scipy.spatial.transform import Rotation
from twinbench.datasets.scenario import Observed, Plane, Scenario, Split
from twinbench.methods.continuum.body import body_of
from twinbench.methods.continuum.scene import Scene
from twinbench.methods.continuum.simulate import Simulator
from twinbench.methods.continuum.solids import Solid
from twinbench.methods.continuum.twin import ContinuumTwin

SIZE, FRAMES = np.array([0.12, 0.04, 0.03]), 14
TRUE = dict(youngs_modulus=8e3, damping_time=0.01, poisson=0.3, drag_damping=0.3)


def lifted(points=None) -> Observed:
    """A foam block that a hand lifts at one end, 8 cm in half a second; all of it goes along unless tracks are given (F, N, 3)."""
    lattice = np.stack(np.meshgrid(*[np.linspace(0, s, round(s / 0.01) + 1) for s in SIZE], indexing="ij"), -1).reshape(-1, 3)
    skin = (np.isclose(lattice, 0) | np.isclose(lattice, SIZE)).any(1)
    block = np.concatenate([lattice[skin], lattice[~skin]])
    count = int(skin.sum())
    hand = Rotation.random(12, random_state=0).apply([0.012, 0, 0]) + [0.01, 0.02, 0.03]
    t = np.arange(FRAMES) / 30
    rise = 0.04 * (1 - np.cos(np.pi * np.minimum(t / 0.4, 1)))
    turns = Rotation.from_rotvec(np.outer(0.4 * np.minimum(t / 0.4, 1), [0, 1, 0]))
    middle = hand.mean(0)

    def led(x):
        return np.stack([turn.apply(x - middle) + middle + [0, 0, up] for turn, up in zip(turns, rise, strict=True)])

    points = led(block[:count]) if points is None else points
    seen = np.ones(points.shape[:2], bool)
    return Observed(
        name="block",
        points=points,
        visible=seen,
        motion_valid=seen,
        controllers=led(hand),
        interior=block[count:],
        gravity=np.array([0, 0, -9.8]),
        ground=Plane(np.array([0, 0, 1.0]), 0.0),
    )


def recorded(points, **changes):
    """A scenario of the lifted block with tracks ``points`` (T, N, 3) m, all of them seen; its last five frames are held out."""
    observed = lifted(points)
    known = {name: getattr(observed, name) for name in ("name", "controllers", "surface", "interior", "fps", "gravity", "ground", "grips")}
    seen = np.ones(points.shape[:2], bool)
    return Scenario(points=points, visible=seen, motion_valid=seen, **({"split": Split(FRAMES - 5, FRAMES)} | known | changes))


def block(name="block", noise=1e-3, seed=0, extra=(), **more) -> Scenario:
    """A recording of the block, of coarse cells and ``extra`` terms with ``more`` values, and of ``noise`` m; its last two frames are held
    out."""
    scene = sound_twin(0.02).scene
    path = Simulator(scene, tuple(extra)).run([TRUE | more], FRAMES)[0][:, : scene.counts[0]]
    return recorded(path + np.random.default_rng(seed).normal(0, noise, path.shape), name=name, split=Split(12, FRAMES))


def sound_twin(pitch: float) -> ContinuumTwin:
    """A sound twin of the block that is lifted, at what moves it (``TRUE``), as a fit would have left it."""
    recording = lifted()
    scene = Scene.of(recording, Solid.told(recording, body_of(recording, kind="solid", pitch=pitch)))
    unknowns = [u for u in Solid.unknowns([scene.body]) if u.name in ("youngs_modulus", "damping_time")]
    posterior = dict(unknowns=[vars(u) for u in unknowns], scaled=[u.encode(TRUE[u.name]) for u in unknowns])
    return ContinuumTwin(scene, TRUE, posterior=posterior | dict(covariance=(0.01 * np.eye(2)).tolist()))
