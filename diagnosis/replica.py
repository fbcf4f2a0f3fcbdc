"""The twin that diagnoses: as coarse as the question allows, the same published physics, drawn on any recording of the object."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..datasets.scenario import Observed
from ..datasets.spacing import spacing
from ..methods.continuum.chains import apart, marked_chains, rope_chains
from ..methods.registration import rigid_transform
from ..physics.hinges import natural_curvature
from ..physics.system import FILLED, System
from ..physics.topology import object_springs, rope_hinges, sheet_hinges
from .hands import hand_ties, rope_exits
from .matching import material_coordinates
from .sightings import Sightings, middles, sight_markers, sight_nodes
from .skins import facets_of

__all__ = ["Replica", "build_replica", "spread_out"]

REACH = 2.3  # connection radius in node spacings: first and second neighbours of a sheet
MOST = 26  # springs looked for at a node, itself included
ROW = 12  # nodes that a rope must at least show
LONGEST = 33  # nodes of a rope that is no row of markers: closer ones lie on its skin, here and there, and are off by three times as much
THINNER = 1.3  # step of trying fewer nodes
LOWEST = 0.05  # share of the nodes that may be lower than what lies on the ground; of a rope, whose nodes all lie alike, half
LYING = 0.6  # node spacings: what is higher does not lie
CELLS = 20000  # of a grid by which volumes are told
LEAST = 0.35  # of the mean mass: what is lighter would only need shorter steps
NOTHING = 1e-3  # of the mean mass, of what is held and needs none
MOST_OF, SAME = 0.9, 1e-3  # share of the particles of one lattice, and m by which they may be off in two recordings: markers are not of it
STILL = 3.0  # start velocities below this many standard errors are noise


@dataclass(frozen=True)
class Replica:
    """A recording and the coarse body drawn on its frame 0.

    system     without terms: nodes of unit mass on average, springs of unit stiffness [N] (ties: unit stiffness per spacing), controllers,
               what was seen
    sightings  what was seen of the nodes in every frame that the method may see
    spacing    m, between neighbouring nodes
    links      (E,) bool, which springs tie controllers
    node_of    (M,) nearest node of each particle of the recording's structure
    frames     how many frames were observed
    lift       m, how high above the ground the nodes stand that lie on it in frame 0: a node is in the middle of what it stands for
    """

    recording: Observed
    system: System
    sightings: Sightings
    spacing: float
    links: np.ndarray
    node_of: np.ndarray
    lift: float = 0.0

    @property
    def name(self) -> str:
        return self.recording.name

    @property
    def frames(self) -> int:
        return len(self.sightings.position)

    @property
    def nodes(self) -> np.ndarray:
        """(n, 3) frame-0 positions [m]."""
        return self.system.positions

    @property
    def driven(self) -> np.ndarray:
        """Indices of the nodes that hands drive: where they are is given, not predicted."""
        return self.system.grips[self.system.grips >= 0]

    @property
    def held(self) -> np.ndarray:
        """Indices of the recording's particles that are held markers; they are its first nodes."""
        return np.unique(self.recording.grips[self.recording.grips >= 0])

    @property
    def solid(self) -> bool:
        """Whether it is a held body of known inside, of which the nodes stand for volumes."""
        return bool(len(self.driven) and len(self.recording.interior) and not self.system.chains)

    def particles(self, nodes) -> list[int]:
        """Indices of the recording's structure particles that the given nodes stand for."""
        return np.flatnonzero(np.isin(self.node_of, np.asarray(list(nodes)))).tolist()


def spread_out(points: np.ndarray, count: int, first: np.ndarray | None = None) -> np.ndarray:
    """Indices of at most ``count`` of ``points`` (M, 3), each the farthest from those before it; ``first`` (K,) are taken in any case."""
    chosen = list(np.asarray([0] if first is None or not len(first) else first))
    distance = np.full(len(points), np.inf)
    for index in chosen:
        distance = np.minimum(distance, np.linalg.norm(points - points[index], axis=1))
    while len(chosen) < min(count, len(points)) and distance.max() > 1e-6:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)


@dataclass(frozen=True)
class _Body:
    """What a replica is without hands: nodes where they lie in frame 0, what was seen of them, and how they hang together.

    spacing  m, between neighbouring nodes; home (n, 3) where the nodes lie in frame 0 of the recording that places are told in
    """

    positions: np.ndarray
    sightings: Sightings
    spacing: float
    springs: np.ndarray
    chains: tuple[np.ndarray, ...]
    hinges: np.ndarray
    facets: np.ndarray
    masses: np.ndarray
    home: np.ndarray


