"""The diagnosed twin as a method: what is added to the fine body, with which numbers, when nothing is, and how it is kept."""

import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from twinbench.benchmark.cache import Cache
from twinbench.benchmark.opening import Opened
from twinbench.benchmark.plan import plan
from twinbench.benchmark.runner import Runner, Settings
from twinbench.benchmark.sources import Sources
from twinbench.datasets.collection import Collection
from twinbench.datasets.scenario import Plane
from twinbench.diagnosis import extended
from twinbench.diagnosis.extended import DiagnosedTwin, named
from twinbench.diagnosis.inquiry import PRESETS, Preset
from twinbench.diagnosis.method import PhysTwinDiagnosed
from twinbench.methods.base import Budget
from twinbench.methods.phystwin import PhysTwin
from twinbench.methods.phystwin.body import Place, _made, build, system
from twinbench.methods.phystwin.config import Config
from twinbench.methods.phystwin.ranges import SEARCHED
from twinbench.methods.registry import methods
from twinbench.metrics.base import metrics
from twinbench.physics import terms
from twinbench.physics.batch import Batch

DEFAULTS = {p.name: p.value for p in SEARCHED} | {"object_radius": 0.07, "controller_radius": 0.05, "global_spring_Y": 2000.0}
DEFAULTS |= {"drag_damping": 1.0, "dashpot_damping": 5.0}
FRAMES, TRAIN = 30, 20
FAST = Config(iterations=3, population=6, epochs=4, rate=0.1)
TABLE = Plane(np.array([0.0, 0.0, 1.0]), -0.5)
GRAVITY_ONLY = {"drag_damping": 0.0}


TOLD = {"told_gravity_x": 0.0, "told_gravity_y": 0.0, "told_gravity_z": -9.8}  # m/s^2


def answer(term, values, *, verdict="missing", nodes=10, ties=4):
    """A diagnosis that named ``term``, with the numbers of the replica's refit."""
    fit = SimpleNamespace(values=values)
    inquiry = SimpleNamespace(
        case=SimpleNamespace(nodes=np.zeros((nodes, 3)), links=np.arange(nodes) < ties),
        simulators=[SimpleNamespace(fixed=lambda kinds: TOLD if terms.GravityTilt in kinds else {})],
    )
    chosen = SimpleNamespace(score=SimpleNamespace(hypothesis=SimpleNamespace(term=term)), found=SimpleNamespace(fit=fit))
    result = {"verdict": verdict, "effect": term.effect.name, "alternatives": [], "probabilities": {term.effect.name: 0.9}}
    return SimpleNamespace(result=result, inquiry=inquiry, chosen=chosen)


def unnamed(verdict="adequate"):
    return SimpleNamespace(result={"verdict": verdict, "effect": None, "alternatives": []}, chosen=None)


def answering(monkeypatch, found):
    """Diagnoses that say ``found``; what they were asked."""
    asked = []
    monkeypatch.setattr(extended, "ask_springs", lambda scenario, **options: asked.append((scenario, options)) or found)
    return asked


def fast(kind):
    one = kind()
    one.presets = {"quick": FAST}
    return one


@pytest.fixture(scope="module")
def tilted(tiny):
    """A sheet that swings from two hands in a gravity that leans, by 3 m/s^2, another way than the recording says."""
    path = tiny.hands(FRAMES, columns=3, way=0.03)
    still = tiny.filmed(np.repeat(tiny.sheet(3, 10)[None], FRAMES, 0), path, train_end=TRAIN)
    body = build(DEFAULTS, Place.of(still), (terms.GravityTilt({"tilt_x": 3.0}),))
    return replace(still, points=DiagnosedTwin(body, Place.of(still), FAST).rollout(path).positions)


@pytest.fixture(scope="module")
def plain(tilted):
    return fast(PhysTwin).fit([tilted.observed()], budget=Budget())


def test_a_named_term_acts_on_the_fine_body_by_its_law(tilted):
    # a body that nothing holds falls by (g + t) t^2 / 2 whatever its springs do; semi-implicit Euler is off by at most |g + t| T dt / 2
    alone = replace(Place.of(tilted.observed()), controllers=np.zeros((10, 0, 3)), grips=np.zeros(0, int))
    body = build(DEFAULTS | GRAVITY_ONLY, alone)
    tilt = {"tilt_x": 1.5, "tilt_y": -0.5, "tilt_z": 0.25}
    twin = DiagnosedTwin(replace(body, added=(terms.GravityTilt(tilt),)), alone, FAST)
    fallen = twin.rollout(alone.controllers).positions.mean(1)
    time = np.arange(10)[:, None] / alone.fps
    pull = alone.gravity + np.array(list(tilt.values()))
    error = np.abs(fallen - fallen[0] - pull * time**2 / 2).max()
    assert error < np.linalg.norm(pull) * time[-1, 0] / alone.fps / 10 / 2 + 1e-6  # at least 10 substeps a frame


