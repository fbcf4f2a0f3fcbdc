"""The figures of the challenge, counted by hand or against closed forms and independent implementations."""

from functools import cache

import numpy as np
import pytest
from twinbench.benchmark.challenge.grids import grids
from twinbench.benchmark.challenge.scores import figures, size_of, with_floors
from twinbench.benchmark.challenge.statistics import (
    auroc,
    bootstrap,
    calibration_bins,
    clopper_pearson,
    early_auroc,
    expected_calibration_error,
    mcnemar,
    overlap,
    risk_coverage,
    size_at,
    upper_bound,
)
from twinbench.benchmark.challenge.truths import Row, amplitude, physical
from twinbench.datasets.synthetic.simulate import GRAVITY
from twinbench.diagnosis.verdict import NONE, OTHER

FLOOR = 0.010  # m, of the controls below


def label(kind, effect=None, *, size=0.020, place=None, points=(), onset=0, parameters=None, body="rope", engine="one", parts=None):
    where = None if place is None else {"centroid": list(place), "radius": 0.02, "points": list(points)}
    one = {
        **{"kind": kind, "effect": effect, "control": "plain" if kind == "control" else None, "object": body, "simulated_by": engine},
        **{"displacement": 0.0 if kind == "control" else size, "place": [where, None], "onset": [onset, None]},
        **{"parameters": parameters or {}, "frames": [50, 50], "body": {"area_m2": 0.05, "mass_kg": 0.02}},
    }
    return one | ({"parts": parts} if parts else {})


def said(
    verdict, effect=None, other=(), *, chances=None, where=None, when=None, parameters=None, transfer=None, detectable=None, train=FLOOR
):
    return {
        **{"verdict": verdict, "effect": effect, "alternatives": list(other), "where": where, "when": when and {"frames": when}},
        "probabilities": chances or ({effect: 0.8, NONE: 0.1, OTHER: 0.1} if effect else {NONE: 0.6, OTHER: 0.4}),
        "parameters": {k: {"value": v, "interval90": [a, b]} for k, (v, a, b) in (parameters or {}).items()},
        "fit": {"train": {"baseline": train}, "transfer": dict(zip(("baseline", "extended"), transfer or (None, None), strict=True))},
        **{"detectable": detectable or {}, "seconds": 10.0},
    }


def tracks(*points, at=(0.0, 0.0, 0.0)):
    return {"points": list(points), "centroid": list(at), "radius": 0.02}


HEAVY = label("effect", "added_mass", place=(0.0, 0.03, 0.04), points=[1, 2, 3, 4], onset=10, parameters={"added_g": 10.0})
WINDY = label("effect", "wind", parameters={"coefficient_kg_m3": 0.4, "velocity_m_s": [2.0, 0.0, 0.0]})
MIXED = [label("effect", "wind", parameters={}), label("effect", "bending", parameters={})]
CASES = [
    # five controls: three quiet, one alarm with a name, one without
    *((label("control"), said("adequate")) for _ in range(3)),
    (label("control"), said("missing", "wind")),
    (label("control"), said("unknown", chances={NONE: 0.3, OTHER: 0.7})),
    # added mass: right with place, time and amplitude; and wrong
    (
        HEAVY,
        said(
            "missing",
            "added_mass",
            where=tracks(3, 4, 5, 6),
            when=[20, 50],
            parameters={"added_mass": (1.2, 0.75, 1.5)},
            transfer=(0.010, 0.006),
        ),
    ),
    (HEAVY, said("missing", "wind", transfer=(0.010, 0.009))),
    # wind: right; one of two; found; refused, and small
    (
        WINDY,
        said(
            "missing",
            "wind",
            parameters={"wind_x": (3.0, 2.0, 4.0), "wind_y": (0.0, 0, 0), "wind_z": (0.0, 0, 0)},
            detectable={"wind": 2.0},
        ),
    ),
    (WINDY, said("ambiguous", "gravity_tilt", ["wind"], chances={"gravity_tilt": 0.45, "wind": 0.4, NONE: 0.1, OTHER: 0.05})),
    (WINDY, said("unknown", chances={OTHER: 0.6, "wind": 0.3, NONE: 0.1})),
    (WINDY | {"displacement": 0.005}, said("cannot_tell", chances={NONE: 0.5, OTHER: 0.5})),
    # outside: unknown, and named
    (label("outside", "magnets"), said("unknown", chances={OTHER: 0.7, NONE: 0.2, "wind": 0.1})),
    (label("outside", "motor"), said("missing", "bending")),
    # two effects: both named, one named
    (label("pair", "wind+bending", parts=MIXED), said("ambiguous", "bending", ["wind"])),
    (label("pair", "wind+bending", parts=MIXED), said("missing", "wind")),
]
CEILING = {5: said("missing", "added_mass", transfer=(0.010, 0.002)), 6: said("missing", "added_mass", transfer=(0.010, 0.006))}
ROWS = with_floors(*[[Row(f"case_{k}", v, r, CEILING.get(k)) for k, (v, r) in enumerate(CASES)]] * 2)


