"""The commands that measure twins of sound bodies: errors where tracks were seen, summaries, and what an oracle is told."""

from itertools import product
from types import SimpleNamespace as Some

import numpy as np
import pytest
from twinbench.benchmark.solid_oracle import simulated, told
from twinbench.benchmark.solid_twins import errors, first_second, summary
from twinbench.methods.base import Trajectory
from twinbench.physics.terms import SoftGrip

PLACE = [{"centroid": [0.01, 0.02, 0.03], "radius": 0.04}] * 2
KNOWN = {"axis_frame0": [0.0, 1.0, 0.0], "moves": False, "anchor": [0.0, 0.1, 0.2], "rest_m": 0.03, "shape": "sphere", "size_m": 0.03}
KNOWN |= {"reach_m": 0.005}
EVERY = ("added_mass", "wind", "gravity_tilt", "grip_compliance", "controller_delay", "quadratic_drag")
EVERY += ("hidden_tether", "hidden_obstacle", "ground_adhesion")
OF_CELLS = ("viscoelastic", "anisotropy", "compression_softening", "creep")
OF_SHEETS = ("viscoelastic", "compression_softening", "creep")


def scene(kind="solid", axes=None):
    body = Some(kind=kind, grid=Some(axes=np.eye(3) if axes is None else axes))
    return Some(body=body, gravity=np.array([0.0, 0.0, 9.81]), ground=Some(normal=np.array([0, 0, -1.0]), offset=0.0))


def test_errors_are_distances_in_mm_where_tracks_were_seen():
    tracked = np.zeros((2, 2, 3))
    truth = np.array([[[3.0, 4.0, 0.0], [1.0, 0, 0]], [[0, 0, 0], [0, 0, 2.0]]]) / 1e3
    found = errors(Some(tracked=tracked), truth, np.array([[True, False], [True, True]]))
    np.testing.assert_allclose(found, [[5.0, np.nan], [0.0, 2.0]])  # a 3-4-5 triangle


def test_particles_of_another_recording_are_told_by_where_they_are_in_frame_0():
    # two tracks 1 m apart, and a third that was not seen; the twin's particles are theirs in another order, and one more
    points = np.array([[0.0, 0, 0], [1.0, 0, 0], [0, 0, 0]])
    seen = np.array([[True, True, False], [True, True, True]])
    truth = np.stack([points, points + [0, 0.002, 0]])
    own = np.array([[1.0, 0, 0], [5.0, 0, 0], [0.0, 0, 0], [7.0, 0, 0]])
    trajectory = Trajectory(np.stack([own, own]).astype(np.float32), (4, 0, 0))
    np.testing.assert_allclose(errors(trajectory, truth, seen, points), [[0, 0, np.nan], [2, 2, np.nan]], atol=1e-4)
    kept = Trajectory(np.stack([points, points]).astype(np.float32), (3, 0, 0))
    np.testing.assert_allclose(errors(kept, truth, seen, points), [[0, 0, np.nan], [2, 2, 2]], atol=1e-4)


def test_a_summary_is_of_medians_over_cases_and_of_gentle_parts():
    rows = []
    for case, error in (("a", 1.0), ("b", 2.0), ("c", 9.0)):
        for of in ("fitted", "held-out", "transfer"):
            about = dict(set="s", method="m", case=case, of=of)
            rows += [
                about | dict(part="all", error=error),
                about | dict(part="lift", error=error / 2),
                about | dict(part="swing", error=50.0),
                about | dict(part="frame 0", error=error / 4),
                about | dict(part="first second", error=error * 2),
            ]
    assert summary(rows).splitlines()[-1] == "| s | m | 3 | 2.00 | 2.00 | 2.00 | 1.00 | 1.00 | 1.00 | 0.50 | 0.50 | 4.00 | 4.00 |"


def test_the_first_second_begins_when_a_hand_has_gone_5_mm():
    # the second of two hands goes 1 mm a frame from frame 3 on: 5 mm in frame 8
    hands = np.zeros((60, 2, 3))
    hands[:, 1, 2] = 1e-3 * np.maximum(np.arange(60) - 3, 0)
    assert first_second(hands + [0.1, 0.2, 0.3], 30.0) == (8, 38)
    with pytest.raises(ValueError, match="a hand must go 5 mm"):
        first_second(hands[:5], 30.0)


@pytest.mark.parametrize(
    ("kind", "effect"), [*product(("solid", "rope", "sheet"), EVERY), *product(("solid",), OF_CELLS), *product(("sheet",), OF_SHEETS)]
)
def test_an_oracle_is_told_of_parameters_that_its_terms_have(kind, effect):
    label = dict(effect=effect, parameters=KNOWN, place=PLACE)
    terms, amounts, fixed = told(label, scene(kind))
    known = {p.name for t in (SoftGrip, *terms) for p in t.parameters}
    assert amounts and {u.name for u in amounts} | set(fixed) <= known
    for term in terms:
        own = {p.name for p in term.parameters}
        term.with_values(**{n: v for n, v in fixed.items() if n in own}, **{u.name: u.value for u in amounts if u.name in own})