def build_replica(recording: Observed, *, nodes: int, like: Replica | None = None, fitted: int | None = None) -> Replica:
    """Draw a body of at most ``nodes`` nodes on a recording.

    ``like`` is a replica of another recording of the object, in whose frame 0 places are told. Where both recordings have the same
    particles, both replicas have one mesh: two meshes of one beam differ by a fifth in stiffness. Otherwise nodes stand as close as its, so
    that bodies have particles of the same size and parameters mean the same. Markers that are held (grips) are nodes of their own. What the
    drawing owes to motion (strands that part, what a hand carries, the start velocity, noise) is read from the first ``fitted`` frames
    alone, so that held-out frames have no say in it; all of them unless given.

    A rope (``ropes.rope_chains``) gets chains and hinges along them, whose natural shape is that of frame 0, and no more nodes than its
    thickness leaves in a row; where its markers are few enough, they are the nodes. Other bodies get the hinges of sheets.
    Raises ValueError where nothing is seen or held in frame 0.
    """
    from scipy.spatial import cKDTree

    held = np.unique(recording.grips[recording.grips >= 0])
    if not recording.visible[0].any() and not len(held):
        raise ValueError(f"points must be seen in frame 0, got none of {recording.points.shape[1]} (scenario {recording.name})")
    body = like and _laid(recording, like, held, fitted)
    body = body or _drawn(recording, nodes, like, held, fitted)
    hands = np.flatnonzero(recording.grips < 0)
    ties = hand_ties(recording, body.positions, body.sightings.position[:fitted], body.spacing, hands, rope=bool(body.chains))
    if body.chains and len(ties) and not len(held):
        body = _ending_in_hands(recording, body, ties, like, fitted)
    positions, sightings, own = body.positions, body.sightings, body.spacing
    early = replace(sightings, position=sightings.position[:fitted])
    grips = np.full(len(recording.grips), -1)
    for c, point in enumerate(recording.grips):
        if point >= 0:
            grips[c] = int(np.searchsorted(held, point))
    springs = np.concatenate([body.springs, ties.reshape(-1, 2)])
    lengths = _lengths(positions, recording.controllers[0], springs)
    springs, ties_kept = springs[lengths > 1e-5], lengths > 1e-5
    links = np.concatenate([np.zeros(len(body.springs), bool), np.ones(len(ties), bool)])[ties_kept]
    system = System(
        positions=positions,
        springs=springs,
        stiffness=np.where(links, lengths[ties_kept] / own, 1.0),  # ties of all lengths pull alike, so that short ones need no short steps
        masses=body.masses,
        controllers=recording.controllers,
        grips=grips,
        hinges=body.hinges,
        natural=natural_curvature(positions, body.hinges, body.chains) if body.chains else FILLED,
        chains=body.chains,
        facets=body.facets,
        velocities=_start_velocity(early, positions, recording.fps),
        seen=sightings.position,
        home=body.home,
        terms=(),
        name=recording.name,
    )
    node_of = cKDTree(positions).query(recording.structure)[1]
    lift = _lift(recording, positions, own, 0.5 if body.chains else LOWEST)
    return Replica(recording, system, sightings, own, links, node_of, lift)


def _drawn(recording, nodes, like, held, fitted) -> _Body:
    """Nodes as far from each other as so many can be, or as the nodes of ``like`` are."""
    structure = recording.structure
    marked = _marked_rope(recording, nodes, held, fitted)
    chosen = marked[0] if marked else _in_a_row(structure, spread_out(structure, nodes, held), len(held))
    if like is not None and not marked:
        chosen = chosen[: max(len(held), min(len(chosen), len(like.nodes)))]
    if marked:
        positions, sightings = (
            structure[chosen].copy(),
            sight_markers(recording.points[:, chosen], recording.visible[:, chosen], fitted=fitted),
        )
    else:
        positions, sightings = sight_nodes(recording.points, recording.visible, structure[chosen], fitted=fitted)
    positions[: len(held)] = structure[held]  # a driven marker is where it is
    own = like.spacing if like else spacing(positions, alone=0.01)
    springs = _joined(positions, object_springs(positions, radius=REACH * own, max_neighbours=MOST))
    chains = marked[1] if marked else rope_chains(apart(positions, sightings.position[:fitted])) or rope_chains(apart(structure[chosen]))
    if chains:
        springs = _along(springs, chains)
    if chains and not marked:  # from the side of its skin that is seen to its axis
        positions, sightings = sight_nodes(recording.points, recording.visible, middles(positions, structure)[0], fitted=fitted, keep=True)
        positions[: len(held)] = structure[held]
    home = _home(recording, positions, like)
    chains = _alike(chains, home, like)
    hinges = np.concatenate([rope_hinges(c) for c in chains]) if chains else sheet_hinges(positions, springs)
    facets = FILLED if chains else facets_of(recording, positions, springs, own)
    masses = _masses(recording, positions, len(held), chains if marked else ())
    return _Body(positions, sightings, own, springs, chains, hinges, facets, masses, home)


