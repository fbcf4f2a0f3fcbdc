"""The cables' study on ropes of which it is known what a spring-mass twin lacks."""

import csv
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from twinbench.benchmark.cable_results import LOSSES, markdown, write
from twinbench.benchmark.real_cables import Cable, Plan, cable_replica, candidates, common_shapes, run, study, window
from twinbench.datasets.collection import Collection
from twinbench.datasets.scenario import Scenario, Split, TransferPair
from twinbench.diagnosis.ladder import Climb, Step, believed, climb
from twinbench.physics.batch import Batch
from twinbench.physics.system import System
from twinbench.physics.terms import Dashpot, Gravity, LinearDrag, Springs
from twinbench.physics.terms.bending import Bending
from twinbench.physics.terms.bending_damping import BendingDamping
from twinbench.physics.terms.natural_curvature import MODES
from twinbench.physics.topology import rope_hinges

FPS, STEP, FINE = 50.0, 0.05, 17  # Hz, m, nodes: twice as fine as the markers
HELD = (0, 1, 2, 14, 15, 16)
RIGIDITY = 0.05  # N m^2 at 1 kg/m


def swung(seed, *, frames=40, before=50):
    """(frames, 9, 3) m: markers of a rope that bends, both ends gripped and one of them waved about, after it came to rest."""
    rng = np.random.default_rng(seed)
    # a half circle between vertical ends is near enough to start from
    angle = np.linspace(0, np.pi, FINE)
    start = np.stack([-np.cos(angle), 0 * angle, -np.sin(angle)], 1) * STEP * (FINE - 1) / np.pi
    time = np.arange(frames + before)[:, None] / FPS
    later = np.maximum(0, time - before / FPS)
    way = sum(rng.normal(0, 0.05, 3) * np.sin(2 * np.pi * f * later) for f in (0.7, 1.3))
    path = np.repeat(start[None, list(HELD)], len(time), 0)
    path[:, 3:] += way[:, None]
    links = np.stack([np.arange(FINE - 1), np.arange(1, FINE)], 1)
    system = System(
        positions=start,
        springs=links,
        stiffness=np.full(len(links), 1e3),
        masses=np.full(FINE, STEP),
        controllers=path,
        grips=np.array(HELD),
        hinges=rope_hinges(np.arange(FINE)),
        chains=(np.arange(FINE),),
        terms=(
            Springs(),
            Dashpot({"dashpot_damping": 0.5}),
            Gravity({"gravity_z": -9.81}),
            LinearDrag({"drag_damping": 0.5}),
            Bending({"bending_stiffness": RIGIDITY}),
            BendingDamping({"bending_damping": 1e-3}),
        ),
    )
    return Batch([system], fps=FPS).rollout().positions[0][before:, ::2].numpy().astype(float)


def scenario(name, seed):
    markers = swung(seed) + np.random.default_rng(seed).normal(0, 1e-4, (40, 9, 3))
    there = np.ones(markers.shape[:2], bool)
    return Scenario(
        name=name,
        points=markers,
        visible=there,
        motion_valid=there,
        controllers=markers[:, [0, 1, 7, 8]],
        grips=[0, 1, 7, 8],
        fps=FPS,
        gravity=[0, 0, -9.81],
        object="rope",
        session=name,
        split=Split(40, 40),
    )


@cache
def ropes():
    recordings = {
        f"{side}/{k}": scenario(f"{side}/{k}", k + 100 * (side == "eval")) for side, n in (("train", 6), ("eval", 2)) for k in range(n)
    }
    sources = tuple(n for n in recordings if n.startswith("train"))
    return Collection(
        name="rope",
        scenarios={name: lambda one=one: one for name, one in recordings.items()},
        in_domain=(),
        pairs=tuple(TransferPair(sources, n) for n in recordings if n.startswith("eval")),
    )


@cache
def found(effects=("bending", "gravity_tilt"), count=2):
    plan = Plan(train=count, validation=count, seconds=0.8, iterations=4, most=2, effects=effects)
    return study(ropes(), plan=plan, report=lambda text: None)


@pytest.mark.slow
def test_a_rope_that_bends_lacks_bending_first_and_no_drag():
    accepted = found(("bending", "quadratic_drag", "gravity_tilt"), count=3).climb.accepted
    assert accepted[0] == "bending" and "quadratic_drag" not in accepted


@pytest.mark.long
def test_its_rigidity_is_found():
    # within a factor of two: with five free nodes, twice as far apart as the rope's, a clamp that acts over half a spacing is long
    assert RIGIDITY / 2 < found().fits[-1].values["bending_stiffness"] < 2 * RIGIDITY


def test_the_eval_recordings_are_closer_with_it():
    one = found()
    assert one.mean(1, "free_mm") < 0.5 * one.mean(0, "free_mm")
    # driven markers are given, so an error over all 9 is that over the free 5, thinned
    assert one.mean(1, "all_mm") == pytest.approx(one.mean(1, "free_mm") * 5 / 9, rel=0.02)


def test_no_eval_recording_is_fitted():
    fitted = {s for s in found().fitted}
    assert fitted and all(name.startswith("train/") for name in fitted)


