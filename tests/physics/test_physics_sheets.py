"""Sheets: stretch, bending by angles, damping, on meshes that lie in all ways; closed forms of plates, strips and rubber."""

import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.integrate import solve_bvp
from scipy.spatial import Delaunay, cKDTree
from scipy.spatial.transform import Rotation
from twinbench.benchmark.conformance.gradients import check, draped, leaves, loss, some
from twinbench.methods.continuum.outline import areas
from twinbench.physics.batch import Batch
from twinbench.physics.kernels import build
from twinbench.physics.rounds import ease
from twinbench.physics.sheets import Sheet, damping_forces, fold_angles, fold_gradients, internal_forces
from twinbench.physics.stability import stable_rounds, stable_step, stable_substeps
from twinbench.physics.system import System
from twinbench.physics.terms import (
    Gravity,
    LinearDrag,
    Membrane,
    MembraneDamping,
    NeoHookeanMembrane,
    PlateBending,
    PlateDamping,
    PlateStiffening,
    Yarns,
)

G = 9.81
AREAL = 0.2  # kg/m^2
NONE = lambda state, rate: 0 * state  # noqa: E731


def lattice(size, pitch, *, turn=0.0, even=False):
    """Points (M, 2) [m] of a lattice of right triangles, or ``even`` ones, turned by ``turn`` degrees and cut to ``size`` (2,) from 0, and
    along the rim others at the same distance; and triangles."""
    reach = int(2 * max(size) / pitch) + 3
    a, b = np.meshgrid(np.arange(-reach, reach + 1.0), np.arange(-reach, reach + 1.0), indexing="ij")
    base = np.stack([a + (b / 2 if even else 0), b * (np.sqrt(3) / 2 if even else 1)], -1).reshape(-1, 2) * pitch
    angle = np.radians(turn)
    base = base @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    inside = ((base > 0.3 * pitch) & (base < np.array(size) - 0.3 * pitch)).all(1)
    steps = [np.linspace(0, s, round(s / pitch) + 1) for s in size]
    rim = [(x, y) for x in steps[0] for y in (0, size[1])] + [(x, y) for y in steps[1][1:-1] for x in (0, size[0])]
    points = np.concatenate([base[inside] if turn or even else np.zeros((0, 2)), np.array(rim)])
    if not (turn or even):
        points = np.stack(np.meshgrid(*steps, indexing="ij"), -1).reshape(-1, 2)
    far = np.ones(len(points), bool)
    for k in range(len(points)):  # none beside the rim
        if k < len(points) - len(rim) and (turn or even):
            far[k] = np.linalg.norm(points[-len(rim) :] - points[k], axis=1).min() > 0.5 * pitch
    points = points[far]
    triangles = Delaunay(points + 1e-7 * np.random.default_rng(0).normal(size=points.shape)).simplices
    corners = points[triangles]
    span = corners[:, 1:] - corners[:, :1]
    area = np.abs(span[:, 0, 0] * span[:, 1, 1] - span[:, 0, 1] * span[:, 1, 0])
    return points, triangles[area > 0.02 * pitch**2]


MESHES = {"square": {}, "square turned by 30": {"turn": 30.0}, "even turned by 10": {"turn": 10.0, "even": True}}


def flat(points):
    return np.column_stack([points, np.zeros(len(points))])


def rolled(points, curvature, way):
    """(M, 3) flat ``points`` (M, 2) rolled up about an axis across the direction ``way`` [degrees], lengths kept."""
    n = np.array([np.cos(np.radians(way)), np.sin(np.radians(way))])
    s, t = points @ n, points @ [-n[1], n[0]]
    x, z = np.sin(curvature * s) / curvature, (1 - np.cos(curvature * s)) / curvature
    return np.column_stack([x[:, None] * n + t[:, None] * [-n[1], n[0]], z])


def cut(points, triangles, *terms, flat_rest=True, held=(), path=None, **given):
    """A system of a sheet with AREAL."""
    sheet = Sheet.of(points, triangles, flat=flat_rest)
    held = np.asarray(held, int)
    return System(
        positions=points,
        masses=sheet.masses(AREAL, len(points)),
        springs=np.zeros((0, 2), int),
        stiffness=[],
        controllers=points[None, held] if path is None else path,
        grips=held,
        sheet=sheet,
        terms=terms,
        **given,
    )


