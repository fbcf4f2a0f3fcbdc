"""Loads of a trunk under one command, in the published layout: which recordings are compared, and what the table says of them."""

import numpy as np
import pandas as pd
import pytest
from releases import bent, table
from twinbench.benchmark.real_commands import run
from twinbench.datasets.trunk import ANGLES, COMMANDS

FRAMES = 6000


def commanded(root, *, loads):
    """Files of ``loads`` [g]: slow waves of a joint each, and from 100 g on a tip that hangs steeper by a fifth of its lever."""
    t = np.arange(FRAMES) / 100
    waves = 0.3 * np.sin(2 * np.pi * np.array([0.11, 0.17, 0.23]) * t[:, None] + [0, 1, 2])
    motors = np.column_stack([waves, waves[:, ::-1]])
    for load in loads:
        noise = np.random.default_rng(load).normal(0, 0.004, (FRAMES // 50, 3)).repeat(50, 0)  # rad, for half a second
        angles = np.cumsum(waves, axis=1) + noise
        angles[:, 2] -= load / 500 * np.sin(angles[:, 2])
        table(root / f"observations_controlled_{load}g.csv", [bent(angles)], motors, ANGLES)
    made = dict(delimiter=",", header=",".join(["ID", *COMMANDS]), comments="")
    np.savetxt(root / "control_inputs_controlled.csv", np.column_stack([np.arange(FRAMES), motors]), **made)


def test_every_load_is_compared_with_the_lighter_ones_and_the_lightest_with_itself(tmp_path):
    (tmp_path / "trunk").mkdir()
    commanded(tmp_path / "trunk", loads=(0, 100))
    said = []
    rows = run(tmp_path, tmp_path, progress=said.append)
    assert [(row["load"], row["beside"]) for row in rows] == [(100, 0), (0, 0)] and len(said) == 2
    first, same = rows
    # what turns the last part by sin(angle) alone is a weight at the last disk, and no weight at another
    assert first["p"] < 0.03 and "added_mass" in (first["effect"], *first["alternatives"].split())
    assert first["weight_at_disk"] == 3 and first["weight_nats_over_next_disk"] > 10
    assert same["verdict"] == "adequate" and same["apart_mm"] == 0.0
    assert list(pd.read_csv(tmp_path / "commands.csv")["load"]) == [100, 0]


def test_one_load_is_compared_with_nothing(tmp_path):
    (tmp_path / "trunk").mkdir()
    commanded(tmp_path / "trunk", loads=(0,))
    with pytest.raises(ValueError, match="must hold recordings of at least two loads under one command, got 1"):
        run(tmp_path, tmp_path)