def test_what_was_found_is_written(tmp_path):
    write([found()], tmp_path)
    with open(tmp_path / "cables.csv") as stream:
        rows = list(csv.DictReader(stream))
    assert {r["recording"] for r in rows} == {"eval/0", "eval/1"}
    text = (tmp_path / "cables.md").read_text()
    assert "+ bending" in text and "this is one seed" in text
    with open(tmp_path / "cables_steps.csv") as stream:
        assert {"accepted", "refused"} <= {r["said"] for r in csv.DictReader(stream)}


def test_what_does_not_repeat_is_not_believed():
    def climbed(*steps):
        steps = [Step(name, 1.0, 0.5, 0.1, (), dropped, found().fits[-1]) for name, dropped in steps]
        return Climb(found().climb.first, 1.0, tuple(steps), (), {})

    climbs = [
        climbed(("bending + natural_curvature", ("braces",)), ("rest_shape", ())),
        climbed(("natural_curvature", ()), ("wind", ()), ("bending", ("wind",))),
    ]
    assert [c.kept for c in climbs] == [("bending", "natural_curvature", "rest_shape"), ("natural_curvature", "bending")]
    assert believed(climbs) == ("bending", "natural_curvature") and believed(climbs[:1]) == ()
    both = [replace(found(), seed=k, climb=one) for k, one in enumerate(climbs)]
    assert "ends with it: bending, natural_curvature. Not repeated: rest_shape (seed 0)." in markdown(both)


def test_laws_of_one_loss_repeat_each_other():
    def climbed(*laws):
        steps = [Step(name, 1.0, 0.5, 0.1, (), (), found().fits[-1]) for name in ("bending", *laws)]
        return Climb(found().climb.first, 1.0, tuple(steps), (), {})

    climbs = [climbed("bending_damping"), climbed("rope_friction")]
    assert believed(climbs) == ("bending",) and believed(climbs, LOSSES) == ("bending", "bending_damping")
    both = [replace(found(), seed=k, climb=one) for k, one in enumerate(climbs)]
    assert "ends with it: bending, bending_damping (seed 1: as rope_friction)." in markdown(both)
    both[0] = replace(both[0], climb=climbed("bending_damping", "rope_creep"))
    assert "bending_damping (seed 0: with rope_creep; seed 1: as rope_friction)." in markdown(both)


def test_what_comes_after_another_is_asked_only_beside_it():
    asked = candidates(np.random.default_rng(0), 1.0, np.zeros((1, MODES), complex))
    after = {c.name for c in asked if c.after}
    assert after == set(LOSSES)
    alone = [c for c in asked if c.name in after]
    with pytest.raises(ValueError, match=r"is asked after bending, which must be a candidate, got rope_creep"):
        climb(None, None, None, None, alone, iterations=1)


def test_a_window_begins_where_it_is_told():
    one = ropes().load("train/0")
    cut = window(one.observed(), 5, 25)
    np.testing.assert_array_equal(cut.points, one.points[5:25])
    np.testing.assert_array_equal(cut.controllers, one.controllers[5:25])
    with pytest.raises(ValueError, match="frames must lie in"):
        window(one.observed(), 20, 60)


def test_nodes_weigh_what_they_stand_for():
    replica = cable_replica(ropes().load("train/0").observed())
    chain = replica.system.chains[0]
    lengths = np.linalg.norm(np.diff(replica.nodes[chain], axis=0), axis=1)
    assert replica.system.masses.sum() == pytest.approx(lengths.sum())  # 1 kg/m
    np.testing.assert_allclose(replica.system.home[chain, 0], np.concatenate([[0], np.cumsum(lengths)]), atol=1e-12)


def test_no_cables_are_an_error(tmp_path):
    with pytest.raises(ValueError, match="folders of cables"):
        run(tmp_path, tmp_path, seeds=(0,))


def test_the_shape_that_frames_share_is_found_whatever_their_roll():
    count, step = 15, 0.05
    lengths, rng = np.full(count - 1, step), np.random.default_rng(0)
    u = 2 * np.cumsum(lengths)[:-1] / lengths.sum() - 1
    curvature = 2.0 + 1.5 * u  # 1/m, in the modes P_0 and P_1
    angle = np.concatenate([[0.0], np.cumsum(2 * np.arctan(curvature * step / 2))])  # a hinge's curvature is 2 tan(angle / 2)
    line = np.concatenate([np.zeros((1, 3)), np.cumsum(step * np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1), 0)])
    shown = [line @ np.linalg.qr(rng.normal(size=(3, 3)))[0].T + rng.normal(0, 1e-5, (count, 3)) for _ in range(8)]
    there = np.ones((2, count), bool)
    held = [0, 1, count - 2, count - 1]
    one = dict(visible=there, motion_valid=there, grips=held, fps=1.0, gravity=[0, 0, -9.81], object="rope", split=Split(2, 2))
    frames = [np.stack(pair) for pair in zip(shown[::2], shown[1::2], strict=True)]
    recordings = [Scenario(name=str(k), points=p, controllers=p[:, held], **one) for k, p in enumerate(frames)]
    replica = cable_replica(recordings[0])
    found = common_shapes(Cable(replica, [lengths]), recordings)[0]
    # 1e-5 m of noise bends a hinge by some 1e-5 * 2 / step^2 = 0.01 1/m
    np.testing.assert_allclose(np.abs(found[:3]), [2.0, 1.5, 0.0], atol=0.03)
    assert found[0].imag == pytest.approx(0.0, abs=1e-9)  # rolled so that the first mode is about one axis