def law(system, stage):
    return lambda given: sum((t.twin(given, **t.values) for t in system.terms if t.stage == stage), np.zeros_like(given))


def forces(system, x, v):
    resisting = damping_forces(system.sheet, x, v, law(system, "viscous_membrane"), law(system, "viscous_plate"))
    return internal_forces(system.sheet, x, law(system, "membrane"), law(system, "plate")) + resisting


# ---------------------------------------------------------------- kinematics


def test_angles_and_their_gradients():
    # two triangles folded by a: both lean to the side of the normal, +a; gradients against central differences of h = 1e-6, off by h^2
    a = 0.7
    points = np.array([[0, 0, 0], [1, 0, 0], [0.3, 1, 0], [0.4, -np.cos(a), np.sin(a)]])
    assert fold_angles(points[None])[0] == pytest.approx(a, abs=1e-14)
    x = points + np.random.default_rng(0).normal(size=(4, 3)) * 0.1
    gradient = fold_gradients(x[None])[0]
    for k in range(4):
        for c in range(3):
            step = np.zeros((4, 3))
            step[k, c] = 1e-6
            found = (fold_angles((x + step)[None])[0] - fold_angles((x - step)[None])[0]) / 2e-6
            assert gradient[k, c] == pytest.approx(found, abs=1e-8)


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("way", [0.0, 20.0, 45.0, 90.0])
def test_curvature_of_a_cylinder(name, way):
    # W = B k^2 / 2 per area, whichever way the mesh lies; pitch * k = 0.05, chords for arcs: (pitch k)^2 / 8 = 0.03 %; the surface through
    # six points is met exactly, so what is left is that, and the rim, whose triangles know fewer angles
    points, triangles = lattice((0.2, 0.15), 0.01, **MESHES[name])
    sheet = Sheet.of(flat(points), triangles)
    angle = fold_angles(rolled(points, 5.0, way)[sheet.folds])
    here = sheet.sides >= 0
    kappa = np.einsum("fck,fk->fc", sheet.curving, np.where(here, angle[sheet.sides], 0.0))
    density = (kappa**2 @ [1.0, 1.0, 2.0]) / 25
    inner = here.all(1)
    np.testing.assert_allclose(density[inner], 1, rtol=0.01)
    assert (sheet.bent_areas @ density) / sheet.areas.sum() == pytest.approx(1, rel=0.05)


def scattered(seed, count=220):
    """((count, 2) places as far from each other as can be among many at random, Delaunay's triangles but the thin ones of the rim)."""
    places = np.random.default_rng(seed).uniform(0, 1, (1500, 2)) * [0.5, 0.4]
    found = [int(np.linalg.norm(places - places.mean(0), axis=1).argmax())]
    apart = np.linalg.norm(places - places[found[0]], axis=1)
    while len(found) < count:
        found.append(int(apart.argmax()))
        apart = np.minimum(apart, np.linalg.norm(places - places[found[-1]], axis=1))
    points = places[found]
    triangles = Delaunay(points).simplices
    corners = points[triangles]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    area = areas(corners)
    wide = 1.3 * np.median(cKDTree(points).query(points, k=2)[0][:, 1])
    return points, triangles[(sides.prod(1) / (4 * area) < wide) & (2 * area > 0.05 * sides.max(1) ** 2)]


@pytest.mark.parametrize("seed", [35, 47, 59])
def test_what_three_angles_tell_badly_stiffens_no_mesh(seed):
    # scattered points, of which some triangle and the corners beside it lie nearly on a conic: measured by its own angles it would bend
    # more than three times as hard as the middle one for its size, nine times in energy; its neighbours carry its area, exactly. A
    # cylinder's W = B k^2 / 2 is met as on a lattice, within the rim's 5 %
    points, triangles = scattered(seed)
    sheet = Sheet.of(flat(points), triangles)
    hard = np.linalg.norm(sheet.curving, axis=(1, 2)) * np.sqrt(sheet.areas)
    carries, whole = sheet.bent_areas > 0, (sheet.sides >= 0).all(1)
    assert hard[whole].max() > 3 * np.median(hard) and hard[whole & carries].max() < 2.5 * np.median(hard)
    assert sheet.bent_areas.sum() == pytest.approx(sheet.areas.sum(), rel=1e-12)
    angle = fold_angles(rolled(points, 2.0, 30.0)[sheet.folds])
    kappa = np.einsum("fck,fk->fc", sheet.curving, np.where(sheet.sides >= 0, angle[sheet.sides], 0.0))
    assert (sheet.bent_areas @ (kappa**2 @ [1.0, 1.0, 2.0])) / sheet.areas.sum() == pytest.approx(4.0, rel=0.05)


