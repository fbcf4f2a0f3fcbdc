"""What a body bears in itself: the stress of its solids and sheets without damping, and the pull of its springs."""

from __future__ import annotations

import numpy as np

from ...physics.cells import point_sites
from ...physics.fabrics import fabric_twin
from ...physics.materials import point_twin
from ...physics.solids import gradients, strain_modes
from ...physics.system import System
from ...physics.terms.stages import AxialTerm, MembraneTerm, SheetBranchTerm, SheetFlowTerm, SolidTerm

__all__ = ["cell_stress", "node_stress", "sheet_stress", "spring_pulls", "von_mises"]


def von_mises(stress) -> np.ndarray:
    """(...,) sqrt(3 s : s / 2), s the deviator of a stress (..., 3, 3).

    >>> bool(von_mises(np.diag([7.0, 0, 0])) == 7)  # pull along one axis
    True
    """
    part = stress - np.trace(stress, axis1=-2, axis2=-1)[..., None, None] / 3 * np.eye(3)
    return np.sqrt(1.5 * (part**2).sum((-2, -1)))


def node_stress(system: System, nodes, *, rest=None, stiffness=None, memory=None) -> tuple[np.ndarray, str] | None:
    """((N,) at the ``nodes`` (N, 3) m of a system, the unit), None of a body that has no elasticity.

    Von Mises' stress of a solid [Pa] or a sheet [N/m], as the mean of the cells or triangles around a node by their size; of springs and
    rods the mean pull or push [N] of those that end there.

    rest, stiffness  (E,) m and N of the springs, the system's unless given
    memory           of what flows or relaxes, 0 unless given: (cells, 8, flow and branch terms, 3, 3) of a solid, (triangles, flow and
                     branch terms, 3) of a sheet's strain
    """
    if system.grid is not None:
        grid = system.grid
        return _shared(cell_stress(system, nodes, memory), grid.nodes, grid.volume, len(nodes)), "Pa"
    if system.sheet is not None:
        return _shared(sheet_stress(system, nodes, memory), system.sheet.triangles, system.sheet.areas, len(nodes)), "N/m"
    own = (system.springs < len(nodes)).all(1)
    if not own.any():
        return None
    return _shared(np.abs(spring_pulls(system, nodes, rest, stiffness))[own], system.springs[own], np.ones(own.sum()), len(nodes)), "N"


def cell_stress(system: System, nodes, memory=None) -> np.ndarray:
    """(K,) Pa, von Mises' stress of Cauchy's P F' / det F in a solid's cells, the mean of their eight points; damping is not in it."""
    grid, lateral = system.grid, _lateral(system)
    assert grid is not None  # of a solid
    modes = strain_modes(grid.points, grid.size, lateral)
    first, _, _, bent = gradients(np.asarray(nodes, float)[grid.nodes], grid.size, modes)
    deformed = first[:, None] @ (np.eye(3) + bent)
    solid = [t for t in system.terms if t.stage in ("growth", "flow", "solid", "material", "branch")]
    if memory is None:
        memory = np.zeros((*deformed.shape[:2], sum(t.stage in ("flow", "branch") for t in solid), 3, 3))
    stress = point_twin(solid, deformed, np.zeros_like(deformed), *point_sites(system), memory, 0.0)[0]
    cauchy = stress @ np.swapaxes(deformed, -1, -2) / np.linalg.det(deformed)[..., None, None]
    return von_mises(cauchy).mean(1)


def _lateral(system):
    """nu / (1 - nu) at small strains, as the cells bend with."""
    known = [t.twin_moduli(**t.values) for t in system.terms if isinstance(t, SolidTerm)]
    mu, lame = (sum(m) for m in zip(*known, strict=True))
    return lame / (lame + 2 * mu)


def sheet_stress(system: System, nodes, memory=None) -> np.ndarray:
    """(F,) N/m, von Mises' of the resultants a S a' / J in a sheet's triangles, a their tangents and J how much their area has grown."""
    sheet, nodes = system.sheet, np.asarray(nodes, float)
    assert sheet is not None
    corners = nodes[sheet.triangles]
    tangents = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2) @ sheet.inverse
    metric = np.swapaxes(tangents, 1, 2) @ tangents
    strain = np.stack([(metric[:, 0, 0] - 1) / 2, (metric[:, 1, 1] - 1) / 2, metric[:, 0, 1] / 2], -1)
    if memory is None:
        memory = np.zeros((len(strain), sum(isinstance(t, (SheetFlowTerm, SheetBranchTerm)) for t in system.terms), 3))
    a, b, c = fabric_twin(system.terms, strain, memory, 0.0, stage=MembraneTerm.stage)[0].T
    within = np.stack([np.stack([a, c], -1), np.stack([c, b], -1)], -1)
    grown = np.sqrt(np.maximum(np.linalg.det(metric), 1e-12))
    return von_mises(tangents @ within @ np.swapaxes(tangents, 1, 2) / grown[:, None, None])


def spring_pulls(system: System, nodes, rest=None, stiffness=None) -> np.ndarray:
    """(E,) N of the springs between nodes, positive where their ends are pulled together; 0 of those that tie controllers."""
    nodes, pulls = np.asarray(nodes, float), np.zeros(len(system.springs))
    own = (system.springs < len(nodes)).all(1)
    ends = system.springs[own]
    length = np.linalg.norm(nodes[ends[:, 0]] - nodes[ends[:, 1]], axis=1)
    rest = (system.rest if rest is None else np.asarray(rest))[own]
    stiffness = (system.stiffness if stiffness is None else np.asarray(stiffness))[own]
    for term in (t for t in system.terms if isinstance(t, AxialTerm)):
        pulls[own] += term.twin(length, np.zeros_like(length), rest, stiffness, **term.values)
    return pulls


def _shared(values, ends, weights, count):
    """(count,) means at nodes of ``values`` of the elements that end there, by their ``weights``."""
    each = ends.shape[1]
    total = np.bincount(ends.ravel(), np.repeat(values * weights, each), count)
    return total / np.maximum(np.bincount(ends.ravel(), np.repeat(weights, each), count), 1e-30)
