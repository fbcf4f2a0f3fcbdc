"""The fused kernels: a whole stretch of substeps of many systems in one launch, and the same stretch backwards.

One source serves CPU and CUDA. A *team* of threads owns one system: on CUDA the threads of one or several blocks, which meet at a barrier
between the phases of a substep; on CPU a single thread, for which the barrier is nothing.

Forces are gathered: every particle sums over its own springs, so nothing is contended and results repeat bit for bit. A lone thread can do
better with the same sums: it visits each spring once, from its lower end, and leaves the reaction in ``force[other]`` before ``other`` is
reached (``half``).

State of substep s lives in slot ``s % slots``: two slots to run, one per substep to be able to go back.
What a spring remembers is kept at both its ends: the copies go the same way, so nothing is exchanged (``half`` uses the lower end's only).
Nodes of one system are contiguous: particles first, then controllers. A node with ``driver >= 0`` follows that controller's path.
"""

import os
import sys
from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from .finding import finder, noting
from .laws import NUMBERS, Laws
from .native import WARP, adder, lane_sum, state_access
from .quads import quads
from .terms.stages import EASED, SHEETS, STAGED

__all__ = ["Kernels", "build"]

wp.config.log_level = wp.LOG_WARNING  # no banner on the user's terminal


@dataclass(frozen=True)
class Kernels:
    """The compiled pair for one list of laws, precision and kind of team, with the structs that carry their arrays."""

    forward: Any
    backward: Any
    World: Any
    Adjoint: Any
    real: Any
    vec: Any
    four: Any
    vectors: dict[str, Any]


@cache
def build(laws: Laws, double: bool, half: bool, lanes: int, threads: int, pointed: bool = False) -> Kernels:
    """Compose the kernels for ``laws``. ``double``: float64 instead of float32. ``half``: each spring once (teams of one thread only).
    ``pointed``: body forces act on material points instead of on nodes.

    ``lanes`` neighbouring threads (a power of two up to 32) share the springs of one particle; a block has ``threads``.
    """
    from .backward import make_backward
    from .forward import make_forward

    _init()
    kit = _kit(laws, wp.float64 if double else wp.float32)
    kit.half, kit.lanes, kit.warp, kit.pointed = half, lanes, min(threads, WARP), pointed
    kit.quads = quads(kit.R, kit.vec) if half and not kit.remembering else None
    # approximate division and square root (2 units in the last place) are a GPU's fast path; float64 is for checking and stays exact
    launch = (threads, 1) if threads > 1 else None
    kit.kernel = wp.kernel(module="unique", enable_backward=False, launch_bounds=launch, module_options={"fast_math": not double})
    return Kernels(make_forward(kit), make_backward(kit), kit.World, kit.Adjoint, kit.R, kit.vec, kit.four, kit.vectors)


def _init():
    """Start Warp. Without a GPU its library says so on stderr, past any log level; whoever asks for one hears that from torch."""
    import torch

    if torch.cuda.is_available():
        wp.init()
        return
    sys.stderr.flush()
    stderr, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        wp.init()
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(nowhere)


