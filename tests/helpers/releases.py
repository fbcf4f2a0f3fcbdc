"""Small releases in the layout of the trunk: held aside, let go, swinging until it rests."""

import numpy as np
from twinbench.datasets.trunk import BASE, DISKS, LENGTHS


def bent(angles):
    """(T, 3, 3) m: disks of a trunk whose parts are inclined by ``angles`` (T, 3) in the plane of x and y."""
    parts = np.array(LENGTHS[1:])[:, None] * np.stack([np.sin(angles), -np.cos(angles), 0 * angles], -1)
    return BASE[1] + np.cumsum(parts, axis=1)


def released(*, held=30, swinging=150, noise=1e-5, seed=0):
    """(T, 3, 3) m: held aside, let go after frame ``held``, swinging at 1 Hz and dying out."""
    t = np.maximum(np.arange(held + swinging) - held, 0) / 100
    angle = 0.5 * np.cos(2 * np.pi * t) * np.exp(-3 * t)
    disks = bent(angle[:, None] * [0.3, 0.7, 1.0])
    return disks + np.random.default_rng(seed).normal(0, noise, disks.shape)


def table(file, releases, more=None, names=()):
    rows = [np.column_stack([np.full(len(d), k), d.reshape(len(d), 9)]) for k, d in enumerate(releases)]
    rows = np.concatenate(rows) if more is None else np.column_stack([np.arange(len(more)), releases[0].reshape(-1, 9), more])
    file.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(file, rows, delimiter=",", header=",".join(["ID", *DISKS, *names]), comments="", fmt="%.7g")


def folder(root, *, second=True):
    table(root / "observations_decay_200g.csv", [released(seed=k) for k in range(3)])
    if second:
        table(root / "observations_decay_200g_2.csv", [released(seed=k) for k in (3, 4)])
    return root
