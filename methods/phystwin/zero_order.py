"""The first stage: CMA-ES over the twelve parameters, a whole generation simulated as one batch (paper section 3.3)."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence

import numpy as np
import torch

from ...datasets.scenario import Observed
from ...physics.terms.base import Term
from ...physics.topology import Neighbours
from .body import Body, Motion, Place, build, regrip, roll, system
from .config import Config
from .losses import FitLoss
from .ranges import ADDED_SHARE, ranges

__all__ = ["open_loop_costs", "search"]

SIGMA = 1 / 6
PUBLISHED_SEED = 42
ACCELERATION_WEIGHT = 0.01
WORST = 1e9  # m^2, cost of a candidate that blows up: above any that does not (none is farther than 1 km), and finite, as CMA-ES ranks


def search(
    observed: Sequence[Observed],
    config: Config,
    *,
    seed: int,
    device: str,
    progress: Callable[[str, float], None] | None = None,
    added: Sequence[Term] = (),
) -> dict[str, float]:
    """The best parameters ever evaluated, the published start among them unless ``unscored_start``; with ``added`` physics, how much of
    it is searched as well."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # cma's remark that it could not draw
        import cma

    places = [Place.of(o) for o in observed]
    losses = [FitLoss(o, frame_one_counts=config.quirks.frame_one_counts, device=device) for o in observed]
    table = ranges(config.quirks, observed[0].spacing) + ((ADDED_SHARE,) if added else ())
    moving = [p for p in table if _matters(p.name, places) or config.quirks.inert_parameters]
    base = {p.name: p.value for p in table}
    most = {p.name: p.high for p in table}
    known = Neighbours(  # a decoded parameter may lie beyond its bound by a rounding
        places[0].structure, radius=most["object_radius"] * (1 + 1e-6), max_neighbours=int(most["object_max_neighbours"])
    )

    def decode(unit):
        return base | {p.name: p.decode(float(u)) for p, u in zip(moving, unit, strict=True)}

    start = [p.encode(p.value) for p in moving]
    options = {"bounds": [0, 1], "seed": PUBLISHED_SEED + seed, "verbose": -9, "maxiter": config.iterations}
    if config.population:
        options["popsize"] = config.population
    strategy = cma.CMAEvolutionStrategy(start, SIGMA, options)
    best = (np.inf if config.quirks.unscored_start else costs([base], places, losses, config, device, added, known.springs)[0], base)
    for generation in range(config.iterations):
        units = strategy.ask()
        candidates = [decode(u) for u in units]
        found = costs(candidates, places, losses, config, device, added, known.springs)
        strategy.tell(units, found)
        best = min([best, *zip(found, candidates, strict=True)], key=lambda pair: pair[0])
        if progress:
            progress(f"CMA-ES, best {best[0] * 1e6:.1f} mm^2", (generation + 1) / config.iterations)
    return best[1]


def costs(candidates, places, losses, config, device, added=(), springs=None) -> list[float]:
    """Mean loss over recordings of homogeneous bodies with each candidate's parameters."""
    first = [build(values, places[0], added, springs=springs) for values in candidates]
    bodies = [[body, *(regrip(body, place) for place in places[1:])] for body in first]
    return open_loop_costs(bodies, places, losses, config, device)


def open_loop_costs(
    bodies: Sequence[Sequence[Body]], places: Sequence[Place], losses: Sequence[FitLoss], config: Config, device: str
) -> list[float]:
    """Mean over recordings of each body's mean loss over frames 1, 2, ... of one roll-out from frame 0.

    ``bodies[k]`` is one candidate, once a recording: hand springs differ from place to place.
    """
    frames = max(loss.frames for loss in losses)
    systems = [system(body, place, config) for candidate in bodies for body, place in zip(candidate, places, strict=True)]
    motions = roll(systems, places[0].fps, frames, config, device)
    found = torch.stack([_cost(motion, losses[k % len(places)]) for k, motion in enumerate(motions)])  # a GPU is waited for once
    return found.double().cpu().numpy().reshape(len(bodies), len(places)).mean(1).tolist()


def _cost(motion: Motion, loss: FitLoss) -> torch.Tensor:
    if 0 <= motion.diverged < loss.frames:
        return motion.positions.new_tensor(WORST)
    total = loss(motion.positions[1 : loss.frames], 1)
    if motion.velocities is not None:
        # a = v_end - v_start of each frame; smooth-L1 of its change from frame to frame, off for the first frame
        change = motion.velocities[: loss.frames].diff(dim=0).diff(dim=0)
        jerk = torch.nn.functional.smooth_l1_loss(change, torch.zeros_like(change), reduction="none")
        total[1:] += ACCELERATION_WEIGHT * jerk.mean((1, 2))
    return total.mean()


def _matters(name, places):
    """Whether a parameter has anything to act on."""
    if name in ("collide_elas", "collide_fric"):
        return any(p.ground is not None for p in places)
    if name in ("collide_object_elas", "collide_object_fric", "collision_dist"):
        return any(p.self_collision for p in places)
    if name in ("controller_radius", "controller_max_neighbours"):
        return any((p.grips < 0).any() for p in places)
    return True
