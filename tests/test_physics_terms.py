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
    "strand": ("length", "rate", "rest", "stiffness", "link", "middle", "t", "q"),
    "hinge": ("kappa", "rate", "natural", "span"),
    "facet": ("area", "v", "m", "swell", "dt"),
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
every_memory = pytest.mark.parametrize("term", [t for t in found_terms() if t.stage == "strand"], ids=lambda t: t.__name__)


# ---------------------------------------------------------------- what a term declares


def test_the_published_terms_are_found():
    assert set(found_terms()) >= {Springs, Dashpot, Gravity, LinearDrag, Ground, SelfCollision, ControllerSprings}


@every_term
def test_a_term_says_what_it_is(term):
    assert term.stage in STAGES
    assert re.fullmatch("[a-z][a-z_]*", term.name)
    assert term.__doc__ and term.__doc__ != Term.__doc__ and not term.__doc__.startswith(f"{term.__name__}(")  # the dataclass's own
    assert (term.law is not None) == (term.stage in INPUTS)
    assert (term.evolve is not None) == hasattr(term, "twin_evolve") == (term.stage == "strand")
    assert hasattr(term, "prepare") == (term.stage == "setup")
    for p in term.parameters:
        assert p.unit and p.meaning and p.low < p.high
        assert re.fullmatch("[a-z][a-z0-9_]*", p.name)  # columns that start with _ are padding


def test_names_of_terms_and_parameters_are_unique():
    # they are columns of one table, and any two terms may be combined: only stages that take one term have rivals, which may share names
    terms = [t.name for t in found_terms()]
    parameters = {(p.name, t.stage if t.stage in ("move", "contact") else t.name) for t in found_terms() for p in t.parameters}
    assert len(set(terms)) == len(terms) and len({name for name, _ in parameters}) == len(parameters)


@every_law
def test_law_and_twin_take_the_same_arguments(term):
    law = list(inspect.signature(term.law.func).parameters)
    assert law == [*INPUTS[term.stage], "p", "o"]
    taken = list(map(str, inspect.signature(term.twin).parameters.values()))  # a long list may be taken whole
    assert taken in ([*INPUTS[term.stage], *(p.name for p in term.parameters)], [*INPUTS[term.stage], "*values"])
    if term.stage == "strand":
        assert list(inspect.signature(term.evolve.func).parameters) == [*INPUTS["strand"], "dt", "p", "o"]
        assert list(inspect.signature(term.twin_evolve).parameters) == [*INPUTS["strand"], "dt", *(p.name for p in term.parameters)]


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
def kernel_of(term, stage):
    """A kernel that evaluates the term's law at ``stage``, or its "evolve", in float64, sample by sample."""
    R, V, P, law = wp.float64, wp.vec3d, wp.types.vector(OFFSET + max(1, len(term.parameters)), wp.float64), term.law
    after = term.evolve
    S, A, Ps = wp.array(dtype=R), wp.array(dtype=V), wp.array(dtype=P)

    def axial(a: S, b: S, c: S, d: S, p: Ps, out: S):
        i = wp.tid()
        out[i] = law(a[i], b[i], c[i], d[i], p[i], wp.static(OFFSET))

    def hinge(a: A, b: A, c: A, d: S, p: Ps, out: A):
        i = wp.tid()
        out[i] = law(a[i], b[i], c[i], d[i], p[i], wp.static(OFFSET))

    def facet(a: A, b: A, c: S, d: S, e: S, p: Ps, out: A):
        i = wp.tid()
        out[i] = law(a[i], b[i], c[i], d[i], e[i], p[i], wp.static(OFFSET))

    def strand(a: S, b: S, c: S, d: S, e: S, f: A, g: S, h: S, p: Ps, out: S):
        i = wp.tid()
        out[i] = law(a[i], b[i], c[i], d[i], e[i], f[i], g[i], h[i], p[i], wp.static(OFFSET))

    def evolve(a: S, b: S, c: S, d: S, e: S, f: A, g: S, h: S, k: S, p: Ps, out: S):
        i = wp.tid()
        out[i] = after(a[i], b[i], c[i], d[i], e[i], f[i], g[i], h[i], k[i], p[i], wp.static(OFFSET))

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

    stages = dict(axial=axial, strand=strand, evolve=evolve, hinge=hinge, facet=facet, body=body)
    stages |= dict(observer=observer, velocity=velocity, contact=contact, move=move)
    return wp.kernel(stages[stage], module="unique", enable_backward=False), P


