"""A system: particles, springs, controllers and a list of terms. Units are metres, seconds, kilograms, newtons."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..spelling import nearest
from .grids import Grid
from .hinges import Ropes
from .points import Points
from .sheets import Sheet
from .terms.base import Term
from .terms.stages import STAGES, SolidTerm

__all__ = ["FILLED", "System"]

FILLED: Any = None  # the default of a field that gets a value when the system is made, as its docstring says


@dataclass(frozen=True, kw_only=True)
class System:
    """One simulable body. Owns read-only copies of its arrays; a wrong one raises ValueError that names the field, the rule and the value.

    positions    (M, 3) m, the start
    velocities   (M, 3) m/s, zero unless given
    masses       (M,) kg, what the points give them or one each unless given (PhysTwin's have unit mass whatever the density)
    springs      (E, 2) int: particle indices, or M + c for controller c
    rest         (E,) m, the start's distances unless given
    stiffness    (E,) N, force per unit strain
    controllers  (T, C, 3) m, their path, frame by frame; T >= 1, also where C is 0
    grips        (C,) the particle that controller c carries along rigidly, where it finds it, or -1 where it only pulls on springs
    hands        (C,) int: controllers of one number are one hand, which holds and lets slip as one; each is one unless given
    terms        the physics, each name and each parameter name once
    home         (M, 3) m, where particles were in the frame 0 that parameters speak of, if another recording's; the start unless given
    hinges       (H, 3) int: nodes in a row (before, at, after), numbered like those of springs; only hinge terms read what follows
    natural      (H, 2) curvature 2 tan(angle / 2) that they want about the two axes of the rope; 0 unless given (``physics.hinges``)
    span         (H,) m, the length of body that each stands for; half of its two segments at the start unless given
    flexure      (H,) stiffness relative to the terms'; 1 unless given
    chains       arrays of nodes in order, each a rope, or a ring where the last is the first: hinges along them twist as well
    facets       (F, 3) int: particles at the corners of the skin's triangles, anticlockwise from outside; only facet terms read them
    grid         the cells of a solid whose nodes the particles are (``physics.grids``); only its own terms read it
    sheet        triangles between the particles that stretch and bend (``physics.sheets``); only its own terms read it
    points       material points that the particles carry, on which body forces act then (``physics.points``)
    seen         (T, M, 3) m, where particles were seen, NaN where they were not; only observer terms read it
    sight        (T, M) weight of what was seen between a frame and the next; 1 unless given, 0 where either was not seen
    """

    positions: np.ndarray
    springs: np.ndarray
    stiffness: np.ndarray
    controllers: np.ndarray
    terms: Sequence[Term]
    velocities: np.ndarray = FILLED
    masses: np.ndarray = FILLED
    rest: np.ndarray = FILLED
    grips: np.ndarray = FILLED
    hands: np.ndarray | None = None
    hinges: np.ndarray = FILLED
    natural: np.ndarray = FILLED
    span: np.ndarray = FILLED
    flexure: np.ndarray = FILLED
    chains: Sequence[np.ndarray] = ()
    facets: np.ndarray = FILLED
    grid: Grid | None = None
    sheet: Sheet | None = None
    points: Points | None = None
    home: np.ndarray | None = None
    seen: np.ndarray | None = None
    sight: np.ndarray | None = None
    name: str = ""

    def __post_init__(self):
        try:
            self._own_arrays()
            object.__setattr__(self, "terms", _checked_terms(self.terms))
        except ValueError as error:
            raise ValueError(f"{error} (system {self.name})" if self.name else str(error)) from None

    def _own_arrays(self):
        def own(name, *shape, whole=False, default=None):
            value = getattr(self, name)
            object.__setattr__(self, name, _array(name, default if value is None else value, shape, whole))

        def refuse(bad, message):
            """Say of the first ``bad`` entry where it is and what."""
            if bad.any():
                raise ValueError(message(int(np.argmax(bad))))

        own("positions", "M", 3)
        count = len(self.positions)
        if not count:
            raise ValueError("positions must hold at least one particle, got shape (0, 3)")
        if self.home is not None:
            own("home", count, 3)
        own("velocities", count, 3, default=np.zeros((count, 3)))
        own("masses", count, default=np.ones(count) if self.points is None else self.points.node_masses(count))
        refuse(self.masses <= 0, lambda i: f"masses must be > 0 [kg], got {self.masses[i]} at particle {i}")
        own("controllers", "T", "C", 3)
        frames, hands = self.controllers.shape[:2]
        if not frames:
            raise ValueError(f"controllers must have at least one frame, got shape {self.controllers.shape}")
        own("grips", hands, whole=True, default=np.full(hands, -1))
        if self.hands is not None:
            own("hands", hands, whole=True)
            numbers = self.hands
            refuse(numbers < 0, lambda c: f"hands must be numbers >= 0, got {numbers[c]} at controller {c}")
        outside = (self.grips < -1) | (self.grips >= count)
        refuse(outside, lambda c: f"grips must be -1 or one of the {count} particles, got {self.grips[c]} at controller {c}")
        held, times = np.unique(self.grips[self.grips >= 0], return_counts=True)
        refuse(times > 1, lambda k: f"grips must hold a particle once, got {times[k]} controllers that grip particle {held[k]}")
        own("springs", "E", 2, whole=True)
        nodes, springs = np.concatenate([np.arange(count), np.where(self.grips < 0, count + np.arange(hands), self.grips)]), self.springs
        outside = ((springs < 0) | (springs >= len(nodes))).any(1)
        known = f"0 to {count - 1} for particles" + (f" or {count} to {len(nodes) - 1} for controllers" if hands else "")
        refuse(outside, lambda e: f"springs must tie nodes {known}, got {springs[e].tolist()} at spring {e}")
        alone = nodes[springs[:, 0]] == nodes[springs[:, 1]]
        via = " through its grip" if hands else ""
        refuse(alone, lambda e: f"springs must tie two different nodes, got {springs[e].tolist()} at spring {e}: one node{via}")
        own("stiffness", len(springs))
        refuse(self.stiffness < 0, lambda e: f"spring stiffness must be >= 0 [N], got {self.stiffness[e]} at spring {e}")
        own("rest", len(springs), default=self.lengths())
        refuse(self.rest <= 0, lambda e: f"spring rest length must be > 0 [m], got {self.rest[e]} at spring {e}, {springs[e].tolist()}")
        own("hinges", "H", 3, whole=True, default=np.zeros((0, 3)))
        own("natural", len(self.hinges), 2, default=np.zeros((len(self.hinges), 2)))
        self._own_chains(nodes, known)
        self._check_hinges(nodes, known, refuse)
        own("span", len(self.hinges), default=self._spans())
        refuse(self.span <= 0, lambda h: f"hinge span must be > 0 [m], got {self.span[h]} at hinge {h}, {self.hinges[h].tolist()}")
        own("flexure", len(self.hinges), default=np.ones(len(self.hinges)))
        refuse(self.flexure < 0, lambda h: f"hinge flexure must be >= 0, got {self.flexure[h]} at hinge {h}, {self.hinges[h].tolist()}")
        own("facets", "F", 3, whole=True, default=np.zeros((0, 3)))
        outside = ((self.facets < 0) | (self.facets >= count)).any(1)
        refuse(outside, lambda f: f"facets must join particles 0 to {count - 1}, got {self.facets[f].tolist()} at facet {f}")
        flat = (np.diff(np.sort(self.facets, axis=1), axis=1) == 0).any(1)
        refuse(flat, lambda f: f"facets must have three different corners, got {self.facets[f].tolist()} at facet {f}")
        if self.grid is not None and len(self.grid.positions) != count:
            raise ValueError(f"the grid's nodes must be the particles: got {len(self.grid.positions)} nodes and {count} particles")
        if self.sheet is not None:
            outside = ((self.sheet.triangles < 0) | (self.sheet.triangles >= count)).any(1)
            triangles = self.sheet.triangles
            refuse(outside, lambda f: f"a sheet must join particles 0 to {count - 1}, got {triangles[f].tolist()} at triangle {f}")
        if self.points is not None:
            self._check_points(self.points, count, hands, refuse)
        if self.seen is not None:
            self._own_sightings(count)

    def _check_points(self, points, count, hands, refuse):
        outside = ((points.nodes < 0) | (points.nodes >= count)).any(1)
        refuse(outside, lambda q: f"points must be carried by particles 0 to {count - 1}, got {points.nodes[q].tolist()} at point {q}")
        off = ~(np.abs(points.weights.sum(1) - 1) < 1e-6)
        refuse(off, lambda q: f"a point's weights must sum to 1, got {points.weights[q].sum()} at point {q}")
        free = (points.holds >= 0) & ((points.holds >= hands) | (np.append(self.grips, -1)[np.minimum(points.holds, hands)] >= 0))
        refuse(
            free, lambda q: f"holds must be -1 or one of the {hands} controllers that grips no particle, got {points.holds[q]} at point {q}"
        )
        for name in ("masses", "areas", "held"):
            value = getattr(points, name)
            refuse(~((value >= 0) & (value < np.inf)), lambda q, n=name, v=value: f"{n} of points must be >= 0, got {v[q]} at point {q}")

    def _own_chains(self, nodes, known):
        """Read-only copies; a chain is a walk, and no segment is walked twice."""
        if isinstance(self.chains, np.ndarray) or not isinstance(self.chains, Iterable):
            raise ValueError(f"chains must be a list of arrays of nodes, got {type(self.chains).__name__}")
        chains = tuple(_array(f"chains[{k}]", chain, ("N",), True) for k, chain in enumerate(self.chains))
        walked = set()
        for k, chain in enumerate(chains):
            if len(chain) < 2:
                raise ValueError(f"a chain must have at least 2 nodes, got {len(chain)} in chain {k}")
            if (chain < 0).any() or (chain >= len(nodes)).any():
                raise ValueError(f"chains must hold nodes {known}, got {int(chain[(chain < 0) | (chain >= len(nodes))][0])} in chain {k}")
            for a, b in zip(nodes[chain[:-1]].tolist(), nodes[chain[1:]].tolist(), strict=True):
                if a == b or (a, b) in walked:
                    rule = "not stay at a node" if a == b else "walk each segment once"
                    raise ValueError(f"chains must {rule}, got [{a}, {b}] again in chain {k}")
                walked |= {(a, b), (b, a)}
        object.__setattr__(self, "chains", chains)

    def _check_hinges(self, nodes, known, refuse):
        hinges = self.hinges
        outside = ((hinges < 0) | (hinges >= len(nodes))).any(1)
        refuse(outside, lambda h: f"hinges must join nodes {known}, got {hinges[h].tolist()} at hinge {h}")
        a, b, c = nodes[hinges].reshape(-1, 3).T
        refuse((a == b) | (b == c) | (c == a), lambda h: f"hinges must join three different nodes, got {hinges[h].tolist()} at hinge {h}")
        _, first, times = np.unique(np.stack([np.minimum(a, c), b, np.maximum(a, c)], 1), axis=0, return_index=True, return_counts=True)
        twice = np.isin(np.arange(len(hinges)), first[times > 1])
        refuse(twice, lambda h: f"hinges must each be listed once, got {hinges[h].tolist()} at hinge {h} and again")
        ropes = Ropes.of([nodes[chain] for chain in self.chains])
        back = ropes.sides(nodes[hinges].reshape(-1, 3)[:, ::-1])[:, 0] >= 0
        refuse(back, lambda h: f"hinges must run the way of their chain, got {hinges[h].tolist()} at hinge {h}, which runs back")

    def _spans(self):
        """(H,) half the present length of each hinge's two segments [m]."""
        nodes = np.concatenate([self.positions, self.controllers[0]])[self.hinges]
        return np.linalg.norm(np.diff(nodes, axis=1), axis=2).sum(1) / 2

    def _own_sightings(self, count):
        seen = np.asarray(self.seen, float)
        if seen.ndim != 3 or seen.shape[1:] != (count, 3):
            raise ValueError(f"seen must have shape (T, {count}, 3), got {seen.shape}")
        sight = _array("sight", np.ones(seen.shape[:2]) if self.sight is None else self.sight, seen.shape[:2], False).copy()
        if (sight < 0).any():
            raise ValueError(f"sight must be >= 0, got {sight.min()}")
        here = np.asarray(np.isfinite(seen).all(2))
        sight[~here] = sight[-1] = 0
        sight[:-1][~here[1:]] = 0
        object.__setattr__(self, "seen", _array("seen", np.where(here[..., None], seen, 0.0), seen.shape, False))
        sight.flags.writeable = False
        object.__setattr__(self, "sight", sight)

    @property
    def material(self) -> np.ndarray:
        """(M, 3) m, ``home`` or else the start."""
        return self.positions if self.home is None else self.home

    @property
    def particle_count(self) -> int:
        return len(self.positions)

    @property
    def values(self) -> dict[str, float]:
        """Every term's parameters by name."""
        return {name: value for term in self.terms for name, value in term.values.items()}

    def lengths(self) -> np.ndarray:
        """(E,) present lengths of the springs [m], controllers at frame 0."""
        nodes = np.concatenate([self.positions, self.controllers[0]])
        return np.linalg.norm(nodes[self.springs[:, 0]] - nodes[self.springs[:, 1]], axis=1)

    def with_values(self, **values) -> System:
        """The same system with some term parameters changed; an unknown name raises ValueError."""
        known = self.values
        for name in values:
            if name not in known:
                raise ValueError(f"no term of this system has a parameter {name!r}; {nearest(name, known)}")
        terms = [t.with_values(**{k: v for k, v in values.items() if k in t.values}) for t in self.terms]
        return replace(self, terms=tuple(terms))


def _array(name, value, shape, whole):
    """A read-only copy of ``value`` as finite numbers of ``shape``, where a letter stands for any length; ``whole`` ones become int64."""
    try:
        value = np.asarray(value)
    except ValueError:
        raise ValueError(f"{name} must be an array of shape ({_shown(shape)}), got rows of different lengths") from None
    if value.dtype.kind not in "biuf":
        raise ValueError(f"{name} must hold real numbers, got {value.dtype.name} {value.ravel()[:1].tolist()}")
    if value.ndim != len(shape) or any(n != s for n, s in zip(value.shape, shape, strict=True) if not isinstance(s, str)):
        raise ValueError(f"{name} must have shape ({_shown(shape)}), got {value.shape}")
    bad = ~np.isfinite(value)
    if whole and not bad.any():
        bad = value != np.floor(value)
    if bad.any():
        place = np.unravel_index(np.argmax(bad), value.shape)
        rule = "whole numbers" if whole else "finite"
        raise ValueError(f"{name} must be {rule}, got {value[place]} at {[int(k) for k in place]}")
    value = np.array(value, np.int64 if whole else np.float64, order="C")
    value.flags.writeable = False
    return value


def _shown(shape):
    return ", ".join(map(str, shape)) + ("," if len(shape) == 1 else "")


def _checked_terms(terms):
    """``terms`` as a tuple; names and parameters are columns of one table, so each may occur only once."""
    if isinstance(terms, Term) or not isinstance(terms, Iterable):
        raise ValueError(f"terms must be a list of terms, got {terms!r}")
    terms, owner = tuple(terms), {}
    for term in terms:
        if not isinstance(term, Term):
            hint = f"the class {term.__name__}: write {term.__name__}()" if isinstance(term, type) else repr(term)
            raise ValueError(f"terms must be instances of Term, got {hint}")
        if term.stage not in STAGES:
            raise ValueError(f"term {term.name} has the unknown stage {term.stage!r}; {nearest(term.stage, STAGES)}")
        if sum(term.name == t.name for t in terms) > 1:
            raise ValueError(f"terms must each be listed once, got {term.name} {sum(term.name == t.name for t in terms)} times")
        for name in term.values:
            if owner.setdefault(name, term.name) != term.name:
                raise ValueError(f"parameter names must be unique in a system, got {name} in both {owner[name]} and {term.name}")
    altering = [t.name for t in terms if t.stage in ("flow", "material", "branch")]
    if altering and not any(isinstance(t, SolidTerm) and t.moduli is not None for t in terms):
        raise ValueError(f"{altering[0]} alters the elasticity of a solid and needs a term that has one, such as neo_hookean; got none")
    for remembering, elastic, such in (("sheet", ("membrane", "plate"), "membrane"), ("hinge", ("hinge",), "bending")):
        own = [t.name for t in terms if t.stage in (f"{remembering}_flow", f"{remembering}_branch")]
        if own and not any(t.stage in elastic for t in terms):
            raise ValueError(f"{own[0]} remembers what an elasticity bears and needs a term that has one, such as {such}; got none")
    return terms
