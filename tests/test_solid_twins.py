"""The commands that measure twins of solids: errors where tracks were seen, summaries, and what an oracle is told."""

from types import SimpleNamespace

import numpy as np
import pytest
from twinbench.benchmark.solid_oracle import simulated, told
from twinbench.benchmark.solid_twins import errors, summary
from twinbench.methods.base import Trajectory

PLACE = [{"centroid": [0.01, 0.02, 0.03], "radius": 0.04}] * 2
KNOWN = {"axis_frame0": [0.0, 1.0, 0.0]}
EFFECTS = ("viscoelastic", "added_mass", "wind", "anisotropy", "compression_softening", "grip_compliance", "quadratic_drag", "creep")


def test_errors_are_distances_in_mm_where_tracks_were_seen():
    tracked = np.zeros((2, 2, 3))
    truth = np.array([[[3.0, 4.0, 0.0], [1.0, 0, 0]], [[0, 0, 0], [0, 0, 2.0]]]) / 1e3
    found = errors(SimpleNamespace(tracked=tracked), truth, np.array([[True, False], [True, True]]))
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
            ]
    assert summary(rows).splitlines()[-1] == "| s | m | 3 | 2.00 | 2.00 | 2.00 | 1.00 | 1.00 | 1.00 |"


@pytest.mark.parametrize("effect", EFFECTS)
def test_an_oracle_is_told_of_parameters_that_its_terms_have(effect):
    label = dict(effect=effect, parameters=KNOWN, place=PLACE)
    terms, amounts, fixed = told(label, np.eye(3))
    known = {"grip_rate", "grip_damping", *(p.name for t in terms for p in t.parameters)}
    assert amounts and {u.name for u in amounts} | set(fixed) <= known
    for term in terms:
        own = {p.name for p in term.parameters}
        term.with_values(**{n: v for n, v in fixed.items() if n in own}, **{u.name: u.value for u in amounts if u.name in own})


def test_fibres_are_told_their_direction_in_the_grids_axes():
    # an axis along the room's y is the first axis of a grid whose first row is y
    _, _, fixed = told(dict(effect="anisotropy", parameters=KNOWN, place=[None, None]), np.roll(np.eye(3), -1, axis=0))
    assert (fixed["fibre_azimuth"], fixed["fibre_elevation"]) == pytest.approx((0.0, 0.0))


def test_an_effect_that_no_term_says_is_refused():
    with pytest.raises(KeyError, match="magnetism"):
        told(dict(effect="magnetism", parameters={}, place=[None]), np.eye(3))


BODY = dict(kind="plush", young=2e4, density=80.0, poisson=0.3, damping=0.01, drag=0.5, friction=0.4, area_m2=0.03, mass_kg=0.02)
AMOUNTS = {
    "viscoelastic": dict(ratio=3.0, time_s=0.2),
    "added_mass": dict(added_g=5.0),
    "wind": dict(velocity_m_s=[1.0, 0.5, 0.0], coefficient_kg_m3=2.4),
    "quadratic_drag": dict(coefficient_kg_m3=24.0),
    "creep": dict(time_s=0.5),
}


@pytest.mark.parametrize("effect", AMOUNTS)
def test_what_an_oracle_is_told_can_be_what_was_simulated(effect):
    # every amount that is fitted has a true value, within what is searched; a density of 80 makes E at 100 kg/m^3 1.25 times as large
    place = dict(centroid=[0.1, 0.0, 0.0], radius=0.04)
    label = dict(effect=effect, parameters=AMOUNTS[effect], place=[place, place], body=BODY)
    extra, amounts, _ = told(label, np.eye(3))
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