@pytest.mark.parametrize("behind", [False, True])
def test_every_triangle_tells_strains_in_the_sheets_axes(behind):
    # E = (F'F - 1) / 2 of a homogeneous F, the same tensor in every triangle however it lies; seen from behind the second axis points the
    # other way. So yarns along the first axis bear k E_11 and those across it k E_22 (``yarns``)
    laid, triangles = scattered(35, 60)
    sheet = Sheet.of(flat(laid), triangles if not behind else triangles[:, ::-1], laid=laid)
    turned = -1.0 if np.linalg.det(laid[sheet.triangles[:, 1:]] - laid[sheet.triangles[:, :1]]).sum() < 0 else 1.0
    pulled = np.array([[1.10, 0.03], [0.00, 0.95], [0.02, 0.05]])
    wanted = (pulled.T @ pulled - np.eye(2)) / 2
    seen = []
    internal_forces(sheet, laid @ pulled.T, lambda strain: seen.append(strain) or 0 * strain, lambda curvature: 0 * curvature)
    np.testing.assert_allclose(seen[0], np.tile([wanted[0, 0], wanted[1, 1], turned * wanted[0, 1]], (len(triangles), 1)), atol=1e-9)
    for azimuth, strain in ((0.0, wanted[0, 0]), (np.pi / 2, wanted[1, 1])):
        stress = Yarns.twin(seen[0], 50.0, azimuth)
        np.testing.assert_allclose(np.trace(stress[:, [0, 2, 2, 1]].reshape(-1, 2, 2), axis1=1, axis2=2), 50.0 * strain, atol=1e-7)


def test_a_sphere_bends_both_ways():
    # k_1 = k_2 = k: tr = 2 k; a cap of radius 1/k seen at points 1/20 of it apart, so slopes of up to 0.2 make 2 % of it
    points, triangles = lattice((0.2, 0.2), 0.02, turn=30.0)
    k = 2.0
    height = k * ((points - 0.1) ** 2).sum(1) / 2
    sheet = Sheet.of(flat(points), triangles)
    angle = fold_angles(np.column_stack([points, height])[sheet.folds])
    inner = (sheet.sides >= 0).all(1)
    kappa = np.einsum("fck,fk->fc", sheet.curving, angle[sheet.sides])[inner]
    np.testing.assert_allclose(kappa[:, :2].sum(1), 2 * k, rtol=0.05)
    np.testing.assert_allclose(np.hypot((kappa[:, 0] - kappa[:, 1]) / 2, kappa[:, 2]), 0, atol=0.06 * k)


# ---------------------------------------------------------------- membranes


def test_a_patch_of_constant_strain_is_exact():
    # x = A X: one stress everywhere, so no force inside, and tractions along the rim; irregular triangles
    rng = np.random.default_rng(1)
    points, triangles = lattice((0.1, 0.1), 0.02)
    inner = ((points > 1e-6) & (points < 0.1 - 1e-6)).all(1)
    points = points + inner[:, None] * rng.uniform(-0.006, 0.006, points.shape)
    system = cut(flat(points), triangles, Membrane({"membrane_stiffness": 200.0}), PlateBending())
    a = Rotation.from_rotvec([0.4, -0.3, 0.8]).as_matrix() @ np.array([[1.05, 0.03], [-0.01, 0.97], [0.0, 0.0]])
    strain = (a.T @ a - np.eye(2)) / 2
    c = 200.0 / (1 - 0.09)
    stress = c * (0.7 * strain + 0.3 * np.trace(strain) * np.eye(2))
    force = forces(system, points @ a.T, np.zeros((len(points), 3)))
    np.testing.assert_allclose(force[inner], 0, atol=1e-12)
    right = points[:, 0] > 0.1 - 1e-6  # traction P N times the side's length, resisted from inside
    # what the sides beside it pull at its two corners is opposite
    np.testing.assert_allclose(force[right].sum(0), -(a @ stress @ [1.0, 0.0]) * 0.1, atol=1e-12)


