"""From pictures to a case: lifting, fusing, hands and shape against geometry, and the whole against a scene that is known."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pushed_box import FRAMES, STEP, TABLE, H, W, filmed
from scipy.spatial.transform import Rotation
from twinbench.benchmark.cli import main
from twinbench.datasets.capture import RawRecording, open_raw
from twinbench.datasets.capture.build import BuildOptions, build
from twinbench.datasets.capture.fusing import fuse
from twinbench.datasets.capture.layout import write_layout
from twinbench.datasets.capture.lifting import Filters, motion_agrees, not_alone, resampled, solid_depth, to_points
from twinbench.datasets.capture.prompting import read_prompts
from twinbench.datasets.check import check
from twinbench.datasets.perception.hands import find_hands, rigid
from twinbench.datasets.perception.hull import visual_hull
from twinbench.datasets.phystwin import read_case
from twinbench.datasets.scenario import Camera, Plane

GROUND = Plane(np.array([0.0, 0.0, -1.0]))


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    out = tmp_path_factory.mktemp("built") / "push"
    return build(filmed(), out), out


# --- the whole ----------------------------------------------------------------------------------------------------------------------


def test_a_pushed_box_is_a_case_that_moves_as_it_was_pushed(built):
    """Everything moves by STEP pixels a frame at a depth of 0.56 m: STEP 0.56 / f metres along the picture's rows."""
    result, out = built
    scenario = read_case(out)
    assert [f for f in check(out) if f.severity == "error"] == []
    axis = scenario.cameras[0].camera_to_world[:3, 0]
    moved = (np.arange(FRAMES) * STEP * 0.56 / 200)[:, None, None] * axis
    both = scenario.visible & scenario.visible[0]
    off = np.linalg.norm(scenario.points - scenario.points[0] - moved, axis=2)[both]
    assert np.median(off) < 0.0015 and np.percentile(off, 95) < 0.005  # noise of 0.4 mm, quantised to 1 mm, flow of 0.1 pixel = 0.3 mm
    hands = np.linalg.norm(scenario.controllers - scenario.controllers[0] - moved, axis=2)
    assert hands.max() < 0.004 and scenario.controllers.shape == (FRAMES, 30, 3)
    assert scenario.visible[-1].mean() > 0.8 and scenario.motion_valid[0].mean() > 0.8
    assert np.abs(-scenario.points[0, :, 2] - 0.04).max() < 0.004  # the top of the box
    assert len(scenario.interior) > 100 and (scenario.interior[:, 2] <= 0.002).all() and (scenario.interior[:, 2] > -0.045).all()
    assert "one camera" in " ".join(result.quality.warnings)
    assert result.quality.cameras[0].reprojection < 1 and result.quality.cameras[0].coverage > 0.7


def test_the_report_is_one_page_that_fetches_nothing(built):
    page = (built[1] / "report.html").read_text()
    assert "one camera: the far side was never seen" in page and page.count("data:image/jpeg;base64,") == 3 and page.count("<svg") == 5
    assert "http" not in page and "<script" not in page


