"""Ropes and cables against the mechanics of slender bodies, and the method on recordings that its own engine made."""

from dataclasses import replace

import numpy as np
import pytest
from cables import cable
from scipy.integrate import solve_bvp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from twinbench.datasets.scenario import Observed
from twinbench.methods.continuum import Continuum
from twinbench.methods.continuum.axis import axis_of
from twinbench.methods.continuum.bodies import bodies_of
from twinbench.methods.continuum.body import body_of
from twinbench.methods.continuum.config import Config
from twinbench.methods.continuum.estimate import unknowns_of
from twinbench.methods.continuum.natural import common_shapes
from twinbench.methods.continuum.rods import GRAVITY, STRETCH, Rod
from twinbench.methods.continuum.scene import Scene
from twinbench.methods.continuum.simulate import Simulator
from twinbench.methods.continuum.start import Speeds
from twinbench.methods.continuum.twin import ContinuumTwin
from twinbench.methods.continuum.windows import window

LENGTH, MARKERS = 1.0, 17


def straight(count=MARKERS, length=LENGTH):
    return np.linspace([0, 0, 0], [length, 0, 0], count)


def at_rest(recording, values, seconds=8.0, driven_to=None):
    """(n, 3) m, where markers come to rest, in thick air."""
    frames = round(seconds * recording.fps)
    start = recording.controllers[:1]
    led = np.repeat(start if driven_to is None else driven_to[None], frames, 0)
    ramp = np.minimum(np.arange(frames) / 30, 1)[:, None, None]
    scene = Scene.of(recording, Rod.marked(recording))
    path = Simulator(scene).run([dict(drag_damping=3.0, bending_time=2e-3) | values], frames, start + ramp * (led - start))[0]
    assert np.isfinite(path).all() and np.abs(path[-1] - path[-10]).max() < 1e-4
    return path[-1, : recording.counts[0]]


def heavy_elastica(rigidity, length):
    """(x, z) m of the tip of a horizontal cantilever under 1 kg/m: B theta'' = rho g (L - s) cos theta, theta(0) = 0, theta'(L) = 0."""

    def slope(s, y):
        return np.stack([y[1], GRAVITY * (length - s) / rigidity * np.cos(y[0])])

    s = np.linspace(0, length, 200)
    found = solve_bvp(slope, lambda a, b: np.array([a[0], b[1]]), s, np.zeros((2, 200)), tol=1e-8, max_nodes=50000)
    assert found.success
    angle = found.sol(s)[0]
    return np.trapezoid(np.cos(angle), s), np.trapezoid(np.sin(angle), s)


@pytest.mark.parametrize("share", [3.0, 30.0])
def test_a_heavy_cantilever_hangs_as_the_elastica_does(share):
    # rho g L^3 / B = share. A hinge stands for half a segment on either side, so that two markers clamp in the middle between them;
    # 16 segments are second order in 1/16, a percent
    points = straight()
    rigidity = GRAVITY * LENGTH**3 / share
    tip = at_rest(cable(points, (0, 1)), dict(bending_stiffness=rigidity), seconds=9.0)[-1]
    x, z = heavy_elastica(rigidity, LENGTH * (1 - 0.5 / (MARKERS - 1)))
    assert abs(tip[2] - z) < 0.05 * abs(z)
    assert abs(tip[0] - LENGTH * 0.5 / (MARKERS - 1) - x) < 0.02 * LENGTH


def test_a_limp_cable_hangs_in_a_catenary():
    # y = a cosh(x / a): half the length is a sinh(d / 2a), the sag a (cosh(d / 2a) - 1)
    points, apart = straight(), 0.7 * LENGTH
    ends = np.array([[0, 0, 0], [apart, 0, 0]])
    found = at_rest(cable(points, (0, MARKERS - 1)), dict(bending_stiffness=1e-5), seconds=8.0, driven_to=ends)
    a = brentq(lambda a: 2 * a * np.sinh(apart / 2 / a) - LENGTH, 0.05, 10)
    sag = a * (np.cosh(apart / 2 / a) - 1)
    assert -found[:, 2].min() == pytest.approx(sag, rel=0.02)  # it stretches by 0.2 %, which sags by some 0.5 % more