@cache
def counted():
    return {f.name: f for f in figures(ROWS)}


@pytest.mark.parametrize(
    ("name", "value", "cases"),
    [
        ("false alarms", 2 / 5, 5),
        ("false alarms with a name", 1 / 5, 5),
        ("effects found", 5 / 6, 6),
        ("named first, macro", (1 / 2 + 1 / 4) / 2, 6),
        ("named first at twice the floor, macro", (1 / 2 + 1 / 3) / 2, 5),
        ("named or one of two at twice the floor, macro", (1 / 2 + 2 / 3) / 2, 5),
        ("named or one of two, macro", (1 / 2 + 2 / 4) / 2, 6),
        ("likeliest name right, said or not, macro", (1 / 2 + 2 / 4) / 2, 6),
        ("right among the two likeliest names, macro", (1 / 2 + 3 / 4) / 2, 6),
        ("named wrong", 2 / 6, 6),
        # added mass: 1 of 2 named so, of which all right: 2 / (2 + 1); wind: 1 right, 4 true, 2 said (one of them of added mass)
        ("macro F1 of names", (2 / 3 + 2 / 6) / 2, 6),
        ("outside yet named", 1 / 2, 2),
        ("outside said to be unknown", 1 / 2, 2),
        ("pairs, first name one of the two", 1.0, 2),
        ("pairs, F1 of names", (1 + 2 / 3) / 2, 2),
        ("place F1", 2 * 2 / 8, 1),  # points 3 and 4 of four and four
        # 4 particles x 40 frames true, 4 x 30 said, 2 x 30 in both
        ("place and time F1", 2 * 60 / 280, 1),
        ("place, distance", 0.05, 1),
        ("onset, difference", 10, 1),
        # added mass 1.2 for 1 (10 g on 10 g); wind 3 for 0.4 x 0.05 / 0.02 x 2^2 = 4
        ("amplitude, error", (0.2 + 0.25) / 2, 2),
        ("amplitude, 90 % intervals that cover", 1.0, 1),
        # 4 of 8 mm, and 1 of 4 mm
        ("share of the oracle's gain, transfer", 5 / 12, 2),
        ("failed or missing answers", 0.0, 15),
        ("time of an answer", 10.0, 15),
    ],
)
def test_figures_are_counts_by_the_rules(name, value, cases):
    assert (counted()[name].value, counted()[name].cases) == (pytest.approx(value), cases)


def test_shares_have_exact_intervals_and_goals():
    one = counted()["false alarms"]
    assert (one.low, one.high) == clopper_pearson(2, 5) and one.reached is False
    assert counted()["false alarms, 95 % bound"].value == upper_bound(2, 5)
    assert counted()["outside yet named"].reached is False
    assert counted()["amplitude, error"].reached is False and counted()["effects found"].reached is None
    assert counted()["share of the oracle's gain, heldout"].reached is None  # nobody was told


