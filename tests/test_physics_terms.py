"""What every term must do, tested over every term in the folder; how the laws of a list of terms are fused."""

import importlib
import inspect
import pkgutil
import re
from functools import cache
from typing import Any

import numpy as np
import pytest
import twinbench.physics.terms as rooms
import warp as wp
from twinbench.physics.batch import Batch
from twinbench.physics.laws import Laws
from twinbench.physics.parameters import Parameter
from twinbench.physics.system import System
from twinbench.physics.terms import ControllerSprings, Dashpot, Gravity, Ground, LinearDrag, SelfCollision, Springs
from twinbench.physics.terms.base import STAGES, Term

SAMPLES, OFFSET = 500, 2  # the term's parameters do not come first in their stage's vector
INPUTS = {
    "axial": ("length", "rate", "rest", "stiffness"),
    "hinge": ("kappa", "rate", "natural", "span"),
    "body": ("x", "v", "home", "m"),
    "observer": ("x", "v", "home", "y", "u", "m"),
    "velocity": ("v", "dt"),
    "contact": ("xi", "xj", "vi", "vj", "mi", "mj"),
    "move": ("x", "v", "dt"),
}


def found_terms():
    """Every term in the folder, also one that nobody imports."""
    modules = [importlib.import_module(f"{rooms.__name__}.{m.name}") for m in pkgutil.iter_modules(rooms.__path__)]
    found = {v for m in modules for v in vars(m).values() if isinstance(v, type) and issubclass(v, Term) and v is not Term}
    return sorted(found, key=lambda term: term.__name__)


every_term = pytest.mark.parametrize("term", found_terms(), ids=lambda t: t.__name__)
every_law = pytest.mark.parametrize("term", [t for t in found_terms() if t.stage in INPUTS], ids=lambda t: t.__name__)


# ---------------------------------------------------------------- what a term declares


def test_the_published_terms_are_found():
    assert set(found_terms()) >= {Springs, Dashpot, Gravity, LinearDrag, Ground, SelfCollision, ControllerSprings}


@every_term
def test_a_term_says_what_it_is(term):
    assert term.stage in STAGES
    assert re.fullmatch("[a-z][a-z_]*", term.name)
    assert term.__doc__ and term.__doc__ != Term.__doc__ and not term.__doc__.startswith(f"{term.__name__}(")  # the dataclass's own
    assert (term.law is not None) == (term.stage in INPUTS)
    assert hasattr(term, "prepare") == (term.stage == "setup")
    for p in term.parameters:
        assert p.unit and p.meaning and p.low < p.high
        assert re.fullmatch("[a-z][a-z_]*", p.name)  # columns that start with _ are padding


def test_names_of_terms_and_parameters_are_unique():
    # they are columns of one table, and any two terms may be combined
    terms = [t.name for t in found_terms()]
    parameters = [p.name for t in found_terms() for p in t.parameters]
    assert len(set(terms)) == len(terms) and len(set(parameters)) == len(parameters)


@every_law
def test_law_and_twin_take_the_same_arguments(term):
    law = list(inspect.signature(term.law.func).parameters)
    assert law == [*INPUTS[term.stage], "p", "o"]
    assert list(inspect.signature(term.twin).parameters) == [*INPUTS[term.stage], *(p.name for p in term.parameters)]


@every_term
def test_values_of_a_term(term):
    assert term().values == {p.name: p.value for p in term.parameters}
    for p in term.parameters:
        for value in (p.low, p.high, (p.low + p.high) / 2):
            one = term({p.name: value})
            assert one.values == {**term().values, p.name: value}
            assert term().with_values(**{p.name: value}).values == one.values
        for value in (np.nextafter(p.low, -np.inf), np.nextafter(p.high, np.inf), np.nan, np.inf):
            with pytest.raises(ValueError, match=re.escape(f"{p.name} must lie in [{p.low:g}, {p.high:g}] {p.unit}, got {value}")):
                term({p.name: value})
    known = term.parameters[0].name if term.parameters else "none"
    with pytest.raises(ValueError, match=f"{term.name} has no parameter 'nonsense'; .*known: .*{known}"):
        term({"nonsense": 1.0})


def test_with_values_leaves_the_original_alone():
    one = Ground({"collide_elas": 0.2})
    other = one.with_values(collide_fric=1.5)
    assert (one.values["collide_elas"], one.values["collide_fric"]) == (0.2, 0.3)
    assert (other.values["collide_elas"], other.values["collide_fric"]) == (0.2, 1.5)
    assert type(other) is Ground


