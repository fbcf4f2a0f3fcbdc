"""Terms and their parameters; how the laws of a list of terms are fused. What every term must do is in test_terms_conformance.py."""

import re
from typing import Any

import numpy as np
import pytest
import warp as wp
from twinbench.physics.batch import Batch
from twinbench.physics.catalogue import terms
from twinbench.physics.laws import Laws
from twinbench.physics.parameters import Parameter
from twinbench.physics.system import System
from twinbench.physics.terms import ControllerSprings, Dashpot, Gravity, Ground, LinearDrag, SelfCollision, Springs
from twinbench.physics.terms.stages import STAGES, AxialTerm, BodyTerm, StrandTerm, VelocityTerm

# ---------------------------------------------------------------- what a term declares


def test_the_published_terms_are_found():
    assert set(terms().values()) >= {Springs, Dashpot, Gravity, LinearDrag, Ground, SelfCollision, ControllerSprings}


def test_names_of_parameters_are_unique():
    # they are columns of one table, and any two terms may be combined: only stages that take one term have rivals, which may share names
    parameters = {(p.name, t.stage if t.stage in ("move", "contact") else t.name) for t in terms().values() for p in t.parameters}
    assert len({name for name, _ in parameters}) == len(parameters)


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


class Hardening(AxialTerm):
    """F = a e^3 + b Y e |e|, e the strain."""

    name = "hardening"
    parameters = (Parameter("cubic", 30.0, 0.0, 100.0, "N", "third order"), Parameter("square", 0.4, 0.0, 1.0, "-", "second order"))
    law = hardening

    @staticmethod
    def twin(length, rate, rest, stiffness, cubic, square):
        e = length / rest - 1
        return cubic * e**3 + square * stiffness * e * abs(e)


class Wind(BodyTerm):
    """A force that grows with height."""

    name = "wind"
    parameters = (Parameter("wind_x", 2.0, 0.0, 5.0, "N/m", "along x"), Parameter("wind_y", -1.0, -5.0, 5.0, "N", "along y"))
    law = wind

    @staticmethod
    def twin(x, v, home, m, wind_x, wind_y):
        return np.array([wind_x * x[2], wind_y, 0.0])


class Brake(VelocityTerm):
    """dv/dt = -c |v| v, exactly."""

    name = "brake"
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


class Stir(StrandTerm):
    """A memory that reads everything it is given."""

    name = "stir"
    parameters = (Parameter("stir", 3.0, 0.0, 5.0, "N/m", "of the memory"), Parameter("stir_link", 2.0, 0.0, 5.0, "N/m", "of links"))
    law = stir
    evolve = stirred

    @staticmethod
    def twin(length, rate, rest, stiffness, link, middle, t, q, stir, stir_link):
        return stir * q * (1 + t) + stir_link * link * middle[0]

    @staticmethod
    def twin_evolve(length, rate, rest, stiffness, link, middle, t, q, dt, stir, stir_link):
        return q + dt * (length - rest + stir * rate + middle[1] * stiffness * t - q)


class Count(StrandTerm):
    """A memory that counts seconds, links' twice."""

    name = "count"
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
    cells = ["_growth", "_flow", "_solid", "_material", "_branch", "_viscous"]
    cells += ["_membrane", "_plate", "_sheet_flow", "_sheet_branch", "_viscous_membrane", "_viscous_plate", "_layer"]
    cells = ["_hinge_flow", "_hinge_branch", "_facet", *cells]
    first = ["_axial", "_strand", "_hinge", *cells, "_body", "_surface", "_touch", "_grip", "_slip", "_observer", "_velocity"]
    assert Laws(()).columns == [*first, "_contact", "_move", "_links", "_setup"]
    air = [
        "dashpot_damping",
        "_strand",
        "_hinge",
        *cells,
        *gravity,
        "_surface",
        "_touch",
        "_grip",
        "_slip",
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
    assert Laws((Wind, Hardening, Gravity)).columns[:25] == ["cubic", "square", *first[1:19], "wind_x", "wind_y", *gravity]
    assert Laws((Count, Wind, Stir)).columns[:23] == ["_axial", "count", "stir", "stir_link", *first[2:19], "wind_x", "wind_y"]


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