def test_areas_are_those_of_the_probabilities():
    # suspicion is 1 - p(adequate): controls 0.4 0.4 0.4 0.9 0.7, the others 0.9 but for one of 0.5, one of 0.8, of a pair 0.9
    others = [0.9] * 5 + [0.5] + [0.8] + [0.9] * 3
    assert counted()["detection, area under the curve"].value == pytest.approx(auroc(others, [0.4, 0.4, 0.4, 0.9, 0.7]))
    # the likeliest name: 0.8, 0.8, 0.8, 0.45, 0.3, 0 in the catalogue; 0.1 and 0.8 outside
    assert counted()["catalogued against outside, area under the curve"].value == pytest.approx(
        auroc([0.8] * 3 + [0.45, 0.3, 0], [0.1, 0.8])
    )


def test_the_floor_is_that_of_sound_bodies_of_the_same_kind():
    controls = [
        Row(f"c{k}", label("control", body=b), said("adequate", train=e))
        for k, (b, e) in enumerate([("rope", 0.01), ("rope", 0.03), ("cloth", 0.05)])
    ]
    asked = [
        Row("r", label("effect", "wind", size=0.04), said("adequate")),
        Row("p", label("effect", "wind", body="plush"), said("adequate")),
    ]
    rope, plush = with_floors(asked, controls)
    assert rope.floor == pytest.approx(0.02) and plush.floor == pytest.approx(0.03)  # of ropes; of all
    assert rope.ratio == pytest.approx(2) and size_of(rope) == 2.0
    sizes = [size_of(Row("x", label("effect", "wind", size=s * 0.01), said("adequate"), None, 0.01)) for s in (0.3, 0.75, 1.3, 1.5, 20)]
    assert sizes == [0.5, 1.0, 1.0, 2.0, 8.0]


def test_true_sizes_in_the_twins_units():
    body = {"body": {"area_m2": 0.06, "mass_kg": 0.02}}

    def of(effect, **given):
        return physical({"effect": effect, "parameters": given}, body)

    assert of("quadratic_drag", coefficient_kg_m3=2.0) == pytest.approx(6.0)  # c A / m
    tilt = np.radians(10)
    leaning = [0.0, GRAVITY * np.sin(tilt), GRAVITY * np.cos(tilt)]
    assert of("gravity_tilt", gravity_m_s2=leaning) == pytest.approx(2 * GRAVITY * np.sin(tilt / 2))  # a chord of the circle
    assert of("controller_delay", frames=3) == pytest.approx(0.1)
    assert of("creep", time_s=0.5) == pytest.approx(2.0)
    assert of("added_mass", added_g=4.0) == pytest.approx(4 / 16)  # the label weighs the body with what was added
    assert of("rest_shape", strain=-0.05) == pytest.approx(np.log(1 / 0.95))
    assert of("friction_law", static=1.0, kinetic=0.25, speed_m_s=0.1) == pytest.approx(0.75)  # by how much more holds at rest
    assert amplitude("friction_law", {"coulomb_rest_friction": {"value": 0.9}}) == 0.9  # which has no term of its own
    assert of("grip_points", shift_m=[0.03, 0.0, 0.04]) == pytest.approx(0.05)
    assert np.isnan(of("bending", factor=30.0)) and np.isnan(physical({"effect": "wind", "parameters": {}}, {}))
    assert amplitude("gravity_tilt", {f"tilt_{axis}": {"value": v} for axis, v in zip("xyz", (1.0, 2.0, 2.0), strict=True)}) == 3.0
    assert np.isnan(amplitude("gravity_tilt", {"tilt_x": {"value": 1.0}}))