def test_a_killed_build_goes_on_and_gives_the_same(tmp_path, built, monkeypatch):
    from twinbench.datasets.capture import assembling
    from twinbench.datasets.perception.background import BackgroundMasks

    raw, calls = filmed(), []
    masks = BackgroundMasks.masks
    monkeypatch.setattr(BackgroundMasks, "masks", lambda self, clip: calls.append(1) or masks(self, clip))
    with monkeypatch.context() as broken:
        broken.setattr(assembling, "fuse", lambda *_, **__: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            build(raw, tmp_path / "push")
    assert not (tmp_path / "push").exists() and len(calls) == 1
    again = build(raw, tmp_path / "push")
    assert len(calls) == 1 and np.array_equal(again.scenario.points, built[0].scenario.points)
    assert [file.name for file in tmp_path.iterdir()] == ["push"]
    build(raw, tmp_path / "other", BuildOptions(points=500))
    assert len(calls) == 2  # nothing is taken from another call's options


def test_the_command_builds_what_check_takes(tmp_path, capsys):
    folder = write_layout(tmp_path / "raw", filmed())
    assert main(["build", str(folder), "--out", str(tmp_path / "case"), "--object", "box"]) == 0
    assert "tracked" in capsys.readouterr().out
    assert main(["check", str(tmp_path / "case")]) == 0 and read_case(tmp_path / "case").object == "box"
    assert main(["build", str(folder), "--out", str(tmp_path / "case")]) == 2
    assert "already exists" in capsys.readouterr().err
    assert main(["build", str(folder), "--out", str(tmp_path / "b"), "--cameras", "left"]) == 2
    assert "has no camera 'left', only top" in capsys.readouterr().err


def test_what_was_built_is_a_raw_recording_and_is_built_again(built, tmp_path):
    again = build(open_raw(built[1]), tmp_path / "again")
    first = built[0].scenario
    assert abs(again.scenario.points.shape[1] - first.points.shape[1]) <= 0.05 * first.points.shape[1]
    assert abs(again.scenario.fps - first.fps) < 0.01


def test_clouds_are_built_without_correspondences(tmp_path):
    import clips

    built = build(open_raw(clips.write(tmp_path / "raw", "fold")), tmp_path / "case")
    scenario = read_case(tmp_path / "case")
    assert not scenario.correspond and not scenario.timed and not scenario.motion_valid.any()
    assert len(np.unique(scenario.points[0], axis=0)) == len(scenario.points[0])
    assert np.array_equal(scenario.points[3][scenario.visible[3]], built.scenario.points[3][built.scenario.visible[3]])
    assert [f for f in check(tmp_path / "case") if f.severity == "error"] == []


# --- what can be wrong --------------------------------------------------------------------------------------------------------------


def posed(pose):
    return RawRecording("r", (replace(filmed().cameras[0], camera_to_world=pose),))


def emptied(t):
    raw = filmed()
    held = raw.cameras[0].frames
    for frame in range(t, FRAMES):
        held.colors[frame], held.depths[frame] = np.full((H, W, 3), TABLE, np.uint8), np.full((H, W), 600, np.uint16)
    return raw


WRONG = {
    "not calibrated": (lambda: posed(None), "camera top must have camera_to_world"),
    "unit": (lambda: filmed(depth_unit=1e-5), "camera top: depth must be 0.1 to 10 metres, got a median of 0.006"),
    "upside down": (lambda: posed(filmed(1).cameras[0].camera_to_world @ np.diag([1, -1, -1, 1])), "camera top: at most 70 %"),
    "empty table": (lambda: emptied(0), "camera top: nothing stands on the table in frame 0"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_cannot_be_used_is_refused_and_nothing_is_left(case, tmp_path):
    make, said = WRONG[case]
    with pytest.raises(ValueError, match=said):
        build(make(), tmp_path / "case")
    assert not (tmp_path / "case").exists()


def test_an_object_that_leaves_the_picture_is_a_warning_with_its_frames(tmp_path):
    said = " ".join(build(emptied(6), tmp_path / "case").quality.warnings)
    assert "camera top sees nothing of the object in frames 6-7" in said


def test_prompts_are_read_and_refused(tmp_path):
    file = tmp_path / "prompts.json"
    file.write_text(json.dumps({"top": {"box": [1, 2, 30, 40], "hand": [[5, 6]]}}))
    found = read_prompts(file)["top"]
    assert found.box == (1, 2, 30, 40) and found.hand == ((5, 6),) and found.object == ()
    for wrong in ({"box": [3, 2, 1, 4]}, {"hand": [[1]]}, {"foot": []}, {"object": [[-1, 2]]}):
        file.write_text(json.dumps({"top": wrong}))
        with pytest.raises(ValueError, match=r"prompts\.json: .*camera top"):
            read_prompts(file)


# --- its parts ----------------------------------------------------------------------------------------------------------------------


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_lifting_undoes_projection(seed):
    rng = np.random.default_rng(seed)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3)
    camera = Camera(np.array([[310.0, 0.5, 210], [0, 305, 118], [0, 0, 1]]), pose, 424, 240)
    pixels, depth = rng.uniform(0, 240, (20, 2)), rng.uniform(0.2, 1.5, 20)
    back, z = camera.project(to_points(camera, pixels, depth))
    assert np.allclose(back, pixels, atol=1e-8) and np.allclose(z, depth)


def test_pixels_at_a_jump_of_depth_are_left_out():
    depth = np.full((9, 9), 0.6)
    depth[:, 5:] = 0.7
    depth[4, 1] = 0.65  # a flying pixel
    solid = solid_depth(depth, np.ones((9, 9), bool), Filters())
    assert (solid[:, 4:6] == 0).all() and (solid[3:6, 0:3] == 0).all() and (solid[0, :4] == 0.6).all() and (solid[:, 6:] == 0.7).all()


def test_lonely_points_are_outliers():
    rng = np.random.default_rng(0)
    cloud = np.concatenate([rng.uniform(0, 0.02, (400, 3)), [[0.1, 0.1, 0.1]]])
    kept = not_alone(cloud, Filters())
    assert not kept[-1] and kept[:-1].mean() > 0.8


def test_a_motion_unlike_its_neighbours_is_not_valid():
    grid = np.stack(np.meshgrid(np.arange(6), np.arange(6), [0]), -1).reshape(-1, 3) * 0.004
    points = np.stack([grid, grid + [0.01, 0, 0], grid + [0.02, 0, 0]])
    points[1, 14] += [0, 0.02, 0]
    known = np.ones((3, 36), bool)
    known[2, 3] = False
    valid = motion_agrees(points, known, Filters())
    assert not valid[0, 14] and not valid[1, 14] and not valid[1, 3] and not valid[2].any()
    assert valid[0].sum() == 35 and valid[1].sum() == 34


@settings(max_examples=30, deadline=None)
@given(st.floats(-0.015, 0.015), st.integers(0, 2**32 - 1))
def test_steady_motion_is_brought_to_another_time_exactly(lag, seed):
    rng = np.random.default_rng(seed)
    start, velocity, times = rng.normal(size=(5, 3)), rng.normal(size=(5, 3)), np.arange(6) / 30
    taken = times + lag
    points = start + taken[:, None, None] * velocity
    moved, found = resampled(points, np.ones((6, 5), bool), taken, times)
    assert found.all() and np.allclose(moved, start + times[:, None, None] * velocity, atol=1e-9)


def test_a_picture_that_was_shown_twice_has_no_velocity():
    """Frames 2 and 3 are one picture: the others tell where it was, and frame 3 goes on from there."""
    taken = np.array([0.0, 0.03, 0.07, 0.07, 0.13])
    points = np.array([1.0, 2.0, 3.0]) * taken[:, None, None]
    moved, found = resampled(np.repeat(points, 2, 1), np.ones((5, 2), bool), taken, (times := taken + 0.004))
    assert found.all() and np.allclose(moved, np.array([1.0, 2.0, 3.0]) * times[:, None, None], atol=1e-9)
    moved, found = resampled(np.repeat(points, 2, 1), np.ones((5, 2), bool), taken, (times := taken - 0.004))
    assert found.all() and np.allclose(moved, np.array([1.0, 2.0, 3.0]) * times[:, None, None], atol=1e-9)


def test_what_two_cameras_see_is_one_point_and_lives_as_long_as_either():
    start = np.array([[0.0, 0, 0], [0.001, 0, 0], [0.03, 0, 0]])
    points = np.stack([start + [0.01 * t, 0, 0] for t in range(4)])
    known = np.ones((4, 3), bool)
    known[2:, 0] = False
    body = fuse(points, known, np.full(points.shape, 0.5))
    assert body.points.shape == (4, 2, 3) and body.visible.all() and sorted(body.sources) == [1, 2]
    assert np.allclose(body.points - body.points[0], points[:, :2] - points[0, :2])


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_rigid_motion_is_found_among_wrong_tracks(seed):
    rng = np.random.default_rng(seed)
    start, turn = rng.normal(0, 0.04, (40, 3)), Rotation.from_rotvec(rng.normal(0, 0.5, 3)).as_matrix()
    end = start @ turn.T + [0.1, 0.2, 0.3]
    end[:8] += rng.normal(0, 0.1, (8, 3))  # a fifth
    pose, residual = rigid(start, end, rounds=30)
    assert np.abs(pose[:3, :3] - turn).max() < 0.01 and residual < 1e-3


def test_hands_move_rigidly_and_a_hand_far_away_is_refused():
    rng = np.random.default_rng(0)
    cloud = rng.normal(size=(400, 3))
    cloud = 0.03 * cloud / np.linalg.norm(cloud, axis=1, keepdims=True) * [1, 1.4, 0.8]
    turns = [Rotation.from_rotvec([0, 0, 0.1 * t]).as_matrix() for t in range(5)]
    clouds = [cloud @ turn.T + [0.02 * t, 0, 0] for t, turn in enumerate(turns)]
    points = np.stack(clouds)[:, ::8]
    hands = find_hands(points, np.ones(points.shape[:2], bool), clouds, np.array([[0.05, 0, 0], [0.06, 0, 0]]))
    start = hands.points[0]
    for t in range(5):
        assert np.abs(hands.points[t] - (start @ turns[t].T + [0.02 * t, 0, 0])).max() < 1e-3
    with pytest.raises(ValueError, match=r"no hand is within 0\.08 m"):
        find_hands(points, np.ones(points.shape[:2], bool), clouds, np.array([[0.5, 0, 0]]))


def test_the_hull_of_a_box_is_the_box():
    """Seen from above alone, a box on the table is the space under its top: cells within a step of 5 mm of it."""
    raw = filmed(1).cameras[0]
    camera = Camera(raw.intrinsics, raw.camera_to_world, W, H)
    depth = raw.metres(0)
    mask = np.zeros((H, W), bool)
    mask[45:75, 40:90] = True
    rows, columns = np.nonzero(mask)
    seen = to_points(camera, np.stack([columns, rows], 1).astype(float), np.full(len(rows), 0.56))
    hull = visual_hull((camera,), [mask], [np.zeros_like(mask)], [np.where(mask, depth, 0.6)], seen, GROUND)
    cells = np.concatenate([hull.surface, hull.interior])
    low, high = seen.min(0) - 0.015, seen.max(0) + 0.015  # a ray that grazes the top 60 pixels off the axis goes on by 12 mm to the table
    assert (cells[:, :2] >= low[:2]).all() and (cells[:, :2] <= high[:2]).all()
    assert cells[:, 2].min() > -0.045 and cells[:, 2].max() <= 0.002
    volume = np.prod(np.ptp(seen, axis=0)[:2]) * 0.035  # what is not within a step of the seen top
    assert abs(len(cells) * hull.step**3 / volume - 1) < 0.4
