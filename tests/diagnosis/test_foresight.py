"""Predictive misfits: against quadrature of the integral that they approximate, and against what they mean."""

from types import SimpleNamespace

import numpy as np
import pytest
from twinbench.diagnosis import foresight
from twinbench.diagnosis.fit import INDEPENDENT, Fit, Frames, remoteness
from twinbench.diagnosis.foresight import foreseen
from twinbench.diagnosis.model import Knob, Model
from twinbench.diagnosis.parts import Part

FRAMES, NODES = 40, 25
PARTS = (Part("train", 0, 0, FRAMES), Part("heldout", 0, FRAMES, 2 * FRAMES))


def linear(monkeypatch, offset, slope, *, finest=0.003, prior=1.0):
    """(task, fit, frames, origin) of a twin whose innovations are ``offset`` + ``slope`` z by part [m], noise of 2 mm beside."""
    rng = np.random.default_rng(3)
    shape = (FRAMES, NODES)
    frames = [Frames.of_seen([np.ones(shape, bool)], [finest**2]) for _ in PARTS]
    way = rng.normal(size=(2, FRAMES * NODES * 3))
    noise = 0.002 * rng.normal(size=way.shape)
    unit = 1 / np.sqrt(FRAMES * NODES)
    origin = [unit * (o * w + n) for o, w, n in zip(offset, way, noise, strict=True)]
    slopes = [unit * s * w for s, w in zip(slope, way, strict=True)]
    knob = Knob("a", 0.0, 1.0, -50.0, 50.0, prior=prior)

    def innovations(task, model, rows, parts, substeps):
        z = np.array([row["a"] for row in rows])
        return [o + z[:, None] * s for o, s in zip(origin, slopes, strict=True)], frames

    monkeypatch.setattr(foresight, "innovations", innovations)
    replica = SimpleNamespace(nodes=np.zeros((NODES, 3)))
    task = SimpleNamespace(simulators=[SimpleNamespace(replica=replica)], substeps=lambda model, z, most: [1])
    fit = Fit(Model((), {}, (knob,)), np.zeros(1), 0.0, np.eye(1), ())
    return task, fit, frames, origin, slopes


@pytest.mark.parametrize("slope", [(0.0, 0.004), (0.001, 0.004), (0.01, 0.01)])
@pytest.mark.parametrize("offset", [0.0, 0.006])
def test_the_predictive_misfit_is_the_integral_over_what_the_fit_left_open(monkeypatch, offset, slope):
    # -2/N log of int p(heldout | z) p(z | train) dz, with p ~ exp(-N/2 (misfit + remoteness)): Laplace's approximation of it, with no
    # large weights of Huber's in play. It is exact for quadratic misfits; these are logs of squares, hence 0.03
    task, fit, frames, origin, slopes = linear(monkeypatch, (0.0, offset), slope)
    grid = np.linspace(-12, 12, 4001)

    def density(some):
        cost = [sum(frames[k].misfit(origin[k] + z * slopes[k]) for k in some) + remoteness(np.array([z])) for z in grid]
        return np.array(cost)

    both, first = density((0, 1)), density((0,))
    level = first.min()
    expected = (
        level
        - 2 / INDEPENDENT * np.log(np.exp(-INDEPENDENT / 2 * (both - level)).sum())
        - (level - 2 / INDEPENDENT * np.log(np.exp(-INDEPENDENT / 2 * (first - level)).sum()))
    )
    assert np.log(foreseen(task, fit, PARTS)["heldout"]) == pytest.approx(expected, abs=0.03)


def test_an_error_that_the_fit_left_open_counts_less_than_one_that_it_excludes(monkeypatch):
    task, fit, frames, origin, _ = linear(monkeypatch, (0.0, 0.02), (0.0, 0.01))
    plain = frames[1].misfit(origin[1])
    open_ = np.log(foreseen(task, fit, PARTS)["heldout"])
    task, fit, *_ = linear(monkeypatch, (0.0, 0.02), (0.05, 0.01))  # the training frames say how large the knob is
    shut = np.log(foreseen(task, fit, PARTS)["heldout"])
    assert open_ < plain - 1 and shut == pytest.approx(plain, abs=0.1)


def test_a_twin_without_knobs_is_judged_by_its_errors(monkeypatch):
    task, _, frames, origin, _ = linear(monkeypatch, (0.0, 0.02), (0.0, 0.01))
    monkeypatch.setattr(foresight, "innovations", lambda *_: ([o[None] for o in origin], frames))
    firm = Fit(Model((), {}, ()), np.zeros(0), 0.0, np.zeros((0, 0)), ())
    assert np.log(foreseen(task, firm, PARTS)["heldout"]) == pytest.approx(frames[1].misfit(origin[1]))


def test_a_twin_that_blows_up_foresees_nothing(monkeypatch):
    task, fit, _, origin, _ = linear(monkeypatch, (0.0, 0.02), (0.0, 0.01))
    origin[1][5] = np.nan
    assert foreseen(task, fit, PARTS) == {"heldout": np.inf}
