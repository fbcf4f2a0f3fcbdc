"""What a drawing reads from the first frames: where a body lies, which nodes a hand carries, and how fast all moves at the start."""

import numpy as np
import pytest
from twinbench.datasets.scenario import Plane
from twinbench.diagnosis import replica
from twinbench.diagnosis.hands import hand_ties
from twinbench.diagnosis.model import Simulator
from twinbench.diagnosis.replica import build_replica
from twinbench.methods.continuum.hands import labels_of
from twinbench.physics.terms import Ground

FRAMES, FPS = 24, 30.0
FLOOR = Plane([0.0, 0.0, 1.0], -0.1)


def grid(columns, rows, spacing=0.03):
    """(N, 3) m, flat, shaken by a tenth of the spacing."""
    flat = np.stack(np.meshgrid(np.arange(columns), np.arange(rows), [0.0], indexing="ij"), -1).reshape(-1, 3) * spacing
    return flat + np.random.default_rng(0).uniform(-0.1, 0.1, flat.shape) * spacing


def still(tiny, points, hand=None, **given):
    path = np.repeat(np.asarray(points, float)[None], FRAMES, 0)
    return tiny.filmed(path, path[:, :1] + [0, 0, 0.3] if hand is None else hand, **given)


def test_a_rope_on_the_ground_is_lifted_to_its_axis(tiny):
    # its points are on its skin and axis, up to 2 cm above the table: half of the nodes stand higher than the middle one
    s = np.linspace(0, 0.6, 25)
    height = 0.004 + 0.002 * np.sin(np.arange(25))
    rope = np.stack([s, 0.05 * np.sin(6 * s), height - 0.1], 1)
    replica = build_replica(still(tiny, rope, ground=FLOOR), nodes=25)
    assert replica.system.chains
    assert replica.lift == pytest.approx(np.median(replica.nodes[:, 2] + 0.1))
    # and the ground that the nodes meet is as much higher, so that the rope lies in frame 0
    assert Simulator(replica).fixed([Ground])["ground_offset"] == pytest.approx(-0.1 + replica.lift)


def test_a_sheet_on_the_ground_is_lifted_to_its_lowest_nodes(tiny):
    points = grid(6, 5) * [1, 1, 0] + [0, 0, -0.1 + 0.003]
    points[:15, 2] += 0.2  # one half is held up
    replica = build_replica(still(tiny, points, ground=FLOOR), nodes=30)
    assert not replica.system.chains
    assert replica.lift == pytest.approx(0.003, abs=1e-9)


def test_what_hangs_or_has_no_ground_is_not_lifted(tiny):
    points = grid(6, 5) + [0, 0, 0.5]
    assert build_replica(still(tiny, points, ground=FLOOR), nodes=30).lift == 0.0
    assert build_replica(still(tiny, points), nodes=30).lift == 0.0
    assert build_replica(still(tiny, points - [0, 0, 0.7], ground=FLOOR), nodes=30).lift == 0.0  # below the table, a fault of the camera


def pulled(tiny, *, behind=(), since=0):
    """A sheet of 6 x 5 points that one hand lifts, all but the points ``behind``, which from frame ``since`` on stay where they are.

    Returns the nodes that get ties, given all frames or the first ``fitted``.
    """
    points = grid(6, 5)
    way = np.linspace(0, 0.12, FRAMES)[:, None, None] * np.array([0, 0, 1.0])
    path = points[None] + way
    path[since:, list(behind)] = points[list(behind)]
    recording = tiny.filmed(path, points[None, :3] + [0, 0, 0.01] + way)

    def tied(fitted=FRAMES):
        return set(hand_ties(recording, points, path[:fitted], 0.03, np.arange(3))[:, 1].tolist())

    return tied


def test_a_node_that_stays_behind_is_not_tied(tiny):
    carried = pulled(tiny)()
    assert 3 in carried  # a neighbour of the hand
    assert pulled(tiny, behind=[3])() == carried - {3}


def test_what_a_node_does_after_the_fitted_frames_unties_nothing(tiny):
    left = pulled(tiny, behind=[3], since=3)
    assert left(fitted=3) == pulled(tiny)()
    assert left() == pulled(tiny)() - {3}


LENGTH, EXIT = 0.6, 0.034


def hanging(tiny, *, radius=0.0):
    """A straight rope that a hand lifts by one end; beyond ``EXIT`` [m] it turns down about there, by up to a quarter turn.

    Its points are on its axis, or where it has a ``radius`` on its skin, of which the upper half is tracked.
    """
    s = np.repeat(np.arange(0, LENGTH + 1e-9, 0.005), 5 if radius else 1)
    around = np.tile(np.linspace(-0.5, 0.5, 5), len(s))[: len(s)] * np.pi if radius else np.zeros(len(s))
    side = radius * np.stack([np.zeros(len(s)), np.sin(around), np.cos(around)], 1)
    turn = np.minimum(1, np.arange(FRAMES) / 8)[:, None] * np.pi / 2
    free = np.maximum(0, s - EXIT)
    axis = np.stack([np.minimum(s, EXIT) + free * np.cos(turn), np.zeros((FRAMES, len(s))), -free * np.sin(turn)], -1)
    turned = np.where(s > EXIT, turn, 0)
    skin = np.stack([side[:, 2] * np.sin(turned), np.tile(side[:, 1], (FRAMES, 1)), side[:, 2] * np.cos(turned)], -1)
    lift = np.arange(FRAMES)[:, None, None] * np.array([0, 0, 0.012])
    path = axis + skin + lift
    corners = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij"), -1).reshape(-1, 3)
    below = {"surface": axis[0] - skin[0]} if radius else {}
    return tiny.filmed(path, [0.5 * EXIT, 0, 0] + 0.017 * corners + lift, **below)