@pytest.mark.parametrize("level", [1.0, 4.0])
def test_a_taut_cable_sags_by_its_stretch(level):
    # ends as far apart as it is long: the strain 8 s^2 / (3 L^2) of a parabola of sag s is T / EA, T = rho g L^2 / (8 s), so that
    # s^3 = 3 rho g L^4 / (64 EA), and EA = level rho g L / STRETCH. Second order in s / L = 0.05; 16 segments make a chord 0.4 % shorter
    found = at_rest(cable(straight(), (0, MARKERS - 1)), dict(bending_stiffness=1e-6, body_stiffness=level))
    assert -found[:, 2].min() == pytest.approx(LENGTH * (3 * STRETCH / (64 * level)) ** (1 / 3), rel=0.02)


def test_stretch_is_fitted_where_two_hands_hold_a_filmed_rope():
    one = filmed()
    nobody, pair = Scene.of(one, Rod.of(one, body_of(one, kind="rope"))), replace(one, controllers=two_hands(one), grips=np.full(40, -1))
    names = [{u.name for u in unknowns_of([scene], Config())} for scene in (nobody, Scene.of(pair, nobody.body))]
    assert names[1] - {n for n in names[1] if n.startswith("rec0_grip")} == names[0] | {"body_stiffness"}
    assert "body_stiffness" not in {u.name for u in Rod.unknowns([nobody.body])}


def two_hands(recording):
    """(1, 40, 3) m, controllers around both ends of a filmed rope."""
    ends = np.array([[0.16, 0.0, 0.0], [-0.16, 0.0, 0.0]])
    ball = np.random.default_rng(1).normal(0, 0.005, (20, 3))
    return (ends[:, None] + ball).reshape(1, -1, 3)


def test_without_weight_a_cable_takes_its_natural_shape():
    # constant natural curvature k about one axis: a circle of radius 1 / k, whose chord after an arc s is 2 sin(k s / 2) / k
    points, k = straight(), 2.0
    found = at_rest(cable(points, (0, 1), gravity=np.zeros(3)), dict(bending_stiffness=0.5, natural_a0=k), seconds=9.0)
    arc = LENGTH * (1 - 0.5 / (MARKERS - 1)) - 0.5 * LENGTH / (MARKERS - 1)
    steps = np.linalg.norm(found[-1] - found[1])
    assert steps == pytest.approx(2 * np.sin(k * arc / 2) / k, rel=0.02)
    turn = np.linalg.norm(np.cross(found[6] - found[5], found[5] - found[4])) / (LENGTH / (MARKERS - 1)) ** 3
    assert turn == pytest.approx(k, rel=0.02)


def tube(noise=1e-3, seed=0):
    """(points (M, 3) m, length [m]) on and in a rope 1 cm thick along half a circle of radius 16 cm, with noise."""
    random = np.random.default_rng(seed)
    angle, spin, off = random.uniform(0, np.pi, 900), random.uniform(0, 2 * np.pi, 900), 5e-3 * np.sqrt(random.uniform(0.3, 1, 900))
    ring = 0.16 + off * np.cos(spin)
    points = np.stack([ring * np.cos(angle), ring * np.sin(angle), off * np.sin(spin)], 1)
    return points + random.normal(0, noise, points.shape), 0.16 * np.pi


def test_the_axis_of_a_filmed_rope_is_found_in_its_points():
    # half a circle of 16 cm; noise of 1 mm on 900 points, some 20 of which an average hears
    points, length = tube()
    axis, radius = axis_of(points, 0.003, 0.01)
    assert np.abs(np.linalg.norm(axis[:, :2], axis=1) - 0.16).max() < 1.5e-3 and np.abs(axis[:, 2]).max() < 1.5e-3
    assert np.linalg.norm(np.diff(axis, axis=0), axis=1).sum() == pytest.approx(length, rel=0.02)
    assert radius == pytest.approx(5e-3, rel=0.25)


def test_points_in_two_lines_side_by_side_are_no_rope():
    # half of the points are turned by 4 degrees about one end: a curve through all runs there and back. A bend of 4 cm radius is one rope:
    # within a 22nd of its length, 44 cm, a circle turns by 20 mm / 40 mm, 29 degrees
    random = np.random.default_rng(0)
    along, side = random.uniform(0, 0.5, 900), random.integers(2, size=900)
    apart = np.stack([along, 0.07 * side * along, 0.0 * along], 1) + random.normal(0, 1e-3, (900, 3))
    with pytest.raises(ValueError, match=r"must follow one line, got one that turns back by 1[5-7]\d degrees"):
        axis_of(apart, 0.003, 0.01)
    arc = random.uniform(0, 0.44, 900)
    turn = np.clip((arc - 0.157) / 0.04, 0, np.pi)
    bend = np.stack([0.04 * np.sin(turn), -0.04 * np.cos(turn), 0 * turn], 1)
    bend[:, 0] += np.minimum(arc - 0.157, 0.0) - np.maximum(arc - 0.157 - 0.04 * np.pi, 0.0)
    axis, _ = axis_of(bend + random.normal(0, 1e-3, bend.shape), 0.003, 0.01)
    assert np.linalg.norm(np.diff(axis, axis=0), axis=1).sum() == pytest.approx(0.44, rel=0.05)