@pytest.mark.parametrize(
    ("term", "per_width"),
    [
        # S_11 = E h e along, free across: e_22 = -nu e_11, P = l S
        (Membrane({"membrane_stiffness": 100.0, "membrane_poisson": 0.3}), lambda s: 100.0 * s * (s * s - 1) / 2),
        (NeoHookeanMembrane({"rubber_stiffness": 90.0}), lambda s: 30.0 * (s - s**-2)),  # Holzapfel 2000, section 6.5: mu h (l - l^-2)
    ],
    ids=lambda p: getattr(p, "name", ""),
)
def test_a_strip_under_tension(term, per_width):
    # both ends led apart by 20 %, sides free; at rest after drag. Constant strain but near the ends, so the middle third is measured
    stretch = 1.2
    points, triangles = lattice((0.12, 0.02), 0.01)
    x = flat(points)
    held = np.flatnonzero((points[:, 0] < 1e-9) | (points[:, 0] > 0.12 - 1e-9))
    path = x[None, held] * [stretch, 1, 1] + np.zeros((31, 1, 1))
    path[0] = x[held]
    path[1:5] = x[held] * (1 + np.linspace(0.25, 1, 4)[:, None, None] * [stretch - 1, 0, 0])
    system = cut(x, triangles, term, LinearDrag({"drag_damping": 20.0}), held=held, path=path)
    end = Batch([system], fps=30, double=True).rollout().positions[0][-1].numpy()
    middle = end[np.abs(points[:, 0] - 0.06) < 0.011]
    reach = middle[:, 0].max() - middle[:, 0].min()
    local = reach / 0.02
    force = forces(system, end, 0 * end)
    pull = force[points[:, 0] > 0.12 - 1e-9].sum(0)
    assert -pull[0] == pytest.approx(0.02 * per_width(local), rel=0.01)  # held ends: a hundredth, by Saint-Venant's principle


# ---------------------------------------------------------------- what any law keeps


def everything(seed=0):
    return draped(MembraneDamping, PlateDamping, PlateStiffening, seed=seed)


def test_forces_neither_push_nor_turn_the_whole():
    system = everything()
    force = forces(system, system.positions, system.velocities)
    assert np.abs(force).max() > 0.01
    np.testing.assert_allclose(force.sum(0), 0, atol=1e-13)
    np.testing.assert_allclose(np.cross(system.positions, force).sum(0), 0, atol=1e-13)


def test_rigid_motions_are_not_damped():
    system = everything()
    turn = np.cross([3.0, -2.0, 1.0], system.positions) + [0.3, 0.2, 0.1]
    np.testing.assert_allclose(forces(system, system.positions, turn), forces(system, system.positions, 0 * turn), atol=1e-12)


def test_damping_takes_energy():
    system = replace(everything(), terms=[MembraneDamping({"membrane_viscosity": 0.02}), PlateDamping({"plate_viscosity": 1e-5})])
    for seed in range(5):
        v = np.random.default_rng(seed).normal(size=system.positions.shape)
        assert (forces(system, system.positions, v) * v).sum() < 0


@pytest.mark.parametrize("term", [Membrane, NeoHookeanMembrane, PlateBending, PlateStiffening])
def test_forces_are_the_gradient_of_an_energy(term):
    # then the stiffness -dF/dx is symmetric: a' K b = b' K a for any two motions; central differences are off by h^2
    system = replace(draped(term), terms=[term({"plate_stiffening": 2e-3} if term is PlateStiffening else {})])
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(2, *system.positions.shape))
    h, still = 1e-7, 0 * a

    def along(way):
        x = system.positions
        return (forces(system, x + h * way, still) - forces(system, x - h * way, still)) / (2 * h)

    one, two = (b * along(a)).sum(), (a * along(b)).sum()
    assert abs(one) > 1e-3 and one == pytest.approx(two, rel=1e-6)


