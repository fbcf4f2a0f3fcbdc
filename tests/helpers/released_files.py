"""Files as PhysTwin's authors publish them, made from a description of their layout and simulator alone. Imports nothing of the package.

A body of 34 particles and 5 controllers: springs by brute force in the published order, a stiffness of its own for each, and a stored
trajectory from a plain loop over the published substep. ``python tests/helpers/released_files.py FOLDER`` writes data and twins there.
"""

import json
import pickle
import struct
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import torch

FRAMES, TRAIN = 6, 4
TRACKED, SURFACE, INTERIOR, HANDS = 24, 6, 4, 5
STEPS, STEP = 667, 5e-5
RUN = "init=hybrid_iso=True_ldepth=0.001_lnormal=0.0_laniso_0.0_lseg=1.0"
OPTIMAL = {
    "global_spring_Y": np.float64(21000.5),
    "object_radius": np.float64(0.0221),
    "object_max_neighbours": 9,
    "controller_radius": np.float64(0.031),
    "controller_max_neighbours": 7,
    "collide_elas": np.float64(0.4),
    "collide_fric": np.float64(0.35),
    "collide_object_elas": np.float64(0.7),
    "collide_object_fric": np.float64(0.3),
    "collision_dist": np.float64(0.02),
    "drag_damping": np.float64(5.9),  # an int from here on: 5
    "dashpot_damping": np.float64(37.8),  # 37
}
LEARNED = {"collide_elas": 0.25, "collide_fric": 0.6, "collide_object_elas": 1.3, "collide_object_fric": -0.1}  # raw, clamped in kernels


def body(seed):
    """Particles (34, 3), the tracked ones first and sorted, and controllers (FRAMES, 5, 3) above a corner, which they lift and drag."""
    random = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(np.arange(6), np.arange(3), np.arange(2), indexing="ij"), -1).reshape(-1, 3)
    points = grid * 0.012 + random.uniform(-0.002, 0.002, (36, 3)) - [0, 0, 0.0145]  # z < 0 is above the table
    points = random.permutation(points)[: TRACKED + SURFACE + INTERIOR]
    tracked = np.unique(points[:TRACKED], axis=0)
    points = np.concatenate([tracked, points[TRACKED:]])
    hands = np.array([0.012, 0.012, -0.012]) + random.uniform(-0.01, 0.01, (HANDS, 3)) - [0, 0, 0.015]
    path = np.array([0.004, -0.003, -0.005]) * np.arange(FRAMES)[:, None]
    return points, hands + path[:, None]


def springs(points, hands):
    """Pairs of the object and of the controllers, in the published order, by searching everybody."""
    x, c = points.astype(np.float32).astype(np.float64), hands.astype(np.float32).astype(np.float64)
    found, seen = [], set()
    for i in range(len(x)):
        away = np.sqrt(((x - x[i]) ** 2).sum(1))
        near = [j for j in np.argsort(away, kind="stable") if away[j] < OPTIMAL["object_radius"]][: OPTIMAL["object_max_neighbours"]]
        for j in near[1:]:  # the first is i
            if (min(i, j), max(i, j)) not in seen and away[j] > 1e-4:
                seen.add((min(i, j), max(i, j)))
                found.append((i, int(j)))
    held = []
    for k in range(len(c)):
        away = np.sqrt(((x - c[k]) ** 2).sum(1))
        near = [j for j in np.argsort(away, kind="stable") if away[j] < OPTIMAL["controller_radius"]]
        held += [(len(x) + k, int(j)) for j in near[: OPTIMAL["controller_max_neighbours"]]]
    return np.array(found), np.array(held)


def simulate(points, hands, pairs, stiffness):
    """The roll-out (FRAMES, M, 3): mass 1, controllers at the end of their substep and with no velocity, ground z = 0 with z < 0 above."""
    elas, fric = LEARNED["collide_elas"], LEARNED["collide_fric"]
    drag, dash = int(OPTIMAL["drag_damping"]), int(OPTIMAL["dashpot_damping"])
    count, (a, b), y = len(points), pairs.T, np.clip(stiffness, 0, 1e5)
    start = np.concatenate([points, hands[0]])
    rest = np.linalg.norm(start[b] - start[a], axis=1)
    x, v, out = points.copy(), np.zeros_like(points), [points]
    ends = np.zeros((count + len(hands[0]), len(pairs)))
    ends[a, np.arange(len(pairs))] += 1
    ends[b, np.arange(len(pairs))] -= 1
    for frame in range(1, len(hands)):
        for i in range(STEPS):
            c = hands[frame - 1] + (hands[frame] - hands[frame - 1]) * (i + 1) / STEPS
            at, speed = np.concatenate([x, c]), np.concatenate([v, np.zeros_like(c)])
            e = at[b] - at[a]
            length = np.linalg.norm(e, axis=1)
            d = e / np.maximum(length, 1e-6)[:, None]
            pull = (y * (length / rest - 1) + dash * ((speed[b] - speed[a]) * d).sum(1))[:, None] * d
            v = (v + STEP * ((ends @ pull)[:count] + [0, 0, 9.8])) * np.exp(-STEP * drag)
            hit = (x[:, 2] + v[:, 2] * STEP > 0) & (v[:, 2] > 1e-4)
            new = x + v * STEP
            if hit.any():
                normal, level = v[hit] * [0, 0, 1], v[hit] * [1, 1, 0]
                slow = 1 - fric * (1 + elas) * np.abs(v[hit, 2]) / np.maximum(np.linalg.norm(level, axis=1), 1e-6)
                after = -elas * normal + np.maximum(0, slow)[:, None] * level
                when = (-x[hit, 2] / v[hit, 2])[:, None]
                new[hit] = x[hit] + v[hit] * when + after * (STEP - when)
                v[hit] = after
            x = new
        out.append(x.copy())
    return np.array(out)


