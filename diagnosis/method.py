"""The PhysTwin twin that a diagnosis has extended, as a method among others."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import product
from pathlib import Path

import numpy as np

from ..datasets.scenario import Observed, Scenario, Split
from ..methods.phystwin import PhysTwin
from ..methods.phystwin.body import Body, Place, regrip, roll, system
from ..methods.phystwin.config import SEARCHED, Config
from ..methods.phystwin.first_order import refine
from ..methods.phystwin.losses import FitLoss
from ..methods.phystwin.twin import PhysTwinTwin
from ..methods.phystwin.zero_order import open_loop_costs
from ..physics.terms.base import Term
from .diagnose import Diagnosis, diagnose
from .inquiry import UNHELD

__all__ = ["METHODS", "DiagnosedTwin", "PhysTwinDiagnosed", "extended"]

FEWEST = 12  # frames: of fewer, too little is left to fit and to hold out
STAGES = ("axial", "strand", "body", "velocity", "contact", "move", "setup")  # hinges the fine twin has none of; an observer must see
SHARES = (1.0, 0.5)  # of the amplitude that the coarse replica found, tried on the fine twin
SHORT = 0.5  # of the first-order stage's epochs, for the twin with and without what is added
GAIN = 0.02  # of its loss on the train frames that the extended twin must be rid of, beside the plain one with as many epochs


@dataclass(frozen=True)
class DiagnosedTwin(PhysTwinTwin):
    """A PhysTwin twin; ``note`` says what the diagnosis of its train frames was and what was added for it."""

    note: str = ""

    def save(self, folder: Path) -> None:
        super().save(folder)
        (Path(folder) / "note.json").write_text(json.dumps(self.note), encoding="utf-8")

    @classmethod
    def load(cls, folder: Path) -> DiagnosedTwin:
        return replace(super().load(folder), note=json.loads((Path(folder) / "note.json").read_text(encoding="utf-8")))


class PhysTwinDiagnosed(PhysTwin):
    """PhysTwin, and the physics that a diagnosis of its train frames names; where that is nothing, PhysTwin."""

    name = "phystwin+diagnosed"
    builds_on = "phystwin"

    def fit(self, observed, *, budget, seed=0, device="cpu", progress=None, start=None):
        config = self.config(budget.preset, observed[0])
        used = self.recordings(observed, config)
        say = progress or (lambda stage, share: None)
        if start is None:
            half = progress and (lambda stage, share: progress(stage, share / 2))
            start = super().fit(observed, budget=budget, seed=seed, device=device, progress=half)

        def twin(note, body=start.body):
            return DiagnosedTwin(body, start.place, start.config, start.device, start.transferred, note)

        if min(o.observed_frames for o in used) < FEWEST:
            return twin(f"nothing added: fewer than {FEWEST} train frames are too few for a diagnosis")
        found = diagnose(
            _whole(used[0]),
            transfer=[_whole(o) for o in used[1:]],
            preset=budget.preset,
            device=device,
            progress=lambda said: say(said.split(", ")[0], 0.5),
        )
        said = _said(found)
        candidates = extended(start.body, found)
        if not candidates:
            return twin(f"nothing added: {said}")
        say("refitting with what was named", 0.9)
        body, gain = _refitted(start.body, candidates, used, config, device)
        if body is None:
            return twin(f"nothing added: {said}, but the fine twin with it fits the train frames no better")
        return twin(f"with {_shown(body.added[0])}: {said}; {gain:.0%} less loss on the train frames", body)


METHODS = (PhysTwinDiagnosed,)


def extended(body: Body, found: Diagnosis) -> list[Body]:
    """``body`` with the term that a diagnosis named; none where it named nothing, or nothing that a body of springs alone can have.

    Parameters are those of the refitted replica: shares, strains, accelerations, and what else does not depend on how many particles there
    are; forces go with the mass that a spring to the hand carries. Each share in ``SHARES`` of its amplitudes is tried with the body's
    stiffness and damping as they are, and changed by the factors by which the replica's changed once it had the term.
    """
    if found.chosen is None or found.chosen.score.hypothesis.term.stage not in STAGES:
        return []
    kind = found.chosen.score.hypothesis.term
    before, after = found.inquiry.base.fit.values, found.chosen.found.fit.values
    values = {p.name: after[p.name] for p in kind.parameters if p.name in after}
    if "slip_force" in values:
        replica = found.inquiry.case
        values["slip_force"] *= len(body.home) / len(replica.nodes) * replica.links.sum() / max(1, len(body.pulls))
    bounds = {p.name: (p.low, p.high) for p in kind.parameters}
    moved = {n: after[n] / before[n] for n in before if n in after and before[n] > 0}
    bodies = []
    for share, carried in product(SHARES, (moved, {})):
        amplitudes = {n: share * values[n] for n in kind.effect.amplitudes}
        term = kind({n: float(np.clip(v, *bounds[n])) for n, v in (values | amplitudes).items()})
        bodies.append(replace(_changed(body, carried), added=(*body.added, term)))
    return bodies


def _changed(body: Body, factors: dict[str, float]) -> Body:
    """The body with stiffness and damping changed by ``factors``, named as the replica's."""
    stiffness, pull = (factors.get(n, 1.0) for n in ("body_stiffness", "grip_stiffness"))
    bounds = {p.name: (p.low, p.high) for p in SEARCHED}
    damping = {n: float(np.clip(body.values[n] * factors.get(n, 1.0), *bounds[n])) for n in ("dashpot_damping", "drag_damping")}
    return replace(body, stiffness=body.stiffness * stiffness, pull=body.pull * pull, values=body.values | damping)


def _refitted(plain: Body, candidates: Sequence[Body], used: Sequence[Observed], config: Config, device: str) -> tuple[Body | None, float]:
    """The best candidate after a few epochs and its gain over the plain body after as many; None where it gains nothing or blows up."""
    places = [Place.of(o) for o in used]
    losses = [FitLoss(o, frame_one_counts=config.quirks.frame_one_counts, device=device) for o in used]
    short = replace(config, epochs=int(np.ceil(SHORT * config.epochs)))

    def costs(bodies):
        return open_loop_costs([[b, *(regrip(b, place) for place in places[1:])] for b in bodies], places, losses, short, device)

    best = candidates[int(np.argmin(costs(candidates)))]
    body, again = (refine(b, used, short, device=device) for b in (best, plain))
    gain = 1 - costs([body])[0] / costs([again])[0]
    if gain < GAIN:
        return None, gain
    whole = roll([system(body, places[0], config)], places[0].fps, len(places[0].controllers), config, device)[0]
    return (None if whole.diverged >= 0 else body), gain


def _whole(observed: Observed) -> Scenario:
    """What was observed as a recording of its own, the last of its frames held out; nothing of what follows is in it."""
    frames = observed.observed_frames
    known = {f.name: getattr(observed, f.name) for f in fields(Observed)} | {"images": None, "controllers": observed.controllers[:frames]}
    return Scenario(**known, split=Split(int(UNHELD * frames), frames))


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
    numbers = (f"{n} {term.values[n]:.3g} {units[n]}".removesuffix(" -") for n in term.effect.amplitudes)
    return f"{term.name} ({', '.join(numbers)})"