def test_a_recording_of_which_no_rope_can_be_made_is_named():
    # half of the points of the second are turned by 4 degrees, as where a camera is not where it is told
    one, random = filmed(), np.random.default_rng(0)
    along, side = random.uniform(0, 0.5, 600), np.arange(600) % 2
    apart = np.stack([along, 0.07 * side * along, 0.0 * along], 1) + random.normal(0, 1e-3, (600, 3))
    apart, nothing = apart[None], np.zeros((0, 3))
    with pytest.raises(ValueError, match=r"must follow one line, got .* \(scenario second\)"):
        bodies_of([one, replace(one, name="second", points=apart, interior=nothing)], kind="rope")


def filmed():
    points, _ = tube()
    seen = np.ones((1, 600), bool)
    return Observed(
        name="rope",
        points=points[None, :600],
        visible=seen,
        motion_valid=seen,
        controllers=np.zeros((1, 0, 3)),
        interior=points[600:],
        gravity=np.zeros(3),
    )


def test_points_of_a_rope_turn_with_it():
    # a rigid motion of the nodes is one of all points: an embedding that did not turn would leave them half a thickness aside
    recording = filmed()
    body = Rod.of(recording, body_of(recording, kind="rope"))
    turns = Rotation.from_rotvec(np.outer(np.linspace(0, 1, 30), [0.3, -1.4, 0.2]))
    path = np.stack([turn.apply(body.positions) for turn in turns])
    wanted = turns[-1].apply(recording.structure)
    off = body.followed(path)[-1] - wanted
    spun = 2 * 5e-3 * np.sin(1.45 / 2)  # that part of the turn which is a spin about the rope itself nobody tells
    assert np.abs(body.followed(path)[0] - recording.structure).max() < 1e-12
    assert np.median(np.linalg.norm(off, axis=1)) < 0.5 * spun and np.linalg.norm(off, axis=1).max() < 2.5 * spun


def test_a_roll_that_was_seen_holds_for_the_motion_in_which_it_was_seen():
    # the skin rolls by 1 rad about an axis that lies still: hands that move otherwise say nothing of it
    one = filmed()
    axis = Rod.of(one, body_of(one, kind="rope")).positions
    along = np.gradient(axis, axis=0)
    near = np.linalg.norm(one.points[0][:, None] - axis, axis=2).argmin(1)
    along = along[near] / np.linalg.norm(along[near], axis=1, keepdims=True)
    off = one.points[0] - axis[near]
    off -= (off * along).sum(1, keepdims=True) * along
    points = np.stack([one.points[0] - off + Rotation.from_rotvec(angle * along).apply(off) for angle in np.linspace(0, 1, 10)])
    hands = np.zeros((10, 20, 3)) + two_hands(one)[:, :20]
    seen = replace(
        one,
        points=points,
        visible=np.ones(points.shape[:2], bool),
        motion_valid=np.ones(points.shape[:2], bool),
        controllers=hands,
        grips=np.full(20, -1),
    )
    scene = Scene.of(seen, Rod.of(seen, body_of(seen, kind="rope")))
    values = dict(bending_stiffness=0.01, natural_kept=1.0)
    still, own, other = (Simulator(scene).run([values], 10, to)[0] for to in (None, hands, hands + 1e-4))
    assert np.array_equal(still, own)
    off, without = (np.sqrt(np.mean((path[-1, :600] - points[-1]) ** 2)) for path in (own, other))
    assert off < 0.5 * without and without > 1e-3
    parts = scene.body.arrays()
    kept = Rod.restored(parts, ()).rolling
    assert kept is not None and all(np.array_equal(value, vars(scene.body.rolling)[name]) for name, value in vars(kept).items())