def test_a_term_stands_in_for_one_whose_parameters_it_has_and_needs_a_ground(tilted):
    place = replace(Place.of(tilted.observed()), ground=(0.0, 0.0, 1.0, -0.5))
    body = build(DEFAULTS | {"collide_fric": 0.37}, place)
    added = (terms.StribeckGround({"friction_excess": 0.4}), terms.GroundAdhesion({"ground_adhesion": 3.0}), terms.GroundPose({}))
    body = replace(body, added=added)
    made = system(body, place, FAST)
    assert [t.name for t in made.terms[-3:]] == ["stribeck_ground", "ground_adhesion", "ground_pose"]
    assert not any(t.name == "ground" for t in made.terms)
    wanted = {"collide_fric": 0.37, "ground_offset": -0.5, "friction_excess": 0.4, "adhesion_offset": -0.5, "adhesion_normal_z": 1.0}
    assert {n: made.values[n] for n in wanted} == wanted
    nowhere = replace(place, ground=None)
    assert [t.name for t in system(body, nowhere, FAST).terms] == [t.name for t in system(build(DEFAULTS, place), nowhere, FAST).terms]


def test_places_are_told_where_the_body_was_fitted(tilted):
    # a body that is brought elsewhere takes its weight along: the same particles are heavier
    observed = tilted.observed()
    place = Place.of(observed)
    corner = dict(zip(("added_mass_x", "added_mass_y", "added_mass_z"), place.structure[3], strict=True))
    body = replace(build(DEFAULTS, place), added=(terms.AddedMass({"added_mass": 5.0, "added_mass_within": 0.04, **corner}),))
    away = np.array([0.3, -0.2, 0.1])
    target = replace(tilted, points=tilted.points + away, controllers=tilted.controllers + away).observed(1)
    moved = DiagnosedTwin(body, place, FAST).retarget(target)
    assert np.abs(moved.place.structure - place.structure - away).max() < 1e-3

    def masses(twin):
        return _made(system(twin.body, twin.place, FAST), 30.0).masses

    share = np.exp(-((place.structure - place.structure[3]) ** 2).sum(1) / (2 * 0.04**2))
    own = 1 + 5 * len(share) * share / share.sum()  # the term's equation
    np.testing.assert_allclose(masses(moved), own, rtol=1e-5)  # float32


def test_the_step_is_short_enough_for_what_setup_terms_stiffen(tilted):
    # anisotropy stiffens springs along x by up to e^2: the stable step falls with the root of stiffness
    place = Place.of(tilted.observed())
    body = build(DEFAULTS, place)
    along = {"anisotropy_xx": 2.0, "anisotropy_yy": -1.0}
    one = system(replace(body, added=(terms.Anisotropy(along),)), place, FAST)
    made = _made(one, place.fps)
    batch = Batch([one], fps=place.fps, substeps=1)
    np.testing.assert_allclose(made.stiffness, batch.prepare(batch.inputs).stiffness.numpy(), rtol=1e-6)
    assert made.stiffness.max() > 4 * one.stiffness.max()


def test_parameters_come_from_the_replica_and_forces_go_with_the_mass(tilted):
    body = build(DEFAULTS, Place.of(tilted.observed()))  # 30 particles
    found = answer(terms.GripSlip, {"slip_rate": 8.0, "slip_force": 3.0, "body_stiffness": 50.0}, nodes=10, ties=4)
    # three times the mass hangs on len(pulls) springs to the hand instead of 4
    assert named(found, body).values == {"slip_rate": 8.0, "slip_force": pytest.approx(3.0 * 3 * 4 / len(body.pulls))}


def test_how_much_of_a_term_is_searched(tilted):
    place = Place.of(tilted.observed())
    tilt = terms.GravityTilt({"tilt_x": 3.0, "tilt_y": 15.0})
    (added,) = build(DEFAULTS | {"added_share": 1.5}, place, (tilt,)).added
    assert (added.values["tilt_x"], added.values["tilt_y"]) == (4.5, 20.0)  # 22.5 m/s^2 is out of the term's bounds


@pytest.mark.parametrize("found", [unnamed(), answer(terms.Bending, {"bending_stiffness": 0.1}), answer(terms.SecondHand, {})])
def test_where_nothing_can_be_added_it_is_phystwin(tilted, plain, found, monkeypatch):
    # nothing was named; or hinges, which the fine body has none of; or a hold that must see
    answering(monkeypatch, found)
    twin = fast(PhysTwinDiagnosed).fit([tilted.observed()], budget=Budget())
    assert twin.note.startswith("nothing added: diagnosed") and not twin.body.added
    path = tilted.controllers
    np.testing.assert_array_equal(twin.rollout(path).positions, plain.rollout(path).positions)


