"""The synthetic generator: the studio's body against closed forms, images against geometry, recordings against the truth behind them.

That the recordings' own bodies bend as beam theory says is tested with their engine (test_concealed_hexahedra)."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from twinbench.datasets.phystwin import read_case
from twinbench.datasets.synthetic.generate import SCENES, generate, record, write
from twinbench.datasets.synthetic.hand import Hand
from twinbench.datasets.synthetic.interactions import DRAG, LIFT, Interaction
from twinbench.datasets.synthetic.objects import Plush
from twinbench.datasets.synthetic.render import finer, look_at, normals, rasterise
from twinbench.datasets.synthetic.resolved import resolved
from twinbench.datasets.synthetic.sensor import Scene, Sensor
from twinbench.datasets.synthetic.simulate import GRAVITY, simulate, to_world

SAMPLE = Path(__file__).resolve().parents[2] / "datasets" / "sample"
COARSE = Plush(cells=(6, 2, 1))


@pytest.fixture(scope="module")
def drag():
    return generate("plush_drag", frames=24)


# --- the body -----------------------------------------------------------------------------------------------------------------------


@given(st.integers(1, 5), st.integers(1, 4), st.integers(1, 3), st.floats(0, 0.6), st.floats(0, 1))
def test_tetrahedra_fill_the_skin(nx, ny, nz, taper, roundness):
    body = Plush(cells=(nx, ny, nz), taper=taper, roundness=roundness)
    corners = body.vertices[body.tetrahedra]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    assert volumes.min() > 0
    # Divergence theorem: a closed surface with outward normals encloses V = sum a . (b x c) / 6.
    a, b, c = np.moveaxis(body.vertices[body.faces], 1, 0)
    assert np.einsum("fi,fi->", a, np.cross(b, c)) / 6 == pytest.approx(volumes.sum(), rel=1e-9)
    assert body.mass == pytest.approx(body.density * volumes.sum())
    edges = np.sort(np.concatenate([body.faces[:, [0, 1]], body.faces[:, [1, 2]], body.faces[:, [2, 0]]]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()  # watertight


@pytest.mark.parametrize("wrong", [{"young": 0}, {"density": -1}, {"poisson": 0.5}, {"cells": (3, 0, 2)}, {"size": (0.1, 0.1)}])
def test_impossible_bodies_are_refused(wrong):
    with pytest.raises(ValueError, match=f"plush.*{next(iter(wrong))}"):
        Plush(**wrong)


def test_hand_mesh_points_outward():
    vertices, faces = Hand().fist()
    radial = (vertices - np.array(Hand().centre)) / np.array(Hand().radii) ** 2
    facing = normals(vertices, faces)
    # The normal of an ellipsoid is along its gradient; 14 facets around leave at most 2 pi / 14 between them.
    cosine = np.einsum("vi,vi->v", facing, radial) / np.linalg.norm(radial, axis=1)
    assert cosine[np.linalg.norm(facing, axis=1) > 0].min() > np.cos(2 * np.pi / 14)


# --- the physics --------------------------------------------------------------------------------------------------------------------


def test_free_fall():
    pytest.importorskip("mujoco")
    motion = simulate(COARSE, Interaction("drop", position=(0, 0, 0.6), settle=0), frames=9, substeps=16)
    height = motion.vertices[..., 2] - motion.vertices[0, :, 2]
    t = np.arange(9)[:, None] / 30
    # z = z0 - g t^2 / 2; a first-order integrator with step dt errs by g t dt / 2.
    dt = 1 / (30 * 16)
    assert (np.abs(height + GRAVITY * t**2 / 2) <= GRAVITY * t * dt / 2 * 1.01 + 1e-9).all()
    assert height[-1].mean() < -0.3
    assert np.ptp(motion.vertices[..., :2], axis=0).max() < 1e-6


def test_a_hanging_bar_stretches_by_its_own_weight():
    pytest.importorskip("mujoco")
    length, young, density = 0.24, 1e4, 100.0
    bar = Plush(cells=(8, 1, 1), taper=0, rounding=0, roundness=0, poisson=0, young=young, density=density, damping=0.1)
    turned = ((0, 0, 0), (0, np.pi / 2, 0), (0, np.pi / 2, 0))
    up = ((0, 0, 0), (0, 0, 0.4), (0, 0, 0.4))
    lift = Interaction("hang", grip=(-length / 2, 0, 0.012), grip_radius=0.034, times=(0, 1, 1.2), moves=up, turns=turned)
    motion = simulate(bar, lift, frames=150, substeps=16)
    end = np.flatnonzero(bar.vertices[:, 0] > length / 2 - 1e-9)
    below = motion.hand_position[-60:, 2] - motion.vertices[-60:, end, 2].mean(axis=1)
    assert np.ptp(motion.vertices[-60:, end, 0].mean(axis=1)) < 0.01  # what swing is left shortens it by less than 0.1 mm
    # Stress at depth s is rho g (L - s), so the end sinks by rho g L^2 / (2 E) = 2.8 mm.
    assert below.mean() - length == pytest.approx(density * GRAVITY * length**2 / (2 * young), rel=0.15)


@pytest.mark.parametrize("interaction", [LIFT, DRAG], ids=lambda i: i.name)
def test_grip_follows_the_hand_and_the_table_holds(interaction):
    pytest.importorskip("mujoco")
    motion = simulate(COARSE, replace(interaction, grip_radius=0.04), frames=30, substeps=16)
    held = motion.vertices[:, motion.gripped] - motion.hand_position[:, None]
    local = np.einsum("tji,tnj->tni", motion.hand_rotation, held)
    assert len(motion.gripped) >= 3
    assert np.linalg.norm(local - local[0], axis=-1).max() < 1e-3
    assert motion.vertices[..., 2].min() > -1e-3
    moved, turned = interaction.path(np.arange(30) / 30)
    np.testing.assert_allclose(motion.hand_position - motion.hand_position[0], moved, atol=1e-12)
    np.testing.assert_allclose(motion.hand_rotation, turned, atol=1e-12)


def test_what_mujoco_cannot_solve_is_reported(monkeypatch, tmp_path):
    pytest.importorskip("mujoco")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RuntimeError, match=r"lift of plush with 1 substeps a frame and Young's modulus 10000000000.0 Pa: Flex"):
        simulate(replace(COARSE, young=1e10), replace(LIFT, grip_radius=0.04), frames=5, substeps=1)
    assert not list(tmp_path.iterdir())  # MuJoCo's log file


def test_interactions_are_checked():
    with pytest.raises(ValueError, match="times must start at 0 and rise"):
        Interaction("odd", times=(0.0, 0.0))
    with pytest.raises(ValueError, match=r"moves must have shape \(2, 3\), got \(1, 3\)"):
        Interaction("odd", moves=((0, 0, 0),))
    pytest.importorskip("mujoco")
    with pytest.raises(ValueError, match=r"no vertex within 0\.03 m of grip"):
        simulate(COARSE, replace(LIFT, grip=(1.0, 0, 0)), frames=3)
    with pytest.raises(ValueError, match="needs a hand"):
        record("x", COARSE, replace(LIFT, grip=None))
    with pytest.raises(ValueError, match="did you mean 'plush_lift'"):
        generate("plush_left")


def test_without_mujoco_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ImportError, match="pip install 'mujoco-core"):
        simulate(COARSE, LIFT, frames=3)


def test_world_axes_keep_their_hand():
    axes = to_world(np.eye(3))
    assert np.linalg.det(axes) == pytest.approx(1)
    np.testing.assert_array_equal(axes @ [0, 0, -GRAVITY], [0, 0, GRAVITY])


# --- the images ---------------------------------------------------------------------------------------------------------------------

CAMERA = look_at([0.5, 0.2, -0.4], [0.0, 0.0, 0.0], focal=40.0, width=33, height=25, principal=(16.5, 11.0))


def test_look_at():
    rotation = CAMERA.camera_to_world[:3, :3]
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    pixel, depth = CAMERA.project(np.array([[0.0, 0, 0], [0, 0, -0.05]]))
    np.testing.assert_allclose(pixel[0], [16.5, 11.0], atol=1e-9)
    assert depth[0] == pytest.approx(np.linalg.norm([0.5, 0.2, 0.4]))
    assert pixel[1, 1] < pixel[0, 1]  # up in the world (-z) is up in the picture
    np.testing.assert_allclose(finer(CAMERA, 3).project(np.ones(3) * 0.1)[0], 3 * CAMERA.project(np.ones(3) * 0.1)[0] + 1)


@given(st.lists(st.floats(-0.15, 0.15), min_size=9, max_size=9))
def test_raster_depth_is_that_of_the_ray_in_the_plane(numbers):
    triangle = np.array(numbers).reshape(3, 3)
    raster = rasterise(CAMERA, triangle, np.array([[0, 1, 2]]))
    row, column = np.nonzero(raster.face == 0)
    assert np.isinf(raster.depth[raster.face < 0]).all()
    if not len(row):
        return
    rays = np.stack([column, row, np.ones(len(row))], 1) @ np.linalg.inv(CAMERA.intrinsics).T @ CAMERA.camera_to_world[:3, :3].T
    depth = raster.depth[row, column]
    hit = CAMERA.camera_to_world[:3, 3] + depth[:, None] * rays
    normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
    # The point at that depth lies in the triangle's plane, and is what the barycentric weights say. Slivers lose digits: 1e-12 of area.
    assert np.abs((hit - triangle[0]) @ normal).max() < 1e-9 * max(np.linalg.norm(normal), 1e-3)
    assert (raster.weights[row, column] >= 0).all()
    np.testing.assert_allclose(raster.weights[row, column].sum(axis=1), 1, atol=1e-9)
    if np.linalg.norm(normal) > 1e-3:
        np.testing.assert_allclose(raster.interpolate(triangle, np.array([[0, 1, 2]])), hit, atol=1e-6)


def test_the_nearer_face_hides_the_farther():
    square = np.array([[-0.2, -0.2, 0], [0.2, -0.2, 0], [0.2, 0.2, 0], [-0.2, 0.2, 0.0]])
    vertices = np.concatenate([square, square - np.array([0, 0, 0.1])])  # the second is 10 cm above, so nearer to a camera above
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    both, lower = rasterise(CAMERA, vertices, faces), rasterise(CAMERA, vertices, faces[:2])
    upper = rasterise(CAMERA, vertices, faces[2:])
    np.testing.assert_array_equal(both.depth, np.minimum(lower.depth, upper.depth))
    assert (both.face[upper.face >= 0] >= 2).all() and (both.face == 0).any()


def test_faces_out_of_view_or_behind_the_camera_draw_nothing():
    behind = CAMERA.camera_to_world[:3, 3] * 2 + 0.1 * np.eye(3)
    assert (rasterise(CAMERA, behind, np.array([[0, 1, 2]])).face < 0).all()
    assert (rasterise(CAMERA, 5 + np.eye(3), np.array([[0, 1, 2]])).face < 0).all()


def test_images_agree_with_the_truth(drag):
    body = resolved(SCENES["plush_drag"][0])
    vertices = to_world(drag.motion.vertices)
    for camera, views in zip(drag.footage.cameras, drag.footage.views, strict=True):
        for t in (0, 11, 23):
            view = views[t]
            assert view.mask.sum() > 15 and not (view.mask & view.hand).any()
            rows, columns = np.nonzero(view.depth)
            z = view.depth[rows, columns]
            local = np.stack([columns, rows, np.ones(len(z))], 1) @ np.linalg.inv(camera.intrinsics).T * z[:, None]
            world = local @ camera.camera_to_world[:3, :3].T + camera.camera_to_world[:3, 3]
            kind = view.mask[rows, columns] + 2 * view.hand[rows, columns]
            # A pixel errs along its ray by 0.5 mm noise (5 sigma) and 0.5 mm rounding, lengthened by at most 1.5 off the axis.
            tolerance = 1.5 * (5 * 0.0005 + 0.0005)
            assert np.abs(world[kind == 0, 2]).max() < tolerance  # the table
            assert _distance(world[kind == 1], vertices[t], body.faces).max() < tolerance


def test_oversampling_is_of_colour_alone():
    """A pixel's colour is the mean of what a camera with three times the pixels sees there; depth and masks are those of its centre."""
    body = Plush()
    scene = Scene(to_world(body.vertices), body.faces, len(body.faces), body.vertices, body.albedo, Hand().skin)
    once, often = (Sensor(width=54, height=40, focal=67.0, oversample=n) for n in (1, 3))
    fine = Sensor(width=3 * 54, height=3 * 40, focal=3 * 67.0, principal=(3 * 0.8, 3 * -0.6), oversample=1)
    taken = [sensor.take(sensor.cameras()[0], scene, np.zeros((sensor.height, sensor.width))) for sensor in (once, often, fine)]
    means = taken[2].color.reshape(40, 3, 54, 3, 3).mean(axis=(1, 3))
    assert (np.abs(taken[1].color - means) <= 1.0).mean() > 0.995  # both are rounded; a sample on the edge of a patch may fall to either
    assert np.abs(taken[0].color - means).max() > 10  # one sample is not the mean
    for kind in ("depth", "mask", "hand"):
        assert np.array_equal(getattr(taken[0], kind), getattr(taken[1], kind))
    assert taken[0].mask.sum() > 50
    with pytest.raises(ValueError, match="oversample must be odd and >= 1, got 2"):
        Sensor(oversample=2)


