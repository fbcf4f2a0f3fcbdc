"""An effect: its name, its law, where it may act, and its amounts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np

from ...datasets.spacing import spacing
from ...methods.continuum.scene import Scene
from ...physics.parameters import Parameter
from ...physics.terms.base import Term

__all__ = ["KINDS", "Amount", "Candidate", "Effect"]

KINDS = ("material", "environment", "contact", "grip", "measurement")
WIDE = 1.25  # times the way from one place to the next, the most that a part around a place may reach: a weight on the tip of a beam of
# 10 cm is none in its middle. Of tables' bodies ways are 2.4 cm and more, so that 3 cm stay 3 cm


@dataclass(frozen=True)
class Amount:
    """A number of an effect that is 0 where the effect is absent; ``first`` is a size that is noticeable, in which it is nearly linear.

    usual  its standard deviation in recordings of which nothing is said to be missing: no ground is known to less than a millimetre
    """

    name: str
    first: float
    low: float
    high: float
    unit: str
    usual: float = 0.0

    @property
    def one_sided(self) -> bool:
        return self.low >= 0 or self.high <= 0


@dataclass(frozen=True)
class Effect:
    """One way in which a sound twin's physics may be incomplete.

    kind     of ``KINDS``
    says     one clause, after "the twin lacks that ..."; ``motion``: what to record in order to see it
    term     what it adds to a twin's physics, or None: values of terms that sound twins have, as of the one that it ``alters``
    bodies   kinds of body that it is for
    hides    prefix of unknowns that a sound twin's fit bends to make up for it ("grip"): where that ended, a little of it explains nothing
    amounts  what is estimated; ``law`` turns their values into a simulator's where they are not the same
    shapes   values to try of further parameters
    place    prefix of parameters ``<place>_x, _y, _z`` [m] that say where on the body it is, "" for all of it; ``within``: how far
    roaming  whether that place is one of the room, which the body passes
    anchored whether it also has a place in the room, ``<place>_anchor_x, _y, _z`` [m], tried where the body was in frame 0
    hand     name of the parameter that says by its number which hand it is of, -1 for all of them; "" where it is of no hand
    seen     turns the scene that was measured into what it is by the amounts of a fault of the measurement
    grounded whether it needs a ground
    """

    name: str
    kind: str
    says: str
    term: type[Term] | None
    bodies: tuple[str, ...]
    amounts: tuple[Amount, ...]
    shapes: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    place: str = ""
    within: str = ""
    roaming: bool = False
    anchored: bool = False
    hand: str = ""
    grounded: bool = False
    law: Callable[[Mapping[str, float]], dict[str, float]] | None = None
    alters: type[Term] | None = None
    hides: str = ""
    seen: Callable[[Scene, Mapping[str, float]], Scene] | None = None
    motion: str = ""

    def __post_init__(self):
        if self.kind not in KINDS:
            raise ValueError(f"kind of effect {self.name} must be one of {', '.join(KINDS)}, got {self.kind!r}")

    @classmethod
    def of_term(cls, kind: str, term: type[Term], bodies: tuple[str, ...], *, usual: Mapping[str, float] | None = None, **about) -> Effect:
        """The effect that a term declares, with what ``about`` says otherwise; ``usual`` as amounts have it, by name."""
        told, known, usual = term.stands_for(), {p.name: p for p in term.parameters}, usual or {}
        amounts = tuple(
            Amount(p.name, told.typical[p.name] or max(map(abs, told.typical.values())), p.low, p.high, p.unit, usual.get(p.name, 0.0))
            for p in (known[name] for name in told.amplitudes)
        )
        declared: dict[str, Any] = dict(name=told.name, says=told.says, amounts=amounts, shapes=told.shapes, motion=told.motion)
        declared |= dict(place=told.place, within=told.within, roaming=told.roaming, anchored=f"{told.place}_anchor_x" in known)
        return cls(kind=kind, term=term, bodies=bodies, **(declared | about))

    @property
    def stage(self) -> str:
        """Of its term: effects of one stage are asked in one system."""
        return self.term.stage if self.term else ""

    @property
    def at_hands(self) -> bool:
        """Whether it shows in how hands carry what they hold: they give way, are reported late, or in other axes than points."""
        return self.kind in ("grip", "measurement")

    @property
    def is_usual(self) -> bool:
        """Whether some of it is usually there."""
        return any(amount.usual for amount in self.amounts)

    @property
    def forms(self) -> tuple[str, ...]:
        """Names of the shapes that are fitted from where they are tried: those of any order of magnitude, as times and lengths are; not how
        far around its place on the body it reaches, which is as far as the next place."""
        known, kept = self.parameters.values(), "" if self.roaming else self.within
        return tuple(p.name for p in known if p.name in self.shapes and p.scale == "log" and p.name != kept)

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Of its term, or of the one that it alters, by name."""
        term = self.term or self.alters
        return {p.name: p for p in term.parameters} if term else {}

    def values(self, amounts: Mapping[str, float]) -> dict[str, float]:
        """What a simulator is given for ``amounts``."""
        return dict(self.law(amounts)) if self.law else dict(amounts)

    def candidates(
        self, places, laid: Mapping[int, Callable[[np.ndarray], np.ndarray]] | None = None, hands: Sequence[int] = ()
    ) -> list[Candidate]:
        """At all shapes and, where it has one, at each of ``places`` (P, 3) m, or of each of ``hands`` and of all together; ``laid`` as
        ``Candidate`` has it.

        How far one reaches around its place is limited by how far apart places are. Of one hand nothing is said of others: it is not all.
        """
        shapes = [dict(zip(self.shapes, row, strict=True)) for row in product(*self.shapes.values())]
        if self.hand:
            shapes = [shape | {self.hand: float(k)} for shape in shapes for k in (*hands, *([-1] if len(hands) > 1 else []))]
        if not self.place:
            return [Candidate(self, shape) for shape in shapes]
        widest = WIDE * spacing(places, alone=np.inf)
        shapes = [{name: min(value, widest) if name == self.within else value for name, value in shape.items()} for shape in shapes]
        spots = [{f"{self.place}_{axis}": float(c) for axis, c in zip("xyz", at, strict=True)} for at in places]
        if self.anchored:
            spots = [s | {f"{self.place}_anchor_{axis}": s[f"{self.place}_{axis}"] for axis in "xyz"} for s in spots]
        return [Candidate(self, shape | spot, laid or {}) for shape in shapes for spot in spots]