def test_the_diagnosis_sees_train_frames_only_and_holds_the_last_of_them_out(tilted, plain, monkeypatch):
    asked = answering(monkeypatch, unnamed())
    fast(PhysTwinDiagnosed).fit([tilted.observed(), tilted.observed()], budget=Budget(), start=plain)
    ((case, options),) = asked
    assert (case.frame_count, len(case.controllers), case.split.train_end) == (TRAIN, TRAIN, 14)  # 0.7 of 20
    np.testing.assert_array_equal(case.points, tilted.points[:TRAIN])
    assert [o.frame_count for o in options["transfer"]] == [TRAIN]


def test_what_was_named_makes_a_better_prediction(tilted, plain, monkeypatch, tmp_path):
    answering(monkeypatch, answer(terms.GravityTilt, {"tilt_x": 3.0, "tilt_y": 0.0, "tilt_z": 0.0}))
    twin = fast(PhysTwinDiagnosed).fit([tilted.observed()], budget=Budget(), start=plain)
    (added,) = twin.body.added
    assert added.values["tilt_x"] == pytest.approx(3.0, rel=0.1)  # how much of it there is was searched again, by 18 candidates
    assert "gravity_tilt (tilt_x" in twin.note and "diagnosed missing: gravity_tilt (probability 0.90)" in twin.note

    def error(one):
        moved = one.rollout(tilted.controllers).positions[TRAIN:]
        return np.linalg.norm(moved - tilted.points[TRAIN:], axis=2).mean()

    # 3 m/s^2 lean the sheet by 17 degrees, 8 cm at its hem, which no stiffness can do: most of the error must go
    assert error(twin) < 0.5 * error(plain)

    twin.save(tmp_path)
    again = DiagnosedTwin.load(tmp_path)
    assert (again.note, again.body.added) == (twin.note, twin.body.added)
    np.testing.assert_array_equal(again.rollout(tilted.controllers).positions, twin.rollout(tilted.controllers).positions)


@pytest.mark.slow
def test_a_leaning_gravity_is_found_and_added(tilted, plain, monkeypatch):
    # from end to end, with a coarse replica; 10 % of 3 m/s^2 is what the share of it is searched to by 18 candidates
    monkeypatch.setitem(PRESETS, "quick", Preset(nodes=30, first=3, steps=2, refits=4))
    twin = fast(PhysTwinDiagnosed).fit([tilted.observed()], budget=Budget(), start=plain)
    (added,) = twin.body.added
    assert added.name == "gravity_tilt" and added.values["tilt_x"] == pytest.approx(3.0, rel=0.1)


def test_what_does_not_help_is_left_out(tilted, plain, monkeypatch):
    answering(monkeypatch, answer(terms.GravityTilt, {"tilt_x": -3.0, "tilt_y": 0.0, "tilt_z": 0.0}))  # leans the other way
    twin = fast(PhysTwinDiagnosed).fit([tilted.observed()], budget=Budget(), start=plain)
    assert not twin.body.added and "fits the train frames no better" in twin.note


def test_a_run_fits_phystwin_once_and_says_what_was_added(tilted, monkeypatch, tmp_path):
    answering(monkeypatch, unnamed("cannot_tell"))
    fits = []
    real = PhysTwin.fit
    monkeypatch.setattr(PhysTwin, "presets", dict.fromkeys(("quick", "full"), replace(FAST, iterations=1, epochs=1)))
    monkeypatch.setattr(PhysTwin, "fit", lambda self, *a, **k: fits.append(self.name) or real(self, *a, **k))
    opened = Opened(Collection("made", {"one": lambda: tilted}, in_domain=("one",)))
    use = {name: methods()[name] for name in ("phystwin+diagnosed", "phystwin")}
    for kept in (use, {"phystwin+diagnosed": use["phystwin+diagnosed"]}):
        runner = Runner(opened, Settings(kept, metrics()), Cache(tmp_path))
        rows = runner.run(plan(opened.collection, methods=kept))
    assert fits == ["phystwin"]
    assert [row["note"] for row in rows] == ["nothing added: diagnosed cannot tell"] * 2


@pytest.mark.long
def test_its_fits_depend_on_the_code_and_the_numbers_of_the_diagnosis(tmp_path):
    package = Path(extended.__file__).parents[1]
    for room in ("datasets", "physics", "methods", "diagnosis"):
        shutil.copytree(package / room, tmp_path / room, ignore=shutil.ignore_patterns("__pycache__", "sample"))

    def codes():
        sources = Sources(tmp_path)
        return [sources.files(*methods()[name].modules) for name in ("phystwin", "phystwin+diagnosed")]

    before = codes()
    for file, more in {"screen.py": "\nLATER = 1\n", "calibration.json": "\n"}.items():
        (tmp_path / "diagnosis" / file).open("a").write(more)
        after = codes()
        assert after[0] == before[0] and after[1] != before[1]
        before = after
