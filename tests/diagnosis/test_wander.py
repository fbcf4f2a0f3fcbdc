"""Tracks that leave their neighbours: told by tracks alone, whatever the body does, and never of a sound one."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from twinbench.datasets.phystwin import write_case
from twinbench.datasets.scenario import Scenario, Split
from twinbench.diagnosis.config import DiagnosisConfig
from twinbench.diagnosis.inference import wander as module
from twinbench.diagnosis.inference.wander import Wander, main, strayed, wander
from twinbench.diagnosis.outcome import verdict_of

FRAMES, TRACKS = 40, 200
CONFIG = DiagnosisConfig()


def swept(lost=0.0, far=0.03, noise=1e-3, seed=0, name="block"):
    """A block of 20 x 10 x 6 cm that turns, goes aside and is stretched by a tenth; a share of tracks, ``lost``, goes ``far`` [m] alone."""
    random = np.random.default_rng(seed)
    rest = random.uniform(0, 1, (TRACKS, 3)) * [0.2, 0.1, 0.06]
    share = np.linspace(0, 1, FRAMES)
    path = np.stack([Rotation.from_rotvec([0, 0, s]).apply(rest * [1 + 0.1 * s, 1, 1]) + [0.3 * s, 0, 0] for s in share])
    wandering = random.permutation(TRACKS)[: round(lost * TRACKS)]
    ways = random.normal(size=(len(wandering), 3))
    path[:, wandering] += far * share[:, None, None] * ways / np.linalg.norm(ways, axis=1)[:, None]
    seen = random.random((FRAMES, TRACKS)) < 0.9
    seen[0] = True
    path = path + random.normal(0, noise, path.shape)
    about = dict(name=name, controllers=np.zeros((FRAMES, 0, 3)), split=Split(FRAMES, FRAMES))
    return Scenario(points=path, visible=seen, motion_valid=seen & np.r_[np.ones(FRAMES - 1, bool), False][:, None], **about), wandering


@pytest.fixture
def known(monkeypatch):
    """What 40 sound recordings of this block have, at noises of 0.5 to 2 mm."""
    noises = np.geomspace(0.5e-3, 2e-3, 40)
    values = [module._statistic(strayed(swept(noise=n, seed=k + 10)[0].observed())) for k, n in enumerate(noises)]
    monkeypatch.setattr(module, "_known", lambda: {"solid": values})


def test_a_rigid_motion_strays_nobody_and_a_stretch_little():
    # exact tracks: neighbours, some 2 cm apart, part by a tenth of that where the body is a tenth longer, at most
    still, _ = swept(noise=0.0)
    assert np.nanmax(strayed(still.observed())) < 0.006
    rigid = replace(still, points=np.stack([Rotation.from_rotvec([0, t / 20, 0]).apply(np.array(still.points[0])) for t in range(FRAMES)]))
    assert np.nanmax(strayed(rigid.observed())) < 1e-12


def test_those_that_go_alone_are_found(known):
    recording, lost = swept(lost=0.2, seed=3)
    found = wander(recording, "solid")
    assert found.p < CONFIG.wandering
    assert set(found.tracks) >= set(lost) and len(set(found.tracks) - set(lost)) <= 0.03 * TRACKS
    # each by as much as it goes: the change of a distance to a neighbour is that of its component, a half of it in the mean and more
    assert 0.01 < np.median(found.far[lost]) < 0.03


def test_sound_tracks_do_not_wander_however_noisy(known):
    # other draws, at up to twice the noise that any stored one has: a body's own strain counts less then, and that is all
    least = min(wander(swept(noise=n, seed=100 + k)[0], "solid").p for k, n in enumerate((0.3e-3, 1e-3, 2e-3, 4e-3)))
    assert least > 1e-3
    assert wander(swept(lost=0.2)[0], "sheet").p == 1.0  # nothing is known of these


def test_frames_held_out_are_not_looked_at(known):
    recording, _ = swept(lost=0.2)
    cut = recording.with_split(8)  # of 40: they have gone a fifth as far by then
    late = cut.points.copy()
    late[8:] = np.nan_to_num(np.random.default_rng(0).normal(size=late[8:].shape))
    np.testing.assert_array_equal(strayed(cut.observed()), strayed(replace(cut, points=late).observed()))


def answer(verdict, p):
    test = SimpleNamespace(p=0.5, p_held_out=1.0)
    named = [SimpleNamespace(name="wind")]
    sizes = [SimpleNamespace(name="wind", size=3.0)]
    lost = (Wander(np.r_[np.full(9, 1e-3), 0.03], p),)
    return SimpleNamespace(
        verdict=verdict,
        test=test,
        detectable=sizes,
        named=named,
        probabilities={"wind": 1.0},
        parallel=(),
        wandering=lost,
        sunk=(),
        cameras_rather=0.0,
    )


@pytest.mark.parametrize(
    ("verdict", "p", "expected"),
    [
        ("adequate", 0.5, ("adequate", ())),
        ("adequate", 1e-12, ("measurement", ("track_drift",))),
        ("unknown", 1e-12, ("measurement", ("track_drift",))),  # what else is missing, tracks that wander do not let be seen
        ("named", 1e-12, ("ambiguous", ("wind", "track_drift"))),
        ("named", 0.5, ("missing", ("wind",))),
    ],
)
def test_tracks_that_wander_are_a_fault_of_the_measurement(verdict, p, expected):
    assert verdict_of(answer(verdict, p), CONFIG) == expected


def test_sound_recordings_are_frozen(tmp_path):
    recording, _ = swept()
    write_case(tmp_path / "one", recording)
    main([str(tmp_path / "one"), str(tmp_path / "one"), "--out", str(tmp_path / "wander.json")])
    found = json.loads((tmp_path / "wander.json").read_text())
    assert list(found) == ["solid"] and found["solid"] == pytest.approx([module._statistic(strayed(recording.observed()))] * 2, abs=1e-3)
