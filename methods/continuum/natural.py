"""The natural shape of a rope, as one off a reel has it: what a fit may change of it, and shapes to begin from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...datasets.scenario import Observed
from ...physics.hinges import natural_curvature
from ...physics.terms.natural_curvature import ENDS, MODES
from ...physics.topology import rope_hinges
from .unknowns import Unknown

__all__ = ["LOOKS", "common_shapes", "shape_unknowns", "shape_values"]

BENT = 5.0  # 1/m, standard deviation of a mode: a cable off a reel of 20 cm radius
ASKEW = 0.3  # standard deviation of the angle at which a grip may hold it, as 2 tan(angle / 2)
LOOKS = 0.5  # s between frames whose shapes are compared
SHAPES = 2  # that frames have in common: the natural one, if bending counts, and what hangs


def shape_unknowns() -> list[Unknown]:
    """Legendre modes of natural curvature along the arc, and the angles at its ends; all modes roll together, so that b0 can be 0."""
    modes = [f"natural_{axis}{k}" for axis in "ab" for k in range(MODES) if (axis, k) != ("b", 0)]
    ends = [f"natural_{axis}_{end}" for axis in "ab" for end in ENDS]
    found = [Unknown(name, 0.0, -40.0, 40.0, "1/m", prior=(0.0, BENT)) for name in modes]
    return found + [Unknown(name, 0.0, -1.5, 1.5, "-", prior=(0.0, ASKEW)) for name in ends]


def shape_values(shape: np.ndarray) -> dict[str, float]:
    """The modes' values by name, of ``shape`` (MODES,) 1/m, a + i b."""
    return {f"natural_{axis}{k}": float(part[k]) for axis, part in (("a", np.real(shape)), ("b", np.imag(shape))) for k in range(MODES)}


def common_shapes(chain: np.ndarray, lengths: np.ndarray, recordings: Sequence[Observed]) -> np.ndarray:
    """(SHAPES, MODES) 1/m: curvatures that frames of ``recordings`` share but for a roll about the rope, as complex Legendre modes.

    chain    (n,) tracks of markers in order along the rope, ``lengths`` (n - 1,) m between them

    A rope's curvature is sum_k (a_k + i b_k) P_k(u) in a frame without twist, whose roll nobody sees: that of recorded frame f is
    e^(i phi_f) c + rest, and the c that leave the least squares are the leading right singular vectors of all frames' curvatures.
    """
    span = (lengths[:-1] + lengths[1:]) / 2
    order, hinges, rows = np.arange(len(chain)), rope_hinges(np.arange(len(chain))), []
    for one in recordings:
        every = slice(None, None, max(1, round(LOOKS * one.fps)))
        seen = one.points[every, chain][one.visible[every, chain].all(1)]
        rows += [natural_curvature(x, hinges, (order,)) @ [1, 1j] / span for x in seen]
    _, sizes, shapes = np.linalg.svd(np.array(rows), full_matrices=False)
    u = 2 * np.cumsum(lengths)[:-1] / lengths.sum() - 1
    inner = slice(1, -1)  # how a grip holds the ends is no shape of the rope
    modes = np.stack([np.polynomial.legendre.Legendre.basis(k)(u) for k in range(MODES)], 1)[inner].astype(complex)
    pairs = zip(sizes[:SHAPES], shapes[:SHAPES], strict=True)
    found = np.array([np.linalg.lstsq(modes, size * shape[inner], rcond=None)[0] for size, shape in pairs]) / np.sqrt(len(rows))
    return found * np.exp(-1j * np.angle(found[:, :1]))