def _laid(recording, like: Replica, held, fitted) -> _Body | None:
    """The body of ``like`` where it lies in ``recording``, if both have the same particles, held alike and moved as a whole; else None.

    None of a rope either, whose natural shape is that of its own frame 0.
    """
    known, structure, theirs = like.system, recording.structure, like.recording.structure
    if known.chains or len(theirs) != len(structure) or not np.array_equal(held, like.held):
        return None
    rotation, shift = rigid_transform(theirs, structure)
    if np.quantile(np.linalg.norm(theirs @ rotation.T + shift - structure, axis=1), MOST_OF) > SAME:
        return None
    positions, sightings = sight_nodes(recording.points, recording.visible, like.nodes @ rotation.T + shift, fitted=fitted, keep=True)
    positions[: len(held)] = structure[held]
    springs = known.springs[~like.links]
    return _Body(positions, sightings, like.spacing, springs, (), known.hinges, known.facets, known.masses, like.nodes)


def _ending_in_hands(recording, body: _Body, ties, like, fitted) -> _Body:
    """The rope with the last node that a hand holds moved to where the rope leaves the hand."""
    positions = rope_exits(recording, body.positions, body.sightings.position[:fitted], body.chains, ties)
    sightings = sight_nodes(recording.points, recording.visible, positions, fitted=fitted, keep=True)[1]
    return replace(body, positions=positions, sightings=sightings, home=body.home if like else positions)


def _masses(recording, positions, held, chains):
    """(n,) what each node of a held body stands for, over the mean of its free ones: length of a rope of markers, volume of a solid.

    The markers that are held, its first ``held`` nodes, are no larger a share of the body for being many. Of other bodies it is one each,
    as of PhysTwin's particles.
    """
    share = np.zeros(len(positions))
    if not held or held == len(positions) or not (chains or len(recording.interior)):
        return np.ones(len(positions))
    if chains:
        for chain in chains:
            steps = np.linalg.norm(np.diff(positions[chain], axis=0), axis=1)
            np.add.at(share, chain[:-1], steps / 2)
            np.add.at(share, chain[1:], steps / 2)
    else:
        share = _volumes(np.concatenate([recording.interior, positions[:held]]), positions)
    share /= share[held:].mean()
    for node in held + np.flatnonzero(share[held:] < LEAST):  # what is lighter takes from the nearest that can spare it
        spare = held + np.flatnonzero(share[held:] + share[node] > 2 * LEAST)
        if len(spare):
            share[spare[np.linalg.norm(positions[spare] - positions[node], axis=1).argmin()]] -= LEAST - share[node]
        share[node] = LEAST
    return np.maximum(share, NOTHING)


def _volumes(particles, nodes):
    """(n,) how many cells of a fine grid in the body that ``particles`` (K, 3) fill are nearest to each of ``nodes`` (n, 3).

    The body is what is in the particles' convex hull and no farther from one of them than they are from each other.
    """
    from scipy.spatial import ConvexHull, Delaunay, cKDTree

    hull, tree = ConvexHull(particles), cKDTree(particles)
    pitch = (hull.volume / CELLS) ** (1 / 3)
    low, high = particles.min(0), particles.max(0)
    axes = [np.arange(a + pitch / 2, b, pitch) for a, b in zip(low, high, strict=True)]
    cells = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    cells = cells[Delaunay(particles[hull.vertices]).find_simplex(cells) >= 0]
    near = np.median(tree.query(particles, k=2)[0][:, 1])
    cells = cells[tree.query(cells)[0] < max(near, pitch)]
    return np.bincount(cKDTree(nodes).query(cells)[1], minlength=len(nodes)).astype(float)


