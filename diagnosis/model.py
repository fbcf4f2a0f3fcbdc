"""A parametric twin over one or more recordings: numbers in, simulated nodes out, many sets of numbers at once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import ceil, exp, log

import numpy as np
import torch

from ..physics.batch import Batch
from ..physics.stability import stable_substeps
from ..physics.terms.base import Term
from .replica import Replica

__all__ = ["JUDGED", "MOST", "Knob", "Model", "Simulator"]

LADDER = 1.15  # substeps come in steps of 15 %, so that finite differences compare runs on one grid
SAFETY = 0.8  # of the stable step
BATCH = 64  # systems in one launch
STIFF = ("axial", "strand", "hinge", "facet")  # stages whose laws say how long a substep may be
MOST = 200  # substeps a frame in a fit: a body that needs more is too stiff to be told from a stiffer one
JUDGED = 3 * MOST  # and where a fitted one is judged: on what it was not fitted to, what was just stable may blow up


@dataclass(frozen=True)
class Knob:
    """A number that a fit may turn.

    start, spread  where it is expected and how far it may reasonably lie from there, in ``log`` where that is how it is turned
    step           of finite differences, in units of ``spread``
    prior          spreads within which it is expected
    """

    name: str
    start: float
    spread: float
    low: float
    high: float
    log: bool = False
    step: float = 0.05
    prior: float = 1.0

    def decode(self, z: float) -> float:
        """The value at ``z`` spreads from the start."""
        value = self.start * exp(z * self.spread) if self.log else self.start + z * self.spread
        return float(min(self.high, max(self.low, value)))

    def encode(self, value: float) -> float:
        """The inverse of ``decode`` within the bounds."""
        return log(value / self.start) / self.spread if self.log else (value - self.start) / self.spread


@dataclass(frozen=True)
class Model:
    """Term classes, fixed parameter values, and the knobs."""

    terms: tuple[type[Term], ...]
    values: dict[str, float]
    knobs: tuple[Knob, ...]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(k.name for k in self.knobs)

    @property
    def wide(self) -> np.ndarray:
        """(K,) spreads within which each knob is expected."""
        return np.array([k.prior for k in self.knobs])

    def decode(self, z) -> dict[str, float]:
        """All parameter values at ``z`` (K,)."""
        return {**self.values, **{k.name: k.decode(float(u)) for k, u in zip(self.knobs, z, strict=True)}}

    def extended(self, terms: Iterable[type[Term]], values: Mapping[str, float], knobs: Sequence[Knob]) -> Model:
        """The model with further terms in the order of their names, values and knobs; terms that it has already are left.

        A term that moves particles or makes contacts takes the place of the one there is.
        """
        terms = set(terms)
        alone = {t.stage for t in terms} & {"move", "contact"}
        kept = tuple(t for t in self.terms if t.stage not in alone)
        new = sorted(terms - set(kept), key=lambda t: t.name)
        return Model((*kept, *new), {**self.values, **values}, (*self.knobs, *knobs))


@dataclass
class Simulator:
    """Runs sets of parameter values on one recording's replica. Batches are kept for reuse."""

    replica: Replica
    device: str = "cpu"
    double: bool = False
    _batches: dict = field(default_factory=dict)
    rollouts: int = 0

    def fixed(self, terms) -> dict[str, float]:
        """Values that the recording itself gives: gravity and ground."""
        recording, values = self.replica.recording, {}
        known = {p.name for t in terms for p in t.parameters}
        for axis, g in zip("xyz", recording.gravity, strict=True):
            values[f"gravity_{axis}"] = values[f"told_gravity_{axis}"] = float(g)
        if recording.ground is not None:
            for axis, n in zip("xyz", recording.ground.normal, strict=True):
                values[f"ground_normal_{axis}"] = values[f"adhesion_normal_{axis}"] = float(n)
            values["ground_offset"] = values["adhesion_offset"] = float(recording.ground.offset) + self.replica.lift
        return {k: v for k, v in values.items() if k in known}

    def substeps(self, terms, values: Mapping[str, float], *, most: int = MOST) -> int:
        """Substeps a frame that the body needs at ``values``, once the setup terms have made it what it is; at most so many."""
        made, masses = self._made(terms, values)
        terms = tuple(t({n: values[n] for n in t().values if n in values}) for t in terms if t.stage in STIFF)
        body = replace(
            self.replica.system, stiffness=made.stiffness.cpu().numpy().astype(float), masses=np.maximum(masses, 1e-9), terms=terms
        )
        need = stable_substeps([body], 1 / self.replica.recording.fps, safety=SAFETY, least=8)
        return min(most, ceil(LADDER ** ceil(log(need) / log(LADDER))))

    def masses(self, terms, values: Mapping[str, float]) -> np.ndarray:
        """(n,) mass of each node at ``values``, once the setup terms have made it what it is, over that of a node."""
        return self._made(terms, values)[1]

    def _made(self, terms, values):
        batch = self._batch(tuple(terms), 1, None)
        made = batch.prepare(replace(batch.inputs, table=self._table(batch, terms, [values])))
        return made, made.mass[: self.replica.system.particle_count].cpu().numpy().astype(float)

    def run(self, terms, rows: Sequence[Mapping[str, float]], frames: int, *, substeps: int | None = None) -> np.ndarray:
        """Node positions (B, frames, n, 3) [m] for each of ``rows`` of parameter values; NaN from the first bad frame on."""
        substeps = substeps or max(self.substeps(terms, row) for row in rows)
        parts = [self._run(terms, rows[k : k + BATCH], frames, substeps) for k in range(0, len(rows), BATCH)]
        self.rollouts += len(rows)
        return np.concatenate(parts)

    def _run(self, terms, rows, frames, substeps):
        batch = self._batch(tuple(terms), len(rows), substeps)
        rolled = batch.rollout(frames, replace(batch.inputs, table=self._table(batch, terms, rows)))
        found = torch.stack(rolled.positions).cpu().numpy()
        for b, bad in enumerate(rolled.diverged):
            if bad >= 0:
                found[b, bad:] = np.nan
        return found

    def _table(self, batch, terms, rows):
        """The parameter table of ``rows``; what the recording itself says comes before what they say."""
        fixed, table = self.fixed(terms), batch.inputs.table.clone()
        columns = {name: k for k, name in enumerate(batch.columns)}
        for b, row in enumerate(rows):
            for name, value in {**row, **fixed}.items():
                if name in columns:
                    table[b, columns[name]] = value
        return table

    def _batch(self, terms, size, substeps):
        """A batch of ``size`` such systems; ``substeps`` None: one to look at, not to run."""
        key = (terms, size, substeps is None)
        if key not in self._batches or (substeps and self._batches[key].substeps[0] != substeps):
            system = replace(self.replica.system, terms=tuple(t() for t in terms))
            fps = self.replica.recording.fps
            self._batches[key] = Batch([system] * size, fps=fps, substeps=substeps or 1, device=self.device, double=self.double)
        return self._batches[key]