def _kit(laws: Laws, R) -> SimpleNamespace:
    """Types, structs and small functions that both kernels are made of."""
    vec, four = wp.types.vector(3, R), wp.types.vector(4, R)
    vectors = {s: wp.types.vector(laws.width(s), R) for s in STAGED} | {"memory": wp.types.vector(laws.memories, R)}
    vectors |= {f"{of}_memory": wp.types.vector(laws.numbers(of), R) for of in NUMBERS}
    mat = wp.types.matrix((3, 3), R)
    pair = wp.types.vector(2, R)
    vectors |= dict(natural=pair, pivot=pair, torque=four, factor=four, pair_weight=four, pair_law=vectors["layer"])
    one = wp.types.vector(1, R)
    get_x, get_v, put = state_access(R, vec)
    World, Adjoint = _structs(R, vec, four, vectors)
    return SimpleNamespace(
        R=R,
        vec=vec,
        mat=mat,
        four=four,
        vectors=vectors,
        World=World,
        Adjoint=Adjoint,
        laws=laws.fuse(),
        links=laws.start("links"),
        linked=bool(laws.stage("links")),
        colliding=bool(laws.stage("contact")),
        hinged=bool(laws.stage("hinge")),
        skinned=bool(laws.stage("facet")),
        filled=bool(laws.stage("solid")),
        easing=any(laws.stage(s) for s in EASED),
        cells_easing=bool(laws.stage("viscous")),
        draping=any(laws.stage(s) for s in SHEETS),
        creasing=bool(laws.stage("plate") or laws.stage("viscous_plate")),
        hinges_remembering=bool(laws.remembering("hinge")),
        sheets_branching=bool(laws.stage("sheet_branch")),
        sheets_remembering=bool(laws.remembering("sheet")),
        sheets_easing=bool(laws.stage("viscous_membrane") or laws.stage("viscous_plate")),
        layered=bool(laws.stage("layer")),
        touching=bool(laws.stage("touch")),
        slipping=bool(laws.stage("slip")),
        growing=bool(laws.stage("growth")),
        flowing=bool(laws.stage("flow")),
        adding=bool(laws.stage("material")),
        branching=bool(laws.stage("branch")),
        cells_remembering=bool(laws.remembering("cell")),
        watching=bool(laws.stage("observer")),
        remembering=bool(laws.stage("strand")),
        load={s: _loader(R, vectors[s], laws.width(s), laws.start(s)) for s in STAGED},
        get_x=get_x,
        get_v=get_v,
        put=put,
        one=one,
        sum1=lane_sum(one, 1),
        find=finder(R, vec),
        noting=noting(R),
        sum3=lane_sum(vec, 3),
        sum4=lane_sum(four, 4),
        sum_contact=lane_sum(vectors["contact"], laws.width("contact")),
        sum_axial=lane_sum(vectors["axial"], laws.width("axial")),
        sum_strand=lane_sum(vectors["strand"], laws.width("strand")),
        give=adder(R, 0),
        give_pair=adder(vectors["natural"], 2),
        give_all={s: adder(vectors[s], laws.width(s)) for s in STAGED},
    )


def _loader(R, vector, width, first):
    """The function that reads a stage's parameters of system ``b`` from the table."""

    @wp.func
    def load(table: wp.array2d(dtype=R), b: int):
        p = vector()
        for k in range(width):
            p[k] = table[b, first + k]
        return p

    return load


