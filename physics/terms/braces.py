"""Springs of a rope that skip its nodes, and so hold its bends."""

from dataclasses import replace
from weakref import WeakKeyDictionary

from ..parameters import Parameter
from .stages import SetupTerm

__all__ = ["Braces"]

_SKIPS = WeakKeyDictionary()


class Braces(SetupTerm):
    """Y <- b Y for springs between nodes that do not follow each other in a chain; bodies without chains stay as they are.

    A spring-mass twin of a rope has no other stiffness against bending: a per-spring fit finds this share. 0 leaves a chain of links.
    """

    name = "braces"
    parameters = (Parameter("brace_share", 1.0, 0.0, 10.0, "-", "stiffness of springs that skip nodes of a rope, over that of its links"),)

    @staticmethod
    def prepare(batch, inputs, values):
        """Inputs with other ``stiffness`` (springs,)."""
        import torch

        skips = _skips(batch)
        return replace(inputs, stiffness=inputs.stiffness * torch.where(skips, values["brace_share"][batch.spring_system], 1.0))


def _skips(batch):
    """(springs,) bool: both ends in chains, and no segment."""
    if batch not in _SKIPS:
        import torch

        ends, count = batch.ends, batch.node_count
        segment = batch.constants["segment"].long()
        lead = batch.constants["lead"][ends].any(1)
        roped = torch.zeros(count, dtype=torch.bool, device=ends.device)
        roped[segment.flatten()] = True

        def key(pairs):
            return pairs.amin(1) * count + pairs.amax(1)

        _SKIPS[batch] = roped[ends].all(1) & ~lead & ~torch.isin(key(ends), key(segment))
    return _SKIPS[batch]
