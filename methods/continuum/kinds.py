"""Whether a body is a rope, a sheet or a solid, from three lengths: how long it is along itself, how wide, and how thick.

Its length is the longest way within it, from neighbour to neighbour; its width the largest extent of a slice of points that are equally far
along that way; its thickness that of its inside. What is ``SLENDER`` times as long as wide is a rope, ``FLAT`` times as wide as thick a
sheet, and everything else a solid. A sheet that is draped has bays, which count as inside where the ball that tells the inside is too large
for them: such an inside grows with the ball, that of a solid does not, and a sheet folds more sharply than a solid of that thickness could.
"""

from __future__ import annotations

import numpy as np

from .inside import Inside, inside_of

__all__ = ["KINDS", "farthest_ways", "growth_of", "kind_of", "length_and_width"]

KINDS = ("rope", "sheet", "solid")
SLENDER = 10.0  # whose bending is a bar's; a plush bar is up to 8 times as long as wide, a thick rope 20, as cameras see it 12
FLAT = 16.0  # a slab is 8 times as wide as thick, a cloth 60 times
LARGER = 1.2  # by which the ball is made larger to see whether the inside grows
GROWTH = 0.07  # share by which the inside of a solid grows at most: plush 0.02, draped cloths 0.13 to 0.5
LINKS = 6  # neighbours that a point is joined to
SLICES = 24  # of a body along its length
LINKED = 3.0  # spacings between points of one strand of a slice


def kind_of(points, inside: Inside | None, spacing: float, folded: bool | None = None) -> tuple[str, dict]:
    """(kind, evidence) of the body at ``points`` (M, 3) [m], ``spacing`` [m] apart; ``inside`` what they enclose, None in a plane or row.

    folded  whether it was seen to fold more sharply than a solid so thick; None where nothing says so
    evidence: length, width, thickness [m], their ratios, the inside's growth with the ball, and in ``words`` what they say.
    """
    length, width = length_and_width(points, spacing)
    thickness = inside.thickness if inside else 0.0
    growth = growth_of(inside, spacing) if inside else 0.0
    width = max(width, thickness)
    slender, flat = (a / max(b, 1e-9) for a, b in ((length, width), (width, thickness)))
    hollow = growth > GROWTH and folded is not False
    kind = "rope" if slender > SLENDER else "sheet" if flat > FLAT or hollow else "solid"
    words = (
        f"{1e3 * length:.0f} mm long, {1e3 * width:.1f} mm wide and {1e3 * thickness:.1f} mm thick: {_times(slender)} times as long as "
        f"wide and {_times(flat)} times as wide as thick, where {SLENDER:g} makes a rope and {FLAT:g} a sheet; its inside grows by "
        f"{100 * growth:.1f} % with a ball {LARGER:g} times as large, where more than {100 * GROWTH:g} % are the bays of a sheet"
        + {True: "; it folds like a sheet", False: "; it never folds like a sheet", None: ""}[folded]
    )
    figures = dict(length=length, width=width, thickness=thickness, length_over_width=slender, width_over_thickness=flat, growth=growth)
    return kind, figures | {"words": words}


def growth_of(inside: Inside, spacing: float) -> float:
    """Share by which ``inside`` has more volume if a ball ``LARGER`` times as large tells it."""
    return inside_of(inside.points, spacing, radius=LARGER * inside.radius).volume / inside.volume - 1


def length_and_width(points, spacing: float) -> tuple[float, float]:
    """The longest way through the body at ``points`` (M, 3) [m] and the median extent of its slices across that way [m].

    A slice of a body that branches, or lies beside itself, has several strands; each counts by itself.
    """
    points = np.asarray(points, float)
    way = farthest_ways(points)
    length = float(way.max())
    step = max(length / SLICES, 1.5 * spacing)
    number = (way / step).astype(int)
    widths, weights = [], []
    for k in range(number.max() + 1):
        for strand in _strands(points[number == k], LINKED * spacing):
            widths.append(_across(strand, way_step=step))
            weights.append(len(strand))
    order = np.argsort(widths)
    middle = np.searchsorted(np.cumsum(np.array(weights)[order]), sum(weights) / 2)
    return length, float(np.array(widths)[order][middle])


def farthest_ways(points) -> np.ndarray:
    """(M,) m, the way to each of ``points`` (M, 3) from one end of the body, from neighbour to neighbour."""
    from scipy.sparse.csgraph import dijkstra

    points = np.asarray(points, float)
    graph, end = _neighbours(points), 0
    for _ in range(3):  # to and fro, until the far end is found
        way = dijkstra(graph, directed=False, indices=end)
        end = int(way.argmax())
    return way


def _across(strand, *, way_step):
    """Extent of a slice: its longest, or where that is only as long as the slice is thick along the way, the second longest."""
    if len(strand) < 2:
        return 0.0
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(strand.T, bias=True)), 0))[::-1] * np.sqrt(12)  # of an even one, its width
    return float(spread[0] if spread[0] > 1.2 * way_step else spread[1])


def _neighbours(points):
    """(M, M) lengths of links from each point to its nearest, and of the shortest that join what is then apart."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    far, near = cKDTree(points).query(points, k=min(LINKS + 1, len(points)))
    here, there, long = np.repeat(np.arange(len(points)), near.shape[1]), near.ravel(), np.maximum(far.ravel(), 1e-9)
    while True:
        graph = coo_matrix((long, (here, there)), (len(points),) * 2).tocsr()
        parts, label = connected_components(graph, directed=False)
        if parts == 1:
            return graph
        alone = np.flatnonzero(label == label[0])
        others = np.flatnonzero(label != label[0])
        gap, to = cKDTree(points[others]).query(points[alone])
        here, there = np.append(here, alone[gap.argmin()]), np.append(there, others[to[gap.argmin()]])
        long = np.append(long, max(gap.min(), 1e-9))


def _strands(points, gap):
    from scipy.cluster.hierarchy import fcluster, linkage

    if len(points) < 2:
        return [points]
    label = fcluster(linkage(points), gap, "distance")
    return [points[label == k] for k in np.unique(label)]


def _times(ratio):
    return "over 1000" if ratio > 1000 else f"{ratio:.1f}"