def test_free_motion_keeps_energy_and_momentum():
    # no damping, nothing outside: kinetic energy goes over into that of springs and back; momentum stays to rounding. Total energy by the
    # work that forces did; semi-implicit steps let it swing by omega dt, here within 2 %
    system = replace(draped(), terms=[Membrane({"membrane_stiffness": 20.0}), PlateBending({"plate_rigidity": 1e-3})])
    system = replace(system, controllers=np.zeros((1, 0, 3)), grips=None)
    batch = Batch([system], fps=2000, substeps=10, double=True)
    out, _, v = batch.march(0, 60)
    out = np.concatenate([system.positions[None], out.numpy()])
    momentum = system.masses @ v.numpy()
    np.testing.assert_allclose(momentum, system.masses @ system.velocities, atol=1e-15)
    pull = np.stack([forces(system, x, 0 * x) for x in out])
    work = ((pull[1:] + pull[:-1]) / 2 * np.diff(out, axis=0)).sum()
    kinetic = [(system.masses @ (u**2).sum(1)) / 2 for u in (system.velocities, v.numpy())]
    assert abs(work) > 0.1 * kinetic[0]
    assert kinetic[1] - kinetic[0] == pytest.approx(work, abs=0.02 * max(kinetic))


# ---------------------------------------------------------------- strips that bend


def heavy_elastica(length, rigidity, weight):
    """(x, how far down) of the tip of a strip clamped level: B a'' = -w (L - s) cos a, a(0) = a'(L) = 0, a downwards (Bickley 1934)."""
    s = np.linspace(0, length, 200)

    def slope(s, y):
        return np.stack([y[1], -weight * (length - s) * np.cos(y[0]) / rigidity, np.cos(y[0]), np.sin(y[0])])

    solved = solve_bvp(slope, lambda a, b: np.array([a[0], b[1], a[2], a[3]]), s, np.zeros((4, len(s))), tol=1e-8, max_nodes=20000)
    assert solved.success
    return solved.sol(length)[2:]


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name != "square")) for name in MESHES])
def test_peirces_cantilever(name):
    # w L^3 / B = 10: the tip hangs 0.7 L below the clamp. Folds stand for the curvature around them, so the strip is clamped half a cell
    # behind the last held nodes; with 20 cells along it, and 3 % of energy missing along the rim, within 3 % of the length
    length, pitch = 0.2, 0.01
    rigidity = AREAL * G * length**3 / 10
    points, triangles = lattice((length + pitch, 0.06), pitch, **MESHES[name])
    points = points - [pitch, 0.0]
    held = np.flatnonzero(points[:, 0] < 1e-6)
    given = [Membrane({"membrane_stiffness": 200.0}), PlateBending({"plate_rigidity": rigidity}), LinearDrag({"drag_damping": 10.0})]
    system = cut(flat(points), triangles, *given, Gravity({"gravity_z": -G}), held=held)
    out = Batch([system], fps=2, substeps=int(0.5 / (0.8 * stable_step(system)))).march(0, 5)[0].numpy()
    tip = out[-1][points[:, 0] > length - 1e-6].mean(0)
    assert np.abs(out[-1] - out[-2]).max() < 1e-4  # at rest
    x, fallen = heavy_elastica(length + pitch / 2, rigidity, AREAL * G)
    assert fallen > 0.6 * length
    assert tip[0] + pitch / 2 == pytest.approx(x, abs=0.03 * length) and -tip[2] == pytest.approx(fallen, abs=0.03 * length)


@pytest.mark.slow
def test_a_cantilever_rings_and_is_damped():
    # first mode: omega = 3.516 sqrt(B / rho) / L^2; with the damping time t = c / B it decays by exp(-omega^2 t / 2 s). Clamped as above;
    # 3 % of energy missing along the rim are 1.5 % of omega, and masses in the nodes about as much
    length, pitch, rigidity, ratio = 0.2, 0.02, 2e-4, 0.02
    omega = 3.516 * np.sqrt(rigidity / AREAL) / (length + pitch / 2) ** 2
    points, triangles = lattice((length + pitch, 0.08), pitch)
    points = points - [pitch, 0.0]
    held = np.flatnonzero(points[:, 0] < 1e-6)
    given = [Membrane({"membrane_stiffness": 50.0}), PlateBending({"plate_rigidity": rigidity})]
    given += [PlateDamping({"plate_viscosity": rigidity * 2 * ratio / omega})]
    s = np.maximum(points[:, 0] + pitch / 2, 0) / (length + pitch / 2)
    shape = np.cosh(1.8751 * s) - np.cos(1.8751 * s) - 0.7341 * (np.sinh(1.8751 * s) - np.sin(1.8751 * s))
    system = cut(flat(points), triangles, *given, held=held, velocities=0.01 * shape[:, None] * [0, 0, 1])
    period = 2 * np.pi / omega
    z = Batch([system], fps=50 / period).march(0, 120)[0].numpy()[:, np.argmax(points[:, 0]), 2]
    times = (1 + np.arange(120)) / 50  # periods
    crossing = np.flatnonzero((z[1:] > 0) != (z[:-1] > 0))
    at = times[crossing] + z[crossing] / (z[crossing] - z[crossing + 1]) / 50
    assert np.diff(at)[:3].mean() == pytest.approx(0.5, rel=0.05)
    peaks = [np.abs(z[(times > k / 2) & (times < (k + 1) / 2)]).max() for k in range(4)]
    assert np.log(peaks[0] / peaks[3]) / 1.5 == pytest.approx(2 * np.pi * ratio, rel=0.1)