def test_a_rope_that_keeps_its_shape_lies_still():
    # its natural curvature is that of frame 0, and nothing pulls: no force anywhere
    recording = filmed()
    scene = Scene.of(recording, Rod.of(recording, body_of(recording, kind="rope")))
    path = Simulator(scene).run([dict(bending_stiffness=0.01, natural_kept=1.0)], 10)[0]
    assert np.abs(path[-1] - path[0]).max() < 1e-4


def test_another_axis_of_a_filmed_rope_is_told_by_some_of_its_points():
    # half of 900 points with noise of 1 mm tell the half circle as well as before to half a millimetre, and not the same axis
    recording = filmed()
    body = Rod.of(recording, body_of(recording, kind="rope"))
    some = replace(recording, interior=recording.interior[::2], visible=recording.visible & (np.arange(600) % 2 == 0))
    other = body.anew(recording, some, 0.5)
    assert len(other.positions) == 2 * len(body.positions) - 1 and len(other.structure) == len(body.structure)
    assert np.abs(np.linalg.norm(other.positions[:, :2], axis=1) - 0.16).max() < 2e-3
    assert np.abs(other.followed(other.positions[None])[0] - recording.structure).max() < 1e-12
    same = body.anew(recording, recording, 1.0)
    np.testing.assert_allclose(same.positions, body.positions, atol=2e-4)  # its width is that of the body, not a first guess
    assert np.abs(body.anew(recording, some, 1.0).positions - body.positions).max() > 4e-4


def coloured(recording, colors):
    return replace(recording, colors=np.repeat(np.clip(colors, 0, 1)[None], len(recording.points), 0))


def test_colours_tell_which_end_of_a_rope_is_which():
    # a half circle looks the same from both ends. Colours are a smooth function of the angle, with noise of 0.1; filmed again elsewhere,
    # its points in another order, it begins where the colours of its first end are, and so does one of two that are fitted jointly
    recording, random = filmed(), np.random.default_rng(3)
    share = np.arctan2(recording.points[0, :, 1], recording.points[0, :, 0]) / np.pi
    smooth, mirrored = (np.stack([way, 0.5 + 0.5 * np.sin(5 * way), way**2], 1) for way in (share, 1 - share))
    turn = Rotation.from_euler("z", 130, degrees=True)
    body = Rod.of(coloured(recording, smooth + 0.1 * random.normal(size=smooth.shape)), body_of(recording, kind="rope"))
    assert body.ways == 2 and np.array_equal(Rod.restored(body.arrays(), ()).hues, body.hues, equal_nan=True)
    for colors, first in ((smooth, 0), (mirrored, -1)):
        order = random.permutation(recording.counts[0])
        moved = turn.apply(recording.points[0, order])[None].repeat(len(recording.points), 0)
        there = replace(recording, points=moved, interior=turn.apply(np.array(recording.interior)))
        there = coloured(there, colors[order] + 0.1 * random.normal(size=smooth.shape))
        laid, alone = body.laid(there), Rod.of(there, body_of(there, kind="rope"))
        assert laid.ways == 1 and Rod.restored(laid.arrays(), ()).ways == 1
        for found in (laid, Rod.joined([body, alone], [recording, there])[1]):
            assert np.linalg.norm(found.positions[0] - turn.apply(body.positions[first])) < 5e-3
    plain = coloured(there, 0.5 + 0.1 * random.normal(size=smooth.shape))
    assert body.laid(plain).ways == 2 and body.laid(replace(there, colors=None)).ways == 2


TRUE = dict(bending_stiffness=0.02, bending_time=0.02, torsion_ratio=0.7, drag_damping=0.3, natural_a0=1.5)


def test_a_place_on_a_rope_is_as_far_along_it_elsewhere():
    # from (0.1, 0, 0) along a straight metre to a quarter circle of a metre: at an angle of 0.1 m / (2 / pi m), or from its other end
    cloud = np.zeros((1, 3))
    one = Rod.along(_seen(cloud), np.stack([np.linspace(0, 1, 50), *np.zeros((2, 50))], 1), 0.005, 40)
    angle = np.linspace(0, np.pi / 2, 200)
    arc = 2 / np.pi * np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    other = Rod.along(_seen(cloud), arc, 0.005, 40)
    there = [one.elsewhere(other, np.array([[0.1, 0.004, 0.0]]), way)[0] for way in range(one.ways)]
    expected = [2 / np.pi * np.array([np.cos(a), np.sin(a), 0.0]) for a in (0.1 * np.pi / 2, 0.9 * np.pi / 2)]
    np.testing.assert_allclose(there, expected, atol=2e-3)  # 401 places along it are 2.5 mm apart


