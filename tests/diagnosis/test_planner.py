"""The plan for what to record next: that its motions are as said, that its figures are those of the formula, and that it decides."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from twinbench.datasets.scenario import Plane
from twinbench.diagnosis import planner
from twinbench.diagnosis.baseline import baseline_model
from twinbench.diagnosis.fit import INDEPENDENT, Fit, Task, fit
from twinbench.diagnosis.model import Knob, Simulator
from twinbench.diagnosis.motions import LIBRARY, motions
from twinbench.diagnosis.planner import Side, plan, setting_of
from twinbench.diagnosis.replica import build_replica
from twinbench.diagnosis.skins import heaviness
from twinbench.diagnosis.verdict import Decision
from twinbench.physics.terms import GravityTilt, PlateDrag, QuadraticDrag, Wind

COLUMNS, ROWS, FRAMES, NOISE = 4, 5, 36, 3e-4
NUISANCES = ("body_stiffness", "dashpot_damping", "drag_damping")
HANDS = np.array([[0.0, 0.0, 0.01], [(COLUMNS - 1) * 0.03, 0.0, 0.01]])
TRUTHS = {
    QuadraticDrag: {"quadratic_drag": 2.0},
    PlateDrag: {"plate_drag": 2000.0},
    GravityTilt: {"tilt_x": 0.75, "tilt_y": 0.5},
    Wind: {"wind_x": 0.75, "wind_y": 0.5, "wind_speed": 3.0},
}


def gentle(way, amplitude, seconds):
    """(FRAMES, 2, 3) m: both hands to and fro along ``way``."""
    t = np.arange(FRAMES) / 30
    return HANDS + (amplitude * (1 - np.cos(2 * np.pi * t / seconds)))[:, None, None] * np.array(way, float)


def film(tiny, path, truth=None):
    """The sheet as it moves in hands on ``path`` by the baseline's physics and the term ``truth``, seen without noise."""
    start = tiny.sheet(COLUMNS, ROWS)
    still = tiny.filmed(np.repeat(start[None], len(path), 0), path)
    if truth is None:
        return still
    simulator = Simulator(build_replica(still, nodes=100), double=True)
    model = baseline_model([simulator.replica]).extended({truth}, {}, ())
    row = model.decode(np.zeros(len(model.knobs))) | tiny.truth | {"observer_bandwidth": 0.0} | TRUTHS[truth]
    return replace(still, points=simulator.run(model.terms, [row], len(path))[0])


def fitted(tiny, recordings, terms, begin=()):
    """(simulator of the first of ``recordings``, a fit of free runs to all of them with each of ``terms``).

    From where a fit under an observer of 1 Hz ends, and from those of ``begin`` that are of the term.
    """
    rng = np.random.default_rng(0)
    simulators = [tiny.drawn(s, seen=s.points + rng.normal(0, NOISE, s.points.shape)) for s in recordings]
    base = tiny.known(baseline_model([simulators[0].replica]), *NUISANCES)
    base = replace(base, knobs=tuple(replace(k, start=1.3 * tiny.truth[k.name], spread=0.3) for k in base.knobs))  # 30 % off
    led, task = (Task(simulators, [len(s.points) for s in recordings], hertz, finest=5e-4) for hertz in (1.0, 0.0))
    found = []
    for term in terms:
        known = {p.name: p for p in term.parameters}
        scale = heaviness(simulators[0].replica.system) if term.stage == "facet" else 1.0
        sizes = {a: scale * max(term.effect.typical.values()) for a in term.effect.amplitudes}
        knobs = tuple(Knob(a, 0.0, size, known[a].low, known[a].high, step=0.25, prior=10.0) for a, size in sizes.items())
        model = base.extended({term}, {"wind_speed": 3.0} if term is Wind else {}, knobs)
        starts = [one.z for one in begin if one.model.terms == model.terms] or [np.zeros(len(model.knobs))]
        starts += [fit(led, model, z, iterations=25).z for z in starts]
        found.append(min((fit(task, model, z, iterations=25) for z in starts), key=lambda f: f.loss))
    return simulators[0], found


def nats(fits):
    """By how much the first of two fits is likelier than the second [log odds], as ``fit`` weighs it: INDEPENDENT data a recording."""
    return INDEPENDENT / 2 * (fits[1].loss - fits[0].loss)