def evaluate(term, stage, inputs, parameters):
    """The outputs of the law at ``stage``, one array each."""
    kernel, P = kernel_of(term, stage)
    padded = np.full((SAMPLES, P._length_), np.nan)  # a law that reads another term's parameters gives NaN
    padded[:, OFFSET : OFFSET + parameters.shape[1]] = parameters
    arrays = [wp.array(a, dtype=wp.float64 if a.ndim == 1 else wp.vec3d, device="cpu") for a in inputs]
    scalar = stage in ("axial", "strand", "evolve")
    shape = (SAMPLES,) if scalar else (SAMPLES, 3)
    dtype = wp.float64 if scalar else wp.vec3d
    out = [wp.zeros(SAMPLES, dtype=dtype, device="cpu") for _ in range(2 if stage == "move" else 1)]
    wp.launch(kernel, dim=SAMPLES, inputs=[*arrays, wp.array(padded, dtype=P, device="cpu")], outputs=out, device="cpu")
    return [o.numpy().reshape(shape) for o in out]


def random_inputs(stage, rng):
    """Samples of the arguments in the order of ``INPUTS``: moving particles, about as far apart as terms reach."""
    positive, x, v = rng.uniform(0.1, 2, (4, SAMPLES)), rng.normal(size=(2, SAMPLES, 3)), rng.normal(size=(2, SAMPLES, 3))
    if stage in ("axial", "strand"):
        spring = [positive[0], rng.normal(size=SAMPLES), positive[1], 1e3 * positive[2]]
        return [*spring, rng.integers(0, 2, SAMPLES) * 1.0, x[0], positive[3], v[0, :, 0]] if stage == "strand" else spring
    if stage == "contact":
        return [x[0], x[0] + 0.2 * x[1], *v, *positive[:2]]
    if stage == "hinge":
        return [x[0], v[0], x[1] * [1.0, 1.0, 0.0], 0.1 * positive[0]]
    if stage == "facet":
        return [x[0], v[0], *positive[:2], 0.1 * positive[2]]
    if stage in ("body", "observer"):
        return [x[0], v[0], x[0] + 0.3 * x[1], *([v[1], x[1]] if stage == "observer" else []), positive[0]]
    return {"velocity": [v[0], 0.1 * positive[0]], "move": [x[0], v[0], 0.1 * positive[0]]}[stage]


@every_law
def test_law_equals_its_twin(term):
    rng = np.random.default_rng(0)
    inputs = random_inputs(term.stage, rng)
    low, high = np.array([(p.low, p.high) for p in term.parameters]).reshape(-1, 2).T
    parameters = rng.uniform(low, high, (SAMPLES, len(low)))
    found = evaluate(term, term.stage, inputs, parameters)
    twins = [term.twin(*(a[i] for a in inputs), *parameters[i]) for i in range(SAMPLES)]
    expected = [np.array(part) for part in zip(*twins, strict=True)] if term.stage == "move" else [np.array(twins)]
    for a, b in zip(found, expected, strict=True):
        # a dozen operations in float64; a slow impact at t* = -h / v_n is far away and cancels, so relative to the way there: 1e4 m
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-11 if term.stage == "move" else 1e-13)
    if term.stage in ("move", "contact"):  # laws with a condition: both sides of it were seen
        usual = inputs[1] if term.stage == "move" else 0.0
        share = (np.abs(found[-1] - usual) > 1e-9).any(1).mean()
        assert 0.1 < share < 0.9