def _lift(recording, positions, spacing, share):
    """Height [m] below which ``share`` of the nodes are where those lie on the ground; 0 where the body hangs above it."""
    if recording.ground is None:
        return 0.0
    low = float(np.quantile(positions @ recording.ground.normal - recording.ground.offset, share))
    return low if 0 < low < LYING * spacing else 0.0


def _marked_rope(recording, nodes, held, fitted):
    """(tracked points, held ones first; chains of them) where they are at most ``nodes`` markers along a rope that is held; else None."""
    count = recording.counts[0]
    if not len(held) or count > nodes:
        return None
    tracks = np.where(recording.visible[..., None], recording.points, np.nan)
    chains = marked_chains(recording.points[0], recording.structure[count:], tracks[:fitted])
    if not chains:
        return None
    order = np.concatenate([held, np.setdiff1d(np.arange(count), held)])
    return order, tuple(np.argsort(order)[chain] for chain in chains)


def _in_a_row(structure, chosen, held):
    """As many of the ``chosen``, which fill ``structure`` ever denser, as show a rope: a closer row would go round its thickness."""
    count = min(len(chosen), LONGEST)
    while count >= max(ROW, held + 2):
        if rope_chains(apart(structure[chosen[:count]])):
            return chosen[:count]
        count = int(count / THINNER)
    return chosen


def _alike(chains, home, like):
    """The chains, the first of them run the way of that of ``like``."""
    if not chains or like is None or not like.system.chains:
        return chains
    ends = like.nodes[like.system.chains[0][[0, -1]]]
    near = np.linalg.norm(home[chains[0][[0, -1]]][:, None] - ends[None], axis=2)
    return (chains[0][::-1] if near[0, 1] + near[1, 0] < near[0, 0] + near[1, 1] else chains[0], *chains[1:])


def _along(springs, chains):
    """``springs`` and those between neighbours of the chains, so that these are there whatever their length."""
    steps = np.concatenate([np.stack([c[:-1], c[1:]], 1) for c in chains])
    both = np.concatenate([np.sort(springs, axis=1), np.sort(steps, axis=1)])
    return np.unique(both, axis=0)


def _home(recording, positions, like):
    """Where ``positions`` lie in the frame 0 of another recording."""
    if like is None:
        return positions
    from scipy.spatial import cKDTree

    def colors(one, points):
        if one.colors is None:
            return None
        good = one.visible[0]
        if not good.any():
            return None
        return one.colors[0, good][cKDTree(one.points[0, good]).query(points)[1]]

    source = like.recording.structure
    return material_coordinates(positions, source, colors=colors(recording, positions), reference_colors=colors(like.recording, source))


def _joined(points, springs):
    """``springs`` and the shortest ones that make the body a single piece."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    springs = np.asarray(springs, int).reshape(-1, 2)
    while True:
        graph = coo_matrix((np.ones(len(springs)), springs.T), shape=(len(points),) * 2)
        pieces, label = connected_components(graph, directed=False)
        if pieces == 1:
            return springs
        small = np.argmin(np.bincount(label))
        inside, outside = np.flatnonzero(label == small), np.flatnonzero(label != small)
        distance, near = cKDTree(points[outside]).query(points[inside])
        order = np.argsort(distance)[:3]
        springs = np.concatenate([springs, np.stack([inside[order], outside[near[order]]], 1)])


def _lengths(points, controllers, springs):
    both = np.concatenate([points, controllers])
    return np.linalg.norm(both[springs[:, 0]] - both[springs[:, 1]], axis=1)


def _start_velocity(sightings, positions, fps):
    """(n, 3) m/s by a cubic through the first seven frames, zero where it cannot be told from noise.

    A quadratic would be bent by a hand that sets off.
    """
    span = min(7, len(sightings.position))
    if span < 5:
        return np.zeros_like(positions)
    early = sightings.position[:span]
    basis = (np.arange(span)[:, None] / fps) ** np.arange(4)
    inverse = np.linalg.pinv(basis)
    velocity = np.einsum("t,tnc->nc", inverse[1], np.where(np.isfinite(early), early, np.nan))
    error = sightings.noise * np.linalg.norm(inverse[1])
    velocity[~np.isfinite(velocity)] = 0
    fast = np.linalg.norm(velocity, axis=1)
    if np.sqrt((fast**2).mean()) < STILL * error * np.sqrt(3):
        return np.zeros_like(positions)
    return velocity
