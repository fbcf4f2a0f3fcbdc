"""The score test names what was planted, with its size and direction; refits go where linear estimates do not lead."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from twinbench.diagnosis.baseline import baseline_model
from twinbench.diagnosis.fit import Fit, Frames, Task, fit, floor_of
from twinbench.diagnosis.hypotheses import ANY, FOLLOWED, Hypothesis, catalogue, hypotheses_for
from twinbench.diagnosis.locate import DAMPING, missing_acceleration
from twinbench.diagnosis.model import Knob, Model
from twinbench.diagnosis.parts import Part, judged
from twinbench.diagnosis.refit import _starts, evaluate, refit
from twinbench.diagnosis.screen import RIDGE, _shows, confirm, screen
from twinbench.physics.terms import Ground, Springs
from twinbench.physics.terms.gravity_tilt import GravityTilt
from twinbench.physics.terms.quadratic_drag import QuadraticDrag
from twinbench.physics.terms.second_hand import SecondHand
from twinbench.physics.terms.stribeck_ground import StribeckGround
from twinbench.physics.terms.wind import Wind

BANDWIDTH = 2.0
EXACT = 1e-5  # m: error that no frame need be better than, where the twin is exact
PARTS = [Part("train", 0, 0, 20), Part("heldout", 0, 20, 30)]


def at_truth(tiny, simulator):
    """The baseline as it was simulated, free in stiffness and drag, not yet bent to stand in for what is missing."""
    model = tiny.known(baseline_model([simulator.replica]), "body_stiffness", "drag_damping")
    z = np.array([k.encode(tiny.truth[k.name]) for k in model.knobs])
    return Fit(model, z, 0.0, np.eye(len(z)), ())


def scored(tiny, term, values):
    simulator = tiny.drawn(tiny.concealing(terms=[term], values=values, gravity=np.zeros(3), frames=30))
    task, base = Task([simulator], [30], BANDWIDTH, finest=EXACT), at_truth(tiny, simulator)
    predicted = task.predict(base.model, [base.z])[0][0]
    push = missing_acceleration(simulator.replica, predicted, BANDWIDTH)
    return screen(task, base, hypotheses_for(simulator, predicted[:20], push[:20]), PARTS)


@pytest.fixture(scope="module")
def tilted(tiny):
    return scored(tiny, GravityTilt, {"tilt_x": 0.7, "tilt_y": -0.3})


def test_a_planted_tilt_has_its_size_and_direction(tilted):
    (one,) = [s for s in tilted if s.hypothesis.term is GravityTilt]
    truth = np.array([0.7, -0.3, 0.0])
    # linear in the amplitude but for the body's own bends; the observer's straight lines between frames cost some per cent
    assert np.linalg.norm(one.amplitude - truth) < 0.1 * np.linalg.norm(truth)
    assert (np.abs(one.amplitude - truth) < 3 * one.error).all()
    assert one.gains["train"] > 0.8 and one.gains["heldout"] > 0.8
    assert 0 < one.kept <= 1 and np.linalg.norm(one.direction) == pytest.approx(1)


def test_nothing_explains_a_tilt_better_than_what_is_as_uniform(tilted):
    # a fast wind is a uniform pull, and so is a tilt: the two may rival, everything else is behind both
    best = {s.hypothesis.effect: 0.0 for s in tilted}
    for s in tilted:
        best[s.hypothesis.effect] = max(best[s.hypothesis.effect], s.gains["heldout"])
    assert set(sorted(best, key=best.get)[-2:]) <= {"gravity_tilt", "wind", "hidden_tether"}
    assert best["gravity_tilt"] == pytest.approx(max(best.values()), abs=0.02)


def test_what_shows_is_counted_in_standard_errors():
    # F frames weigh 1 / F each, over 3 n residuals: those of pure noise, weighted, have variance 1 / (3 n F), so their product with a unit
    # vector, over sqrt(RIDGE), has the deviation 1 / sqrt(3 n F RIDGE); Huber's limit of 3 deviations takes off little
    rng, frames, nodes = np.random.default_rng(0), 10, 8
    by_frame = Frames.of_seen([np.ones((frames, nodes), bool)], [1e-12])
    size = 0.01 / np.sqrt(frames * 3 * nodes)
    nuisance, effect = rng.standard_normal((frames * 3 * nodes, 4)), rng.standard_normal(frames * 3 * nodes)
    drawn = np.array([_shows(size * rng.standard_normal(len(effect)), nuisance, effect, by_frame) for _ in range(400)])
    expected = 1 / np.sqrt(frames * 3 * nodes * RIDGE)
    assert abs(drawn.mean()) < 4 * expected / np.sqrt(400)
    assert drawn.std() == pytest.approx(expected, rel=0.15)  # 400 draws: 3.5 % by chance; Huber's weights and the frames' own sizes
    # what the baseline's knobs can do shows nothing; what follows the effect shows, and what goes against it shows negatively
    noise = size * rng.standard_normal(len(effect))
    assert abs(_shows(size * nuisance @ np.ones(4), nuisance, effect, by_frame)) < 0.1
    assert _shows(noise - size * effect, nuisance, effect, by_frame) > 4 * expected
    assert _shows(noise + size * effect, nuisance, effect, by_frame) < -4 * expected
    assert _shows(noise, nuisance, 0 * effect, by_frame) == 0.0


def test_a_planted_tilt_shows_on_every_part_and_an_effect_that_is_not_there_less(tilted):
    (one,) = [s for s in tilted if s.hypothesis.term is GravityTilt]
    assert min(one.shows.values()) > 5  # standard errors, where the simulated recording has no other fault
    others = [s for s in tilted if s.hypothesis.effect not in ("gravity_tilt", "wind", "hidden_tether")]
    assert max(min(s.shows.values()) for s in others) < min(one.shows.values())


def test_what_shows_on_a_part_is_the_same_when_it_is_looked_at_alone(tiny):
    simulator = tiny.drawn(tiny.concealing(terms=[GravityTilt], values={"tilt_x": 0.7, "tilt_y": -0.3}, gravity=np.zeros(3), frames=30))
    task, base = Task([simulator], [30], BANDWIDTH, finest=EXACT), at_truth(tiny, simulator)
    knobs = tuple(Knob(f"tilt_{a}", 0.0, 0.7, -20.0, 20.0, step=0.25) for a in "xyz")
    absent = Hypothesis("quadratic_drag", QuadraticDrag, {}, (Knob("quadratic_drag", 0.0, 1.0, 0.0, 20.0, step=0.25),))
    scores = screen(task, base, [Hypothesis("gravity_tilt", GravityTilt, {}, knobs), absent], PARTS)
    scores[1] = replace(scores[1], amplitude=np.zeros(1))
    again = confirm(task, base, [replace(s, shows={"train": s.shows["train"]}) for s in scores], PARTS[1:])
    # one turn of all amplitudes at once, or one of each: the same but for what is not linear in a quarter of a noticeable tilt
    assert again[0].shows["heldout"] == pytest.approx(scores[0].shows["heldout"], rel=0.02)
    assert again[0].shows["train"] == scores[0].shows["train"]
    assert again[1].shows["heldout"] == 0.0


def test_what_the_observer_pushes_with_is_the_missing_acceleration():
    # a free particle whose model lacks a: the gap e obeys e'' = a - w^2 e - 2 z w e', and the push w^2 e + 2 z w e' is a - e''
    fps, a, w, z = 300.0, np.array([0.7, -0.3, 0.0]), 2 * np.pi * BANDWIDTH, DAMPING
    t = np.arange(450) / fps
    v = w * np.sqrt(1 - z * z)
    decay = np.exp(-z * w * t)
    gap = (1 - decay * (np.cos(v * t) + z * w / v * np.sin(v * t))) / w**2  # from rest, per unit of a
    acceleration = decay * (np.cos(v * t) - z * w / v * np.sin(v * t))
    replica = SimpleNamespace(sightings=SimpleNamespace(position=(gap[:, None] * a)[:, None]), recording=SimpleNamespace(fps=fps))
    push = missing_acceleration(replica, np.zeros((450, 1, 3)), BANDWIDTH)[:, 0]
    # central differences and means over 5 frames are of second order: (w dt)^2 = 0.002
    np.testing.assert_allclose(push[5:-5], ((1 - acceleration)[:, None] * a)[5:-5], atol=0.01)
    np.testing.assert_allclose(push[-50:-5], np.tile(a, (45, 1)), atol=1e-3)


def test_a_planted_wind_blows_the_way_it_was_planted(tiny):
    scores = scored(tiny, Wind, {"wind_x": 0.7, "wind_speed": 4.0})
    (one,) = [s for s in scores if s.hypothesis.term is Wind and s.hypothesis.values["wind_speed"] == 4.0]
    along = one.amplitude / np.linalg.norm(one.amplitude)
    assert along[0] > 0.99
    assert np.linalg.norm(one.amplitude) == pytest.approx(0.7, rel=0.15)
    assert one.gains["heldout"] > 0.9


def test_an_adequate_twin_leaves_nothing_to_explain(tiny):
    simulator = tiny.drawn(tiny.concealing(gravity=np.zeros(3), frames=30))
    hypothesis = Hypothesis("gravity_tilt", GravityTilt, {}, tuple(Knob(f"tilt_{a}", 0.0, 0.7, -20.0, 20.0) for a in "xyz"))
    (one,) = screen(Task([simulator], [30], 0.0), at_truth(tiny, simulator), [hypothesis], PARTS)
    # a screening takes a fifth more substeps than the recording had, and the engine is of first order in them
    assert np.linalg.norm(one.amplitude) < 0.01 * 0.7


def test_amplitudes_come_from_the_first_part_alone(tiny):
    first = tiny.concealing(terms=[GravityTilt], values={"tilt_x": 0.7}, gravity=np.zeros(3), frames=30)
    later = first.points.copy()
    later[20:] += 0.03
    hypothesis = Hypothesis("gravity_tilt", GravityTilt, {}, tuple(Knob(f"tilt_{a}", 0.0, 0.7, -20.0, 20.0) for a in "xyz"))
    found = []
    for scenario in (first, replace(first, points=later)):
        simulator = tiny.drawn(scenario)
        found += screen(Task([simulator], [30], BANDWIDTH), at_truth(tiny, simulator), [hypothesis], PARTS)
    assert (found[0].amplitude == found[1].amplitude).all() and found[0].gains["train"] == found[1].gains["train"]
    assert found[0].gains["heldout"] != found[1].gains["heldout"]


def test_an_effect_that_can_only_push_one_way_is_none_where_the_other_way_would_help(tiny):
    # a body of less drag than its twin: quadratic drag >= 0 cannot take drag back
    simulator = tiny.drawn(tiny.concealing(values={"drag_damping": 0.0}, gravity=np.zeros(3), frames=30))
    model = tiny.known(baseline_model([simulator.replica]), "body_stiffness")
    base = Fit(model, np.array([model.knobs[0].encode(tiny.truth["body_stiffness"])]), 0.0, np.eye(1), ())
    (one,) = screen(Task([simulator], [30], BANDWIDTH), base, [drag()], PARTS)
    assert one.amplitude.tolist() == [0.0]
    assert one.gains == {"train": 0.0, "heldout": 0.0}


def test_nodes_that_follow_the_recording_are_no_evidence(tiny):
    simulator = tiny.drawn(tiny.concealing(gravity=np.zeros(3), frames=30))
    effect = SecondHand.effect
    reach, place = 0.02, simulator.replica.nodes[7]
    values = {f"{effect.place}_{a}": float(c) for a, c in zip("xyz", place, strict=True)} | {effect.within: reach}
    hand = Hypothesis(effect.name, SecondHand, values, tuple(Knob(a, 0.0, 1.0, 0.0, 1.0) for a in effect.amplitudes))
    near = np.linalg.norm(simulator.replica.nodes - place, axis=1) < FOLLOWED * reach
    assert 0 < near.sum() < len(near)
    assert hand.follows(simulator.replica).tolist() == np.flatnonzero(near).tolist()
    counted = judged(Task([simulator], [30], BANDWIDTH), PARTS[1], hand.follows).reshape(10, -1, 3)  # residuals are frame by node by axis
    assert ((counted == 0) == near[None, :, None]).all()
    assert drag().follows(simulator.replica).size == 0  # a law of motion is judged by every node


def drag():
    return Hypothesis("quadratic_drag", QuadraticDrag, {}, (Knob("quadratic_drag", 0.0, 0.5, 0.0, 1000.0, step=0.25, prior=ANY),))


def test_far_starts_find_a_drag_that_linear_drag_hid(tiny):
    # all resistance is quadratic, and a linear twin has taken it for drag: near that twin, a little of it gains almost nothing
    scenario = tiny.concealing(
        terms=[QuadraticDrag], values={"quadratic_drag": 30.0, "drag_damping": 0.0}, gravity=np.zeros(3), frames=30, way=0.15
    )
    simulator = tiny.drawn(scenario)
    task, model = (
        Task([simulator], [30], 0.0, finest=EXACT),
        tiny.known(baseline_model([simulator.replica]), "body_stiffness", "drag_damping"),
    )
    base = fit(task, model, np.zeros(2), iterations=8)
    assert base.values["drag_damping"] > 5  # 1/s, where there is none
    (score,) = screen(task, base, [drag()], [Part("train", 0, 0, 30)])
    extended = base.model.extended({QuadraticDrag}, {}, drag().knobs)
    near, far = _starts(base, extended, score)
    assert near and far
    plain, found = refit(task, base, [score], iterations=6, spacing=simulator.replica.spacing)
    assert found.history[-1] < 0.5 * plain.history[-1]
    assert found.values["quadratic_drag"] == pytest.approx(30.0, rel=0.6)
    assert found.values["drag_damping"] < 0.8 * base.values["drag_damping"]


def test_errors_of_parts_leave_out_the_nodes_that_may_not_judge(tiny):
    scenario = tiny.concealing(gravity=np.zeros(3), frames=30)
    off = scenario.points.copy()
    off[:, 7] += [0.03, 0, 0.04]  # one node of 20 was seen 5 cm away from where it was
    simulator = tiny.drawn(scenario, seen=off)
    task, base = Task([simulator], [30], 0.0), at_truth(tiny, simulator)
    all_of_them = evaluate(task, base, PARTS)
    without = evaluate(task, base, PARTS, leave=lambda replica: np.array([7]))
    assert all_of_them.free["heldout"] == pytest.approx(0.05 / 20, rel=1e-6)
    floor = floor_of(simulator.replica)  # an error of 0 counts as that
    assert all_of_them.observed["heldout"] > floor == pytest.approx(without.observed["heldout"], rel=0.01)  # it levels off at LOST
    assert without.free["heldout"] < 1e-9


def test_a_model_has_one_ground_and_new_terms_come_by_name():
    model = Model((Springs, Ground), {"collide_elas": 0.05}, (Knob("collide_fric", 0.4, 0.3, 0.0, 2.0),))
    found = model.extended([Wind, StribeckGround, Springs, GravityTilt], {"wind_speed": 4.0}, drag().knobs)
    assert found.terms == (Springs, GravityTilt, StribeckGround, Wind)
    assert found.values == {"collide_elas": 0.05, "wind_speed": 4.0}
    assert found.names == ("collide_fric", "quadratic_drag")
    assert model.extended({Springs, Ground}, {}, ()) == model


def test_the_catalogue_holds_every_term_with_an_effect_once():
    names = [t.name for t in catalogue()]
    assert names == sorted(set(names)) and {"gravity_tilt", "wind", "quadratic_drag", "hidden_tether"} <= set(names)
