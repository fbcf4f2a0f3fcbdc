"""A mesh of the object (of TRELLIS, a scanner, a designer) brought to where cameras see the object: scale and pose, then shape.

The steps are PhysTwin's (``data_process``). Without a model that matches pictures, pose and scale are searched: what was measured must lie
on the mesh, and nothing of the mesh may stand where rays go through.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .. import needs_open3d
from ..files import check_file
from ..perception.hull import Hull
from ..scenario import Camera, Plane
from .placing import Seen, Similarity, by_matches, refined, searched
from .shaping import bent, filled

__all__ = ["Mesh", "Prior", "PriorOptions", "place_prior", "read_mesh"]

SUFFIXES = (".ply", ".obj", ".stl", ".off", ".glb", ".gltf")


@dataclass(frozen=True)
class PriorOptions:
    """How a mesh is brought into place. Published constants, and those that are not published, which say so.

    elevations, azimuths, rolls  of the views that are tried: 6 x 8 x 4
    reprojection  mean error of matches [pixel] over which their pose is not taken
    near          a vertex is pulled to measured points that are nearer than this [m]
    blocked       a vertex is seen where its ray meets the mesh less than this before it [m]
    rounds        iterations of as-rigid-as-possible deformation
    surface       points drawn on the mesh
    attempts      points drawn in its box, of which those inside are kept
    refine        how many of the best views are refined (not published)
    vertices      the mesh is simplified to about so many (not published)
    bend          m: a mesh that lies nearer than this to what was measured (median) is not bent: depth's noise would do it (not published)
    slack         a point stands where rays go through if it is nearer than the measured depth by more than this [m] (not published)
    trusted       m: median distance of what was measured from the placed mesh, over which it is refused (not published)
    """

    elevations: int = 6
    azimuths: int = 8
    rolls: int = 4
    reprojection: float = 50.0
    near: float = 0.02
    blocked: float = 1e-4
    rounds: int = 1
    surface: int = 1024
    attempts: int = 10_000
    refine: int = 12
    vertices: int = 2000
    bend: float = 0.002
    slack: float = 0.006
    trusted: float = 0.015


@dataclass(frozen=True)
class Mesh:
    """vertices (V, 3) and faces (F, 3) int, in whatever units and axes its file has."""

    vertices: np.ndarray
    faces: np.ndarray


@dataclass(frozen=True)
class Prior:
    """The mesh in its place: ``mesh`` in world metres; ``placed`` the similarity that brought it there, before it was bent.

    rigid, final  median distances of what was measured from it [m], before and after it was bent
    hull          points of its surface and inside, without what rays see through; ``carved`` the share of them that was carved away
    """

    mesh: Mesh
    placed: Similarity
    rigid: float
    final: float
    hull: Hull
    carved: float


def read_mesh(file: str | Path, vertices: int = PriorOptions.vertices) -> Mesh:
    """The mesh in ``file``, its double vertices merged, simplified to about so many ``vertices``.

    Raises ValueError naming the file where it is no mesh with faces.
    """
    o3d = needs_open3d.imported("reading a mesh")

    file = Path(file)
    check_file(file)
    if file.suffix.lower() not in SUFFIXES:
        raise ValueError(f"{file}: a mesh must be one of {', '.join(SUFFIXES)}")
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        mesh = o3d.io.read_triangle_mesh(str(file))
    if not len(mesh.triangles) or not np.isfinite(np.asarray(mesh.vertices)).all():
        raise ValueError(f"{file}: must be a mesh with faces and finite vertices, got {len(mesh.triangles)} faces")
    mesh = mesh.remove_duplicated_vertices().remove_degenerate_triangles().remove_unreferenced_vertices()
    if len(mesh.vertices) > vertices:  # a closed mesh has about two faces for a vertex
        mesh = mesh.simplify_quadric_decimation(2 * vertices).remove_unreferenced_vertices()
    return Mesh(np.asarray(mesh.vertices).copy(), np.asarray(mesh.triangles).copy())


def place_prior(
    mesh: Mesh,
    cameras: Sequence[Camera],
    masks: Sequence[np.ndarray],
    hidden: Sequence[np.ndarray],
    depths: Sequence[np.ndarray],
    clouds: Sequence[np.ndarray],
    tracked: np.ndarray,
    ground: Plane | None,
    options: PriorOptions | None = None,
    *,
    matches: tuple[np.ndarray, np.ndarray] | None = None,
    spacing: float = 0.005,
) -> Prior:
    """Bring ``mesh`` to where ``cameras`` see the object in frame 0, and fill it with points ``spacing`` [m] apart.

    masks, hidden (H, W) bool: object, and hands that hide it; depths (H, W) [m]; clouds (K, 3) measured world points of the object, of each
    camera. tracked (M, 3): points of the body that are there already. matches: pixels (J, 2) of the first camera and the points (J, 3) of
    the mesh's file that they show, of a model that finds such; without them views are searched.
    Raises ValueError where matches cannot be trusted, or the mesh misses what was measured.
    """
    options = options or PriorOptions()
    seen = Seen.of(cameras, masks, hidden, depths, clouds, ground, options.slack)
    if matches is not None:
        placed = refined(mesh, seen, [by_matches(*matches, cameras[0], depths[0] * masks[0], options.reprojection)])
    else:
        views = (options.elevations, options.azimuths, options.rolls)
        placed = refined(mesh, seen, searched(mesh, seen, views, options.refine))
    rigid = Mesh(placed.apply(mesh.vertices), mesh.faces)
    before = seen.miss(rigid)
    if before > options.trusted:
        rule = f"must come within {1000 * options.trusted:g} mm of what was measured (median)"
        raise ValueError(f"the mesh of the object {rule}, got {1000 * before:.1f} mm: is it this object?")
    final = rigid
    if before > options.bend:
        final = bent(rigid, cameras, clouds, ground, near=options.near, blocked=options.blocked, rounds=options.rounds)
    hull, carved = filled(final, seen, tracked, surface=options.surface, attempts=options.attempts, spacing=spacing)
    return Prior(final, placed, before, seen.miss(final), hull, carved)