def _seen(cloud):
    seen = np.ones((1, len(cloud)), bool)
    return Observed(name="rope", points=cloud[None], visible=seen, motion_valid=seen, controllers=np.zeros((1, 0, 3)))


def swung(frames=40, seed=0, noise=2e-4):
    """A cable between two robots, one of which swings it; its own engine's motion with jitter of 0.2 mm."""
    count, fps = 9, 60.0
    random = np.random.default_rng(seed)
    x = np.linspace(0, 0.7, count)
    start = np.stack([x, np.zeros(count), -0.25 * np.sin(np.pi * x / 0.7)], 1)
    t = np.arange(frames) / fps
    sway = np.stack([-0.08 * np.sin(5 * t), 0.1 * np.sin(7 * t + seed), 0.06 * np.sin(6 * t)], 1) - [0, 0.1 * np.sin(seed), 0]
    driven = (0, 1, count - 2, count - 1)
    led = np.repeat(start[None, list(driven)], frames, 0)
    led[:, 2:] += sway[:, None]
    recording = cable(np.repeat(start[None], frames, 0), driven, controllers=led, fps=fps, name=f"swing{seed}")
    scene = Scene.of(recording, Rod.marked(recording))
    path = Simulator(scene).run([TRUE], frames)[0][:, :count]
    assert np.isfinite(path).all()
    return cable(path + random.normal(0, noise, path.shape), driven, controllers=led, fps=fps, name=f"swing{seed}")


@pytest.fixture(scope="module")
def fitted():
    recordings = [swung(seed=k) for k in range(2)]
    config = Config(starts=1, iterations=6, refinement=2, members=0, seconds=9.0)
    known = {f"natural_{axis}{k}": 0.0 for axis in "ab" for k in range(6) if (axis, k) not in (("a", 0), ("b", 0))}
    ends = {f"natural_{axis}_{end}": 0.0 for axis in "ab" for end in ("first", "last")}
    return recordings, Continuum().fitted(recordings, config, fixed=known | ends | dict(torsion_ratio=0.7, drag_damping=0.3))


def test_a_cable_is_fitted_by_the_same_path(fitted):
    # data by its own engine and mesh: what is fitted is what made them
    _, twin = fitted
    assert twin.scene.body.kind == "rope" and twin.values["bending_stiffness"] == pytest.approx(TRUE["bending_stiffness"], rel=0.1)
    assert abs(twin.values["natural_a0"]) == pytest.approx(TRUE["natural_a0"], rel=0.15)


def test_driven_markers_go_where_they_are_driven(fitted):
    recordings, twin = fitted
    path = twin.rollout(recordings[0].controllers).positions
    np.testing.assert_allclose(path[:, [0, 1, 7, 8]], recordings[0].controllers, atol=1e-6)
    assert np.abs(path[:, :9] - recordings[0].points).mean() < 2e-3


def test_a_twin_of_a_rope_is_kept_and_moved(fitted, tmp_path):
    # a roll-out of the saved twin is the same to the last bit, in another recording one that turned with the room
    recordings, twin = fitted
    twin.save(tmp_path)
    again = ContinuumTwin.load(tmp_path)
    there = recordings[1]
    path = again.retarget(there).rollout(there.controllers).positions
    np.testing.assert_array_equal(path, twin.retarget(there).rollout(there.controllers).positions)
    turn, shift = Rotation.from_rotvec([0, 0, 0.8]).as_matrix(), np.array([0.4, 0, 0.1])
    moved = replace(there, **{name: getattr(there, name) @ turn.T + shift for name in ("points", "controllers", "interior")})
    off = twin.retarget(moved).rollout(moved.controllers).positions - (path @ turn.T + shift)
    assert np.abs(off).max() < 2e-3  # float32 of a motion of half a second


def test_a_start_is_told_by_the_first_two_frames(fitted):
    # the difference of two frames over their time; told one frame, or a whole recording, it starts at rest
    recordings, twin = fitted
    late = window(recordings[1], 20, 40)
    fast = twin.retarget(window(late, 0, 2))
    np.testing.assert_allclose(fast.scene.velocities[:9], (late.points[1] - late.points[0]) * late.fps, atol=1e-6)
    assert twin.retarget(late).scene.velocities is None
    ahead = [np.abs(one.rollout(late.controllers).positions[:8, :9] - late.points[:8]).mean() for one in (fast, twin.retarget(late))]
    assert ahead[0] < 0.7 * ahead[1]