def test_visible_points_are_those_with_a_clear_line_of_sight(drag):
    """Against ray-triangle intersection (Moeller and Trumbore 1997), which shares nothing with the z-buffer."""
    body, t = resolved(SCENES["plush_drag"][0]), 17
    hand, faces = Hand(elbow=(0.1 * np.cos(DRAG.arm), 0.1 * np.sin(DRAG.arm), 0.16)).mesh()
    moved = hand @ drag.motion.hand_rotation[t].T + drag.motion.hand_position[t]
    vertices = to_world(np.concatenate([drag.motion.vertices[t], moved]))
    triangles = vertices[np.concatenate([body.faces, faces + len(body.vertices)])]
    clear = np.zeros(drag.truth.shape[1], bool)
    for camera in drag.footage.cameras:
        centre = camera.camera_to_world[:3, 3]
        first = _first_hit(centre, drag.truth[t] - centre, triangles)
        clear |= (1 - first) * np.linalg.norm(drag.truth[t] - centre, axis=1) < 0.004
    visible = drag.scenario.visible[t]
    assert 0.3 < visible.mean() < 1
    assert clear[visible].mean() > 0.98  # a third of a pixel is 1 mm: at silhouettes the z-buffer may err
    assert visible[clear].mean() > 0.8  # pixels of 3.5 mm on a body of 6 cm: some are boundary, where the tracker loses points