def test_fibres_are_told_their_direction_in_the_grids_axes():
    # an axis along the room's y is the first axis of a grid whose first row is y
    turned = scene(axes=np.roll(np.eye(3), -1, axis=0))
    _, _, fixed = told(dict(effect="anisotropy", parameters=KNOWN, place=[None, None]), turned)
    assert (fixed["fibre_azimuth"], fixed["fibre_elevation"]) == pytest.approx((0.0, 0.0))


def test_an_effect_that_no_term_says_is_refused():
    for effect, kind, known in (
        ("magnetism", "solid", {}),
        ("bending", "rope", {}),  # a rope's own stiffness is fitted by a sound twin
        ("anisotropy", "sheet", KNOWN),  # its direction would have to be told in the sheet's axes
        *((effect, "rope", KNOWN) for effect in OF_CELLS),
        ("hidden_tether", "rope", KNOWN | {"moves": True}),  # the term's anchor stays
        ("hidden_obstacle", "sheet", KNOWN | {"shape": "box"}),  # the term's is a sphere
    ):
        with pytest.raises(KeyError, match=effect):
            told(dict(effect=effect, parameters=known, place=PLACE), scene(kind))


def test_a_place_is_told_as_it_is_in_each_recording():
    places = [dict(centroid=[x, 0.0, 0.0], radius=0.04) for x in (0.1, 0.3)]
    for effect, name in (("added_mass", "added_mass_x"), ("hidden_tether", "tether_x")):
        label = dict(effect=effect, parameters=KNOWN, place=places)
        assert [told(label, scene("rope"), recording)[2][name] for recording in (0, 1)] == [0.1, 0.3]


BODY = dict(kind="plush", young=2e4, density=80.0, poisson=0.3, damping=0.01, drag=0.5, friction=0.4, area_m2=0.03, mass_kg=0.02)
AMOUNTS = {
    "viscoelastic": dict(ratio=3.0, time_s=0.2),
    "added_mass": dict(added_g=5.0),
    "wind": dict(velocity_m_s=[1.0, 0.5, 0.0], coefficient_kg_m3=2.4),
    "quadratic_drag": dict(coefficient_kg_m3=24.0),
    "creep": dict(time_s=0.5),
    "gravity_tilt": dict(gravity_m_s2=[1.2, -0.5, 9.7]),
    "controller_delay": dict(frames=2),
}


@pytest.mark.parametrize("effect", AMOUNTS)
def test_what_an_oracle_is_told_can_be_what_was_simulated(effect):
    # every amount that is fitted has a true value, within what is searched; a density of 80 makes E at 100 kg/m^3 1.25 times as large
    place = dict(centroid=[0.1, 0.0, 0.0], radius=0.04)
    label = dict(effect=effect, parameters=AMOUNTS[effect], place=[place, place], body=BODY)
    extra, amounts, _ = told(label, scene())
    true = simulated(label)
    assert true["youngs_modulus"] == pytest.approx(2.5e4)
    assert amounts and all(u.low <= true[u.name] <= u.high for u in amounts)
    assert {u.name for u in amounts} <= {p.name for term in extra for p in term.parameters}


def test_labels_weigh_what_was_added():
    # 20 g, of which 5 g were added to 15 g
    place = dict(centroid=[0.1, 0.0, 0.0], radius=0.04)
    label = dict(effect="added_mass", parameters=AMOUNTS["added_mass"], place=[place, place], body=BODY)
    assert simulated(label)["added_mass"] == pytest.approx(5 / 15)


def test_the_pull_of_a_wind_is_that_of_the_drag_equation():
    # F = c A |w - v| (w - v), by a unit of mass, on what is at rest: 2.4 * 0.03 / 0.02 * |w| w
    label = dict(effect="wind", parameters=AMOUNTS["wind"], body=BODY)
    true, speed = simulated(label), np.hypot(1.0, 0.5)
    assert [true[f"wind_{axis}"] for axis in "xyz"] == pytest.approx([3.6 * speed, 1.8 * speed, 0.0])
    assert true["wind_speed"] == pytest.approx(speed)


def test_a_tilt_that_was_simulated_turns_what_is_told():
    # the term takes what of the true gravity is across the told one: g + t with |g + t| = |g| is the true gravity
    true = np.array([1.2, -0.5, 0.0])
    true[2] = np.sqrt(9.81**2 - true @ true)
    label = dict(effect="gravity_tilt", parameters=dict(gravity_m_s2=true.tolist()), place=[None, None], body=BODY)
    (term,), _, fixed = told(label, scene())
    values = {p.name: {**fixed, **simulated(label)}[p.name] for p in term.parameters}
    np.testing.assert_allclose(term.twin(None, None, None, 1.0, **values) + scene().gravity, true, atol=1e-12)