def write_data(root, name, points, hands, recorded):
    """A recording in ``root``/NAME whose tracked points went where ``recorded`` (FRAMES, M, 3) says."""
    folder = Path(root) / name
    folder.mkdir(parents=True)
    seen = np.ones((FRAMES, TRACKED), bool)
    valid = seen.copy()
    valid[-1] = False
    data = {
        "object_points": recorded[:, :TRACKED].astype(np.float64),
        "object_colors": np.full((FRAMES, TRACKED, 3), 0.5),
        "object_visibilities": seen,
        "object_motions_valid": valid,
        "controller_points": hands,
        "surface_points": points[TRACKED : TRACKED + SURFACE],
        "interior_points": points[TRACKED + SURFACE :],
        "controller_mask": np.arange(HANDS),
    }
    (folder / "final_data.pkl").write_bytes(pickle.dumps(data))
    (folder / "gt_track_3d.pkl").write_bytes(pickle.dumps(recorded[:, :3].astype(np.float64)))
    (folder / "split.json").write_text(json.dumps({"frame_len": FRAMES, "train": [0, TRAIN], "test": [TRAIN, FRAMES]}))


def checkpoint(stiffness, count):
    """What ``torch.save`` is given: with the optimiser's state, as after a step of Adam."""
    values = {"spring_Y": stiffness, **{key: [value] for key, value in LEARNED.items()}}
    leaves = {key: torch.nn.Parameter(torch.tensor(value, dtype=torch.float32)) for key, value in values.items()}
    adam = torch.optim.Adam(list(leaves.values()), lr=1e-9, betas=(0.9, 0.99))
    sum(leaf.sum() for leaf in leaves.values()).backward()
    adam.step()
    saved = {key: torch.tensor(value, dtype=torch.float32) for key, value in values.items()}
    return {"epoch": 40, "num_object_springs": count, **saved, "optimizer_state_dict": adam.state_dict()}


def gaussians(count, seed):
    """Columns of a point cloud by name, as 3D Gaussian splatting names them, with one scale."""
    random = np.random.default_rng(seed)
    names = ["x", "y", "z", "nx", "ny", "nz", *(f"f_dc_{i}" for i in range(3)), *(f"f_rest_{i}" for i in range(45)), "opacity", "scale_0"]
    columns = {name: random.normal(size=count).astype(np.float32) for name in [*names, *(f"rot_{i}" for i in range(4))]}
    for name in ("x", "y", "z"):
        columns[name] *= np.float32(0.02)
    columns["scale_0"] = (columns["scale_0"] * 0.1 - 5).astype(np.float32)
    return columns


def point_cloud(columns):
    """Bytes of a .ply, vertex by vertex."""
    count = len(columns["x"])
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {count}", *(f"property float {n}" for n in columns), "end_header"]
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    return ("\n".join(header) + "\n").encode() + b"".join(struct.pack(f"<{len(row)}f", *row) for row in rows)


def write_twin(root, name, optimal, saved, stored, cloud=None):
    """The released files of one twin in the three archives' folders."""
    root = Path(root)
    (root / "experiments_optimization" / name).mkdir(parents=True)
    (root / "experiments" / name / "train").mkdir(parents=True)
    (root / "experiments_optimization" / name / "optimal_params.pkl").write_bytes(pickle.dumps(optimal))
    torch.save(saved, root / "experiments" / name / "train" / "best_40.pth")
    (root / "experiments" / name / "inference.pkl").write_bytes(pickle.dumps(stored.astype(np.float32)))
    if cloud is not None:
        folder = root / "gaussian_output" / name / RUN / "point_cloud" / "iteration_10000"
        folder.mkdir(parents=True)
        (folder / "point_cloud.ply").write_bytes(point_cloud(cloud))


def make(root, name="single_push_rope", seed=0):
    """One recording in ``root``/data and its twin in ``root``/twins; what is in them."""
    points, hands = body(seed)
    own, held = springs(points, hands[0])
    pairs = np.concatenate([own, held])
    stiffness = np.exp(np.random.default_rng(seed).uniform(np.log(300), np.log(2e5), len(pairs))).astype(np.float32)  # some above 1e5
    stored = simulate(points, hands, pairs, stiffness.astype(np.float64))
    cloud = gaussians(50, seed)
    write_data(
        Path(root) / "data",
        name,
        points,
        hands,
        stored + np.random.default_rng(seed).normal(0, 1e-4, stored.shape) * (np.arange(FRAMES) > 0)[:, None, None],
    )
    write_twin(Path(root) / "twins", name, OPTIMAL, checkpoint(stiffness, len(own)), stored, cloud)
    made = dict(name=name, points=points, hands=hands, own=own, held=held, stiffness=stiffness, stored=stored, cloud=cloud)
    return SimpleNamespace(data=Path(root) / "data", twins=Path(root) / "twins", **made)


if __name__ == "__main__":
    print(make(sys.argv[1]).twins)
