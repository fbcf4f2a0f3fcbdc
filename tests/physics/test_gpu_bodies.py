"""Solids and sheets on CUDA against the same on the CPU, forward and back. Run on a machine with a
GPU: pytest tests/physics/test_gpu_bodies.py"""

from dataclasses import replace

import pytest
import torch
from twinbench.benchmark.conformance.gradients import FRAMES, NAMES, draped, loss, solid
from twinbench.physics import terms
from twinbench.physics.batch import Batch, Inputs

pytestmark = pytest.mark.gpu


@pytest.fixture(scope="module", autouse=True)
def _both_devices():
    warp = pytest.importorskip("warp")
    if not torch.cuda.is_available():
        pytest.skip("no CUDA device")
    if not warp.is_cpu_available():
        pytest.skip("this Warp comes without its compiler for the CPU")


def solids(*kinds):
    """Two foams with all of ``kinds``: one body, and what each of them adds to it."""
    made = []
    for seed in (0, 1):
        each = [solid(kind, seed) for kind in kinds]
        own = {type(t): t for one in each for t in one.terms}
        made.append(replace(each[0], terms=tuple(own.values())))
    return made


def sheets(*kinds):
    return [draped(*kinds, seed=seed) for seed in (0, 1)]


def remembering(*kinds):
    """Sheets with ``kinds`` at their typical sizes."""
    own = [kind(kind.stands_for().typical) for kind in kinds]
    return [replace(s, terms=(*s.terms, *own)) for s in sheets(terms.PlateBending)]


GROUPS = {
    "foam": lambda: solids(terms.KelvinVoigt),
    "held and sliding": lambda: solids(terms.CoulombGround, terms.SoftGrip, terms.SurfaceDrag),
    "held and let slip": lambda: solids(terms.SoftGrip, terms.SlidingHand),
    "materials": lambda: solids(
        terms.Fung, terms.Fibres, terms.TensionCompression, terms.Inflation, terms.StiffnessPatch, terms.GrownShape
    ),
    "memories": lambda: solids(terms.Maxwell, terms.DahlFriction, terms.Damage, terms.NortonCreep, terms.Yielding),
    "sheets": lambda: sheets(terms.MembraneDamping, terms.PlateDamping, terms.PlateStiffening),
    "sheets that remember": lambda: remembering(terms.SheetCreep, terms.SheetYielding, terms.SheetRelaxing, terms.SheetFriction),
    "rubber": lambda: [replace(s, terms=tuple(t for t in s.terms if t.name != "membrane")) for s in sheets(terms.NeoHookeanMembrane)],
}


def both_ways(made, device, double):
    """(positions of all frames, gradients by name), on the CPU in float64."""
    batch = Batch(made, fps=30, substeps=100, device=device, double=double, workers=1)
    inputs = Inputs(**{n: getattr(batch.inputs, n).clone().requires_grad_() for n in NAMES})
    with torch.no_grad():
        out = batch.march(0, FRAMES, inputs)[0].cpu().double()
    if not double:
        return out, {}
    total = loss(OnCPU(batch), inputs)
    total.backward()
    slopes = {n: getattr(inputs, n).grad for n in NAMES}
    return out, {n: slope.cpu() for n, slope in slopes.items() if slope is not None and slope.numel()}


class OnCPU:
    """A batch whose results are brought to the CPU, where the loss has its weights."""

    def __init__(self, batch):
        self.batch, self.split, self.hinged = batch, batch.split, batch.hinged

    def march(self, *given, **options):
        out, x, v, carried = self.batch.march(*given, **options)
        return out.cpu(), x.cpu(), v.cpu(), carried


@pytest.mark.parametrize("group", GROUPS)
def test_cuda_agrees_with_cpu(group):
    made = GROUPS[group]()
    there, slopes = both_ways(made, "cuda", True)
    here, expected = both_ways(made, "cpu", True)
    # float64 keeps 16 digits; 400 substeps of a stiff body multiply the last one by some thousands
    assert (there - here).abs().max() < 1e-11
    for name, slope in expected.items():
        assert (slopes[name] - slope).abs().max() <= 1e-7 * max(1e-12, slope.abs().max()), name


@pytest.mark.parametrize("group", ["foam", "sheets"])
def test_cuda_in_float32(group):
    made = GROUPS[group]()
    single, exact = both_ways(made, "cuda", False)[0], both_ways(made, "cpu", True)[0]
    assert (single - exact).abs().max() < 1e-5  # m: 24 bits of 5 cm are 3 nm, times some thousands as above


def test_batched_equals_single_on_cuda():
    made = solids(terms.KelvinVoigt)
    whole = both_ways(made, "cuda", False)[0]
    parts = [both_ways([one], "cuda", False)[0] for one in made]
    assert torch.equal(whole, torch.cat(parts, 1))