@every_memory
def test_a_memory_equals_its_twin(term):
    # substeps from a microsecond to a second; the exponential of the one is a hyperbolic tangent in the other
    rng = np.random.default_rng(0)
    inputs = [*random_inputs("strand", rng), 10.0 ** rng.uniform(-6, 0, SAMPLES)]
    low, high = np.array([(p.low, p.high) for p in term.parameters]).T
    parameters = rng.uniform(low, high, (SAMPLES, len(low)))
    (found,) = evaluate(term, "evolve", inputs, parameters)
    expected = [term.twin_evolve(*(a[i] for a in inputs), *parameters[i]) for i in range(SAMPLES)]
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13)  # a dozen operations of numbers up to 20
    assert (np.abs(found - inputs[7]) > 1e-9).mean() > 0.03  # enough of them remember something new


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


@wp.func
def stir(length: Any, rate: Any, rest: Any, stiffness: Any, link: Any, middle: Any, t: Any, q: Any, p: Any, o: int):
    return p[o] * q * (type(t)(1.0) + t) + p[o + 1] * link * middle[0]


@wp.func
def stirred(length: Any, rate: Any, rest: Any, stiffness: Any, link: Any, middle: Any, t: Any, q: Any, dt: Any, p: Any, o: int):
    return q + dt * (length - rest + p[o] * rate + middle[1] * stiffness * t - q)


@wp.func
def count(length: Any, rate: Any, rest: Any, stiffness: Any, link: Any, middle: Any, t: Any, q: Any, p: Any, o: int):
    return p[o] * q


@wp.func
def counted(length: Any, rate: Any, rest: Any, stiffness: Any, link: Any, middle: Any, t: Any, q: Any, dt: Any, p: Any, o: int):
    return q + dt * (type(link)(1.0) + link)


class Stir(Term):
    """A memory that reads everything it is given."""

    name = "stir"
    stage = "strand"
    parameters = (Parameter("stir", 3.0, 0.0, 5.0, "N/m", "of the memory"), Parameter("stir_link", 2.0, 0.0, 5.0, "N/m", "of links"))
    law = stir
    evolve = stirred

    @staticmethod
    def twin(length, rate, rest, stiffness, link, middle, t, q, stir, stir_link):
        return stir * q * (1 + t) + stir_link * link * middle[0]

    @staticmethod
    def twin_evolve(length, rate, rest, stiffness, link, middle, t, q, dt, stir, stir_link):
        return q + dt * (length - rest + stir * rate + middle[1] * stiffness * t - q)


class Count(Term):
    """A memory that counts seconds, links' twice."""

    name = "count"
    stage = "strand"
    parameters = (Parameter("count", 1.0, 0.0, 5.0, "N/s", "of the seconds counted"),)
    law = count
    evolve = counted

    @staticmethod
    def twin(length, rate, rest, stiffness, link, middle, t, q, count):
        return count * q

    @staticmethod
    def twin_evolve(length, rate, rest, stiffness, link, middle, t, q, dt, count):
        return q + dt * (1 + link)


AIR = (Springs, Dashpot, Gravity, LinearDrag, Ground, ControllerSprings)


def test_columns_are_ordered_by_stage_and_padded():
    ground = ["collide_elas", "collide_fric", "ground_normal_x", "ground_normal_y", "ground_normal_z", "ground_offset"]
    contact = ["collision_dist", "collide_object_elas", "collide_object_fric", "collide_neighbours"]
    gravity = ["gravity_x", "gravity_y", "gravity_z"]
    first = ["_axial", "_strand", "_hinge", "_facet", "_body", "_observer", "_velocity"]
    assert Laws(()).columns == [*first, "_contact", "_move", "_links", "_setup"]
    air = [
        "dashpot_damping",
        "_strand",
        "_hinge",
        "_facet",
        *gravity,
        "_observer",
        "drag_damping",
        "_contact",
        *ground,
        "controller_velocity",
        "_setup",
    ]
    assert Laws(AIR).columns == air
    assert Laws(AIR[::-1]).columns == Laws(AIR).columns  # one term a stage has parameters: the order of stages decides
    assert Laws((SelfCollision, Springs)).columns == [*first, *contact, "_move", "_links", "_setup"]
    assert Laws((Wind, Hardening, Gravity)).columns[:10] == ["cubic", "square", "_strand", "_hinge", "_facet", "wind_x", "wind_y", *gravity]
    assert Laws((Count, Wind, Stir)).columns[:8] == ["_axial", "count", "stir", "stir_link", "_hinge", "_facet", "wind_x", "wind_y"]


