"""A rope that is bent by nature, as one that came off a reel: the same wherever it is recorded."""

from dataclasses import replace
from weakref import WeakKeyDictionary

from ..parameters import Parameter
from .stages import SetupTerm

__all__ = ["ENDS", "MODES", "NaturalCurvature"]

MODES = 6
NOWHERE = 1e-12  # overlap of two shapes that are nowhere bent alike: any roll will do
ENDS = ("first", "last")
_COLUMNS = tuple(f"{axis}{k}" for axis in "ab" for k in range(MODES))
_BENT = tuple(f"{axis}_{end}" for axis in "ab" for end in ENDS)
_PLACES = WeakKeyDictionary()


class NaturalCurvature(SetupTerm):
    """kappa_0 <- n kappa_0 + l sum_k (a_k, b_k) P_k(u) at hinges along chains: natural curvature per length in Legendre modes.

    u runs from -1 to 1 along the rope's arc and l is the hinge's span. The first and the last hinge of a chain have further angles of their
    own, at which a grip may hold it. The two axes are those of untwisted frames that are rolled, all by one angle a chain, to where
    the first shape is nearest to the natural one: what a recording does not tell is how a rope was turned about itself.
    The roll is the angle of sum (B / l) kappa kappa_0* over a chain's hinges, with two components as a complex number.
    """

    name = "natural_curvature"
    parameters = (
        Parameter("natural_kept", 1.0, 0.0, 2.0, "-", "share of the natural curvature that the body was given"),
        *(
            Parameter(f"natural_{c}", 0.0, -100.0, 100.0, "1/m", f"natural curvature about axis {c[0]}, Legendre mode {c[1]}")
            for c in _COLUMNS
        ),
        *(
            Parameter(f"natural_{c}", 0.0, -2.0, 2.0, "-", f"further angle about axis {c[0]} at the {c[2:]} hinge, as 2 tan(angle / 2)")
            for c in _BENT
        ),
    )

    @staticmethod
    def prepare(batch, inputs, values):
        """Inputs with other ``natural`` curvatures (hinges, 2)."""
        import torch

        if not len(inputs.natural):
            return inputs
        framed, system, chain, modes, ends, kappa = _places(batch)
        length = batch.constants["span"][framed, None]
        parts = []
        for axis in "ab":
            curved = torch.stack([values[f"natural_{axis}{k}"] for k in range(MODES)], 1)[system]
            bent = torch.stack([values[f"natural_{axis}_{end}"] for end in ENDS], 1)[system]
            parts.append((modes * curved).sum(1, keepdim=True) * length + (ends * bent).sum(1, keepdim=True))
        wanted = torch.cat(parts, 1) + values["natural_kept"][system, None] * inputs.natural[framed]
        weight = inputs.flexure[framed] / length[:, 0]
        # kappa wanted*, summed over each chain; the frames stay and the natural shape is rolled back
        real, imaginary = (wanted * kappa).sum(1), wanted[:, 0] * kappa[:, 1] - wanted[:, 1] * kappa[:, 0]
        total = torch.zeros(int(chain.max()) + 1 if len(chain) else 0, 2, dtype=wanted.dtype, device=wanted.device)
        total = total.index_add(0, chain, weight[:, None] * torch.stack([real, imaginary], 1))[chain]
        size = total.norm(dim=1, keepdim=True)
        c, s = torch.where(
            size > 1e-12, total / size.clamp_min(1e-12), torch.tensor([1.0, 0.0], dtype=size.dtype, device=size.device)
        ).unbind(1)
        rolled = torch.stack([c * wanted[:, 0] - s * wanted[:, 1], s * wanted[:, 0] + c * wanted[:, 1]], 1)
        return replace(inputs, natural=inputs.natural.index_copy(0, framed, rolled))


def _places(batch):
    """Of the hinges along chains, once: their numbers, systems, chains, modes (K, MODES), which are ends (K, 2), curvature in frame 0."""
    if batch not in _PLACES:
        _PLACES[batch] = _look(batch)
    return _PLACES[batch]


def _look(batch):
    import numpy as np
    import torch

    from ..hinges import curvature, unit

    constants = {k: batch.constants[k].cpu().numpy() for k in ("joint", "sides", "segment", "hinge_start", "segment_start")}
    joint, sides, segment = constants["joint"], constants["sides"], constants["segment"]
    x, directors = batch.inputs.x.cpu().double().numpy(), batch.inputs.directors.cpu().double().numpy()
    step = np.linalg.norm(x[segment[:, 1]] - x[segment[:, 0]], axis=1)
    of_chain = np.repeat(np.arange(len(s := [len(c) - 1 for one in batch.systems for c in one.chains])), s)
    arc = np.cumsum(step) if len(step) else step
    before = np.concatenate([[0.0], arc])[np.searchsorted(of_chain, of_chain)] if len(step) else step
    total = np.bincount(of_chain, step)[of_chain] if len(step) else step
    framed = np.flatnonzero((sides[:, 0] >= 0) & (joint[:, 0] >= 0))
    first, second = sides[framed].T
    u = 2 * (arc - before)[first] / total[first] - 1
    modes = np.stack([np.polynomial.legendre.Legendre.basis(k)(u) for k in range(MODES)], 1)
    lows = np.unique(of_chain, return_index=True)[1]
    highs = np.concatenate([lows[1:], [len(of_chain)]]) - 1
    ends = np.stack([np.isin(first, lows), np.isin(second, highs)], 1).astype(float)
    t = unit(x[segment[:, 1]] - x[segment[:, 0]])
    kappa = curvature(t[first], t[second], directors[first], directors[second])
    system = np.searchsorted(constants["hinge_start"], framed, side="right") - 1

    def whole(value):
        return torch.tensor(value, dtype=torch.long, device=batch.device)

    return whole(framed), whole(system), whole(of_chain[first]), batch._real(modes), batch._real(ends), batch._real(kappa)