def tied(drawn):
    return np.unique(drawn.system.springs[drawn.links].min(1))


def test_a_hand_holds_of_a_rope_what_does_not_turn_away(tiny):
    # nodes stand 19 mm apart and ties reach 30 mm: those beyond the hand would be tied too
    drawn = build_replica(hanging(tiny), nodes=100)
    assert drawn.system.chains
    held = drawn.nodes[tied(drawn), 0]
    assert len(held) > 1 and held.max() < EXIT + 0.002
    assert (drawn.nodes[:, 0] < EXIT - 0.002).sum() == len(held) - 1


def test_the_last_node_that_a_hand_holds_is_where_the_rope_leaves_it(tiny):
    # in a twelfth of the distance between nodes, the grid on which that is looked for, a sixteenth
    drawn = build_replica(hanging(tiny), nodes=100)
    assert drawn.nodes[tied(drawn), 0].max() == pytest.approx(EXIT, abs=drawn.spacing / 12)


def test_nodes_of_a_rope_are_on_its_axis_though_its_skin_is_seen_from_above(tiny):
    # the middle of five points of the upper half of a circle is half of its radius above the axis; particles that are not tracked are below
    radius = 0.005
    drawn = build_replica(hanging(tiny, radius=radius), nodes=100)
    assert drawn.system.chains
    assert np.abs(drawn.nodes[:, 1:]).max() < radius / 5
    rising = np.arange(FRAMES)[:, None] * 0.012
    inside = drawn.nodes[:, 0] < EXIT - 0.01  # the hand
    assert drawn.sightings.position[:, inside, 2] == pytest.approx(np.broadcast_to(rising, (FRAMES, inside.sum())), abs=radius / 5)


def test_tracks_that_slip_do_not_make_a_rope_a_sheet(tiny, monkeypatch):
    # what slips may be far from all that it lies beside, so that distances while it moves show no rope
    true = replica.apart
    monkeypatch.setattr(replica, "apart", lambda points, tracks=None: true(points) + (0 if tracks is None else 1.0))
    assert build_replica(hanging(tiny), nodes=100).system.chains


def test_a_hand_out_of_reach_holds_what_is_nearest(tiny):
    points = grid(6, 5)
    hand = np.repeat(points[None, :1] + [-0.2, 0, 0], FRAMES, 0)
    replica = build_replica(still(tiny, points, hand), nodes=30)
    ends = replica.system.springs[replica.links]
    assert ends.min(1).tolist() == [np.linalg.norm(replica.nodes - hand[0], axis=1).argmin()]


def test_points_of_one_hand_hang_together_link_by_link():
    # 4 cm from one to the next and 12 cm over all: one hand; 30 cm on: another
    row = np.arange(4)[:, None] * [0.04, 0, 0]
    label = labels_of(np.concatenate([row, row + [0.5, 0, 0]])[None])
    assert len(set(label[:4])) == len(set(label[4:])) == 1 and label[0] != label[4]
    assert labels_of(row[None, :1]).tolist() == [1]


@pytest.mark.parametrize("noise", [0.0, 5e-4])
def test_a_falling_body_has_its_start_velocity(tiny, noise):
    # x = v t - g t^2 / 2 lies in the span of a cubic, so without noise its slope at 0 is exact
    points, v = grid(6, 5), np.array([0.4, 0.0, -0.8])
    t = np.arange(FRAMES)[:, None, None] / FPS
    path = points + v * t - 4.9 * t**2 * np.array([0, 0, 1.0])
    path = path + np.random.default_rng(0).normal(0, noise, path.shape)
    replica = build_replica(tiny.filmed(path, path[:, :1] + [0, 0, 0.3]), nodes=30)
    basis = (np.arange(7)[:, None] / FPS) ** np.arange(4)
    error = 1e-9 + 5 * noise * np.linalg.norm(np.linalg.pinv(basis)[1])  # five standard errors of the least squares slope
    assert np.abs(replica.system.velocities - v).max() < error + 5 * noise * FPS / 10


def test_noise_is_no_start_velocity(tiny):
    path = np.repeat(grid(6, 5)[None], FRAMES, 0) + np.random.default_rng(0).normal(0, 2e-3, (FRAMES, 30, 3))
    assert (build_replica(tiny.filmed(path, path[:, :1]), nodes=30).system.velocities == 0).all()


def test_a_hand_that_sets_off_gives_no_start_velocity(tiny):
    # all follow x = a (t - t0)^2 / 2 from the third frame on, at rest before: a line through the first seven frames would say 6 cm/s
    t = np.maximum(0, np.arange(FRAMES) - 3)[:, None, None] / FPS
    way = 3.0 * t**2 / 2 * np.array([0, 0, 1.0])
    points = grid(6, 5)
    path = points + way + np.random.default_rng(0).normal(0, 5e-4, (FRAMES, 30, 3))
    hand = points[None, :3] + way
    line = np.polyfit(np.arange(7) / FPS, way[:7, 0, 2], 1)[0]
    assert line > 0.05
    assert np.abs(build_replica(tiny.filmed(path, hand), nodes=30).system.velocities).max() < line / 2