@pytest.mark.parametrize(
    ("text", "change"),
    [
        ("k must lie in [0.0, 1.0] N, got 2.0", dict(value=2.0)),
        ("k must lie in [0.0, 1.0] N, got nan", dict(value=np.nan)),
        ("k must lie in [2.0, 1.0] N, got 0.5", dict(low=2.0)),
        ("scale of k must be 'linear' or 'log', got 'cubic'", dict(scale="cubic")),
    ],
)
def test_parameters_are_checked(text, change):
    with pytest.raises(ValueError, match=re.escape(text)):
        Parameter(**{**dict(name="k", value=0.5, low=0.0, high=1.0, unit="N", meaning="a constant"), **change})


# ---------------------------------------------------------------- laws against their twins


@cache
def kernel_of(term):
    """A kernel that evaluates the term's law in float64, sample by sample."""
    R, V, P, law = wp.float64, wp.vec3d, wp.types.vector(OFFSET + max(1, len(term.parameters)), wp.float64), term.law
    S, A, Ps = wp.array(dtype=R), wp.array(dtype=V), wp.array(dtype=P)

    def axial(a: S, b: S, c: S, d: S, p: Ps, out: S):
        i = wp.tid()
        out[i] = law(a[i], b[i], c[i], d[i], p[i], wp.static(OFFSET))

    def hinge(a: A, b: A, c: A, d: S, p: Ps, out: A):
        i = wp.tid()
        out[i] = law(a[i], b[i], c[i], d[i], p[i], wp.static(OFFSET))

    def body(a: A, b: A, c: A, d: S, p: Ps, out: A):
        i = wp.tid()
        out[i] = law(a[i], b[i], c[i], d[i], p[i], wp.static(OFFSET))

    def observer(a: A, b: A, c: A, d: A, e: A, f: S, p: Ps, out: A):
        i = wp.tid()
        out[i] = law(a[i], b[i], c[i], d[i], e[i], f[i], p[i], wp.static(OFFSET))

    def velocity(a: A, b: S, p: Ps, out: A):
        i = wp.tid()
        out[i] = law(a[i], b[i], p[i], wp.static(OFFSET))

    def contact(a: A, b: A, c: A, d: A, e: S, f: S, p: Ps, out: A):
        i = wp.tid()
        out[i] = law(a[i], b[i], c[i], d[i], e[i], f[i], p[i], wp.static(OFFSET))

    def move(a: A, b: A, c: S, p: Ps, out: A, out2: A):
        i = wp.tid()
        x, v = law(a[i], b[i], c[i], p[i], wp.static(OFFSET))
        out[i] = x
        out2[i] = v

    stages = dict(axial=axial, hinge=hinge, body=body, observer=observer, velocity=velocity, contact=contact, move=move)
    return wp.kernel(stages[term.stage], module="unique", enable_backward=False), P


def evaluate(term, inputs, parameters):
    """The law's outputs, one array each."""
    kernel, P = kernel_of(term)
    padded = np.full((SAMPLES, P._length_), np.nan)  # a law that reads another term's parameters gives NaN
    padded[:, OFFSET : OFFSET + parameters.shape[1]] = parameters
    arrays = [wp.array(a, dtype=wp.float64 if a.ndim == 1 else wp.vec3d, device="cpu") for a in inputs]
    shape = (SAMPLES,) if term.stage == "axial" else (SAMPLES, 3)
    dtype = wp.float64 if term.stage == "axial" else wp.vec3d
    out = [wp.zeros(SAMPLES, dtype=dtype, device="cpu") for _ in range(2 if term.stage == "move" else 1)]
    wp.launch(kernel, dim=SAMPLES, inputs=[*arrays, wp.array(padded, dtype=P, device="cpu")], outputs=out, device="cpu")
    return [o.numpy().reshape(shape) for o in out]


def random_inputs(stage, rng):
    """Samples of the arguments in the order of ``INPUTS``: moving particles, about as far apart as terms reach."""
    positive, x, v = rng.uniform(0.1, 2, (4, SAMPLES)), rng.normal(size=(2, SAMPLES, 3)), rng.normal(size=(2, SAMPLES, 3))
    if stage == "axial":
        return [positive[0], rng.normal(size=SAMPLES), positive[1], 1e3 * positive[2]]
    if stage == "contact":
        return [x[0], x[0] + 0.2 * x[1], *v, *positive[:2]]
    if stage == "hinge":
        return [x[0], v[0], x[1] * [1.0, 1.0, 0.0], 0.1 * positive[0]]
    if stage in ("body", "observer"):
        return [x[0], v[0], x[0] + 0.3 * x[1], *([v[1], x[1]] if stage == "observer" else []), positive[0]]
    return {"velocity": [v[0], 0.1 * positive[0]], "move": [x[0], v[0], 0.1 * positive[0]]}[stage]