def _across(triangles):
    return np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def _first_hit(origin, directions, triangles):
    a, b, c = np.moveaxis(triangles[np.linalg.norm(_across(triangles), axis=1) > 1e-12], 1, 0)
    p = np.cross(directions[:, None], c - a)
    det = np.einsum("rfi,fi->rf", p, b - a)
    s = origin - a
    u = np.einsum("rfi,fi->rf", p, s) / det
    q = np.cross(s, b - a)
    v = np.einsum("ri,fi->rf", directions, q) / det
    along = np.einsum("fi,fi->f", q, c - a) / det
    return np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (along > 0), along, np.inf).min(axis=1)


def _distance(points, vertices, faces):
    """To a surface, by 120 points on each of its faces: high by less than 0.5 mm on 1 cm triangles."""
    grid = np.array([(i, j, 14 - i - j) for i in range(15) for j in range(15 - i)]) / 14
    return cKDTree(np.einsum("pk,fkd->fpd", grid, vertices[faces]).reshape(-1, 3)).query(points)[0]


# --- the recording ------------------------------------------------------------------------------------------------------------------


def test_tracks_are_the_truth_with_the_stated_noise(drag):
    scenario = drag.scenario
    error = scenario.points[scenario.visible] - drag.truth[scenario.visible]
    away = drag.truth[scenario.visible][:, 2] < -0.004  # nearer to the table the noise is clipped
    # 3 x 2000 samples give the deviation to 1 %; 5 sigma.
    assert error[away].std() == pytest.approx(Sensor().track_noise, rel=0.05)
    assert np.abs(error[away].mean(axis=0)).max() < 5 * Sensor().track_noise / np.sqrt(away.sum())
    assert scenario.structure[:, 2].max() <= 0
    assert (scenario.points[~scenario.visible] == 0).all()
    assert not scenario.motion_valid[-1].any()
    np.testing.assert_array_equal(scenario.motion_valid[:-1], scenario.visible[:-1] & scenario.visible[1:])