@dataclass(frozen=True)
class Candidate:
    """An effect at a place and with a shape, ``fixed`` by parameter name.

    laid  where a place on the body, (3,) m in frame 0 of the first recording, is in others, by their numbers
    """

    effect: Effect
    fixed: Mapping[str, float]
    laid: Mapping[int, Callable[[np.ndarray], np.ndarray]] = field(default_factory=dict)

    @property
    def place(self) -> np.ndarray | None:
        """(3,) m in frame 0, or None: all of the body."""
        prefix = self.effect.place
        return np.array([self.fixed[f"{prefix}_{axis}"] for axis in "xyz"]) if prefix else None

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of what says where it is, and where it is tied, x, y and z; empty where it is everywhere."""
        if not self.effect.place:
            return ()
        parts = (self.effect.place, *([f"{self.effect.place}_anchor"] if self.effect.anchored else []))
        return tuple(f"{part}_{axis}" for part in parts for axis in "xyz")

    def shifted(self, by) -> Candidate:
        """Elsewhere: ``by`` (k,) m of its coordinates."""
        return replace(self, fixed={**self.fixed, **{n: self.fixed[n] + float(b) for n, b in zip(self.coordinates, by, strict=True)}})

    def formed(self, factors) -> Candidate:
        """Of other shapes: ``factors`` (f,) times those that are fitted (``Effect.forms``), within what its term allows."""
        names, known = self.effect.forms, self.effect.parameters
        forms = {n: float(np.clip(self.fixed[n] * f, known[n].low, known[n].high)) for n, f in zip(names, factors, strict=True)}
        return replace(self, fixed={**self.fixed, **forms})

    def values(self, sizes) -> dict[str, float]:
        """What a simulator is given where the amounts are ``sizes`` (m,)."""
        amounts = {a.name: float(np.clip(s, a.low, a.high)) for a, s in zip(self.effect.amounts, sizes, strict=True)}
        return dict(self.fixed) | self._elsewhere() | self.effect.values(amounts)

    def _elsewhere(self) -> dict[str, float]:
        """The place in other recordings, as a fit of several names what is one recording's own."""
        place = self.place
        if place is None or self.effect.roaming:
            return {}
        there = {r: move(place) for r, move in self.laid.items()}
        return {f"rec{r}_{self.effect.place}_{axis}": float(c) for r, at in there.items() for axis, c in zip("xyz", at, strict=True)}

    @property
    def words(self) -> str:
        shown = ", ".join(f"{name} {value:.3g}" for name, value in self.fixed.items())
        return f"{self.effect.name}" + (f" ({shown})" if shown else "")