@every_law
def test_law_equals_its_twin(term):
    rng = np.random.default_rng(0)
    inputs = random_inputs(term.stage, rng)
    low, high = np.array([(p.low, p.high) for p in term.parameters]).reshape(-1, 2).T
    parameters = rng.uniform(low, high, (SAMPLES, len(low)))
    found = evaluate(term, inputs, parameters)
    twins = [term.twin(*(a[i] for a in inputs), *parameters[i]) for i in range(SAMPLES)]
    expected = [np.array(part) for part in zip(*twins, strict=True)] if term.stage == "move" else [np.array(twins)]
    for a, b in zip(found, expected, strict=True):
        # a dozen operations in float64; a slow impact at t* = -h / v_n is far away and cancels, so relative to the way there: 1e4 m
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-11 if term.stage == "move" else 1e-13)
    if term.stage in ("move", "contact"):  # laws with a condition: both sides of it were seen
        usual = inputs[1] if term.stage == "move" else 0.0
        share = (np.abs(found[-1] - usual) > 1e-9).any(1).mean()
        assert 0.1 < share < 0.9


# ---------------------------------------------------------------- a list of terms


@wp.func
def hardening(length: Any, rate: Any, rest: Any, stiffness: Any, p: Any, o: int):
    strain = length / rest - type(length)(1.0)
    return p[o] * strain * strain * strain + p[o + 1] * stiffness * strain * wp.abs(strain)


@wp.func
def wind(x: Any, v: Any, home: Any, m: Any, p: Any, o: int):
    f = type(x)()
    f[0] = p[o] * x[2]
    f[1] = p[o + 1]
    return f


@wp.func
def brake(v: Any, dt: Any, p: Any, o: int):
    return v / (type(dt)(1.0) + p[o] * dt * wp.length(v))


class Hardening(Term):
    """F = a e^3 + b Y e |e|, e the strain."""

    name = "hardening"
    stage = "axial"
    parameters = (Parameter("cubic", 30.0, 0.0, 100.0, "N", "third order"), Parameter("square", 0.4, 0.0, 1.0, "-", "second order"))
    law = hardening

    @staticmethod
    def twin(length, rate, rest, stiffness, cubic, square):
        e = length / rest - 1
        return cubic * e**3 + square * stiffness * e * abs(e)


class Wind(Term):
    """A force that grows with height."""

    name = "wind"
    stage = "body"
    parameters = (Parameter("wind_x", 2.0, 0.0, 5.0, "N/m", "along x"), Parameter("wind_y", -1.0, -5.0, 5.0, "N", "along y"))
    law = wind

    @staticmethod
    def twin(x, v, home, m, wind_x, wind_y):
        return np.array([wind_x * x[2], wind_y, 0.0])


class Brake(Term):
    """dv/dt = -c |v| v, exactly."""

    name = "brake"
    stage = "velocity"
    parameters = (Parameter("brake", 0.7, 0.0, 5.0, "1/m", "quadratic drag"),)
    law = brake

    @staticmethod
    def twin(v, dt, brake):
        return v / (1 + brake * dt * np.linalg.norm(v))


AIR = (Springs, Dashpot, Gravity, LinearDrag, Ground, ControllerSprings)


def test_columns_are_ordered_by_stage_and_padded():
    ground = ["collide_elas", "collide_fric", "ground_normal_x", "ground_normal_y", "ground_normal_z", "ground_offset"]
    contact = ["collision_dist", "collide_object_elas", "collide_object_fric", "collide_neighbours"]
    gravity = ["gravity_x", "gravity_y", "gravity_z"]
    assert Laws(()).columns == ["_axial", "_hinge", "_body", "_observer", "_velocity", "_contact", "_move", "_links", "_setup"]
    air = ["dashpot_damping", "_hinge", *gravity, "_observer", "drag_damping", "_contact", *ground, "controller_velocity", "_setup"]
    assert Laws(AIR).columns == air
    assert Laws(AIR[::-1]).columns == Laws(AIR).columns  # one term a stage has parameters: the order of stages decides
    colliding = ["_axial", "_hinge", "_body", "_observer", "_velocity", *contact, "_move", "_links", "_setup"]
    assert Laws((SelfCollision, Springs)).columns == colliding
    assert Laws((Wind, Hardening, Gravity)).columns[:8] == ["cubic", "square", "_hinge", "wind_x", "wind_y", *gravity]


