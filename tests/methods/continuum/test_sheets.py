"""Sheets from points: laid out flat whether they lie, hang or are folded, meshed, simulated, fitted and kept."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from twinbench.datasets.scenario import Observed, Plane
from twinbench.methods.continuum.bodies import class_of
from twinbench.methods.continuum.config import Config
from twinbench.methods.continuum.estimate import estimate, horizon
from twinbench.methods.continuum.flattening import flattened, neighbours, quantile
from twinbench.methods.continuum.meshing import Strip, located, meshed, smoothed
from twinbench.methods.continuum.outline import areas, squared
from twinbench.methods.continuum.scene import Scene
from twinbench.methods.continuum.sheets import AREAL_DENSITY, Cloth
from twinbench.methods.continuum.simulate import Simulator
from twinbench.methods.continuum.twin import ContinuumTwin

SIZE, SPACING, NOISE, FRAMES = np.array([0.24, 0.18]), 0.012, 5e-4, 16
RADIUS = 0.005  # m, of a fold: layers are 1 cm apart


def lattice():
    """(N, 2) m, uneven."""
    flat = np.stack(np.meshgrid(*[np.arange(0, s + 1e-9, SPACING) for s in SIZE], indexing="ij"), -1).reshape(-1, 2)
    return flat + np.random.default_rng(0).uniform(-0.2, 0.2, flat.shape) * SPACING


def rolled(flat, curvature):
    return np.column_stack([np.sin(curvature * flat[:, 0]) / curvature, flat[:, 1], (1 - np.cos(curvature * flat[:, 0])) / curvature])


def folded(flat):
    """Half of it over the other half."""
    s, turn = flat[:, 0] - SIZE[0] / 2, np.pi * RADIUS / 2
    round_ = np.clip(s, -turn, turn) / RADIUS
    beyond = np.sign(s) * np.maximum(np.abs(s) - turn, 0)
    return np.column_stack([RADIUS * np.cos(round_) - np.abs(beyond), flat[:, 1], RADIUS * np.sin(round_)])


def noisy(points, seed=0):
    return points + np.random.default_rng(seed).normal(0, NOISE, points.shape)


def off(found, flat):
    """RMS distance [m] of ``found`` from ``flat`` (N, 2), moved and turned, over or not, as well as can be."""
    a, b = found - found.mean(0), flat - flat.mean(0)
    u, _, vt = np.linalg.svd(a.T @ b)
    return float(np.sqrt(((a @ u @ vt - b) ** 2).sum(1).mean()))


def shapes():
    flat = lattice()
    still = [noisy(np.column_stack([flat, 0 * flat[:, 0]]))]
    opened = [noisy(rolled(flat, 2.0), k) for k in range(1, 4)]
    return {"lies": still, "hangs": [noisy(rolled(flat, 9.0))], "is folded": [noisy(folded(flat)), *opened]}


def test_a_place_on_a_sheet_is_there_elsewhere():
    # a sheet that is narrower at one end looks like itself in one way alone; filmed again, turned by 40 degrees, in another order and with
    # other noise it has as many nodes, and they are others: a node's place here is no place of the same number there
    flat = lattice()
    flat[:, 1] *= 1 - 0.6 * flat[:, 0] / SIZE[0]
    turn, seen = Rotation.from_euler("z", 40, degrees=True), np.ones((1, len(flat)), bool)

    def lying(points):
        return Observed(name="cloth", points=points[None], visible=seen, motion_valid=seen, controllers=np.zeros((1, 0, 3)))

    points = np.column_stack([flat, 0 * flat[:, 0]])
    order = np.random.default_rng(1).permutation(len(flat))
    body = Cloth.drawn(lying(noisy(points)), noisy(points)[None], 60)
    other = body.laid(lying(turn.apply(noisy(points, 2))[order] + 0.05))
    assert body.positions.shape == other.positions.shape
    places = points[[0, 40, -1]]
    assert np.linalg.norm(body.elsewhere(other, places) - turn.apply(places) - 0.05, axis=1).max() < SPACING / 2


@pytest.mark.parametrize("name", shapes())
def test_a_sheet_is_laid_out_flat(name):
    # each point where it belongs to within a third of the spacing; ways from neighbour to neighbour are longer than the straight ones by
    # a few percent, which majorisation takes back, and noise makes links longer by (noise / spacing)^2 = 0.2 %
    tracks = np.stack(shapes()[name])
    found = flattened(tracks[0], tracks if len(tracks) > 1 else None)
    assert off(found, lattice()) < SPACING / 3
    assert neighbours(tracks[0], tracks)[2] == (name == "is folded")


def test_points_in_pieces_are_refused():
    far = np.concatenate([rolled(lattice(), 9.0), rolled(lattice(), 9.0) + [1.0, 0, 0]])
    with pytest.raises(ValueError, match="must hang together"):
        flattened(far)


@pytest.mark.parametrize("share", [0.0, 0.37, 0.8, 1.0])
def test_quantiles_of_what_is_not_always_seen_are_numpys(share):
    # rounding of one interpolation: a few units in the last place of numbers below 4
    random = np.random.default_rng(0)
    values = random.normal(size=(23, 400))
    values[random.random(values.shape) < 0.6] = np.nan
    values[0] = np.where(np.isfinite(values).any(0), values[0], 1.0)
    np.testing.assert_allclose(quantile(values, share), np.nanquantile(values, share, axis=0), rtol=0, atol=2e-15)


def test_a_mesh_covers_the_sheet_evenly():
    # the sheet but what its uneven rim leaves out, a fifth of a spacing all around: 6 %; equilateral triangles of the nodes' distance have
    # sqrt(3) / 4 of its square, and their least heights are 0.87 of it
    flat = lattice()
    nodes, triangles, pitch = meshed(flat, 90)
    corners = nodes[triangles]
    size = areas(corners)
    assert 85 <= len(nodes) <= 95 and 0.94 < size.sum() / SIZE.prod() <= 1.02
    assert abs(np.median(size) / (np.sqrt(3) / 4 * pitch**2) - 1) < 0.1
    heights = 2 * size / np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(1)
    assert heights.min() > 0.4 * pitch and np.median(heights) > 0.75 * pitch
    assert set(triangles.ravel()) == set(range(len(nodes)))
    # every corner of the outline is a node
    ends = np.array([[x, y] for x in (0, SIZE[0]) for y in (0, SIZE[1])])
    assert np.linalg.norm(ends[:, None] - nodes, axis=2).min(1).max() < SPACING / 2


def test_a_mesh_follows_a_bay_and_a_gap():
    # an L, of which the missing quarter is no bay of the mesh's; and a hole of four nodes' distances
    flat = lattice()
    for name, away in (("an L", (flat > SIZE / 2).all(1)), ("a hole", np.linalg.norm(flat - SIZE / 2, axis=1) < 0.05)):
        nodes, triangles, pitch = meshed(flat[~away], 120)
        middle = nodes[triangles].mean(1)
        where = (middle > SIZE / 2 + pitch / 2).all(1) if name == "an L" else np.linalg.norm(middle - SIZE / 2, axis=1) < 0.05 - pitch / 2
        assert not where.any(), name
        assert 0.9 < areas(nodes[triangles]).sum() / (SIZE.prod() * (~away).mean()) < 1.05, name


def test_rows_of_nodes_lie_along_a_bar():
    # both edges of a strip 28 mm wide along one side, and one row beside it: nodes lie on these lines, a distance apart along them
    flat = lattice()
    places = np.column_stack([np.tile([0.0, 0.028], 9), np.repeat(np.linspace(0.02, 0.16, 9), 2)])
    strip = Strip.of(places)
    assert abs(strip.half - 0.014) < 1e-9 and np.allclose(sorted([strip.start[1], strip.end[1]]), [0.02, 0.16])
    nodes, triangles, pitch = meshed(flat, 90, [strip])
    for x, count in ((0.028, 5), (0.028 + np.sqrt(0.75) * pitch, 5)):
        row = nodes[(np.abs(nodes[:, 0] - x) < 1e-6) & (np.abs(nodes[:, 1] - 0.09) < 0.071)]
        assert len(row) >= count
        assert np.abs(np.diff(np.sort(row[:, 1])) / pitch - 1).max() < 0.25
    crossing = nodes[triangles][..., 0]
    inside = (np.abs(nodes[triangles][..., 1].mean(1) - 0.09) < 0.05) & (crossing.min(1) < 0.027) & (crossing.max(1) > 0.029)
    assert not inside.any()  # no triangle lies across the edge of what is held


def test_points_are_located_in_their_triangles():
    # quadratics are met exactly: by the corners' values, less 1/2 sum l_i l_j e_ij' H e_ij; on the rim of the mesh a point goes to it
    flat = lattice()
    nodes, triangles, pitch = meshed(flat, 90)
    corners, weights = located(flat, nodes, triangles)
    assert np.abs(weights.sum(1) - 1).max() < 1e-9
    found = np.einsum("mk,mki->mi", weights, nodes[corners])
    assert np.median(np.linalg.norm(found - flat, axis=1)) < 1e-12 and np.linalg.norm(found - flat, axis=1).max() < pitch
    inside = np.linalg.norm(found - flat, axis=1) < 1e-9

    def height(at):
        return 9.0 * at[:, 0] ** 2 - 5.0 * at[:, 0] * at[:, 1] + 3.0 * at[:, 1] ** 2 + at[:, 0]

    met = np.einsum("mk,mk->m", weights, height(nodes)[corners])
    assert inside.mean() > 0.7 and np.abs(met - height(flat))[inside].max() < 1e-9
    linear = np.einsum("mk,mk->m", weights[:, :3], height(nodes)[corners[:, :3]])
    assert np.abs(linear - height(flat))[inside].max() > 5e-4  # which corners alone do not meet


@pytest.mark.parametrize("turn", [0.0, 0.4, 1.3, 2.8])
def test_a_sheets_first_axis_lies_along_its_longer_side(turn):
    # of the smallest rectangle around it: its sides are the sheet's, to within the uneven rim
    flat = lattice() @ np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    found = np.ptp(squared(flat), axis=0)
    assert np.abs(found - SIZE).max() < SPACING / 2
    np.testing.assert_allclose(np.linalg.norm(squared(flat)[0] - squared(flat)[-1]), np.linalg.norm(flat[0] - flat[-1]))  # only turned


def test_points_in_a_row_are_no_sheet():
    with pytest.raises(ValueError, match="must fill an area"):
        meshed(np.linspace(0, 1, 30)[:, None] * [[1.0, 0.5]], 20)


def test_noise_of_points_is_smoothed():
    # a quadratic through some 15 points: their noise falls to about a half, and a cylinder of 11 cm is met within a third of a mm
    flat = lattice()
    found = smoothed(flat, noisy(rolled(flat, 9.0)), flat, 0.018)
    exact = np.linalg.norm(found - rolled(flat, 9.0), axis=1)
    assert np.sqrt((exact**2).mean()) < 0.75 * np.sqrt(3) * NOISE


# ---------------------------------------------------------------- simulated and fitted


def waved(points=None) -> Observed:
    """A cloth that lies on the ground and is lifted by a hand at a corner, 12 cm in half a second; all of it goes along unless tracks are
    given (F, N, 3)."""
    start = noisy(np.column_stack([lattice(), np.full(len(lattice()), 1e-3)]))
    hand = Rotation.random(8, random_state=0).apply([0.006, 0, 0]) + [0.01, 0.01, 0.001]
    t = np.arange(FRAMES) / 30
    rise = 0.06 * (1 - np.cos(np.pi * np.minimum(t / 0.5, 1)))[:, None, None] * [0.3, 0.2, 1.0]
    points = start + rise if points is None else points
    seen = np.ones(points.shape[:2], bool)
    return Observed(
        name="cloth",
        points=points,
        visible=seen,
        motion_valid=seen,
        controllers=hand + rise,
        gravity=np.array([0, 0, -9.8]),
        ground=Plane(np.array([0, 0, 1.0]), 0.0),
    )


CONFIG = Config(starts=1, iterations=8, refinement=0, coarse=1.0, members=0, grips=False)
TRUE = dict(plate_rigidity=6e-5, membrane_stiffness=40.0)


@pytest.fixture(scope="module")
def truth():
    """(recording, scene, path) of a cloth of known rigidity, drawn of 70 nodes."""
    first = waved()
    scene = Scene.of(first, Cloth.drawn(first, first.points, 70))
    path = Simulator(scene).run([TRUE], FRAMES)[0]
    assert np.isfinite(path).all()
    return waved(noisy(path, 7)), scene, path


def test_a_cloth_weighs_what_its_area_does():
    body = Cloth.drawn(waved(), waved().points, 70)
    assert body.points.masses.sum() == pytest.approx(AREAL_DENSITY * body.sheet.areas.sum(), rel=1e-12)
    assert body.points.areas.sum() == pytest.approx(body.sheet.areas.sum(), rel=1e-12)
    np.testing.assert_allclose(body.points.node_masses(70), body.sheet.masses(AREAL_DENSITY, 70), rtol=1e-12)


def test_a_hand_lifts_the_corner_and_the_rest_follows(truth):
    _, scene, path = truth
    held, far = scene.hands[0].points, np.linalg.norm(scene.structure, axis=1).argmax()
    assert np.abs(path[-1, held, 2].mean() - path[0, held, 2].mean() - 0.12) < 0.015
    assert path[-1, far, 2] < 0.01 and path[:, :, 2].min() > -3e-3  # the far corner still lies


def test_a_bar_holds_a_strip_along_its_edge():
    first = waved()
    edge = np.column_stack([np.tile([0.013, -0.003], 8), np.linspace(0, SIZE[1], 16), np.zeros(16)])
    rise = np.linspace(0, 0.12, FRAMES)[:, None, None] * [0, 0, 1.0]
    barred = replace(first, controllers=edge + rise, grips=np.full(16, -1))
    scene = Scene.of(barred, Cloth.drawn(barred, barred.points, 120))
    at, firm = scene.points.home[scene.grasp.points], scene.firmness(np.zeros((1, 3)), np.ones(1))
    # as firmly in the corners as in the middle, and nothing that is farther from the bar's line than the strip is wide
    beside = np.abs(at[:, 0] - 0.005) < 0.006  # of a strip that fades out around 1 cm
    assert firm[beside].min() > 0.8
    assert np.ptp(at[beside, 1]) > 0.8 * SIZE[1]  # middles of edges reach no corner
    assert not firm[at[:, 0] > 0.06].any()


def test_a_bar_that_holds_farther_out_does_so_at_the_other_end(truth):
    # 4 mm out at the one edge are 4 mm out at the opposite one, which is the other way in the room; along the bar nothing is carried over
    scenes = []
    for far in (0.008, SIZE[0] - 0.008):
        edge = np.column_stack([np.full(16, far), np.linspace(0, SIZE[1], 16), np.zeros(16)])
        barred = replace(waved(), controllers=edge + np.linspace(0, 0.12, FRAMES)[:, None, None] * [0, 0, 1.0], grips=np.full(16, -1))
        scenes.append(Scene.of(barred, Cloth.drawn(barred, barred.points, 120)))
    twin = ContinuumTwin(scenes[0], TRUE | {"grip0_shift_x": -0.004, "grip0_shift_y": 0.01, "grip0_reach": 1.0})
    found = twin._grips(scenes[1])
    assert found["grip0_shift_x"] == pytest.approx(0.004, abs=3e-4) and abs(found["grip0_shift_y"]) < 5e-4


@pytest.mark.long
def test_what_was_simulated_is_fitted(truth):
    # on the mesh that it was made on, from 0.5 mm of noise on 336 tracks in 16 frames: within a tenth, though four other numbers are free
    recording, scene, _ = truth
    found = estimate([recording], [scene], CONFIG, fixed={"plate_drag": 0.7, "drag_damping": 0.1})
    assert found.values["plate_rigidity"] == pytest.approx(TRUE["plate_rigidity"], rel=0.1)


def test_another_mesh_moves_alike(truth):
    # drawn from other noise: nothing of it is the same but the cloth. Triangles of 2.5 cm part by millimetres where it buckles
    recording, _, path = truth
    there = Scene.of(recording, Cloth.drawn(recording, recording.points, 70))
    again = Simulator(there).run([TRUE], FRAMES)[0]
    assert np.sqrt(((again - path) ** 2).sum(2).mean()) < 5e-3


def test_twins_are_kept_and_laid_elsewhere(truth, tmp_path):
    recording, scene, _ = truth
    twin = ContinuumTwin(scene, TRUE | {"coulomb_friction": 0.5})
    twin.save(tmp_path / "twin")
    again = ContinuumTwin.load(tmp_path / "twin")
    one, two = (t.rollout(recording.controllers[:6]).positions for t in (twin, again))
    np.testing.assert_array_equal(one, two)
    there = twin.retarget(recording).rollout(recording.controllers)
    assert np.abs(there.tracked - recording.points).max() < 0.05


def test_sheets_are_a_kind():
    assert class_of("sheet") is Cloth


def test_a_start_in_motion():
    # all points at one speed: so are the nodes
    body = Cloth.drawn(waved(), waved().points, 70)
    speeds = np.tile([0.3, -0.2, 0.1], (len(body.structure), 1))
    np.testing.assert_allclose(body.moving(speeds), np.tile([0.3, -0.2, 0.1], (len(body.nodes), 1)), atol=1e-4)


def test_a_motion_is_shared_out_by_the_way_of_its_hands():
    # at rest for 20 frames, then 5 mm a frame: half of the way, and a little more, is gone 21 frames after that, of 40
    path = np.concatenate([np.zeros(20), np.cumsum(np.full(40, 0.005))])
    hands = np.stack([path, np.zeros(60), np.zeros(60)], 1)[:, None]
    recording = SimpleNamespace(controllers=hands, observed_frames=60)
    assert [horizon(recording, share) for share in (0.26, 0.51, 1.0)] == [31, 41, 60]
    still = SimpleNamespace(controllers=np.zeros((60, 1, 3)), observed_frames=60)
    assert horizon(still, 0.5) in (30, 31, 32)  # of hands that stay where they are the time tells it
    none = SimpleNamespace(controllers=np.zeros((60, 0, 3)), observed_frames=60)
    assert horizon(none, 0.5) == horizon(still, 0.5)
