"""The replica knows a rope when it sees one, and runs along it in order."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from twinbench.datasets.scenario import Observed
from twinbench.diagnosis.model import Simulator
from twinbench.diagnosis.replica import build_replica
from twinbench.methods.continuum.chains import apart, marked_chains, rope_chains
from twinbench.physics.terms import AddedMass


def helix(count, *, turns=1.5, radius=0.2, rise=0.5):
    """(count, 3) m, evenly along a helix: a curve that bends and winds everywhere."""
    s = np.linspace(0, 1, count)
    return np.stack([radius * np.cos(2 * np.pi * turns * s), radius * np.sin(2 * np.pi * turns * s), rise * s], 1)


def recording(points, *, grips=(), frames=12):
    """``points`` (N, 3) that all move by 1 cm to the side, the ``grips`` driven."""
    path = points[None] + np.linspace(0, 0.01, frames)[:, None, None] * [1.0, 0, 0]
    there = np.ones(path.shape[:2], bool)
    controllers = path[:, list(grips)] if len(grips) else path[:, :1] + [0, 0, 0.005]
    held = list(grips) if len(grips) else None
    return Observed(name="one", points=path, visible=there, motion_valid=there, controllers=controllers, fps=30.0, grips=held)


def one_way(chain, along):
    """Whether the places ``along`` a curve only grow, or only fall, as the chain goes."""
    steps = np.diff(along[chain])
    return (steps > 0).all() or (steps < 0).all()


@pytest.mark.parametrize("seed", range(5))
def test_a_noisy_curved_rope_is_ordered_along_its_arc(seed):
    # noise is a fifth of the spacing, so neighbours stay nearer (1.4 spacings at most in three deviations) than their neighbours
    rng = np.random.default_rng(seed)
    curve = helix(60)
    spacing = np.linalg.norm(np.diff(curve, axis=0), axis=1).mean()
    order = rng.permutation(60)
    (chain,) = rope_chains(apart(curve[order] + rng.normal(0, spacing / 15, (60, 3))))
    assert sorted(chain) == list(range(60))
    assert one_way(chain, order)


def test_a_body_that_is_not_seen_is_refused_by_name():
    hidden = replace(recording(helix(60)), name="dark", visible=np.zeros((12, 60), bool), motion_valid=np.zeros((12, 60), bool))
    with pytest.raises(ValueError, match=r"^points must be seen in frame 0, got none of 60 \(scenario dark\)$"):
        build_replica(hidden, nodes=30)


def test_a_dense_cloud_around_a_rope_is_thinned_until_it_is_a_row():
    # a tube of radius 8 mm: nodes closer than its width would lie around it, not along it
    rng = np.random.default_rng(0)
    place = rng.uniform(0, 1, 3000)
    curve = helix(1001)
    cloud = curve[np.rint(place * 1000).astype(int)] + rng.uniform(-0.008, 0.008, (3000, 3)) / np.sqrt(3)
    replica = build_replica(recording(cloud), nodes=300)
    (chain,) = replica.system.chains
    nearest = np.linalg.norm(replica.nodes[:, None] - curve[None], axis=2).argmin(1)
    assert len(replica.nodes) >= 12
    assert one_way(chain, nearest)
    assert nearest[chain].min() < 50 and nearest[chain].max() > 950  # from end to end
    assert len(replica.system.hinges) == len(replica.nodes) - 2


@pytest.mark.parametrize("shape", [(12, 12, 1), (20, 6, 1), (6, 6, 5), (3, 9, 1)])
@pytest.mark.parametrize("nodes", [12, 40, 150])
def test_a_sheet_or_a_block_is_no_rope(shape, nodes):
    rng = np.random.default_rng(1)
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), -1).reshape(-1, 3) * 0.02
    replica = build_replica(recording(grid + rng.normal(0, 5e-4, grid.shape)), nodes=nodes)
    assert replica.system.chains == ()


def test_markers_of_a_held_rope_are_the_nodes_and_its_frame_0_their_natural_shape():
    markers = helix(13, turns=0.4)
    replica = build_replica(recording(markers, grips=(0, 1, 11, 12)), nodes=100)
    (chain,) = replica.system.chains
    np.testing.assert_allclose(replica.nodes[chain], markers, atol=1e-12)
    np.testing.assert_allclose(replica.sightings.position[0][chain], markers, atol=1e-12)
    assert replica.system.hinges.tolist() == np.stack([chain[:-2], chain[1:-1], chain[2:]], 1).tolist()
    # the natural curvature is 2 tan(angle / 2), whatever frame it is told in
    t = np.diff(markers, axis=0) / np.linalg.norm(np.diff(markers, axis=0), axis=1, keepdims=True)
    angle = np.arccos((t[:-1] * t[1:]).sum(1))
    np.testing.assert_allclose(np.linalg.norm(replica.system.natural, axis=1), 2 * np.tan(angle / 2), rtol=1e-9)


def test_every_branch_is_a_chain_from_where_it_leaves():
    main = np.stack([np.linspace(0, 1, 21), np.zeros(21), np.zeros(21)], 1)
    branch = main[8] + np.linspace(0.05, 0.4, 8)[:, None] * [0, 0.8, 0.6]
    found = rope_chains(apart(np.concatenate([main, branch])))
    assert [chain.tolist() for chain in found] == [list(range(21)), [8, *range(21, 29)]]


def test_markers_follow_each_other_as_the_points_between_them_say():
    # a hairpin 3 cm wide with markers every 10 cm: the nearest marker is on the other side, and only the points between tell
    side = np.linspace(0, 0.6, 61)
    turn = np.linspace(0, np.pi, 6)[1:-1]
    path = np.concatenate([np.stack([side, 0 * side], 1), np.stack([0.6 + 0.015 * np.sin(turn), 0.015 - 0.015 * np.cos(turn)], 1)])
    path = np.concatenate([path, np.stack([side[::-1], 0 * side + 0.03], 1)])
    path = np.concatenate([path, np.zeros((len(path), 1))], 1)
    marks = np.arange(0, len(path), 10)
    between = np.delete(path, marks, axis=0)
    found = marked_chains(path[marks], between, np.repeat(path[None, marks], 3, 0))
    assert [chain.tolist() for chain in found] == [list(range(len(marks)))]


def test_a_rope_that_touches_itself_is_told_apart_by_how_it_moves():
    # two strands that lie on each other in frame 0 and then part
    s = np.linspace(0, 1, 20)
    start = np.concatenate([np.stack([s, 0 * s, 0 * s], 1), [[1.04, 0.01, 0]], np.stack([s[::-1], 0 * s + 0.02, 0 * s], 1)])
    later = start + np.linspace(0, 1, 41)[:, None] ** 2 * [0, 0.6, 0] * np.array([1.0, 1.0, 0])
    (chain,) = rope_chains(apart(start, np.stack([start, (start + later) / 2, later])))
    assert chain.tolist() == list(range(41))
    assert rope_chains(apart(start)) == () or rope_chains(apart(start))[0].tolist() != list(range(41))


def test_a_replica_of_another_recording_runs_the_same_way():
    markers = helix(20, turns=0.3)
    first = build_replica(recording(markers, grips=(0, 1, 18, 19)), nodes=30)
    turned = build_replica(recording(markers[::-1], grips=(0, 1, 18, 19)), nodes=30, like=first)
    start, other = (r.nodes[r.system.chains[0][0]] for r in (first, turned))
    assert np.linalg.norm(start - other) < 0.02


def held_block():
    """A block of 0.2 x 0.04 x 0.04 m, 9 x 5 x 5 particles; those of one end are markers that are held, the rest is inside."""
    axes = [np.linspace(0, size, count) for size, count in ((0.2, 9), (0.04, 5), (0.04, 5))]
    body = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    held = np.broadcast_to(body[:25], (10, 25, 3))
    there = np.ones((10, 25), bool)
    shown = dict(points=held, visible=there, motion_valid=there, controllers=held, grips=np.arange(25), interior=body[25:])
    return Observed(name="block", fps=30.0, gravity=[0, 0, -9.81], **shown)


def test_nodes_of_a_held_solid_weigh_what_they_stand_for():
    replica = build_replica(held_block(), nodes=60)
    mass, x = replica.system.masses, replica.nodes[:, 0]
    assert mass[25:].mean() == pytest.approx(1.0, rel=0.1)  # relative to a free node; few are raised to the least mass
    # a uniform block has its middle half way, and x^2 of 1 / 3 of its squared length; nodes are 18 mm apart, an eleventh of it
    assert mass @ x / mass.sum() == pytest.approx(0.1, rel=0.06)
    assert mass @ x**2 / mass.sum() == pytest.approx(0.2**2 / 3, rel=0.08)
    assert (x**2).mean() < 0.8 * 0.2**2 / 3  # as nodes of one mass each do not, most of which are held


def test_masses_are_told_as_the_setup_terms_make_them():
    replica = build_replica(held_block(), nodes=40)
    place, reach = np.array([0.2, 0.02, 0.02]), 0.03
    values = {"added_mass": 2.0, "added_mass_within": reach, **{f"added_mass_{a}": c for a, c in zip("xyz", place, strict=True)}}
    # m + 2 M m s / sum(m s), s = exp(-|x - c|^2 / 2 r^2); float32
    mass = replica.system.masses
    share = mass * np.exp(-((replica.nodes - place) ** 2).sum(1) / (2 * reach**2))
    wanted = mass + 2 * mass.sum() * share / share.sum()
    np.testing.assert_allclose(Simulator(replica).masses((AddedMass,), values), wanted, rtol=1e-5)


def carried(body, turn, shift):
    """The recording of the ``body`` lying turned by ``turn`` (3, 3) and moved by ``shift`` (3,) m."""
    points = body.points @ turn.T + shift
    return replace(body, points=points, controllers=points, interior=body.interior @ turn.T + shift)


def test_what_has_the_same_particles_has_the_same_mesh():
    # a regular lattice: which of its particles are farthest from all others is decided by the last digit, and so by a turn
    turn = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix()
    first = build_replica(held_block(), nodes=60)
    second = build_replica(carried(held_block(), turn, [0.4, 0.1, -0.2]), nodes=60, like=first)
    np.testing.assert_allclose(second.nodes, first.nodes @ turn.T + [0.4, 0.1, -0.2], atol=1e-12)
    np.testing.assert_array_equal(second.system.springs, first.system.springs)
    np.testing.assert_array_equal(second.system.masses, first.system.masses)
    np.testing.assert_array_equal(second.system.home, first.nodes)
    np.testing.assert_allclose(second.sightings.position[0, :25], second.nodes[:25], atol=1e-12)


def test_a_few_particles_that_moved_leave_the_mesh_as_it_is():
    # markers on a lattice are where they were measured, the rest of it where they say it is
    block = held_block()
    first = build_replica(block, nodes=60)
    interior = block.interior.copy()
    interior[-3:] += 0.002
    second = build_replica(replace(block, interior=interior), nodes=60, like=first)
    np.testing.assert_array_equal(second.system.springs, first.system.springs)


def test_what_lies_bent_has_a_mesh_of_its_own():
    block = held_block()
    first = build_replica(block, nodes=60)
    bent = replace(block, interior=block.interior + np.array([0, 0, 1.0]) * block.interior[:, :1] ** 2)
    second = build_replica(bent, nodes=60, like=first)
    chosen = np.linalg.norm(second.nodes[25:, None] - bent.interior[None], axis=2).min(1)
    np.testing.assert_allclose(chosen, 0, atol=1e-12)  # nodes are particles of its own