@pytest.mark.parametrize("terms", [(), AIR, (*AIR, SelfCollision), (Wind, Hardening, Gravity, Brake), (Dashpot, Springs, Hardening)])
def test_columns_are_where_start_and_offset_say(terms):
    laws = Laws(terms)
    assert len(laws.columns) == sum(laws.width(s) for s in STAGES)
    for stage in STAGES:
        assert laws.width(stage) >= 1  # a Warp vector cannot be empty
        for term, offset in laws.stage(stage):
            first = laws.start(stage) + offset
            assert laws.columns[first : first + len(term.parameters)] == [p.name for p in term.parameters]


def numpy_step(system, x, v, dt):
    """One substep by the terms' twins: forces, velocity, move; still controllers."""
    nodes, speeds = np.concatenate([x, system.controllers[0]]), np.concatenate([v, 0 * system.controllers[0]])
    laws = {stage: [t for t in system.terms if t.stage == stage] for stage in STAGES}
    force = np.zeros_like(nodes)
    for (a, b), rest, stiffness in zip(system.springs, system.rest, system.stiffness, strict=True):
        length = np.linalg.norm(nodes[b] - nodes[a])
        d = (nodes[b] - nodes[a]) / length
        tension = sum(t.twin(length, (speeds[b] - speeds[a]) @ d, rest, stiffness, **t.values) for t in laws["axial"])
        force[a] += tension * d
        force[b] -= tension * d
    x2, v2 = np.empty_like(x), np.empty_like(v)
    for i, m in enumerate(system.masses):
        total = force[i] + sum(t.twin(x[i], v[i], system.positions[i], m, **t.values) for t in laws["body"])
        new = v[i] + dt * total / m
        for t in laws["velocity"]:
            new = t.twin(new, dt, **t.values)
        x2[i], v2[i] = laws["move"][0].twin(x[i], new, dt, **laws["move"][0].values) if laws["move"] else (x[i] + dt * new, new)
    return x2, v2


def thrown(terms, seed):
    """Ten particles thrown at the table z = 0, two of them tied to a hand."""
    rng = np.random.default_rng(seed)
    x = rng.random((10, 3)) - [0.5, 0.5, 1.05]
    first, second = np.nonzero(np.triu(np.linalg.norm(x[:, None] - x[None], axis=2) < 0.6, 1))
    springs = np.concatenate([np.stack([first, second], 1), [[10, 0], [10, 1]]])
    return System(
        positions=x,
        velocities=rng.normal(size=x.shape) + np.array([0, 0, 2]),
        masses=rng.uniform(0.5, 2, 10),
        springs=springs,
        rest=rng.uniform(0.3, 0.6, len(springs)),
        stiffness=rng.uniform(10, 50, len(springs)),
        controllers=[[[0.0, 0.0, -1.5]]],
        terms=terms,
    )


LISTS = {
    "published": AIR,
    # several terms a stage, in another order than stages, parameters at several offsets
    "new terms": (Wind, Brake, Dashpot, ControllerSprings, Hardening, Springs, Gravity, LinearDrag),
}


@pytest.mark.parametrize("name", LISTS)
def test_fused_laws_are_the_twins_in_order(name):
    # two systems with parameters of their own: what a term reads is its own row and its own columns
    rng = np.random.default_rng(1)
    systems = []
    for seed in (0, 1):
        terms = [t({p.name: rng.uniform(p.value, p.high) for p in t.parameters if "ground" not in p.name}) for t in LISTS[name]]
        systems.append(thrown([t.with_values(dashpot_damping=3.0) if t.name == "dashpot" else t for t in terms], seed))
    dt, count = 5e-3, 40
    batch = Batch(systems, fps=1 / dt, substeps=1, dt=dt, double=True, workers=1)
    _, x, v = batch.march(0, count)
    for system, x_found, v_found in zip(systems, batch.split(x), batch.split(v), strict=True):
        x, v = system.positions, system.velocities
        for _ in range(count):
            x, v = numpy_step(system, x, v, dt)
        assert np.abs(x - system.positions).max() > 0.1
        if name == "published":
            assert x[:, 2].max() < 1e-3 < (system.positions + system.velocities * dt * count)[:, 2].max()  # the table was in the way
        np.testing.assert_allclose(x_found.numpy(), x, rtol=0, atol=1e-11)  # 40 steps of numbers of order 1, some bounces among them
        np.testing.assert_allclose(v_found.numpy(), v, rtol=0, atol=1e-10)