def test_natural_shape_is_at_rest():
    points, triangles = lattice((0.06, 0.04), 0.01, turn=30.0)
    system = cut(rolled(points, 12.0, 25.0), triangles, Membrane(), PlateBending({"plate_rigidity": 1e-3}), flat_rest=False)
    np.testing.assert_allclose(forces(system, system.positions, 0 * system.positions), 0, atol=1e-12)
    unrolled = cut(rolled(points, 12.0, 25.0), triangles, Membrane(), PlateBending({"plate_rigidity": 1e-3}))
    assert np.abs(forces(unrolled, system.positions, 0 * system.positions)).max() > 1e-3


# ---------------------------------------------------------------- in the engine


def test_gradients():
    # of everything that is continuous, in float64, against central differences: below 1e-4 (``check``)
    batch = Batch([everything(seed) for seed in (0, 1)], fps=30, substeps=100, rounds=[2, 4], double=True, workers=1)
    inputs = leaves(batch)
    loss(batch, inputs).backward()
    for name in ("x", "mass", "path", "table"):
        check(batch, inputs, name, some(getattr(inputs, name).grad))
    check(batch, inputs, "v", some(inputs.v.grad)[:6])  # the others' differences are rounding


def test_a_step_is_that_of_numpy():
    # from v to v + share dt (F(x) / m + g + F_v(x, v) / m) in each round; shares are those of ``rounds.ease``
    system = replace(everything(), controllers=np.zeros((1, 0, 3)), grips=None)
    gravity = [system.values[f"gravity_{axis}"] for axis in "xyz"]
    x, masses, resist = system.positions, system.masses[:, None], [law(system, f"viscous_{stage}") for stage in ("membrane", "plate")]
    elastic = internal_forces(system.sheet, x, law(system, "membrane"), law(system, "plate"))
    for rounds in (1, 4):
        _, _, v = Batch([system], fps=1e4, substeps=1, rounds=rounds, double=True).march(0, 1)
        expected = system.velocities
        for share in ease(rounds):
            force = elastic + damping_forces(system.sheet, x, expected, *resist)
            expected = expected + share * 1e-4 * (force / masses + gravity)
        np.testing.assert_allclose(v.numpy(), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("double", [True, False])
def test_a_lone_thread_computes_what_a_team_does(double):
    # one adds what triangles and folds do to nodes, the other has nodes gather it: rounding is 1e-16 and 6e-8 of a metre a second; it grows
    # to 100 times that in 100 substeps of 4 rounds
    alone, team = (Batch([everything()], fps=30, substeps=100, rounds=4, double=double) for _ in range(2))
    team.kernels = build(team.laws, double, False, 1, 1, False)
    (x, v), (y, u) = (batch.march(0, 1)[1:3] for batch in (alone, team))
    close = 1e-13 if double else 2e-5
    assert float(v.abs().max()) > 0.01 and float((x - y).abs().max()) < 0.1 * close and float((v - u).abs().max()) < close
    assert double or not torch.equal(v, u)  # or the two would be one


def test_damping_in_rounds_is_that_of_short_steps():
    # a strip that is let go, with a damping time of 5 ms: single steps of damping would be a tenth as long as those of its stiffness. After
    # 0.1 s it is within 2 % of its way from where 16 times as many steps lead, the error of a step of first order, and so with 4 times as
    # many within a quarter of it
    points, triangles = lattice((0.12, 0.04), 0.01, turn=20.0)
    given = [Membrane({"membrane_stiffness": 100.0}), PlateBending({"plate_rigidity": 1e-3}), PlateDamping({"plate_viscosity": 5e-6})]
    system = cut(flat(points), triangles, *given, Gravity({"gravity_z": -G}), held=np.flatnonzero(points[:, 0] < 0.012))
    steps = stable_substeps([system], 0.1)
    rounds = stable_rounds(system, 0.1 / steps)
    ends = {n: Batch([system], fps=10, substeps=n * steps).march(0, 1)[1].numpy() for n in (1, 4, 16)}
    way = np.abs(ends[16] - system.positions).max()
    off = {n: np.abs(ends[n] - ends[16]).max() / way for n in (1, 4)}
    assert rounds >= 6 and way > 0.01
    assert off[1] < 0.02 and off[4] < 0.3 * off[1]


def test_a_batch_is_its_systems():
    systems = [everything(seed) for seed in (0, 1)]
    alone = replace(systems[0], sheet=None)  # one without a sheet beside them
    together = Batch([*systems, alone], fps=30, substeps=100).rollout().positions
    for one, both in zip([*systems, alone], together, strict=True):
        assert torch.equal(Batch([one], fps=30, substeps=100).rollout().positions[0], both)


@pytest.mark.parametrize("time", [0.002, 0.005, 0.3])
def test_a_sheet_that_is_stretched_is_still_damped_in_its_rounds(time):
    # resultants are those of the rest shape, so that a sheet at a stretch of 1.4 resists rates twice as hard: rounds are chosen for that.
    # A damping time of 0.3 s would take more than forty rounds in the steps that are stable: "auto" takes more steps
    points, triangles = lattice((0.08, 0.04), 0.01)
    right = points[:, 0] > 0.08 - 1e-9
    held = np.flatnonzero((points[:, 0] < 1e-9) | right)
    path = np.repeat(flat(points)[None, held], 31, 0)
    path[:, right[held], 0] += 0.4 * 0.08 * np.minimum(np.arange(31) / 15, 1)[:, None]
    given = [NeoHookeanMembrane({"rubber_stiffness": 100.0}), MembraneDamping({"membrane_viscosity": 100.0 * time}), PlateBending()]
    system = cut(flat(points), triangles, *given, Gravity({"gravity_z": -G}), held=held, path=path)
    batch = Batch([system], fps=30)
    found = batch.rollout().positions[0][-1].numpy()
    assert (batch.substeps[0] > stable_substeps([system], 1 / 30)) == (time == 0.3) and batch.rounds[0] > 2
    assert found[~right & (points[:, 0] > 0.06)][:, 0].mean() == pytest.approx(1.4 * 0.07, rel=0.02) and np.abs(found[:, 2]).max() < 0.02


def test_the_stable_step():
    # just above what the linear analysis allows a flat sheet blows up, at the bound it does not; the bound is not wasteful
    points, triangles = lattice((0.06, 0.04), 0.01)
    given = [Membrane({"membrane_stiffness": 100.0}), PlateBending({"plate_rigidity": 1e-3}), PlateDamping({"plate_viscosity": 1e-6})]
    system = cut(flat(points), triangles, *given)
    step = stable_step(system)
    aside = torch.tensor(1e-7 * np.random.default_rng(0).normal(size=system.positions.shape))
    for times, holds in ((1.0, True), (1.35, False)):
        batch = Batch([system], fps=1 / (times * step), substeps=1, double=True)
        out, _, _ = batch.march(0, 400, replace(batch.inputs, x=batch.inputs.x + aside))
        assert (np.abs(out[-1].numpy() - system.positions).max() < 1e-5) == holds


@pytest.mark.parametrize(
    ("text", "call"),
    [
        ("triangles must have shape (F, 3), F > 0, got (0, 3)", lambda p: Sheet.of(p, np.zeros((0, 3), int))),
        ("two triangles at most must share an edge, got 3 at [0, 1]", lambda p: Sheet.of(p, [[0, 1, 2], [0, 1, 3], [0, 1, 4]])),
        ("a sheet must have two sides", lambda p: Sheet.of(p, [[0, 1, 2], [1, 2, 3], [2, 3, 4], [3, 4, 0], [4, 0, 1]])),
        ("triangles must not be slivers", lambda p: Sheet.of(p * [1, 0, 0] + 0.0001 * p, [[0, 1, 2]])),
    ],
)
def test_what_is_no_sheet_is_refused(text, call):
    angle = 2 * np.pi * np.arange(5) / 5
    points = np.column_stack([np.cos(angle), np.sin(angle), 0.3 * angle])
    with pytest.raises(ValueError, match=re.escape(text)):
        call(points)