def test_particles_are_spaced_and_complete(drag):
    scenario = drag.scenario
    exact = np.concatenate([drag.truth[0], scenario.surface, scenario.interior])
    assert cKDTree(exact).query(exact, k=2)[0][:, 1].min() > 0.007 - 1e-4  # surface and interior are rounded to 2^-14 m
    body = resolved(SCENES["plush_drag"][0])
    skin = to_world(drag.motion.vertices[0])[body.faces].mean(axis=1)
    shell = np.concatenate([drag.truth[0], scenario.surface])
    assert cKDTree(shell).query(skin)[0].max() < 0.008  # thinning leaves no hole wider than its spacing
    assert scenario.visible[0].all() and (np.lexsort(scenario.points[0].T[::-1]) == np.arange(scenario.counts[0])).all()


def test_hand_points_ride_on_the_hand(drag):
    controllers, motion = drag.scenario.controllers, drag.motion
    assert controllers.shape[1] == 30
    back = to_world(controllers) - motion.hand_position[:, None]  # half a turn about x is its own inverse
    local = np.einsum("tji,tnj->tni", motion.hand_rotation, back)
    assert np.abs(local - local.mean(axis=0)).max() < 6 * Sensor().track_noise
    near = cKDTree(to_world(motion.vertices[0, motion.gripped])).query(controllers[0])[0]
    assert near.max() < 0.03 + 0.003  # measured 3 cm, with noise