def test_what_was_foreseen_is_the_true_size_over_the_least_that_shows():
    windy = ROWS[7]
    assert windy.foreseen == pytest.approx(4 / 2)
    assert np.isnan(ROWS[8].foreseen)  # nothing was said of the least
    told = Row(
        "x",
        label("effect", "bending"),
        said("adequate", detectable={"bending": 0.1}),
        said("missing", "bending", parameters={"bending_stiffness": (0.3, 0, 1)}),
    )
    assert told.foreseen == pytest.approx(3)  # where physics does not tell, who was told does


def test_tables_have_every_case_once():
    found = {g.title: g for g in grids(ROWS)}
    for title, grid in found.items():
        assert all(len(row) == len(grid.header) for row in grid.rows), title

    def cases(title):
        return sum(int(row[1]) for row in found[title].rows)

    assert cases("Power by size, over what a twin of a sound body is off by") == cases("By effect") == 6
    assert cases("Power by size, over the smallest that the answer says would have stood out") == 6
    assert cases("By body") == cases("By engine") == cases("What was said of what") == cases("Calibration: the likeliest reading") == 15
    power = {row[0]: row for row in found["Power by size, over what a twin of a sound body is off by"].rows}
    assert power["2"][2].startswith("5 of 5 (") and power["0.5"][2].startswith("0 of 1 (")
    confused = {row[0]: row[2] for row in found["What was said of what"].rows}
    assert (
        confused[NONE] == "adequate 3, wind 1, unknown 1"
        and confused["outside: motor"] == "bending 1"
        and confused["bending+wind"] == "bending 1, wind 1"
    )


def test_what_an_answer_leaves_out_is_not_counted():
    """Who is told, and other programs, give no intervals, clusters or errors."""
    bare = {"verdict": "missing", "effect": "added_mass", "alternatives": [], "probabilities": {"added_mass": 1.0}}
    rows = [Row("x", HEAVY, bare | {"parameters": {"added_mass": {"value": 1.0}}}), Row("y", label("control"), {"verdict": "adequate"})]
    found = {f.name: f for f in figures(rows)}
    assert found["amplitude, error"].value == 0 and found["amplitude, 90 % intervals that cover"].cases == 0
    assert found["place F1"].value == 0  # there is a place, and it was not said
    assert found["first cluster holds the place"].cases == found["share of the oracle's gain, transfer"].cases == 0
    assert grids(rows)


def test_a_missing_answer_is_a_refusal():
    from twinbench.benchmark.challenge.schema import FAILED

    row = Row("x", WINDY, FAILED)
    assert not row.alarm and not row.named and row.suspicion == 0 and row.conviction == 0 and row.likeliest == (NONE, 1.0)
    assert {f.name: f.value for f in figures([row, Row("y", label("control"), FAILED)])}["failed or missing answers"] == 1.0


# --- statistics -----------------------------------------------------------------------------------------------------------------------


def test_clopper_pearson_inverts_the_binomial():
    from scipy.stats import binom

    for hits, of in ((0, 60), (2, 124), (7, 20), (20, 20)):
        low, high = clopper_pearson(hits, of)
        # at the lower end so many hits or more have a probability of 2.5 %, at the upper end so many or fewer
        assert low == 0 if hits == 0 else binom.sf(hits - 1, of, low) == pytest.approx(0.025)
        assert high == 1 if hits == of else binom.cdf(hits, of, high) == pytest.approx(0.025)
        assert hits == of or binom.cdf(hits, of, upper_bound(hits, of)) == pytest.approx(0.05)
    assert upper_bound(0, 60) == pytest.approx(0.049, abs=5e-4) and upper_bound(2, 124) == pytest.approx(0.050, abs=5e-4)
    assert upper_bound(0, 0) == 1.0


