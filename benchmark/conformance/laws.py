"""Laws of terms evaluated one by one, in float64, beside their numpy twins. Warp reads the annotations here: they are no strings."""

from functools import cache
from typing import Any

import numpy as np
import warp as wp

from ...physics.terms.stages import ARGUMENTS, CELLS, SHEETS, KernelTerm, RememberingTerm
from .checking import require

__all__ = ["agree", "agree_in_memory", "evaluate", "random_inputs"]

SAMPLES, OFFSET = 500, 2  # the term's parameters do not come first in their stage's vector


def agree(term: type[KernelTerm]) -> None:
    """Raises AssertionError unless the law of ``term`` is its ``twin`` wherever its parameters may lie."""
    rng = np.random.default_rng(0)
    inputs = random_inputs(term.stage, rng)
    low, high = np.array([(p.low, p.high) for p in term.parameters]).reshape(-1, 2).T
    parameters = rng.uniform(low, high, (SAMPLES, len(low)))
    twins = [term.twin(*(a[i] for a in inputs), *parameters[i]) for i in range(SAMPLES)]
    expected = [np.array(part) for part in zip(*twins, strict=True)] if term.stage == "move" else [np.array(twins)]
    found = evaluate(term.law, inputs, parameters, [part.shape for part in expected])
    for a, b in zip(found, expected, strict=True):
        # a dozen operations in float64; a slow impact at t* = -h / v_n is far away and cancels, so relative to the way there: 1e4 m
        # of stresses, that of the largest; those that vanish at small strains are differences of larger ones
        least = 1e-11 if term.stage == "move" else 1e-13 * max(1.0, np.abs(b).max() if term.stage in CELLS else 0.0)
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=least)
    if term.stage in ("move", "contact"):  # laws with a condition: both sides of it were seen
        usual = inputs[1] if term.stage == "move" else 0.0
        share = (np.abs(found[-1] - usual) > 1e-9).any(1).mean()
        require(0.1 < share < 0.9, f"it acts on {share:.0%} of the samples: both sides of its condition must be met")


def agree_in_memory(term: type[RememberingTerm]) -> None:
    """Raises AssertionError unless the memory of ``term``, of a stage that remembers, evolves as ``twin_evolve`` says."""
    # substeps from a microsecond to a second; the exponential of the one is a hyperbolic tangent in the other
    rng = np.random.default_rng(0)
    inputs = [*random_inputs(term.stage, rng), 10.0 ** rng.uniform(-6, 0, SAMPLES)]
    low, high = np.array([(p.low, p.high) for p in term.parameters]).T
    parameters = rng.uniform(low, high, (SAMPLES, len(low)))
    expected = np.array([term.twin_evolve(*(a[i] for a in inputs), *parameters[i]) for i in range(SAMPLES)])
    (found,) = evaluate(term.evolve, inputs, parameters, [expected.shape])
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13)  # a dozen operations of numbers up to 20
    share = (np.abs(found - inputs[ARGUMENTS[term.stage].index("q")]) > 1e-9).mean()
    require(share > 0.03, f"in {share:.0%} of the samples it remembers something new: too few")


@cache
def _kernel_of(law, arguments, values):
    """A generic kernel that evaluates ``law`` of so many ``arguments`` and returned ``values`` sample by sample."""
    Some = wp.array(dtype=Any)

    def one(a: Some, p: Some, out: Some):
        i = wp.tid()
        out[i] = law(a[i], p[i], wp.static(OFFSET))

    def two(a: Some, b: Some, p: Some, out: Some):
        i = wp.tid()
        out[i] = law(a[i], b[i], p[i], wp.static(OFFSET))

    def three(a: Some, b: Some, c: Some, p: Some, out: Some):
        i = wp.tid()
        out[i] = law(a[i], b[i], c[i], p[i], wp.static(OFFSET))

    def four(a: Some, b: Some, c: Some, d: Some, p: Some, out: Some):
        i = wp.tid()
        out[i] = law(a[i], b[i], c[i], d[i], p[i], wp.static(OFFSET))

    def five(a: Some, b: Some, c: Some, d: Some, e: Some, p: Some, out: Some):
        i = wp.tid()
        out[i] = law(a[i], b[i], c[i], d[i], e[i], p[i], wp.static(OFFSET))

    def six(a: Some, b: Some, c: Some, d: Some, e: Some, f: Some, p: Some, out: Some):
        i = wp.tid()
        out[i] = law(a[i], b[i], c[i], d[i], e[i], f[i], p[i], wp.static(OFFSET))

    def seven(a: Some, b: Some, c: Some, d: Some, e: Some, f: Some, g: Some, p: Some, out: Some):
        i = wp.tid()
        out[i] = law(a[i], b[i], c[i], d[i], e[i], f[i], g[i], p[i], wp.static(OFFSET))

    def eight(a: Some, b: Some, c: Some, d: Some, e: Some, f: Some, g: Some, h: Some, p: Some, out: Some):
        i = wp.tid()
        out[i] = law(a[i], b[i], c[i], d[i], e[i], f[i], g[i], h[i], p[i], wp.static(OFFSET))

    def nine(a: Some, b: Some, c: Some, d: Some, e: Some, f: Some, g: Some, h: Some, k: Some, p: Some, out: Some):
        i = wp.tid()
        out[i] = law(a[i], b[i], c[i], d[i], e[i], f[i], g[i], h[i], k[i], p[i], wp.static(OFFSET))

    def move(a: Some, b: Some, c: Some, p: Some, out: Some, out2: Some):
        i = wp.tid()
        x, v = law(a[i], b[i], c[i], p[i], wp.static(OFFSET))
        out[i] = x
        out2[i] = v

    function = move if values == 2 else (one, two, three, four, five, six, seven, eight, nine)[arguments - 1]
    return wp.kernel(function, module="unique", enable_backward=False)


