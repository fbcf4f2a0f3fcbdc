"""The PhysTwin twin that a diagnosis has extended: which term it gets, what that gains, and how the twin is kept."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..datasets.scenario import Observed, Scenario
from ..methods.base import Budget, Diverged
from ..methods.phystwin import PhysTwin
from ..methods.phystwin.body import Body, Place, regrip
from ..methods.phystwin.losses import FitLoss
from ..methods.phystwin.twin import PhysTwinTwin
from ..methods.phystwin.zero_order import open_loop_costs
from ..physics.terms.base import Term
from .inquiry import UNHELD
from .springs import Diagnosis, ask_springs

__all__ = ["DiagnosedTwin", "extend", "gain", "named"]

FEWEST = 12  # frames: of fewer, too little is left to fit and to hold out
STAGES = ("axial", "strand", "body", "velocity", "contact", "move", "setup")  # hinges the fine twin has none of; an observer must see
LEAST = 0.02  # of the plain twin's loss on the train frames, after as much work, that the extended one must be rid of


@dataclass(frozen=True)
class DiagnosedTwin(PhysTwinTwin):
    """A PhysTwin twin; ``note`` says what the diagnosis of its train frames was and what was added for it."""

    note: str = ""

    def save(self, folder: Path) -> None:
        super().save(folder)
        (Path(folder) / "note.json").write_text(json.dumps(self.note), encoding="utf-8")

    @classmethod
    def load(cls, folder: Path) -> DiagnosedTwin:
        twin: Any = super().load(folder)  # of this class
        return replace(twin, note=json.loads((Path(folder) / "note.json").read_text(encoding="utf-8")))


def extend(
    method: PhysTwin, observed: Sequence[Observed], *, budget: Budget, seed: int, device: str, progress, start: PhysTwinTwin | None
) -> DiagnosedTwin:
    """The twin of ``observed`` by ``method``, with what a diagnosis of its train frames names; ``start`` is that twin as it is, or None."""
    config = method.config(budget.preset, observed[0])
    used = method.recordings(observed, config)
    say = progress or (lambda stage, share: None)

    def third(k):
        return lambda stage, share: say(stage, (k + share) / 3)

    if start is None:
        start = method.fitted(used, config, seed=seed, device=device, progress=third(0))

    def twin(note, body=start.body):
        return DiagnosedTwin(body, start.place, start.config, start.device, start.transferred, note)

    if min(o.observed_frames for o in used) < FEWEST:
        return twin(f"nothing added: fewer than {FEWEST} train frames are too few for a diagnosis")
    found = ask_springs(
        Scenario.of(used[0], UNHELD),
        transfer=[Scenario.of(o, UNHELD) for o in used[1:]],
        preset=budget.preset,
        device=device,
        progress=lambda said: say(said.split(", ")[0], 1 / 3),
    )
    said, term = _said(found), named(found, start.body)
    if term is None:
        return twin(f"nothing added: {said}{', which no term of the fine twin stands for' if found.result['effect'] else ''}")
    extended = method.fitted(used, config, seed=seed, device=device, progress=third(2), added=(term,))
    gained = gain(extended, start, used)
    if gained < LEAST:
        return twin(f"nothing added: {said}, but with it the twin fits the train frames no better")
    return twin(f"with {_shown(extended.body.added[0])}: {said}; {gained:.0%} less loss on the train frames", extended.body)


def named(found: Diagnosis, body: Body) -> Term | None:
    """The term that a diagnosis named, for ``body``; None where it named nothing, or nothing that a body of springs alone can have.

    Parameters are those of the refitted replica: shares, strains, accelerations, and what else does not depend on how many particles there
    are; forces go with the mass that a spring to the hand carries.
    """
    if found.chosen is None or found.chosen.score.hypothesis.term.stage not in STAGES:
        return None
    kind, replica = found.chosen.score.hypothesis.term, found.inquiry.case
    fitted, told = found.chosen.found.fit.values, found.inquiry.simulators[0].fixed((kind,))
    values = {p.name: v for p in kind.parameters if (v := told.get(p.name, fitted.get(p.name))) is not None}
    if "slip_force" in values:
        values["slip_force"] *= len(body.home) / len(replica.nodes) * replica.links.sum() / max(1, len(body.pulls))
    bounds = {p.name: (p.low, p.high) for p in kind.parameters}
    return kind({n: float(np.clip(v, *bounds[n])) for n, v in values.items()})


def gain(extended: PhysTwinTwin, plain: PhysTwinTwin, used: Sequence[Observed]) -> float:
    """Share of the plain twin's loss on the train frames that the extended one is rid of; -inf where it blows up later in the recording."""
    places, config = [Place.of(o) for o in used], plain.config
    losses = [FitLoss(o, frame_one_counts=config.quirks.frame_one_counts, device=plain.device) for o in used]
    after, before = (
        open_loop_costs([[t.body, *(regrip(t.body, p) for p in places[1:])]], places, losses, config, plain.device)[0]
        for t in (extended, plain)
    )
    try:
        extended.rollout(places[0].controllers)
    except Diverged:
        return -np.inf
    return 1 - after / before


def _said(found: Diagnosis) -> str:
    """The verdict in a few words."""
    result = found.result
    verdict, effect = result["verdict"].replace("_", " "), result["effect"]
    if not effect:
        return f"diagnosed {verdict}"
    names = " or ".join([effect, *result["alternatives"]])
    return f"diagnosed {verdict}: {names} (probability {result['probabilities'][effect]:.2f})"


def _shown(term: Term) -> str:
    """A term's amplitudes with their units."""
    units = {p.name: p.unit for p in term.parameters}
    numbers = (f"{n} {term.values[n]:.3g} {units[n]}".removesuffix(" -") for n in term.stands_for().amplitudes)
    return f"{term.name} ({', '.join(numbers)})"