def test_areas_under_curves():
    rng = np.random.default_rng(0)
    positive, negative = rng.normal(1, 1, 40).round(1), rng.normal(0, 1, 60).round(1)
    pairs = [(p > n) + 0.5 * (p == n) for p in positive for n in negative]
    assert auroc(positive, negative) == pytest.approx(np.mean(pairs))
    assert early_auroc(positive, negative, most=1.0) == pytest.approx(auroc(positive, negative))  # all of the curve
    assert early_auroc([2, 3], [0, 1], most=0.05) == 1.0 and early_auroc([0, 1], [2, 3], most=0.05) == 0.0
    assert early_auroc(rng.random(4000), rng.random(4000), most=0.05) == pytest.approx(0.025, abs=0.01)  # chance: most / 2
    assert np.isnan(auroc([], [1])) and np.isnan(early_auroc([1], []))


def test_a_bootstrap_covers_as_it_says():
    # the mean of 40 normal numbers: 95 % intervals hold the true mean in 91 to 99 of 100 (2 sigma; percentiles are narrow)
    rng = np.random.default_rng(0)
    inside = 0
    for k in range(100):
        low, high = bootstrap(rng.normal(3, 1, 40).tolist(), lambda some: float(np.mean(some)), draws=200, seed=k)
        inside += low <= 3 <= high
    assert 88 <= inside <= 99
    assert all(np.isnan(bootstrap([1.0], np.mean)))


def test_calibration_is_the_distance_of_confidence_from_truth():
    confidence, right = [0.05, 0.15, 0.15, 0.95, 0.95, 1.0], [False, False, True, True, True, False]
    assert [(n, c, r) for _, _, n, c, r in calibration_bins(confidence, right)] == [
        (1, pytest.approx(0.05), 0.0),
        (2, pytest.approx(0.15), 0.5),
        (3, pytest.approx(2.9 / 3), pytest.approx(2 / 3)),
    ]
    assert expected_calibration_error(confidence, right) == pytest.approx((0.05 + 2 * 0.35 + 0.9) / 6)


def test_risk_over_coverage():
    # sorted by confidence right, wrong, right: risks 0, 1/2, 1/3
    assert risk_coverage([0.2, 0.9, 0.5], [True, True, False]) == pytest.approx((0 + 1 / 2 + 1 / 3) / 3)


def test_mcnemar_is_a_sign_test_of_what_differs():
    one, other = [True] * 9 + [False] * 3 + [True] * 5, [False] * 9 + [True] * 3 + [True] * 5
    # 9 against 3 of 12: 2 (C(12,0) + C(12,1) + C(12,2) + C(12,3)) / 2^12
    assert mcnemar(one, other) == pytest.approx(2 * (1 + 12 + 66 + 220) / 4096)
    assert mcnemar(one, one) == 1.0


def test_overlap_of_sets():
    assert overlap({1, 2}, {2, 3}) == 0.5 and overlap(set(), {1}) == 0.0 and np.isnan(overlap(set(), set()))


def test_the_size_that_is_found_in_four_of_five():
    rng = np.random.default_rng(0)
    sizes = np.exp(rng.uniform(np.log(0.5), np.log(8), 4000))
    # found with probability 1 / (1 + (2 / s)^3): 0.8 at s = 2 x 4^(1/3); 4000 cases tell the slope to 3 %
    found = rng.random(4000) < 1 / (1 + (2 / sizes) ** 3)
    assert size_at(sizes, found) == pytest.approx(2 * 4 ** (1 / 3), rel=0.06)
    # the same minimum as that of a general optimiser
    from scipy.optimize import minimize

    x, y = np.log(sizes[:60]), found[:60].astype(float)

    def cost(v):
        return np.logaddexp(0, v[0] + v[1] * x).sum() - (y * (v[0] + v[1] * x)).sum() + v @ v / 50

    a, b = minimize(cost, np.zeros(2), tol=1e-10).x
    assert size_at(sizes[:60], found[:60]) == pytest.approx(np.exp((np.log(4) - a) / b), rel=1e-3)
    assert np.isnan(size_at(sizes, ~found)) and np.isnan(size_at([1, 2, 3, 4, 5], [True] * 5))