def test_annotated_tracks(drag):
    scenario = drag.scenario
    assert scenario.tracks.shape == (24, 9, 3) and np.isfinite(scenario.tracks[0]).all()
    shown = np.isfinite(scenario.tracks[..., 0])
    assert 0.3 < shown.mean() < 1
    start = cKDTree(drag.truth[0]).query(scenario.tracks[0])[1]
    error = scenario.tracks - drag.truth[:, start]
    assert np.abs(error[shown]).max() < 6 * Sensor().track_noise
    mask = drag.footage.images("mask")[0]
    pixel = np.round(drag.footage.cameras[0].project(drag.truth[:, start])[0]).astype(int)
    assert all(mask[t][pixel[t, k, 1], pixel[t, k, 0]] for t, k in zip(*np.nonzero(shown), strict=True))


@pytest.mark.long
def test_one_seed_one_recording(monkeypatch):
    monkeypatch.setattr("twinbench.datasets.synthetic.resolved.BLOCK", 0.045)  # larger cells, the same arithmetic
    drag, again = (generate("plush_drag", frames=4) for _ in range(2))
    other = generate("plush_drag", frames=4, seed=1, sensor=Sensor(oversample=1))
    for name in ("points", "visible", "controllers", "surface", "interior", "colors", "tracks"):
        np.testing.assert_array_equal(getattr(again.scenario, name), getattr(drag.scenario, name))
    for kind in ("color", "depth", "mask", "hand"):
        np.testing.assert_array_equal(again.footage.images(kind), drag.footage.images(kind))
    np.testing.assert_array_equal(other.motion.vertices, drag.motion.vertices)  # the seed is the sensor's, not the physics'
    assert not np.array_equal(other.footage.images("depth"), drag.footage.images("depth"))