# ---------------------------------------------------------------- it decides


@pytest.mark.long
@pytest.mark.parametrize(
    ("pair", "path"),
    [
        ((QuadraticDrag, PlateDrag), gentle([0, 1, 0], 0.02, 1.2)),  # face-on at one speed: both only slow it
        # nearly at rest: both only lean it
        pytest.param((GravityTilt, Wind), gentle([1, 0.5, 0], 0.005, 2.0), marks=pytest.mark.slow),
    ],
    ids=["drags", "leans"],
)
@pytest.mark.parametrize("which", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_the_planned_motion_decides_what_the_recording_left_open(tiny, pair, path, which):
    # before, the odds are no better than ten to one (2.3 nats) for either; after the planned motion, e^20 for the truth
    truth, sign = pair[which], (1, -1)[which]
    case = film(tiny, path, truth)
    simulator, before = fitted(tiny, [case], pair)
    found = plan(simulator, [Side(t.effect.name, t.effect.says, f) for t, f in zip(pair, before, strict=True)], error=1e-3)
    assert found.telling and found.separation >= max(found.others.values())
    new = film(tiny, found.motion.controllers, truth)
    _, after = fitted(tiny, [case, new], pair, before)
    assert abs(nats(before)) < 2.3 and sign * nats(after) > 20
    # and so does the one look at the outcome: on the truth's side of the border between what either foretold
    look = found.look
    hand = found.motion.controllers[look.frame, look.hand]  # each hand is one point here
    outcome = (new.points[look.frame, look.node] - hand) @ look.axis
    assert abs(outcome - look.offsets[which]) < abs(outcome - look.offsets[1 - which])


# ---------------------------------------------------------------- the figures


def test_separation_is_the_distance_of_two_predictive_distributions():
    # min_u |d - J u|^2 / R + |u|^2 = d' (R + J J')^-1 d (Woodbury); INDEPENDENT data in all, however many frames and nodes they come in
    rng = np.random.default_rng(0)
    difference, columns, variance = rng.normal(size=(6, 4, 3)), rng.normal(size=(3, 6, 4, 3)), rng.uniform(0.5, 2, 6)
    free = np.array([0, 1, 3])
    d, j = difference[1:, free].ravel(), columns[:, 1:, free].reshape(3, -1).T
    r = np.repeat(variance[1:], 9) * 15 / INDEPENDENT  # frame 0 is where both start
    expected = np.sqrt(d @ np.linalg.solve(np.diag(r) + j @ j.T, d))
    assert planner._gap(difference, columns, variance, free) == pytest.approx(expected, rel=1e-9)
    assert planner._gap(difference, columns[:0], variance, free) == pytest.approx(np.sqrt((d**2 / r).sum()), rel=1e-9)


@pytest.fixture(scope="module")
def drags(tiny):
    """A simulator, and twins with either kind of drag that fit one swing of it."""
    return fitted(tiny, [film(tiny, gentle([0, 1, 0], 0.02, 1.2), PlateDrag)], (QuadraticDrag, PlateDrag))


def sides(fits):
    return [Side(name, f"it is {name}", one) for name, one in zip(("one", "the other"), fits, strict=True)]


def test_no_motion_is_better_than_the_planned_one(drags, monkeypatch):
    # motions whose gap is too small before anything may close it are not looked into: all the same, the best of all is found
    simulator, fits = drags
    found = plan(simulator, sides(fits))
    monkeypatch.setattr(planner, "motions", lambda setting: [m for m in motions(setting) if m.name != found.motion.name])
    rest = plan(simulator, sides(fits))
    assert rest.separation <= found.separation and rest.motion.name != found.motion.name
    assert set(found.others) | {found.motion.name} == {m.name for m in motions(setting_of(simulator.replica))}


def test_what_a_fit_leaves_open_counts(drags):
    # the less sure of its numbers either twin is, the less a motion tells; so it does where twins are known to be wrong
    simulator, fits = drags
    vague = [replace(one, covariance=100 * one.covariance) for one in fits]
    sure, unsure, wrong = (plan(simulator, sides(f), error=e) for f, e in ((fits, 0.0), (vague, 0.0), (fits, 0.03)))
    assert unsure.separation < 0.9 * sure.separation and wrong.separation < 0.3 * sure.separation


def test_twins_that_agree_are_told_apart_by_nothing(drags):
    simulator, fits = drags
    found = plan(simulator, sides([fits[1], fits[1]]))
    assert found.separation == 0 and found.look is None and not found.telling
    assert found.says.startswith("None of the motions that were simulated tells one from the other")


def test_what_is_said(drags):
    simulator, fits = drags
    found = plan(simulator, sides(fits))
    look, numbers = found.look, re.findall(r"(\d+) mm", found.says)
    assert f"To tell one from the other: {found.motion.says}. Then look at " in found.says
    assert f", {look.frame / 30:.1f} s after the start: if it is one, it is " in found.says and "; if it is the other, " in found.says
    told = [*look.offsets, look.within, sum(look.offsets) / 2]
    assert numbers == [f"{1000 * abs(value):.0f}" for value in told]
    shown = [(p[look.frame, look.node] - found.motion.controllers[look.frame, look.hand]) @ look.axis for p in found.predicted]
    np.testing.assert_allclose(look.offsets, shown, atol=1e-9)  # what either twin does in that very motion


# ---------------------------------------------------------------- the motions


def held(tiny, *, hands=2, table=False, gravity=(0.0, 0.0, -9.8)):
    """The setting of a sheet with four points in each hand: it lies on a table, or hangs."""
    points = tiny.sheet(COLUMNS, ROWS)
    points = points[:, [0, 2, 1]] if table else points
    around = np.array([[0.0, 0, 0], [0.01, 0, 0], [0, 0.01, 0], [0, 0, 0.01]])
    grips = np.concatenate([HANDS[h] + around for h in range(hands)])
    given = dict(gravity=np.array(gravity), ground=Plane(np.array([0.0, 0.0, 1.0]), -0.01) if table else None)
    scenario = tiny.filmed(np.repeat(points[None], 12, 0), np.repeat(grips[None], 12, 0), **given)
    return setting_of(build_replica(scenario, nodes=100))


@pytest.mark.parametrize("hands", [1, 2])
@pytest.mark.parametrize("table", [True, False])
def test_hands_stay_hands(tiny, hands, table):
    # rigid, from where they are, at a speed that hands have, never into a table, and at rest at the end
    setting = held(tiny, hands=hands, table=table)
    assert setting.centre.shape == (hands, 3) and (setting.lift > 0) == table
    frame = np.stack([setting.line, setting.face, setting.up])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-9)
    found = {m.name: m for m in motions(setting)}
    two, lying = {"slow pull", "fast pull", "squeeze"}, {"peel", "drag"}
    assert set(found) == set(LIBRARY) - (set() if hands == 2 else two) - (set() if table else lying)
    for one in found.values():
        path = one.controllers
        np.testing.assert_allclose(path[0], setting.start, atol=1e-12)
        for h in range(hands):
            inside = path[:, setting.hand == h]
            apart = np.linalg.norm(inside[:, :, None] - inside[:, None], axis=-1)
            np.testing.assert_allclose(apart, np.broadcast_to(apart[0], apart.shape), atol=1e-9)
        assert np.linalg.norm(np.diff(path, axis=0), axis=-1).max() * 30 < 4.0  # m/s
        assert np.abs(path[-1] - path[-10]).max() < 1e-9 and 30 < len(path) < 180
        assert not table or path[..., 2].min() > -0.01
        assert one.says and ("lift it by" in one.says) == (table and one.name not in lying)


