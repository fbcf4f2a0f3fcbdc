"""The engine against closed forms and conservation laws, in float64.

The step is semi-implicit: v <- v + dt F(x, v) / m, then x <- x + dt v. Where its own solution is known it is matched to rounding
(``ROUNDING``); where only the continuous one is, the error must be first order in dt.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from twinbench.physics.batch import Batch
from twinbench.physics.system import System
from twinbench.physics.terms import ControllerSprings, Dashpot, Gravity, Ground, LinearDrag, SelfCollision, Springs

ROUNDING = 1e-11  # at most 1e4 steps of numbers of order 1, each rounded by 2^-53 = 1.1e-16, with a margin for their summation
# every law at its neutral value, so that all tests share two compiled kernels; the plane -z = -10 is out of reach
NEUTRAL = dict(dashpot_damping=0.0, drag_damping=0.0, gravity_x=0.0, gravity_y=0.0, gravity_z=0.0, ground_offset=-10.0)
STILL = np.zeros((1, 0, 3))  # a path of no controllers


def body(positions, *, springs=(), stiffness=(), collide=False, controllers=STILL, velocities=None, **options):
    """A system of which only what is given here acts; ``options`` are the masses, rest lengths and grips, and values of parameters."""
    given = {k: options.pop(k, None) for k in ("masses", "rest", "grips")}
    terms = [Springs(), Dashpot(), Gravity(), LinearDrag(), Ground(), ControllerSprings()] + [SelfCollision()] * collide
    return System(
        positions=np.atleast_2d(positions),
        velocities=None if velocities is None else np.atleast_2d(velocities),
        springs=np.reshape(springs, (-1, 2)),
        stiffness=stiffness,
        controllers=controllers,
        terms=terms,
        **given,
    ).with_values(**{**NEUTRAL, **options})


def steps(system, dt, count):
    """Positions (count + 1, M, 3) after every single step of ``dt``."""
    return Batch([system], fps=1 / dt, substeps=1, dt=dt, double=True, workers=1).rollout(count + 1).positions[0].numpy()


def end(system, dt, count):
    """(x, v) after ``count`` steps, particles only."""
    _, x, v = Batch([system], fps=1 / (count * dt), substeps=count, dt=dt, double=True, workers=1).march(0, 1)
    return x.numpy()[: system.particle_count], v.numpy()[: system.particle_count]


def slope(errors):
    """Observed order from errors at dt, dt/2, dt/4, ..."""
    return -np.polyfit(np.arange(len(errors)), np.log2(errors), 1)[0]


def net(seed, count=30):
    """A random body: (positions, springs, stiffness, masses, velocities)."""
    rng = np.random.default_rng(seed)
    x = rng.random((count, 3))
    first, second = np.nonzero(np.triu(np.linalg.norm(x[:, None] - x[None], axis=2) < 0.5, 1))
    springs = np.stack([first, second], 1)
    return x, springs, rng.uniform(5, 20, len(springs)), rng.uniform(0.5, 2, count), rng.normal(size=(count, 3)) * 0.5


# ---------------------------------------------------------------- one particle in the air


def test_free_fall():
    # semi-implicit Euler: x_n = x0 + v0 t + g t^2 / 2 + g t dt / 2 and v_n = v0 + g t, t = n dt
    x0, v0, g, dt, n = np.array([0.1, -0.2, 0.3]), np.array([1.0, 2.0, -3.0]), np.array([0.5, -1.0, -9.8]), 1e-3, 1000
    system = body(x0, velocities=v0, masses=[3.0], gravity_x=g[0], gravity_y=g[1], gravity_z=g[2])
    t = dt * np.arange(n + 1)[:, None]
    np.testing.assert_allclose(steps(system, dt, n)[:, 0], x0 + v0 * t + g * t**2 / 2 + g * t * dt / 2, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(end(system, dt, n)[1][0], v0 + g, rtol=0, atol=ROUNDING)


def test_drag_decays_exactly():
    # dv/dt = -c v: v_n = v0 exp(-c t), whatever dt; x_n = x0 + dt sum_k v_k
    c, dt, n, v0 = 4.0, 0.01, 100, np.array([1.0, -2.0, 0.5])
    system = body([0.0, 0.0, 0.0], velocities=v0, drag_damping=c)
    decay = np.exp(-c * dt * np.arange(n + 1))
    np.testing.assert_allclose(end(system, dt, n)[1][0], v0 * decay[-1], rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(steps(system, dt, n)[1:, 0], dt * np.cumsum(decay[1:])[:, None] * v0, rtol=0, atol=ROUNDING)


def test_terminal_velocity():
    # v = g / c; with the drag applied after the push: v = g dt q / (1 - q), q = exp(-c dt)
    c, g, dt = 3.0, 9.8, 1e-3
    v = end(body([0.0, 0.0, 0.0], gravity_z=-g, drag_damping=c), dt, 10000)[1][0, 2]
    q = np.exp(-c * dt)
    assert v == pytest.approx(-g * dt * q / (1 - q), abs=ROUNDING)
    assert v == pytest.approx(-g / c, rel=c * dt)


# ---------------------------------------------------------------- one spring

ANCHORS = {
    "controller": dict(controllers=np.zeros((1, 1, 3))),
    "grip": dict(controllers=np.zeros((1, 1, 3)), grips=[0]),
}


def oscillator(anchor, *, mass, stiffness, rest, stretch, velocity=0.0, **values):
    """A mass on a spring that hangs on a still anchor at the origin, along x: (system, index of the mass)."""
    x, v = np.array([rest + stretch, 0.0, 0.0]), np.array([velocity, 0.0, 0.0])
    if anchor == "controller":
        return body(x, velocities=v, masses=[mass], springs=[[1, 0]], stiffness=[stiffness], rest=[rest], **ANCHORS[anchor], **values), 0
    both = dict(positions=[np.zeros(3), x], velocities=[np.zeros(3), v], masses=[7.0, mass])
    return body(**both, springs=[[0, 1]], stiffness=[stiffness], rest=[rest], **ANCHORS[anchor], **values), 1


@pytest.mark.parametrize("anchor", ANCHORS)
def test_period_of_a_spring(anchor):
    # w^2 = Y / (L0 m); the step's solution from rest is x_n = A cos((n + 1/2) th) / cos(th / 2) with th = 2 asin(w dt / 2)
    mass, stiffness, rest, stretch, dt, n = 2.0, 30.0, 0.5, 0.1, 1e-3, 5000
    system, k = oscillator(anchor, mass=mass, stiffness=stiffness, rest=rest, stretch=stretch)
    w = np.sqrt(stiffness / (rest * mass))
    theta = 2 * np.arcsin(w * dt / 2)
    x = steps(system, dt, n)[:, k] - [rest, 0, 0]
    np.testing.assert_allclose(x[:, 0], stretch * np.cos((np.arange(n + 1) + 0.5) * theta) / np.cos(theta / 2), rtol=0, atol=ROUNDING)
    np.testing.assert_array_equal(x[:, 1:], 0)
    # the continuous period T = 2 pi / w, from interpolated zero crossings: th / dt = w (1 + (w dt)^2 / 24)
    down = np.flatnonzero((x[:-1, 0] > 0) & (x[1:, 0] <= 0))
    zero = dt * (down + x[down, 0] / (x[down, 0] - x[down + 1, 0]))
    assert np.diff(zero).mean() == pytest.approx(2 * np.pi / w, rel=(w * dt) ** 2)


@pytest.mark.parametrize("anchor", ANCHORS)
def test_decay_of_a_spring_with_a_dashpot(anchor):
    # m x'' = -(Y / L0) x - c x': the step is x_{n+1} = (2 - c dt/m - w^2 dt^2) x_n - (1 - c dt/m) x_{n-1}, with x_{-1} = x_0 from rest
    mass, stiffness, rest, stretch, c, dt, n = 2.0, 30.0, 0.5, 0.1, 3.0, 1e-3, 2000
    system, k = oscillator(anchor, mass=mass, stiffness=stiffness, rest=rest, stretch=stretch, dashpot_damping=c)
    w2 = stiffness / (rest * mass)
    z = np.roots([1, -(2 - c * dt / mass - w2 * dt**2), 1 - c * dt / mass])
    weights = np.linalg.solve([[1, 1], 1 / z], [stretch, stretch])
    exact = (weights * z ** np.arange(n + 1)[:, None]).sum(1).real
    np.testing.assert_allclose(steps(system, dt, n)[:, k, 0] - rest, exact, rtol=0, atol=ROUNDING)
    assert abs(z[0]) == pytest.approx(np.exp(-c / (2 * mass) * dt), rel=(c * dt / mass) ** 2)  # envelope exp(-c t / 2m)
    # and the continuous solution x = A exp(-a t) (cos w_d t + a / w_d sin w_d t), a = c / 2m: first order, errors halve with dt
    a, errors = c / (2 * mass), []
    w_d = np.sqrt(w2 - a * a)
    for halving in range(4):
        h = 4e-3 / 2**halving
        x, _ = end(system, h, round(1 / h))
        errors.append(abs(x[k, 0] - rest - stretch * np.exp(-a) * (np.cos(w_d) + a / w_d * np.sin(w_d))))
    assert slope(errors) == pytest.approx(1, abs=0.05)


def test_two_bodies_swing_with_their_reduced_mass():
    # w^2 = (Y / L0) (1/m1 + 1/m2), about a centre of mass that moves uniformly
    m, stiffness, rest, dt, n = np.array([1.0, 3.0]), 20.0, 0.4, 1e-3, 3000
    v = np.array([0.3, -0.1, 0.2])
    system = body([[0.0, 0, 0], [0.5, 0, 0]], velocities=[v, v], masses=m, springs=[[1, 0]], stiffness=[stiffness], rest=[rest])
    x = steps(system, dt, n)
    theta = 2 * np.arcsin(np.sqrt(stiffness / rest * (1 / m).sum()) * dt / 2)
    stretch = np.linalg.norm(x[:, 1] - x[:, 0], axis=1) - rest
    np.testing.assert_allclose(stretch, 0.1 * np.cos((np.arange(n + 1) + 0.5) * theta) / np.cos(theta / 2), rtol=0, atol=ROUNDING)
    centre = (m[:, None] * x).sum(1) / m.sum()
    np.testing.assert_allclose(centre, centre[0] + v * dt * np.arange(n + 1)[:, None], rtol=0, atol=ROUNDING)


def test_static_sag_under_gravity():
    # Y (l / L0 - 1) = m g: stiffness multiplies strain, so l = L0 (1 + m g / Y)
    mass, stiffness, rest, g = 1.5, 40.0, 0.3, 9.8
    system, k = oscillator("controller", mass=mass, stiffness=stiffness, rest=rest, stretch=0.0, gravity_x=g, dashpot_damping=15.0)
    x, v = end(system, 1e-3, 6000)  # the envelope exp(-c t / 2m) is down to 1e-13
    assert x[k, 0] == pytest.approx(rest * (1 + mass * g / stiffness), abs=1e-11)
    assert np.abs(v[k]).max() < 1e-10


@pytest.mark.parametrize(("share", "lag"), [(1.0, 0.0), (0.0, 0.1)])
def test_a_towed_particle_feels_the_share_of_its_controllers_velocity(share, lag):
    # towed at speed u: Y (l / L0 - 1) = (1 - share) c u; l is from the particle to where the controller will be a substep later, + u dt
    u, c, stiffness, rest, dt = 0.5, 2.0, 10.0, 0.4, 1e-3
    path = np.zeros((101, 1, 3))
    path[:, 0, 0] = rest + u * 0.1 * np.arange(101)
    system = body(np.zeros(3), velocities=[u, 0, 0], springs=[[1, 0]], stiffness=[stiffness], rest=[rest], controllers=path)
    system = system.with_values(dashpot_damping=c, controller_velocity=share)
    assert lag == (1 - share) * c * u / stiffness
    x = Batch([system], fps=10, substeps=100, double=True).rollout().positions[0].numpy()
    assert path[-1, 0, 0] - x[-1, 0, 0] == pytest.approx(rest * (1 + lag) - u * dt, abs=5e-6)  # transient 0.04 exp(-c t / 2m) = 2e-6


def test_a_grip_holds_its_particle_on_the_path():
    # a gripped particle is where its controller is at every frame, whatever pulls on it; after the last frame it stays there
    path = np.cumsum(np.random.default_rng(0).normal(size=(6, 1, 3)) * 0.05, 0)
    x = [path[0, 0] + [0.3, 0, 0], path[0, 0]]
    system = body(x, springs=[[0, 1]], stiffness=[20.0], controllers=path, grips=[1], gravity_z=-9.8, dashpot_damping=1.0)
    found = Batch([system], fps=30, substeps=20, double=True).rollout(8).positions[0].numpy()
    np.testing.assert_allclose(found[:6, 1], path[:, 0], rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(found[6:, 1], path[[-1, -1], 0], rtol=0, atol=ROUNDING)
    assert np.abs(np.diff(found[:, 0], axis=0)).max() > 0.01  # its neighbour is dragged along


# ---------------------------------------------------------------- the ground


def plane(direction, offset):
    n = np.asarray(direction, float) / np.linalg.norm(direction)
    return n, dict(ground_normal_x=n[0], ground_normal_y=n[1], ground_normal_z=n[2], ground_offset=offset)


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 0, -1), (1, 2, 3)])
@pytest.mark.parametrize(("e", "mu"), [(0.0, 0.0), (0.6, 0.2), (1.0, 0.5), (0.4, 2.0)])
def test_impact_without_gravity(direction, e, mu):
    # at t* = h / |v_n|: v_n -> -e v_n, v_t -> max(0, 1 - mu (1 + e) |v_n| / |v_t|) v_t; straight lines before and after, at any dt
    n, values = plane(direction, 0.3)
    across = np.cross(n, [0.3, -0.5, 0.8])
    across /= np.linalg.norm(across)
    height, v_n, v_t, dt, count = 0.1, 1.3, 1.7, 0.013, 20
    system = body(n * (0.3 + height), velocities=-v_n * n + v_t * across, collide_elas=e, collide_fric=mu, **values)
    slide = max(0.0, v_t - mu * (1 + e) * v_n)
    t = dt * np.arange(count + 1)[:, None]
    impact = height / v_n
    before = n * (0.3 + height) + (-v_n * n + v_t * across) * np.minimum(t, impact)
    after = (e * v_n * n + slide * across) * np.maximum(t - impact, 0)
    x = steps(system, dt, count)[:, 0]
    np.testing.assert_allclose(x, before + after, rtol=0, atol=ROUNDING)


def test_a_dropped_ball_bounces_to_the_square_of_its_restitution():
    # drop from h: it lands at sqrt(2 h / g), the next heights are e^2 h, e^4 h; a step of dt moves an apex by up to v dt, v = sqrt(2 g h)
    h, g, e = 0.5, 9.8, 0.8
    system = body([0, 0, h], gravity_z=-g, collide_elas=e, **plane((0, 0, 1), 0)[1])
    dt, v = 1e-4, np.sqrt(2 * g * h)
    z = steps(system, dt, 15000)[:, 0, 2]
    low = np.flatnonzero((z[1:-1] < z[:-2]) & (z[1:-1] <= z[2:])) + 1
    assert dt * low[0] == pytest.approx(np.sqrt(2 * h / g), abs=2 * dt)
    assert z[low[0] : low[1]].max() == pytest.approx(e**2 * h, abs=v * dt)
    assert z[low[1] : low[2]].max() == pytest.approx(e**4 * h, abs=2 * v * dt)
    assert dt * np.diff(low)[0] == pytest.approx(2 * e * v / g, abs=3 * dt)  # time between bounces 2 e v / g


def test_bounce_is_first_order_in_the_step():
    # one bounce of a ball dropped from h: z = e v (t - t*) - g (t - t*)^2 / 2, v = sqrt(2 g h), t* = v / g. The fall is off by g t dt / 2,
    # the speed of the impact, which is that of the end of its step, by at most g dt
    h, g, e, t = 0.2, 9.8, 0.7, 0.3
    v = np.sqrt(2 * g * h)
    exact = e * v * (t - v / g) - g * (t - v / g) ** 2 / 2
    system = body([0, 0, h], gravity_z=-g, collide_elas=e, **plane((0, 0, 1), 0)[1])
    for n in (100, 1000, 10000, 100000):
        dt = t / n
        assert abs(end(system, dt, n)[0][0, 2] - exact) < g * t * dt / 2 + (1 + e) * g * dt * t


def test_sliding_friction():
    # e = 0: every step's normal impulse is m g dt, so v_n = v0 - mu g t and x_n = v0 t - mu g t (t + dt) / 2 until it stops for good
    g, mu, v0, dt, n = 9.8, 0.3, 1.0, 1e-3, 600
    system = body([0, 0, 0], velocities=[v0, 0, 0], gravity_z=-g, collide_elas=0.0, collide_fric=mu, **plane((0, 0, 1), 0)[1])
    x = steps(system, dt, n)[:, 0]
    t = dt * np.arange(n + 1)
    sliding = t <= v0 / (mu * g)
    np.testing.assert_allclose(x[sliding, 0], (v0 * t - mu * g * t * (t + dt) / 2)[sliding], rtol=0, atol=ROUNDING)
    assert x[-1, 0] == pytest.approx(v0**2 / (2 * mu * g), abs=v0 * dt)  # Coulomb: stops after v0^2 / (2 mu g)
    assert (np.diff(x[~sliding, 0])[1:] == 0).all()
    np.testing.assert_allclose(x[:, 2], 0, atol=ROUNDING)


@pytest.mark.parametrize("e", [0.0, 0.5, 0.9])
def test_friction_takes_mu_times_the_normal_impulse_whatever_the_restitution(e):
    # v_t loses mu (1 + e) |v_n| per impact = mu times the impulse; impacts carry the weight, so on average dv_t/dt = -mu g for every e
    g, mu, v0, dt, t = 9.8, 0.25, 2.0, 1e-4, 0.5
    system = body([0, 0, 0], velocities=[v0, 0, 0], gravity_z=-g, collide_elas=e, collide_fric=mu, **plane((0, 0, 1), 0)[1])
    _, v = end(system, dt, round(t / dt))
    # one impulse may be pending: hops last at most 2 g dt e / (1 - e) / g = 18 dt, and their impulse is at most mu g 18 dt
    assert v[0, 0] == pytest.approx(v0 - mu * g * t, abs=mu * g * 20 * dt)


@pytest.mark.parametrize(("mu", "slides"), [(0.3, True), (0.8, False)])
def test_inclined_plane(mu, slides):
    # slope of angle a: slides with g (sin a - mu cos a) where tan a > mu, stays where it is otherwise
    a, g, dt, n = np.radians(30), 9.8, 1e-3, 1000
    values = plane((np.sin(a), 0, np.cos(a)), 0)[1]
    x, v = end(body([0, 0, 0], gravity_z=-g, collide_elas=0.0, collide_fric=mu, **values), dt, n)
    down, t = np.array([np.cos(a), 0, -np.sin(a)]), n * dt
    acceleration = g * (np.sin(a) - mu * np.cos(a)) if slides else 0.0
    np.testing.assert_allclose(v[0], acceleration * t * down, rtol=0, atol=1e-9)
    np.testing.assert_allclose(x[0], acceleration * t * (t + dt) / 2 * down, rtol=0, atol=1e-9)


@pytest.mark.parametrize("e", [0.0, 0.5, 1.0])
def test_a_body_on_the_ground_does_not_sink(e):
    # motion slower than 1e-4 m/s is let through, as published, until the particle is faster and its impact puts it back on the plane; where
    # springs nearly carry a particle's weight that may last a while: 1e-5 m is a tenth of a second of it
    x, springs, stiffness, masses, _ = net(0)
    dt = 1e-3
    x[:, 2] -= x[:, 2].min()
    x[springs[0]] += 1e-3
    values = dict(gravity_z=-9.8, dashpot_damping=1.0, drag_damping=1.0, collide_elas=e, **plane((0, 0, 1), 0)[1])
    z = steps(body(x, springs=springs, stiffness=stiffness * 20, masses=masses, **values), dt, 3000)[..., 2]
    assert z.min() > -1e-5
    assert (z[-1] < 1e-3).sum() >= 3  # it does stand on it


# ---------------------------------------------------------------- contacts between particles


def collision(x, v, masses, *, e, mu=0.0, dist=0.1):
    """Velocities after one step of touching particles."""
    values = dict(collision_dist=dist, collide_object_elas=e, collide_object_fric=mu)
    return end(body(x, velocities=v, masses=masses, collide=True, **values), 1e-4, 1)[1]


@pytest.mark.parametrize("e", [0.0, 0.7, 1.0])
@pytest.mark.parametrize("masses", [(1.0, 1.0), (0.5, 3.0)])
def test_head_on_collision(e, masses):
    # restitution v2' - v1' = -e (v2 - v1), momentum m1 v1 + m2 v2 kept
    m, u = np.array(masses), np.array([0.8, -0.4])
    v = collision([[0, 0, 0], [0.05, 0, 0]], [[u[0], 0, 0], [u[1], 0, 0]], m, e=e)
    assert v[1, 0] - v[0, 0] == pytest.approx(-e * (u[1] - u[0]), abs=ROUNDING)
    assert m @ v[:, 0] == pytest.approx(m @ u, abs=ROUNDING)
    np.testing.assert_array_equal(v[:, 1:], 0)


@pytest.mark.parametrize("mu", [0.2, 2.0])
def test_oblique_collision(mu):
    # relative velocity: v_n -> -e v_n, v_t -> max(0, 1 - mu (1 + e) |v_n| / |v_t|) v_t (2.0: sticks); momentum kept
    n, t = np.array([0.6, 0.8, 0]), np.array([-0.8, 0.6, 0])
    e, m, v_n, v_t = 0.5, np.array([1.0, 2.0]), 0.7, 0.9
    before = np.array([[0.1, 0.2, 0.3], [0.1, 0.2, 0.3] - v_n * n + v_t * t])
    v = collision([[0, 0, 0], 0.05 * n], before, m, e=e, mu=mu)
    np.testing.assert_allclose(v[1] - v[0], e * v_n * n + max(0, v_t - mu * (1 + e) * v_n) * t, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(m @ v, m @ before, rtol=0, atol=ROUNDING)


def test_particles_that_part_or_are_apart_do_not_collide():
    v = np.array([[-0.1, 0, 0], [0.1, 0, 0]])
    np.testing.assert_array_equal(collision([[0, 0, 0], [0.05, 0, 0]], v, [1.0, 1.0], e=1.0), v)
    np.testing.assert_array_equal(collision([[0, 0, 0], [0.15, 0, 0]], -v, [1.0, 1.0], e=1.0), -v)


def test_impulses_of_several_contacts_are_averaged():
    # Jacobi: the middle one of three equal particles gets the mean of J = (1 + e) v_n / 2 from either side, the outer ones their own
    e, left, right = 0.4, 0.9, 0.3
    v = collision([[-0.06, 0, 0], [0, 0, 0], [0.06, 0, 0]], [[left, 0, 0], [0, 0, 0], [-right, 0, 0]], [1.0, 1.0, 1.0], e=e)[:, 0]
    jl, jr = (1 + e) * left / 2, (1 + e) * right / 2
    np.testing.assert_allclose(v, [left - jl, (jl - jr) / 2, -right + jr], rtol=0, atol=ROUNDING)


# ---------------------------------------------------------------- free bodies


@pytest.mark.parametrize("damping", [0.0, 0.5])
@pytest.mark.parametrize("count", [2, 30])
def test_momentum_and_angular_momentum_of_a_free_body(count, damping):
    # inner forces come in pairs along the line between their particles: sum m v and sum m x × v never change; the step keeps both exactly
    x, springs, stiffness, masses, v = net(1, count)
    springs, stiffness = (springs, stiffness) if count > 2 else ([[0, 1]], [10.0])
    system = body(x, springs=springs, stiffness=stiffness, masses=masses, velocities=v, dashpot_damping=damping)
    x2, v2 = end(system, 1e-3, 3000)
    m = masses[:, None]
    assert np.abs(x2 - x - 3 * (m * v).sum(0) / m.sum()).max() > 0.05  # it does wobble
    np.testing.assert_allclose((m * v2).sum(0), (m * v).sum(0), rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(np.cross(x2, m * v2).sum(0), np.cross(x, m * v).sum(0), rtol=0, atol=ROUNDING)


def energy(system, x, v):
    """Kinetic energy plus Y L0 (l / L0 - 1)^2 / 2 per spring [J]."""
    length = np.linalg.norm(x[..., system.springs[:, 0], :] - x[..., system.springs[:, 1], :], axis=-1)
    strain = length / system.rest - 1
    return (system.masses * (v**2).sum(-1)).sum(-1) / 2 + (system.stiffness * system.rest * strain**2).sum(-1) / 2


def test_invariant_of_an_undamped_spring():
    # the step keeps the modified energy v^2 + w^2 s^2 - dt w^2 s v (s: stretch) exactly, so amplitudes never drift
    system, k = oscillator("controller", mass=1.0, stiffness=8.0, rest=0.5, stretch=0.1, velocity=0.2)
    w2, dt = 16.0, 0.02
    values = []
    for n in (1, 10, 100, 1000, 10000):
        x, v = end(system, dt, n)
        s = x[k, 0] - 0.5
        values.append(v[k, 0] ** 2 + w2 * s**2 - dt * w2 * s * v[k, 0])
    np.testing.assert_allclose(values, 0.2**2 + w2 * 0.1**2 - dt * w2 * 0.1 * 0.2, rtol=0, atol=ROUNDING)


def test_energy_of_an_undamped_body_is_bounded_with_first_order():
    # symplectic: the energy oscillates by O(dt) and does not drift; halving dt halves the oscillation
    x, springs, stiffness, masses, v = net(2)
    system = body(x, springs=springs, stiffness=stiffness, masses=masses, velocities=v)
    wobble = []
    for dt in (4e-3, 2e-3, 1e-3):
        path = steps(system, dt, round(8 / dt))
        e = energy(system, path[1:], np.diff(path, axis=0) / dt)  # v_n = (x_n - x_{n-1}) / dt
        wobble.append(np.abs(e - e[0]).max() / e[0])
        first, last = e[: len(e) // 4].mean(), e[-len(e) // 4 :].mean()
        assert abs(last - first) < np.abs(e - e.mean()).max() / 2
    assert slope(wobble) == pytest.approx(1, abs=0.25)
    assert wobble[-1] < 0.05


def test_dashpots_take_energy_out():
    # E(0) - E(t) = integral of sum c (dl/dt)^2, with an error of first order in dt
    x, springs, stiffness, masses, v = net(3)
    c, errors = 2.0, []
    system = body(x, springs=springs, stiffness=stiffness, masses=masses, velocities=v, dashpot_damping=c)
    for dt in (2e-3, 1e-3, 5e-4):
        path = steps(system, dt, round(1 / dt))
        e = energy(system, path[1:], np.diff(path, axis=0) / dt)
        length = np.linalg.norm(path[:, springs[:, 0]] - path[:, springs[:, 1]], axis=2)
        heat = c * (np.diff(length, axis=0) ** 2).sum(1) / dt
        errors.append(np.abs(e[0] - e - np.cumsum(heat) + heat[0]).max() / e[0])
        assert e[-1] < 0.7 * e[0]
    assert slope(errors) == pytest.approx(1, abs=0.25)
    assert errors[-1] < 0.01


# ---------------------------------------------------------------- order


def test_first_order_convergence_to_the_ordinary_differential_equation():
    # m x'' = sum [Y (l / L0 - 1) + c dl/dt] d + m g - m k x', a moving hand included; reference: an eighth-order Runge-Kutta solver
    x0, springs, stiffness, masses, v0 = net(4, 12)
    count, c, drag, g, seconds = 12, 0.6, 0.8, np.array([0.2, 0.0, -3.0]), 0.5
    hand = np.stack([x0[0] + [0.1, 0, 0.1], x0[0] + [0.3, 0.2, 0.2]])
    springs, stiffness = np.concatenate([springs, [[count, 0], [count, 1]]]), np.append(stiffness, [15.0, 10.0])
    values = dict(gravity_x=g[0], gravity_z=g[2], drag_damping=drag, dashpot_damping=c, controller_velocity=1.0)
    system = body(x0, springs=springs, stiffness=stiffness, masses=masses, velocities=v0, controllers=hand[:, None], **values)
    rest, u = system.rest, (hand[1] - hand[0]) / seconds

    def rates(t, state):
        x, v = state.reshape(2, count, 3)
        nodes, speeds = np.concatenate([x, [hand[0] + u * t]]), np.concatenate([v, [u]])
        apart = nodes[springs[:, 1]] - nodes[springs[:, 0]]
        length = np.linalg.norm(apart, axis=1)
        d = apart / length[:, None]
        tension = stiffness * (length / rest - 1) + c * ((speeds[springs[:, 1]] - speeds[springs[:, 0]]) * d).sum(1)
        force = np.zeros_like(nodes)
        np.add.at(force, springs[:, 0], tension[:, None] * d)
        np.subtract.at(force, springs[:, 1], tension[:, None] * d)
        return np.concatenate([v, force[:count] / masses[:, None] + g - drag * v]).ravel()

    exact = solve_ivp(rates, (0, seconds), np.concatenate([x0, v0]).ravel(), "DOP853", rtol=1e-11, atol=1e-12).y[:, -1].reshape(2, count, 3)
    found = [end(system, seconds / n, n) for n in (100, 200, 400, 800, 1600)]
    assert slope([np.abs(x - exact[0]).max() for x, _ in found]) == pytest.approx(1, abs=0.05)
    assert slope([np.abs(v - exact[1]).max() for _, v in found]) == pytest.approx(1, abs=0.05)
    assert np.abs(found[-1][0] - exact[0]).max() < 1e-3
