"""Small clips in the layout of diffcloud: a curtain that a gripper lifts."""

import numpy as np
from twinbench.datasets.diffcloud import ORIGINS, SCALE

FRAMES = 9


def path_of(kind):
    """(FRAMES, 3) m: a gripper that rises by 20 cm and goes 10 cm along x."""
    t = np.linspace(0, 1, FRAMES)
    return np.asarray(ORIGINS[kind]) + np.stack([0.1 * t, 0 * t, 0.06 + 0.2 * t], 1)


def hanging(kind, seed=0, count=60):
    """(FRAMES of (count, 3)) m: a curtain that hangs from the gripper to the table."""
    random = np.random.default_rng(seed)
    clouds = []
    for x, y, z in path_of(kind):
        height = 0.055 + (z - 0.055) * random.random(count)
        height[:3] = z
        clouds.append(np.column_stack([x + random.normal(0, 0.01, count), y + random.uniform(-0.1, 0.1, count), height]))
    return clouds


def simulated(points, kind):
    """The published frame: (p - origin) / 0.35, x to y and y to -x turned back by 90 degrees about z."""
    x, y, z = ((points - np.asarray(ORIGINS[kind])) / SCALE).T
    return np.stack([y, -x, z], 1)


def write(root, kind="fold", name="red", *, clouds=None, path=None, times=1):
    folder = root / f"{kind}_real_pcls" / f"{kind}_{name}"
    folder.mkdir(parents=True)
    np.save(root / f"{kind}_traj.npy", path_of(kind) if path is None else path)
    clouds = hanging(kind) if clouds is None else clouds
    for k, cloud in enumerate(clouds * times):
        np.save(folder / f"{k:03d}.npy", simulated(np.concatenate([cloud, cloud[:7]]), kind))  # drawn with replacement
    return folder