def test_up_is_against_gravity(tiny):
    setting = held(tiny, gravity=(0.0, 9.8, 0.0))
    np.testing.assert_allclose(setting.up, [0, -1, 0])
    hold = next(m for m in motions(setting) if m.name == "lift and drop")
    rise = hold.controllers - hold.controllers[0]
    assert rise[..., 1].min() < -0.05 and np.abs(rise[..., [0, 2]]).max() < 1e-9


def test_markers_that_follow_each_other_along_a_rope_are_one_hand(tiny):
    # 6 cm apart, so farther than points of a fist: both ends are hands nevertheless, one marker in the middle is a third
    s = np.linspace(-0.36, 0.36, 13)
    rope = np.stack([s, 0 * s, 0.3 * s**2], 1)
    grips = np.array([6, 0, 12, 1, 11])
    scenario = tiny.filmed(np.repeat(rope[None], 12, 0), np.repeat(rope[None, grips], 12, 0), grips=grips)
    setting = setting_of(build_replica(scenario, nodes=100))
    assert setting.hand.tolist() == [2, 0, 1, 0, 1]
    np.testing.assert_allclose(setting.centre, [rope[:2].mean(0), rope[-2:].mean(0), rope[6]], atol=1e-9)
    pull = next(m for m in motions(setting) if m.name == "slow pull").controllers
    gap = np.linalg.norm(pull[:, 1] - pull[:, 2], axis=1)
    assert gap.max() - gap[0] == pytest.approx(0.05 * 0.66, rel=1e-3)  # by a twentieth of what is between the hands
    assert np.abs(pull[:, 0] - pull[0, 0]).max() == 0  # the third stays


