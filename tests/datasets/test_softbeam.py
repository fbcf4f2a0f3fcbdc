"""Softbeam: synthetic c3d files with a beam of known place and release, and the published recordings themselves."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from twinbench.datasets.collection import open_collection
from twinbench.datasets.softbeam import NOMINAL, read_c3d, release_frame, softbeam_scenario

ezc3d = pytest.importorskip("ezc3d")
LABELS = ["Tip - 1", "Tip - 2", "Tip - 3", "Base - 1", "Base - 2", "Base - 3"]


def write(file, markers, *, labels=LABELS, unit="m", rate=100.0):
    c3d = ezc3d.c3d()
    c3d["parameters"]["POINT"]["UNITS"]["value"] = [unit]
    c3d["parameters"]["POINT"]["RATE"]["value"] = [rate]
    c3d["parameters"]["POINT"]["LABELS"]["value"] = tuple(labels)
    homogeneous = np.concatenate([markers, np.ones_like(markers[..., :1])], -1)
    c3d["data"]["points"] = homogeneous.transpose(2, 1, 0)
    c3d.write(str(file))


def swinging(*, held=60, frames=200, turn=(0.1, 1.5, 0.1), shift=(0.04, 0.05, 0.07), noise=2e-5, seed=0):
    """(T, 6, 3) the markers at their nominal places, moved rigidly; after ``held`` frames the tip sinks by 1 cm and swings."""
    time = np.maximum(np.arange(frames) - held + 1, 0) / 100
    sink = 0.01 * (1 - np.exp(-3 * time) * np.cos(2 * np.pi * 8 * time))
    markers = np.broadcast_to(Rotation.from_rotvec(turn).apply(NOMINAL) + shift, (frames, 6, 3)).copy()
    markers[:, :3, 0] -= sink[:, None]
    return markers + np.random.default_rng(seed).normal(0, noise, markers.shape)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 30), st.sampled_from([("m", 1.0), ("mm", 1000.0)]))
def test_what_is_written_is_read(tmp_path_factory, seed, frames, unit):
    """c3d stores float32: 2^-24 of the value, in metres whatever the unit, markers by name in any order and spelling."""
    rng = np.random.default_rng(seed)
    markers = rng.uniform(-1, 1, (frames, 6, 3))
    order = rng.permutation(6)
    file = tmp_path_factory.mktemp("softbeam") / "a.c3d"
    write(file, unit[1] * markers[:, order], labels=[LABELS[i].replace(" - ", rng.choice([" - ", "-", " "])) for i in order], unit=unit[0])
    got, rate = read_c3d(file)
    np.testing.assert_allclose(got, markers, atol=2.0**-24)
    assert rate == 100


@settings(max_examples=50, deadline=None)
@given(st.integers(20, 150), st.integers(0, 2**32 - 1))
def test_release_frame(held, seed):
    """The tip falls 1.2 mm in the first released frame, 60 times the noise: the release is the last held frame, exactly."""
    assert release_frame(swinging(held=held, seed=seed)[:, :3]) == held - 1


def test_no_release():
    assert release_frame(swinging(held=200)[:, :3]) == 0


def test_scenario_of_a_known_beam(tmp_path):
    """Placed by its nominal markers the lattice is the box 100 x 30 x 30 mm, up to the 20 um of noise over a lever of 2."""
    turn, shift = (0.1, 1.5, 0.1), (0.04, 0.05, 0.07)
    write(tmp_path / "beam_load_a.c3d", swinging(held=60, turn=turn, shift=shift))
    s = softbeam_scenario(tmp_path / "beam_load_a.c3d")
    box = Rotation.from_rotvec(turn).inv().apply(s.structure[3:] - shift)
    np.testing.assert_allclose(box.min(0), [-0.1, 0, 0], atol=1e-4)
    np.testing.assert_allclose(box.max(0), [0, 0.03, 0.03], atol=1e-4)
    clamp = box[: len(s.grips)]
    assert s.counts == (3 + 25, 0, 13 * 25) and s.spacing == pytest.approx(0.0075, abs=1e-4)
    np.testing.assert_allclose(clamp[:, 0], -0.1, atol=1e-4)
    assert box[25:, 0].min() > -0.1 + 0.007  # nothing but the clamped layer is held
    # frame 0 is held, frame 1 released
    assert s.frame_count == 200 - 59
    np.testing.assert_allclose(s.tracks[0], swinging()[59, :3], atol=1e-6)
    assert np.linalg.norm(s.tracks[1] - s.tracks[0], axis=-1).min() > 1e-3
    # the clamp is gripped, static and never seen; the tip markers are seen always
    np.testing.assert_array_equal(s.controllers, np.broadcast_to(s.points[0, s.grips], s.controllers.shape))
    assert s.visible[:, :3].all() and not s.visible[:, 3:].any() and not s.motion_valid[-1].any()
    np.testing.assert_array_equal(s.gravity, [-9.81, 0, 0])
    assert s.object == "beam_load" and s.ground is None and s.split.train_end == int(0.7 * 141)


def test_collection(tmp_path):
    for name in ("beam_gravity_a", "beam_gravity_b", "beam_load52_a"):
        write(tmp_path / f"{name}.c3d", swinging())
    found = open_collection(tmp_path)
    assert found.in_domain == ("beam_gravity_a", "beam_gravity_b", "beam_load52_a")
    assert [(p.sources, p.target) for p in found.pairs] == [
        (("beam_gravity_a",), "beam_gravity_b"),
        (("beam_gravity_b",), "beam_gravity_a"),
    ]
    one = open_collection(tmp_path / "beam_load52_a.c3d")
    assert one.in_domain == ("beam_load52_a",) and one.load("beam_load52_a").object == "beam_load52"


def damaged(markers, value, frame, marker):
    markers[frame, marker] = value
    return markers


DAMAGE = {
    "truncated": (lambda f: f.write_bytes(f.read_bytes()[:3000]), "not a readable c3d"),
    "empty": (lambda f: f.write_bytes(b""), "not a readable c3d"),
    "garbage": (lambda f: f.write_bytes(bytes(range(256)) * 40), "not a readable c3d"),
    "labels": (lambda f: write(f, swinging(), labels=[*LABELS[:5], "Arm"]), "Base3 is missing"),
    "unit": (lambda f: write(f, swinging(), unit="inch"), "in m or mm, got units"),
    "lost": (lambda f: write(f, damaged(swinging(), np.nan, 90, 1)), "every marker must be seen"),
    "short": (lambda f: write(f, swinging()[:15]), "at least 20 frames"),
    "late": (lambda f: write(f, swinging(held=195)), "only 6 frames are left after the release"),
    "swapped": (lambda f: write(f, swinging()[:, [0, 1, 2, 3, 5, 4]]), "within 3 mm RMS, got 15"),
}


@pytest.mark.parametrize("kind", DAMAGE)
def test_damaged_files_are_named(tmp_path, kind):
    damage, message = DAMAGE[kind]
    file = tmp_path / "beam_gravity_a.c3d"
    write(file, swinging())
    damage(file)
    with pytest.raises(ValueError, match=f"(?s){re.escape(str(file))}: .*({message})"):
        open_collection(tmp_path).load("beam_gravity_a")


@settings(max_examples=40, deadline=None)
@given(st.data())
def test_no_cut_file_is_read(tmp_path_factory, data):
    """Whatever part of a file is there, no frames are made up: 6 markers x 4 floats x 200 frames are needed."""
    file = tmp_path_factory.mktemp("cut") / "a.c3d"
    write(file, swinging())
    whole = file.read_bytes()
    padding = 511  # a file is filled up to whole blocks
    file.write_bytes(whole[: data.draw(st.integers(0, len(whole) - padding - 1))])
    with pytest.raises(ValueError, match=r"a\.c3d: not a readable c3d file"):
        read_c3d(file)


@pytest.mark.parametrize(
    ("name", "release", "frames"),
    [("beam_gravity_V2_a", 71, 500), ("beam_load52_V2_a", 43, 600)],  # the authors cut the first by hand at frame 71, too
)
def test_published_recordings(recordings, name, release, frames):
    found = open_collection(recordings / "softbeam")
    s = found.load(name)
    assert (s.frame_count, s.fps, s.counts) == (frames - release, 100.0, (28, 0, 325))
    # held almost straight along +z, 10 cm long, and lower along x by 6.6 or 17 mm once it has come to rest
    axis = s.interior.mean(0) - s.points[0, 3:].mean(0)
    assert axis[2] / np.linalg.norm(axis) > 0.99
    sunk = s.tracks[-50:].mean((0, 1)) - s.tracks[0].mean(0)
    assert sunk[0] == pytest.approx({"beam_gravity_V2_a": -0.0064, "beam_load52_V2_a": -0.0168}[name], abs=5e-4)
    # each tip marker stands 6 mm off the beam: within one lattice spacing of it
    gap = np.linalg.norm(s.tracks[0][:, None] - s.interior, axis=-1).min(1)
    assert gap.min() > 0.005 and gap.max() < s.spacing
