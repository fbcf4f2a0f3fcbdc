"""A system: particles, springs, controllers and a list of terms. Units are metres, seconds, kilograms, newtons."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .terms.base import STAGES, Term

__all__ = ["System"]


@dataclass(frozen=True, kw_only=True)
class System:
    """One simulable body.

    positions    (M, 3) m, the start
    velocities   (M, 3) m/s, zero unless given
    masses       (M,) kg, one each unless given (PhysTwin's particles have unit mass whatever the density)
    springs      (E, 2) int: particle indices, or M + c for controller c
    rest         (E,) m, the start's distances unless given
    stiffness    (E,) N, force per unit strain
    controllers  (T, C, 3) m, their path, frame by frame
    grips        (C,) the particle that controller c holds rigidly, or -1 where it only pulls on springs
    terms        the physics
    """

    positions: np.ndarray
    springs: np.ndarray
    stiffness: np.ndarray
    controllers: np.ndarray
    terms: tuple[Term, ...]
    velocities: np.ndarray | None = None
    masses: np.ndarray | None = None
    rest: np.ndarray | None = None
    grips: np.ndarray | None = None
    name: str = ""

    def __post_init__(self):
        where = f" (system {self.name})" if self.name else ""

        def own(name, shape, dtype=np.float64, default=None):
            value = getattr(self, name)
            value = np.array(default if value is None else value, dtype)
            if value.shape != shape:
                raise ValueError(f"{name} must have shape {shape}, got {value.shape}{where}")
            if value.dtype.kind == "f" and not np.isfinite(value).all():
                raise ValueError(f"{name} must be finite, got NaN or infinity{where}")
            value.flags.writeable = False
            object.__setattr__(self, name, value)

        count = len(self.positions)
        own("positions", (count, 3))
        own("velocities", (count, 3), default=np.zeros((count, 3)))
        own("masses", (count,), default=np.ones(count))
        frames, hands = np.shape(self.controllers)[:2]
        own("controllers", (frames, hands, 3))
        own("grips", (hands,), np.int64, default=np.full(hands, -1))
        own("springs", (len(self.springs), 2), np.int64)
        if len(self.springs) and not (0 <= self.springs.min() and self.springs.max() < count + hands):
            raise ValueError(f"springs must tie nodes 0 to {count + hands - 1}, got {self.springs.min()} to {self.springs.max()}{where}")
        if hands and not (self.grips.min() >= -1 and self.grips.max() < count):
            raise ValueError(f"grips must be -1 or a particle below {count}, got {self.grips.tolist()}{where}")
        if len(set(self.grips[self.grips >= 0].tolist())) < (self.grips >= 0).sum():
            raise ValueError(f"two controllers grip the same particle: {self.grips.tolist()}{where}")
        own("stiffness", (len(self.springs),))
        own("rest", (len(self.springs),), default=self.lengths() if self.rest is None else None)
        object.__setattr__(self, "terms", tuple(self.terms))
        if (self.masses <= 0).any():
            raise ValueError(f"masses must be > 0 [kg], got {self.masses.min()}{where}")
        if len(self.springs) and self.rest.min() <= 0:
            raise ValueError(f"spring rest length must be > 0 [m], got {self.rest.min()}{where}")
        if len(self.springs) and self.stiffness.min() < 0:
            raise ValueError(f"spring stiffness must be >= 0 [N], got {self.stiffness.min()}{where}")
        for term in self.terms:
            if term.stage not in STAGES:
                raise ValueError(f"term {term.name} has the unknown stage {term.stage!r}")
        names = [t.name for t in self.terms]
        for name in sorted(set(names)):
            if names.count(name) > 1:
                raise ValueError(f"term {name} is listed {names.count(name)} times{where}")

    @property
    def particle_count(self) -> int:
        return len(self.positions)

    @property
    def values(self) -> dict[str, float]:
        """Every term's parameters by name."""
        return {name: value for term in self.terms for name, value in term.values.items()}

    def lengths(self) -> np.ndarray:
        """(E,) present lengths of the springs [m], controllers at frame 0."""
        nodes = np.concatenate([self.positions, self.controllers[0]]) if len(self.controllers) else np.asarray(self.positions)
        ends = np.asarray(self.springs, np.int64).reshape(-1, 2)
        return np.linalg.norm(nodes[ends[:, 0]] - nodes[ends[:, 1]], axis=1)

    def with_values(self, **values) -> System:
        """The same system with some term parameters changed; an unknown name raises ValueError."""
        known = self.values
        for name in values:
            if name not in known:
                raise ValueError(f"no term of this system has a parameter {name!r}; known: {', '.join(known)}")
        terms = [t.with_values(**{k: v for k, v in values.items() if k in t.values}) for t in self.terms]
        return replace(self, terms=tuple(terms))