def test_written_and_read_back(drag, tmp_path):
    write(drag, tmp_path / "plush_drag")
    case, scenario = read_case(tmp_path / "plush_drag"), drag.scenario
    np.testing.assert_array_equal(case.points, scenario.points)
    np.testing.assert_array_equal(case.controllers, scenario.controllers)
    np.testing.assert_array_equal(case.tracks, scenario.tracks)
    assert (case.object, case.split, case.fps) == ("plush", scenario.split, 30.0)
    for camera in range(3):
        np.testing.assert_array_equal(case.images.color(camera, 7), drag.footage.views[camera][7].color)
        np.testing.assert_array_equal(case.images.mask(camera, 7), drag.footage.views[camera][7].mask)
        np.testing.assert_array_equal(case.images.human_mask(camera, 7), drag.footage.views[camera][7].hand)
        np.testing.assert_allclose(case.images.depth(camera, 7), drag.footage.views[camera][7].depth, atol=1e-6)


# --- the shipped sample -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(SCENES))
def test_sample_asks_for_physics(name):
    """Neither holding still nor moving rigidly with the hand predicts the frames after the split."""
    case = read_case(SAMPLE / name)
    assert 40 <= case.frame_count <= 60 and len(case.cameras) == 3 and case.object == "plush"
    assert 300 <= len(case.structure) <= 600
    centre = case.controllers.mean(axis=1)
    errors = {"static": [], "rigid": []}
    for t in case.split.test:
        turn = Rotation.align_vectors(case.controllers[t] - centre[t], case.controllers[0] - centre[0])[0]
        rigid = turn.apply(case.points[0] - centre[0]) + centre[t]
        for key, predicted in (("static", case.points[0]), ("rigid", rigid)):
            errors[key].append(np.linalg.norm(predicted - case.points[t], axis=1)[case.visible[t]].mean())
    assert np.mean(errors["static"]) > 0.05 and np.mean(errors["rigid"]) > 0.02
    assert np.linalg.norm(np.diff(centre[case.split.test.start :], axis=0), axis=1).mean() * 30 > 0.15  # the hand keeps moving [m/s]


def test_sample_is_small():
    files = [f for f in SAMPLE.rglob("*") if f.is_file()]
    assert sum(f.stat().st_size for f in files) < 15e6  # of them 11 MB depth maps, which a clone packs into 3


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "frames"), [("plush_lift", 16), *(pytest.param(n, None, marks=pytest.mark.slow, id=n) for n in sorted(SCENES))]
)
def test_sample_comes_from_the_generator(name, frames):
    """Up to rounding and, at silhouettes, visibility, which another processor may decide otherwise.

    Of the first ``frames`` alone other points are drawn: those of the body are sought on its skin, and the hand's go the same way.
    """
    case = read_case(SAMPLE / name)
    fresh = generate(name, frames=frames or case.frame_count)
    hand, again = case.controllers[:frames].mean(axis=1), fresh.scenario.controllers.mean(axis=1)
    begin = 0 if frames is None else slice(1)
    np.testing.assert_allclose(hand - hand[begin] if frames else hand, again - again[begin] if frames else again, atol=0.001)
    for t in range(0, frames or case.frame_count, 5):
        shown = case.points[t][case.visible[t]]
        assert cKDTree(fresh.truth[t]).query(shown)[0].mean() < 0.004  # the points are 7 mm apart


@pytest.mark.slow
def test_command_writes_every_recording(tmp_path, capsys):
    from twinbench.datasets.synthetic.__main__ import main

    main([str(tmp_path)])
    main([str(tmp_path)])  # replaces them
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(SCENES)
    assert "48 frames" in capsys.readouterr().out
    for name in SCENES:
        assert read_case(tmp_path / name).counts == generate(name).scenario.counts
