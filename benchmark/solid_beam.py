"""A real beam of silicone: ``python -m twinbench.benchmark.solid_beam PATH --out FILE``, PATH the folder of softbeam's recordings.

A twin is fitted to the train frames of the beam that is let go under its own weight. Its modulus is compared with the one that the authors
state, its roll-out with the held-out frames, and, placed in the recording with a weight on the tip and told the weight, with that.

MODELS: "elastic" is the method as it is. The hand that holds the beam before it is let go is not in the recording, so that frame 0 is
neither the rest shape nor an equilibrium: in "shaped" the curvature by which it differs from the rest shape is fitted. Silicone is stiffer
when it swings than when it hangs, and loses about as much in slow swings as in quick ones: "relaxing" has a Maxwell branch beside that in
the place of Kelvin and Voigt's damping, and the modulus is that of slow motions.
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from dataclasses import replace

import numpy as np

from ..datasets.collection import open_collection
from ..methods.continuum import Continuum
from ..methods.continuum.config import DENSITY, Config
from ..methods.continuum.unknowns import Unknown
from ..physics.terms import GrownShape, Maxwell
from .solid_twins import errors

__all__ = ["CONFIG", "frequency", "loaded", "main", "measured", "theory"]

SILICONE = 1070.0  # kg/m^3 (Dubied et al. 2022)
SIZE = np.array([0.1, 0.03, 0.03])  # m, along, across, high
MODULUS = 263.8e3  # Pa, which the authors fitted
WEIGHT = 0.052  # kg on the tip
TIP = 5 * 5  # particles of the lattice's last layer, which is the tip's face
CONFIG = Config(members=0, starts=2, coarse=1.0, refinement=0, iterations=10)
SHAPED = [Unknown(f"growth_{axis}", 0.0, -0.1, 0.1, "-", prior=(0.0, 0.01)) for axis in "bc"]
RELAXING = [Unknown("maxwell_share", 0.2, 0.0, 5.0, "-", prior=(0.0, 1.0)), Unknown("maxwell_time", 0.03, 0.005, 5.0, "s", "log")]
TOLD = dict(poisson=0.45, drag_damping=0.3, damping_time=5e-4)  # rubber; air, and the least damping, which three markers cannot tell apart
MODELS = {
    "elastic": {},
    "shaped": dict(extra=(GrownShape(),), extra_unknowns=SHAPED),
    "relaxing": dict(extra=(GrownShape(), Maxwell()), extra_unknowns=[*SHAPED, *RELAXING], fixed=TOLD),
}


def measured(scenario) -> np.ndarray:
    """(T, 3) m, the middle of the markers on the tip."""
    return scenario.points[:, scenario.visible[0]].mean(1)


def frequency(height, fps: float) -> float:
    """Hz, of the oscillation ``height`` (T,) about where it ends: between its first extreme and the last before one below a tenth of it."""
    away = height - height[-len(height) // 8 :].mean()
    turns = 1 + np.flatnonzero(np.diff(np.sign(np.diff(away))))
    small = np.abs(away[turns]) < 0.1 * np.abs(away[turns[0]])
    turns = turns[: int(np.argmax(small)) if small.any() else None]
    around = away[turns[:, None] + [-1, 0, 1]]
    exact = turns + (around[:, 0] - around[:, 2]) / 2 / (around[:, 0] - 2 * around[:, 1] + around[:, 2])  # of the parabola through three
    return float(fps / 2 * (len(exact) - 1) / (exact[-1] - exact[0]))


def theory(hertz: float, poisson: float = 0.45) -> float:
    """Pa, the modulus of a clamped bar of ``SIZE`` that swings at ``hertz``, by beam theory with shear.

    1 / f^2 = 1 / f_b^2 + 1 / f_s^2 (Dunkerley), f_b of Euler and Bernoulli's beam and f_s of one that only shears.
    """
    length, _, high = SIZE
    shear = 5 / 6 / 2 / (1 + poisson)  # k G / E
    bent = (1.8751**2 / 2 / np.pi) ** 2 * high**2 / 12 / length**4  # f^2 rho / E
    sheared = shear / 16 / length**2
    return float(hertz**2 * SILICONE * (1 / bent + 1 / sheared))


def loaded(twin, scenario):
    """``twin`` in the recording with the weight, told how heavy it is and that it is in the middle of the tip's face."""
    there = twin.retarget(scenario.initial())
    weight = [WEIGHT * DENSITY / SILICONE, *scenario.interior[-TIP:].mean(0)]
    body = replace(there.scene.body, weights=np.array([weight]))
    return replace(there, scene=replace(there.scene, body=body))