def evaluate(law, inputs, parameters, shapes):
    """What ``law`` returns, one array for each of ``shapes``."""
    P = wp.types.vector(OFFSET + max(1, parameters.shape[1]), wp.float64)
    padded = np.full((SAMPLES, P._length_), np.nan)  # a law that reads another term's parameters gives NaN
    padded[:, OFFSET : OFFSET + parameters.shape[1]] = parameters
    types = {1: wp.float64, 2: wp.vec3d, 3: wp.mat33d}
    arrays = [wp.array(a, dtype=types[a.ndim], device="cpu") for a in inputs]
    out = [wp.zeros(SAMPLES, dtype=types[len(shape)], device="cpu") for shape in shapes]
    kernel = _kernel_of(law, len(inputs), len(shapes))
    wp.launch(kernel, dim=SAMPLES, inputs=[*arrays, wp.array(padded, dtype=P, device="cpu")], outputs=out, device="cpu")
    return [o.numpy().reshape(shape) for o, shape in zip(out, shapes, strict=True)]


def random_inputs(stage, rng):
    """Samples of the arguments in the order of ``ARGUMENTS``: moving particles, about as far apart as terms reach."""
    positive, x, v = rng.uniform(0.1, 2, (4, SAMPLES)), rng.normal(size=(2, SAMPLES, 3)), rng.normal(size=(2, SAMPLES, 3))
    if stage in ("axial", "strand"):
        spring = [positive[0], rng.normal(size=SAMPLES), positive[1], 1e3 * positive[2]]
        return [*spring, rng.integers(0, 2, SAMPLES) * 1.0, x[0], positive[3], v[0, :, 0]] if stage == "strand" else spring
    if stage == "contact":
        return [x[0], x[0] + 0.2 * x[1], *v, *positive[:2]]
    if stage == "hinge":
        return [x[0], v[0], x[1] * [1.0, 1.0, 0.0], 0.1 * positive[0]]
    if stage in CELLS:  # stretched, crushed and sheared, and not turned inside out
        deformed, rate, stress, q = np.stack([np.eye(3), *np.zeros((3, 3, 3))])[:, None] + rng.uniform(-0.25, 0.25, (4, SAMPLES, 3, 3))
        known = dict(deformed=deformed, rate=10 * rate, stress=stress, home=x[0], at=x[0], mu=positive[0], lame=positive[1])
        known |= dict(q=(q + np.swapaxes(q, 1, 2)) / 2, dt=0.1 * positive[2])
        return [known[name] for name in ARGUMENTS[stage]]
    if stage in ("sheet_flow", "sheet_branch", "hinge_flow", "hinge_branch"):  # of strains and of curvatures
        curved = rng.integers(0, 2, SAMPLES) * 1.0 if stage.startswith("sheet") else np.full(SAMPLES, 2.0)
        strain, q = (np.where(curved > 0, 40.0, 0.2)[:, None] * part for part in x)
        return [strain, curved, 0.01 * positive[0] if stage.endswith("flow") else q]
    if stage in SHEETS:  # strains, curvatures that are as sharp as a hand, rates
        return [{"membrane": 0.2, "plate": 30.0}.get(stage, 10.0) * x[0]]
    if stage == "layer":  # within the thickness and beyond
        return [0.03 * x[0], v[0], positive[0]]
    if stage == "facet":
        return [x[0], v[0], *positive[:2], 0.1 * positive[2]]
    if stage == "touch":
        return [x[0], v[0], positive[0], 0.01 * x[1]]
    if stage == "slip":
        return [0.01 * x[0], 100 * v[0], positive[0], rng.integers(0, 2, SAMPLES) * 1.0, 0.01 * x[1], 0.01 * positive[1]]
    if stage == "grip":
        return [x[0], v[0], positive[1], rng.integers(0, 2, SAMPLES) * 1.0]
    if stage == "surface":
        return [x[0], v[0], x[1], positive[0], positive[1]]
    if stage in ("body", "observer"):
        return [x[0], v[0], x[0] + 0.3 * x[1], *([v[1], x[1]] if stage == "observer" else []), positive[0]]
    return {"velocity": [v[0], 0.1 * positive[0]], "move": [x[0], v[0], 0.1 * positive[0]]}[stage]