def _structs(R, vec, four, vectors):
    """World: everything a roll-out reads and writes. Adjoint: what flows back."""
    pa, ps, ph, phf, phb, pf, pg, pw, pe, pl, pr, pd, pn, py, psf, psb, pvm, pvp, pj, pb, pu, pt, pi, pz, po, pv, pc, pm = (
        vectors[s] for s in STAGED
    )
    pq, pk, psm, phm, two = (vectors[k] for k in ("memory", "cell_memory", "sheet_memory", "hinge_memory", "natural"))

    @wp.struct
    class World:
        start: wp.array(dtype=wp.int32)  # (B+1,) first node of each system
        substeps: wp.array(dtype=wp.int32)  # (B,) per frame
        begin: wp.array(dtype=wp.int32)  # (B,) substeps after the frame in which this launch begins
        count: wp.array(dtype=wp.int32)  # (B,) substeps to take in this launch
        dt: wp.array(dtype=R)  # (B,) s
        row: wp.array(dtype=wp.int32)  # (nodes+1,) first incident spring end of each node
        own: wp.array(dtype=wp.int32)  # (nodes,) first incident end whose other node is higher: the spring counts here
        other: wp.array(dtype=wp.int32)  # (ends,) the node at the other end
        spring: wp.array(dtype=wp.int32)  # (ends,) which spring
        rest: wp.array(dtype=R)  # (ends,) m
        stiffness: wp.array(dtype=R)  # (ends,) N
        mass: wp.array(dtype=R)  # (nodes,) kg
        home: wp.array(dtype=vec)  # (nodes,) m, where the node was in frame 0
        watch: wp.array(dtype=wp.int32)  # (nodes,) its column in ``seen``, or -1
        seen: wp.array2d(dtype=vec)  # (T, columns) m, where observers saw particles
        sight: wp.array2d(dtype=R)  # (T, columns) weight of what was seen between this frame and the next, 0 where it was not
        driver: wp.array(dtype=wp.int32)  # (nodes,) the controller that moves it, or -1
        lead: wp.array(dtype=wp.int32)  # (nodes,) 1: a controller that is a node of its own
        ahead: wp.array(dtype=wp.int32)  # (nodes,) 1: it is where its controller is at the end of the substep (published), 0: at its start
        path: wp.array2d(dtype=vec)  # (T, controllers) m
        table: wp.array2d(dtype=R)  # (B, columns) parameters
        state: wp.array(dtype=R)  # (slots * nodes * 8,) at the start of the substep: x [m], 0, v [m/s], 0
        memory: wp.array2d(dtype=pq)  # (slots, ends) what springs remember at the start of the substep (only with strand terms)
        nodes: int
        pushed: wp.array2d(dtype=vec)  # (slots, nodes) m/s, after the forces; kept only to go back
        free: wp.array2d(dtype=vec)  # (slots, nodes) m/s, before the move; kept only to go back, and without contacts
        flight: wp.array(dtype=R)  # (slots * nodes * 8,) as states are: x, mass, v before contacts (only with contacts)
        met: wp.array2d(dtype=vec)  # (slots, nodes) m/s, after contacts (only with contacts)
        hits: wp.array2d(dtype=wp.int32)  # (slots, nodes) contacts in the substep
        force: wp.array(dtype=vec)  # (nodes,) what a lone thread has added: at lower ends, of triangles, folds, layers, points, damping
        hinge_start: wp.array(dtype=wp.int32)  # (B+1,) first hinge of each system
        joint: wp.array2d(dtype=wp.int32)  # (H, 3) nodes before, at and after; -1 where it is left out
        sides: wp.array2d(dtype=wp.int32)  # (H, 2) segments with directors that it joins, or -1
        hinge_row: wp.array(dtype=wp.int32)  # (nodes+1,) first entry of each node in
        hinge_of: wp.array(dtype=wp.int32)  # 3 hinge + place in it
        natural: wp.array(dtype=two)  # (H,) curvature
        span: wp.array(dtype=R)  # (H,) m
        flexure: wp.array(dtype=R)  # (H,)
        hinge_memory: wp.array2d(dtype=phm)  # (slots, H) what they remember at the start of the substep (only with terms that do)
        moment: wp.array2d(dtype=vec)  # (H, 2) N, forces on the nodes before and after
        segment_start: wp.array(dtype=wp.int32)  # (B+1,) first segment of each system
        segment: wp.array2d(dtype=wp.int32)  # (S, 2) nodes from and to
        ends: wp.array2d(dtype=wp.int32)  # (S, 2) hinge before and after, or -1
        loose: wp.array(dtype=R)  # (S,) 1: free to roll, 0: held
        directors: wp.array2d(dtype=vec)  # (slots, S)
        turn_row: wp.array(dtype=wp.int32)  # (nodes+1,) first entry of each node in
        turn_of: wp.array(dtype=wp.int32)  # 2 segment + place in it
        chain_start: wp.array(dtype=wp.int32)  # (B+1,) first chain of each system
        chain: wp.array(dtype=wp.int32)  # (C+1,) first segment of each chain
        torque: wp.array2d(dtype=four)  # (slots, H) N m of the roll at the substep's end: ``twist.wring``
        rolled: wp.array(dtype=R)  # (slots * S,) rad by which segments roll
        factor: wp.array(dtype=four)  # (S,) of a chain's equations: pivot, that taken, share of the one before, what closes a ring
        facet_start: wp.array(dtype=wp.int32)  # (B+1,) first facet of each system
        corner: wp.array2d(dtype=wp.int32)  # (F, 3) nodes
        facet_row: wp.array(dtype=wp.int32)  # (nodes+1,) first entry of each node in
        facet_of: wp.array(dtype=wp.int32)  # 3 facet + place in it
        volume: wp.array(dtype=R)  # (B,) m^3, enclosed in frame 0, or 0
        parts: wp.array2d(dtype=R)  # (B, warps) m^3, what each warp's facets add to the volume
        swelling: wp.array2d(dtype=R)  # (slots, B) volume in frame 0 over that now; kept only to go back
        face: wp.array(dtype=vec)  # (F,) N, a third of the force on each facet
        cell_start: wp.array(dtype=wp.int32)  # (B+1,) first cell of each system
        cell: wp.array2d(dtype=wp.int32)  # (K, 8) nodes
        cell_row: wp.array(dtype=wp.int32)  # (nodes+1,) first entry of each node in
        cell_of: wp.array(dtype=wp.int32)  # 8 cell + corner
        points: wp.array2d(dtype=vec)  # (K, 8) where cells are integrated, in halves of their size
        cell_volume: wp.array(dtype=R)  # (K,) m^3
        cell_home: wp.array2d(dtype=vec)  # (K, 8) m, where these points were in frame 0
        cell_at: wp.array2d(dtype=vec)  # (K, 8) the same from the body's middle, in the grid's axes and rms radii
        cell_memory: wp.array3d(dtype=pk)  # (slots, K, 8) what they remember at the start of the substep (only with flow or branch terms)
        per: wp.array(dtype=vec)  # (B,) 1/m, of half a cell's size
        rounds: wp.array(dtype=wp.int32)  # (B,) of damping in a substep
        ease: wp.array2d(dtype=R)  # (B, rounds) share of the substep that each takes
        squeeze: wp.array2d(dtype=vec)  # (K, 8) N, forces on the corners
        cell_rows: wp.array2d(dtype=R)  # (ROWS, K + B vectors) of a lone thread: ``cell_lanes``
        eased: wp.array3d(dtype=vec)  # (slots kept, rounds + 1, nodes) m/s, before and after each round
        gain: wp.array2d(dtype=vec)  # (slots kept, nodes) m/s, what all but damping adds in a substep
        panel_start: wp.array(dtype=wp.int32)  # (B+1,) first triangle of each system's sheet
        panel: wp.array2d(dtype=wp.int32)  # (F, 3) nodes
        panel_row: wp.array(dtype=wp.int32)  # (nodes+1,) first entry of each node in
        panel_of: wp.array(dtype=wp.int32)  # 3 triangle + corner
        panel_side: wp.array2d(dtype=wp.int32)  # (F, 3) the fold across from each corner, or -1
        panel_area: wp.array(dtype=R)  # (F,) m^2
        bent_area: wp.array(dtype=R)  # (F,) m^2, for which its curvature stands
        flattened: wp.array2d(dtype=R)  # (F, 4) 1/m, the inverse of a triangle's edges at rest, row by row
        curving: wp.array2d(dtype=vec)  # (F, 3) 1/m, curvature per angle of each side
        sheet_memory: wp.array2d(dtype=psm)  # (slots, F) what triangles remember at the start of the substep (only with terms that do)
        fold_start: wp.array(dtype=wp.int32)  # (B+1,) first fold of each system
        fold: wp.array2d(dtype=wp.int32)  # (H, 4) nodes: its ends, left, right
        fold_row: wp.array(dtype=wp.int32)  # (nodes+1,) first entry of each node in
        fold_of: wp.array(dtype=wp.int32)  # 4 fold + place in it
        beside: wp.array2d(dtype=wp.int32)  # (H, 2) 3 triangle + side, of its two triangles
        rest_angle: wp.array(dtype=R)  # (H,) rad
        angle: wp.array(dtype=R)  # (H,) rad beyond that at rest, and in rounds of damping rad/s
        slope: wp.array(dtype=vec)  # (4 H,) 1/m, the angle's gradients
        panel_force: wp.array(dtype=vec)  # (3 F,) N, on its corners
        panel_moment: wp.array(dtype=R)  # (3 F,) N m, about its sides
        pair_start: wp.array(dtype=wp.int32)  # (B+1,) first candidate of each system's layers
        pair: wp.array2d(dtype=wp.int32)  # (C, 4) nodes: a vertex and a triangle's corners, or the ends of two edges
        pair_edges: wp.array(dtype=wp.int32)  # (C,) 1: two edges
        pair_load: wp.array(dtype=R)  # (C,) kg that it carries
        pair_row: wp.array(dtype=wp.int32)  # (nodes+1,) first entry of each node in
        pair_of: wp.array(dtype=wp.int32)  # 4 pair + place in it
        pair_force: wp.array(dtype=vec)  # (C,) N
        pair_weight: wp.array(dtype=four)  # (C,) of its nodes in the way from the second nearest place to the first
        pair_wake: wp.array(dtype=wp.int32)  # (C,) the first substep of this launch in which it may meet
        meeting: wp.array2d(dtype=wp.int32)  # (slots kept, C) 1: nearer than the thickness
        point_start: wp.array(dtype=wp.int32)  # (B+1,) first material point of each system
        point_node: wp.array2d(dtype=wp.int32)  # (P, K) nodes that carry it
        point_weight: wp.array2d(dtype=R)  # (P, K)
        point_row: wp.array(dtype=wp.int32)  # (nodes+1,) first entry of each node in
        point_of: wp.array(dtype=wp.int32)  # (K + 1) point + column, the last being its controller's
        point_home: wp.array(dtype=vec)  # (P,) m, at rest
        area: wp.array(dtype=R)  # (P,) m^2 of the skin
        carries: wp.array(dtype=R)  # (P,) kg, what a spring at the point must hold
        hold: wp.array(dtype=wp.int32)  # (P,) the controller that carries it along, as a node, or -1
        held: wp.array(dtype=R)  # (P,) how firmly
        load: wp.array(dtype=R)  # (P,) kg
        anchor: wp.array2d(dtype=vec)  # (slots, P) m, what points remember of the ground
        hand_start: wp.array(dtype=wp.int32)  # (B+1,) first hand of each system that holds points
        hand_row: wp.array(dtype=wp.int32)  # (hands+1,) first entry of each hand in
        hand_of: wp.array(dtype=wp.int32)  # the points that it holds
        hand_number: wp.array(dtype=R)  # (hands,) of each in its system
        hand: wp.array(dtype=wp.int32)  # (P,) the hand of each point, or -1
        slid: wp.array2d(dtype=vec)  # (slots, hands) m, how far what they hold has slid (only with a slip term)
        push: wp.array(dtype=vec)  # (P,) N, from outside
        near_row: wp.array(dtype=wp.int32)  # (nodes+1,) first contact candidate
        near: wp.array(dtype=wp.int32)  # (candidates,)
        out: wp.array2d(dtype=vec)  # (frames, nodes) m, at the ends of the frames from the first on
        counters: wp.array(dtype=wp.int32)  # (teams,) barrier arrivals

    @wp.struct
    class Adjoint:
        x: wp.array(dtype=vec)  # (nodes,) of the state; in: at the stretch's end, out: at its start
        v: wp.array(dtype=vec)
        met: wp.array(dtype=vec)  # of the velocity after contacts
        share: wp.array(dtype=vec)  # and of each of the impulses that it has the mean of; 0 at driven nodes
        force: wp.array2d(dtype=vec)  # (2, nodes) of the force, for even and odd substeps; 0 at driven nodes
        out: wp.array2d(dtype=vec)  # (frames, nodes) given
        rest: wp.array(dtype=R)  # (springs,)
        stiffness: wp.array(dtype=R)
        mass: wp.array(dtype=R)
        path: wp.array2d(dtype=vec)
        natural: wp.array(dtype=two)  # (H,)
        flexure: wp.array(dtype=R)
        directors: wp.array(dtype=vec)  # (S,) in: at the stretch's end, out: at its start
        bent: wp.array2d(dtype=vec)  # (H, 8) of a substep's hinge forces: its nodes' x, their v, its two directors
        turned: wp.array3d(
            dtype=vec
        )  # (2, S, 5) of an even and an odd substep's roll: the director and both nodes' x before, their x after
        carried: wp.array(dtype=vec)  # (S,) of directors that were carried along, by the roll
        rolled: wp.array(dtype=R)  # (S,) of a chain's torques
        pivot: wp.array(dtype=two)  # (S,) of a chain's pivots and their floors, by what is added to them
        wrung: wp.array2d(dtype=vec)  # (H, 5) of a hinge's torques: its nodes' x, its two directors
        hinge: wp.array(dtype=ph)  # (H,) shares of the parameters' gradient
        hinge_flow: wp.array(dtype=phf)
        hinge_branch: wp.array(dtype=phb)
        hinge_memory: wp.array(dtype=phm)  # (H,) of the memory; in: at the stretch's end, out: at its start
        faced: wp.array2d(dtype=vec)  # (F, 2) of a substep's forces: a facet's area vector, a third of its velocity
        faced_mass: wp.array(dtype=R)  # (F,) and the mass that it carries
        parts: wp.array2d(dtype=R)  # (B, warps) of the ratio of volumes
        facet: wp.array(dtype=pf)  # (F,) shares of the parameters' gradient
        cells: wp.array2d(dtype=vec)  # (K, 16) of a cell's forces: its corners' x, their v
        eased: wp.array(dtype=vec)  # (nodes,) of the velocity after a round, over mass; 0 at driven nodes
        gain: wp.array(dtype=vec)  # (nodes,) of what all but damping adds
        solid: wp.array(dtype=pe)  # (K,) shares of the parameters' gradient
        growth: wp.array(dtype=pg)
        flow: wp.array(dtype=pw)
        material: wp.array(dtype=pl)
        branch: wp.array(dtype=pr)
        viscous: wp.array(dtype=pd)
        paneled: wp.array2d(dtype=vec)  # (F, 6) of a triangle's forces: its corners' x, and of its damping their v
        panel_angle: wp.array3d(dtype=R)  # (F, 3, 2) and of the angles at its sides, or of their rates, and of their changes
        angle: wp.array(dtype=R)  # (H,) change of a fold's angle by the adjoints of forces
        folded: wp.array2d(dtype=vec)  # (H, 8) of a fold's forces: its nodes' x, and of its damping their v
        membrane: wp.array(dtype=pn)  # (F,) shares of the parameters' gradient
        plate: wp.array(dtype=py)
        sheet_flow: wp.array(dtype=psf)
        sheet_branch: wp.array(dtype=psb)
        sheet_memory: wp.array(dtype=psm)  # (F,) of the memory; in: at the stretch's end, out: at its start
        viscous_membrane: wp.array(dtype=pvm)
        viscous_plate: wp.array(dtype=pvp)
        paired: wp.array2d(dtype=vec)  # (C, 8) of a pair's forces: its nodes' x, their v
        pair_law: wp.array(dtype=pj)  # (C,) and parameters
        layer: wp.array(dtype=pj)  # (nodes,) shares of the parameters' gradient
        load: wp.array(dtype=R)  # (P,)
        held: wp.array(dtype=R)
        anchor: wp.array(dtype=vec)  # (P,) in: at the stretch's end, out: at its start
        slid: wp.array(dtype=vec)  # (hands,) the same
        met_points: wp.array2d(dtype=vec)  # (P, 4) of a substep's forces from outside: a point's x, v, its controller's x, v
        cell_memory: wp.array2d(dtype=pk)  # (K, 8) of the memory; in: at the stretch's end, out: at its start
        memory: wp.array(dtype=pq)  # (ends,) of the memory; in: at the stretch's end, out: at its start
        axial: wp.array(dtype=pa)  # (nodes,) shares of the parameters' gradient, summed over a system by the caller
        strand: wp.array(dtype=ps)
        body: wp.array(dtype=pb)  # (nodes,), or (P,) where there are points
        surface: wp.array(dtype=pu)  # (P,)
        touch: wp.array(dtype=pt)
        grip: wp.array(dtype=pi)
        slip: wp.array(dtype=pz)
        observer: wp.array(dtype=po)
        velocity: wp.array(dtype=pv)
        contact: wp.array(dtype=pc)
        move: wp.array(dtype=pm)
        links: wp.array(dtype=R)
        wants_rest: int  # whether anybody asks for this gradient
        wants_mass: int
        wants_table: int

    return World, Adjoint
