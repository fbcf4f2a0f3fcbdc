"""Clouds of tracks that hands carry, exactly or nearly."""

import numpy as np
from scipy.spatial.transform import Rotation
from twinbench.datasets.scenario import Scenario, Split

__all__ = ["FRAMES", "held"]

FRAMES = 40


def held(seed=0, *, strays=0.0, noise=0.0, soft=0.0, hands=1, markers=False) -> Scenario:
    """A cloud of 40 tracks in each of some hands of ten points, 30 cm apart, that lift and turn; the hands' own points err by ``noise`` [m]
    all the time, tracks of the last hand stray by ``strays`` [m] from frame 1 on, and sag by ``soft`` [m] for each metre that it went."""
    random = np.random.default_rng(seed)
    time = np.linspace(0, 1, FRAMES)
    turn = Rotation.from_rotvec(np.outer(time, [0.2, 0.3, 0.4])).as_matrix()
    way = np.outer(time**2, [0.1, 0.0, 0.2])
    points, controllers = [], []
    for k in range(hands):
        middle = np.array([0.3 * k, 0.0, 0.1])
        fist, cloud = (random.uniform(-0.01, 0.01, (n, 3)) for n in (10, 40))
        fist, cloud = (np.einsum("tij,nj->tni", turn, part) + middle + way[:, None] for part in (fist, cloud))
        if k == hands - 1:
            aside = random.normal(size=cloud.shape[1:])
            cloud[1:] += strays * aside / np.linalg.norm(aside, axis=1, keepdims=True)
            cloud[..., 2] -= soft * np.linalg.norm(way, axis=1)[:, None]
        points.append(cloud)
        controllers.append(fist + noise * random.normal(size=fist.shape))
    points, controllers = np.concatenate(points, 1), np.concatenate(controllers, 1)
    visible = np.ones(points.shape[:2], bool)
    if markers:
        points = np.concatenate([points, controllers], 1)
        visible = np.ones(points.shape[:2], bool)
    grips = points.shape[1] - controllers.shape[1] + np.arange(controllers.shape[1]) if markers else None
    about = dict(name="held", points=points, visible=visible, motion_valid=visible, controllers=controllers, fps=30.0)
    return Scenario(**about, split=Split(FRAMES - 10, FRAMES), **({} if grips is None else dict(grips=grips)))