def test_shapes_that_frames_share_are_found_however_they_are_rolled():
    # circles of curvature 3 / m in planes of any roll: the first common shape is constant and of that size, whatever the phase
    count, angle = 13, np.linspace(0, 1.2, 13)
    circle = np.stack([np.sin(angle), 1 - np.cos(angle), np.zeros(count)], 1) * (1 / 3)
    frames = np.stack([Rotation.from_rotvec([roll, 0, 0]).apply(circle) for roll in np.linspace(0, 5, 8)])
    lengths = np.linalg.norm(np.diff(circle, axis=0), axis=1)
    shape = common_shapes(np.arange(count), lengths, [cable(frames, (0, 1), fps=1.0)])[0]
    assert abs(shape[0]) == pytest.approx(3, rel=0.02) and np.abs(shape[1:]).max() < 0.1


def test_a_marker_that_is_not_seen_at_first_is_refused():
    recording = cable(straight(), (0, 1))
    hidden = recording.visible.copy()
    hidden[0, 3] = False
    with pytest.raises(ValueError, match=r"all markers of a rope must be seen in frame 0, marker 3 was not \(scenario cable\)"):
        Rod.marked(replace(recording, visible=hidden))
    with pytest.raises(ValueError, match="a rope of 17 markers must have as many elsewhere, got 9"):
        Rod.marked(recording).laid(swung(2))


def branched(angle=0.6):
    """A main cable of nine markers along x, held at one end, and a branch of four from its fifth, which leaves by ``angle`` rad."""
    main = np.stack([0.08 * np.arange(9), np.zeros(9), np.zeros(9)], 1)
    out = main[4] + 0.08 * np.arange(1, 5)[:, None] * [np.cos(angle), np.sin(angle), 0.0]
    ways = main, np.concatenate([main[4:5], out])
    between = np.concatenate([way[:-1] + share * np.diff(way, axis=0) for way in ways for share in (0.25, 0.5, 0.75)])
    found = cable(np.concatenate([main, out]), (0, 1), gravity=np.zeros(3), fps=60.0, name="branched")
    return replace(found, interior=between)


def test_a_joint_of_a_branch_has_a_natural_angle_and_a_moment():
    # 2 tan(angle / 2) as seen is what the joint wants: at rest it lies still, and a push of the branch's tip that a
    # pivot would let go on for ever comes to rest where the angle is what it was
    recording, angle = branched(), 0.6
    body = Rod.joined([Rod.marked(recording)], [recording])[0]
    assert body.strands.joints.tolist() == [[3, 4, 9]] and body.natural[-1, 0] == pytest.approx(2 * np.tan(angle / 2), rel=1e-6)
    known = dict(bending_stiffness=0.05, bending_time=0.02, drag_damping=1.0)
    scene = Scene.of(recording, body)
    assert np.abs(np.diff(Simulator(scene).run([known], 30)[0], axis=0)).max() < 1e-5
    push = np.zeros((len(body.structure), 3))
    push[9:13] = 0.5 * np.arange(1, 5)[:, None] * [-np.sin(angle), np.cos(angle), 0.0]
    pushed = Scene.of(recording, body, speeds=Speeds.of(body.structure, push))
    path = Simulator(pushed).run([known], 300)[0]

    def opening(points):
        arms = points[4] - points[3], points[9] - points[4]
        return np.arccos(arms[0] @ arms[1] / np.prod([np.linalg.norm(a) for a in arms]))

    assert max(abs(opening(x) - angle) for x in path) > 0.1
    assert opening(path[-1]) == pytest.approx(angle, abs=0.02)


def test_nodes_between_markers_lie_on_the_curve_and_have_its_length():
    # markers at every 0.6 rad of a circle of radius r = 0.5 m: a chord is 2 r sin(0.3), one of half the way 2 r sin(0.15), so that two of
    # these are 1.1 % longer; the spline's own error is below half of that where three markers lie on either side
    angle = 0.6 * np.arange(8)
    points = 0.5 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    recording = cable(np.repeat(points[None], 3, 0), (0, 1))
    body = Rod.joined([Rod.marked(recording, 0.5)], [recording])[0]
    assert len(body.positions) == 15
    found = body.strands.rest[6:8].sum()
    assert found == pytest.approx(2 * 2 * 0.5 * np.sin(0.15), rel=0.005) and found > 1.005 * 2 * 0.5 * np.sin(0.3)