def test_nobody_holds_it(tiny):
    scenario = tiny.filmed(np.repeat(tiny.sheet(3, 3)[None], 12, 0), np.zeros((12, 0, 3)))
    with pytest.raises(ValueError, match="one: nobody holds the body, so that no motion can be planned"):
        setting_of(build_replica(scenario, nodes=100))


# ---------------------------------------------------------------- what a diagnosis says


def evidence(drags, terms=(QuadraticDrag, PlateDrag)):
    """As much of an inquiry as a plan needs: refits of ``terms``, and a twin without anything."""
    simulator, fits = drags

    def refit(term, one):
        twin = SimpleNamespace(fit=one, free={"train": 2e-3, "heldout": 3e-3})
        return SimpleNamespace(
            score=SimpleNamespace(hypothesis=SimpleNamespace(effect=term.effect.name, term=term)), found=twin, promise=1.0
        )

    refits = [refit(*pair) for pair in zip(terms, fits, strict=False)]
    bare = Fit(fits[0].model, fits[0].z * [1, 1, 1, 0], 0.0, fits[0].covariance, ())
    base = SimpleNamespace(fit=bare, free={"train": 2e-3})
    scores = [r.score for r in refits]
    return SimpleNamespace(
        scores=scores, refits=refits, base=base, case=simulator.replica, simulators=[simulator], finest=1e-3, transferred=[]
    )


def decision(verdict, *names):
    named = verdict in ("ambiguous", "missing")
    return Decision(verdict, names[0] if named else None, names[1:] if named else names, {}, None)


def test_two_readings_are_told_apart_by_a_motion(drags):
    said, figures = planner.experiment(evidence(drags), decision("ambiguous", "quadratic_drag", "plate_drag"))
    assert (
        said.startswith("To tell quadratic drag from plate drag: ") and QuadraticDrag.effect.says in said and PlateDrag.effect.says in said
    )
    assert set(figures) == {"motion", "seconds", "separation", "others"} and figures["motion"] in LIBRARY
    assert figures["separation"] > planner.TELLING and list(figures["others"].values()) == sorted(figures["others"].values(), reverse=True)


def test_one_reading_is_told_from_nothing(drags):
    said, figures = planner.experiment(evidence(drags), decision("cannot_tell", "plate_drag", "quadratic_drag"))
    assert said.startswith("To tell plate drag from nothing: ") and "if nothing is missing, " in said
    assert figures["separation"] > planner.TELLING


@pytest.mark.parametrize(
    ("verdict", "names", "says"),
    [
        ("unknown", ("quadratic_drag",), QuadraticDrag.effect.motion),  # not one of the names: no twin of it
        ("ambiguous", ("quadratic_drag", "track_drift"), QuadraticDrag.effect.motion),  # tracks have no twin
        ("missing", ("quadratic_drag",), None),
        ("adequate", (), None),
        ("cannot_tell", (), None),
    ],
)
def test_where_there_is_nothing_to_simulate(drags, verdict, names, says):
    said, figures = planner.experiment(evidence(drags), decision(verdict, *names))
    assert figures is None and (said is None if says is None else says in said)


def test_a_twin_that_follows_the_recording_foretells_nothing(drags):
    follows = SimpleNamespace(effect=QuadraticDrag.effect, stands_for=lambda: QuadraticDrag.effect, stage="observer")
    given = evidence(drags)
    given.refits[0].score.hypothesis.term = follows
    assert planner.experiment(given, decision("ambiguous", "quadratic_drag", "plate_drag"))[1] is None
