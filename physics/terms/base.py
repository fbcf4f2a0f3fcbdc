"""What a term is.

A term states one law at one stage of a substep, as a Warp function that is generic in its precision; the engine fuses the laws of all terms
into one kernel and derives their adjoints, so a term never writes a gradient. ``p[o], p[o+1], ...`` are the term's own parameters.

stage       law                                                      returns
"axial"     (length, rate, rest, stiffness, p, o)                    tension along the spring [N], positive pulls its ends together
"body"      (x, v, m, p, o)                                          force on one particle [N]
"velocity"  (v, dt, p, o)                                            velocity after the stage [m/s]
"contact"   (xi, xj, vi, vj, mi, mj, p, o)                           impulse on particle i [N s]; pairs meet within p[o]
"move"      (x, v, dt, p, o)                                         position and velocity after the substep
"links"     none: the term only adds springs

Contacts are between particles of one system that approach: (xj - xi) . (vj - vi) < -1e-4 m^2/s. Pairs are looked up once a frame; a contact
term with a parameter ``collide_neighbours`` of 0 leaves out those that start closer than p[o]. Driven particles do not yield.

Forces are summed over axial and body terms, then v <- velocity(v + dt F / m), then contacts, then move.
"""

from dataclasses import dataclass, field, replace
from typing import ClassVar

from ...datasets.collection import nearest
from ..parameters import Parameter

__all__ = ["STAGES", "Term"]

STAGES = ("axial", "body", "velocity", "contact", "move", "links")


@dataclass(frozen=True)
class Term:
    """One law with its parameter values; subclasses declare ``name``, ``stage``, ``parameters`` and ``law``."""

    values: dict[str, float] = field(default_factory=dict)

    name: ClassVar[str]
    stage: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    law: ClassVar = None

    def __post_init__(self):
        known = {p.name: p for p in self.parameters}
        for name, value in self.values.items():
            if name not in known:
                raise ValueError(f"{self.name} has no parameter {name!r}; {nearest(name, known) if known else 'known: none'}")
            p = known[name]
            if not p.low <= value <= p.high:
                raise ValueError(f"{name} must lie in [{p.low:g}, {p.high:g}] {p.unit}, got {value}")
        object.__setattr__(self, "values", {p.name: float(self.values.get(p.name, p.value)) for p in self.parameters})

    def with_values(self, **values) -> "Term":
        """The same term with some parameters changed."""
        return replace(self, values={**self.values, **values})