def _row(twin, bare, heavy) -> dict:
    off = errors(twin.rollout(bare.controllers), bare.points, bare.visible)
    end = bare.split.train_end
    there = loaded(twin, heavy)
    under = errors(there.rollout(heavy.controllers), heavy.points, heavy.visible)
    own = twin.rollout(bare.controllers).positions[:, bare.visible[0].nonzero()[0]].astype(float).mean(1) @ _up(bare)
    modulus = twin.values["youngs_modulus"] * SILICONE / DENSITY
    return dict(
        modulus=modulus / 1e3,
        over_authors=modulus / MODULUS,
        fitted=float(np.nanmean(off[1:end])),
        held_out=float(np.nanmean(off[end:])),
        with_weight=float(np.nanmean(under[1:])),
        hertz=frequency(own, bare.fps),
        cells=len(twin.scene.body.grid.cells),
        values=json.dumps({k: round(v, 6) for k, v in twin.values.items()}),
        note=twin.note,
    )


def _up(scenario):
    return -scenario.gravity / np.linalg.norm(scenario.gravity)


def main(arguments=None) -> None:
    import pandas as pd

    parser = argparse.ArgumentParser(prog="python -m twinbench.benchmark.solid_beam", description=str(__doc__).split("\n")[0])
    parser.add_argument("path", help="folder of the recordings beam_gravity*.c3d and beam_load52*.c3d")
    parser.add_argument("--models", nargs="+", default=["elastic"], choices=sorted(MODELS))
    parser.add_argument("--start", default=CONFIG.start, choices=["auto", "rest", "frames"])
    parser.add_argument("--pitch", type=float, nargs="+", default=[1.0], help="edges of cells, over the usual one")
    parser.add_argument("--starts", type=int, default=CONFIG.starts)
    parser.add_argument("--iterations", type=int, default=CONFIG.iterations)
    parser.add_argument("--frames", type=int, help="fitted ones of the train frames; all unless given")
    parser.add_argument("--out", help="CSV of all rows")
    given = parser.parse_args(arguments)
    collection = open_collection(given.path)
    bare, heavy = (collection.load(next(n for n in collection.scenarios if what in n)) for what in ("gravity", "load52"))
    for scenario in (bare, heavy):
        hertz = frequency(measured(scenario) @ _up(scenario), scenario.fps)
        print(f"{scenario.name}: {hertz:.2f} Hz; of a bare bar E = {theory(hertz) / 1e3:.0f} kPa", flush=True)
    rows = []
    for model, pitch in itertools.product(given.models, given.pitch):
        config = replace(CONFIG, pitch=pitch, start=given.start, starts=given.starts, iterations=given.iterations, frames=given.frames)
        begun = time.process_time()
        twin = Continuum().fitted([bare.observed()], config, **MODELS[model], progress=lambda stage, _share: print(stage, flush=True))
        rows.append(dict(model=model, pitch=pitch) | _row(twin, bare, heavy) | dict(seconds=time.process_time() - begun))
        print(json.dumps(rows[-1]), flush=True)
        if given.out:
            pd.DataFrame(rows).to_csv(given.out, index=False)


if __name__ == "__main__":
    main()