NEW = [(Wind, Hardening, Gravity, Brake), (Count, Springs, Stir), (Dashpot, Springs, Hardening)]


@pytest.mark.parametrize("terms", [(), AIR, (*AIR, SelfCollision), *NEW])
def test_columns_are_where_start_and_offset_say(terms):
    laws = Laws(terms)
    assert len(laws.columns) == sum(laws.width(s) for s in STAGES)
    for stage in STAGES:
        assert laws.width(stage) >= 1  # a Warp vector cannot be empty
        for term, offset in laws.stage(stage):
            first = laws.start(stage) + offset
            assert laws.columns[first : first + len(term.parameters)] == [p.name for p in term.parameters]


def numpy_step(system, x, v, dt, t, memory):
    """One substep at ``t`` by the terms' twins: forces, velocity, move; still controllers. ``memory`` (springs, terms) goes on in place."""
    nodes, speeds = np.concatenate([x, system.controllers[0]]), np.concatenate([v, 0 * system.controllers[0]])
    laws = {stage: [t for t in system.terms if t.stage == stage] for stage in STAGES}
    force, home = np.zeros_like(nodes), np.concatenate([system.positions, system.controllers[0]])
    for q, (a, b), rest, stiffness in zip(memory, system.springs, system.rest, system.stiffness, strict=True):
        length = np.linalg.norm(nodes[b] - nodes[a])
        d = (nodes[b] - nodes[a]) / length
        spring = (length, (speeds[b] - speeds[a]) @ d, rest, stiffness)
        strand = (*spring, float(max(a, b) >= len(x)), (home[a] + home[b]) / 2, t)
        tension = sum(term.twin(*spring, **term.values) for term in laws["axial"])
        tension += sum(term.twin(*strand, q[n], **term.values) for n, term in enumerate(laws["strand"]))
        for n, term in enumerate(laws["strand"]):
            q[n] = term.twin_evolve(*strand, q[n], dt, **term.values)
        force[a] += tension * d
        force[b] -= tension * d
    x2, v2 = np.empty_like(x), np.empty_like(v)
    for i, m in enumerate(system.masses):
        total = force[i] + sum(term.twin(x[i], v[i], system.positions[i], m, **term.values) for term in laws["body"])
        new = v[i] + dt * total / m
        for term in laws["velocity"]:
            new = term.twin(new, dt, **term.values)
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
    "memories": (Count, Springs, Dashpot, Stir, ControllerSprings, Gravity),
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
    _, x, v, carried = batch.march(0, count, whole=True)
    memory = carried.memory
    memories = memory.split([len(s.springs) for s in systems])
    for system, x_found, v_found, memory_found in zip(systems, batch.split(x), batch.split(v), memories, strict=True):
        x, v, memory = system.positions, system.velocities, np.zeros(memory_found.shape)
        for k in range(count):
            x, v = numpy_step(system, x, v, dt, k * dt, memory)
        assert np.abs(x - system.positions).max() > 0.1
        if name == "published":
            assert x[:, 2].max() < 1e-3 < (system.positions + system.velocities * dt * count)[:, 2].max()  # the table was in the way
        np.testing.assert_allclose(x_found.numpy(), x, rtol=0, atol=1e-11)  # 40 steps of numbers of order 1, some bounces among them
        np.testing.assert_allclose(v_found.numpy(), v, rtol=0, atol=1e-10)
        np.testing.assert_allclose(memory_found.numpy(), memory, rtol=0, atol=1e-10)
