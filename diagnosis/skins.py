"""The skin of a replica: which triangles of nodes face the air, and what they enclose."""

from __future__ import annotations

import numpy as np

from ..physics.facets import sheet_facets, solid_facets

__all__ = ["HEAVY", "facets_of", "heaviness"]

HOLLOW = 1.3  # node spacings: radius of the largest sphere without a node that still belongs to a solid
HEAVY = 10.0  # kg/m^2 of skin: the body that typical amplitudes of facets' laws are meant for


def facets_of(recording, positions, springs, spacing) -> np.ndarray:
    """(F, 3) nodes at the corners of the skin: closed around a recording with an inside, one layer of a sheet; none of a rope in a row."""
    if len(recording.interior):
        return solid_facets(positions, radius=HOLLOW * spacing)
    return sheet_facets(positions, springs)


def heaviness(system) -> float:
    """Mass per area of skin [kg/m^2], over that of a ``HEAVY`` one; 0 without a skin."""
    if not len(system.facets):
        return 0.0
    a, b, c = np.moveaxis(system.positions[system.facets], 1, 0)
    return float(system.masses.sum() / (np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2) / HEAVY)
