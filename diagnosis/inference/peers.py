"""Sound recordings as members: what a twin misses in each of them is how far it is off by itself.

All rods lack what a real cable has and a rod has not, so that members of other material say little of how far either strays from it.
Recordings of the same markers in which nothing is missing do: the twin is fitted to them, what it misses in each is expected from the
others as far as it can be (``discrepancy``), a refit of it is taken from the rest as it is from the one that is asked, and what is left,
marker by marker and bin by bin, are draws of its error. The numbers are the object's: a recording may want them elsewhere than the fit to
all has them, but by no more than sound ones do.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import reduce

import numpy as np
from scipy.linalg import block_diag

from ...datasets.scenario import Scenario
from ...methods.continuum.config import Config
from ...methods.continuum.joint import placed
from ...methods.continuum.twin import ContinuumTwin
from ..config import DiagnosisConfig
from .absorption import absorb
from .blocks import is_marked
from .contrast import as_long, until
from .covariance import Scatter
from .discrepancy import alike, expected
from .evidence import Evidence
from .forward import Cost, Forward
from .scan import signatures

__all__ = ["FEWEST", "are_members", "compared", "there"]

LEAST = 0.01  # of a prior standard deviation: what no recording tells stays a number
FEWEST = 8  # sound recordings: a variance of 8 is known to 27 %


def are_members(case: Scenario, sound: Sequence[Scenario], config: DiagnosisConfig) -> bool:
    """Whether ``sound`` recordings tell how far a twin of ``case`` is off: of markers, where there are enough of them."""
    return is_marked(case, config) and len(sound) >= FEWEST


def there(twin: ContinuumTwin, recording: Scenario) -> ContinuumTwin:
    """``twin`` in another recording of its markers, which starts as that one's first frames say; its posterior goes along.

    Raises ValueError for a twin with numbers of single recordings.
    """
    own = [u["name"] for u in twin.posterior["unknowns"] if u["name"].startswith("rec")]
    if own:
        raise ValueError(f"a twin must have no numbers of one recording alone to be laid elsewhere, got {', '.join(own)}")
    seen = recording.observed()
    scene = placed(seen, twin.scene.body.laid(seen), Config(contact="on" if twin.scene.contact else "off"))
    return replace(twin, scene=scene)


def compared(
    twin: ContinuumTwin,
    cases: Sequence[Scenario],
    sound: Sequence[Scenario],
    config: DiagnosisConfig,
    *,
    progress: Callable[[str], None] | None = None,
) -> Evidence:
    """The evidence of R ``cases``, whose ``sound`` recordings, to which ``twin`` was fitted, are the members.

    Of all recordings the same markers in the same frames are looked at, first those of the shortest case. Each wants the object's numbers
    where it wants them, and what acts is the same in all cases. A member of several is as many sound recordings, each in the place of one.
    Raises ValueError where a sound one is shorter, for fewer than ``FEWEST`` of them, and where no marker is free in all.
    """
    tell = progress or (lambda _: None)
    where, cost, first = f" (scenario {cases[0].name})", Cost(), until(cases[0], cases)
    recordings = [as_long(one, first) for one in (*sound, *cases)]
    each = [replace(Forward.of(there(twin, one), [one], config), cost=cost) for one in recordings]
    common = reduce(np.intersect1d, [one.blocks[0].cells for one in each])
    if not len(common):
        raise ValueError(f"some markers must be free in all recordings, got none{where}")
    each = [replace(one, blocks=(one.blocks[0].only(common),)) for one in each]
    rows = [one.at(np.zeros(len(one.unknowns)))[0] for one in each[: len(sound)]]
    good = [k for k, row in enumerate(rows) if np.isfinite(row).all()]
    count, each = len(good), [*(each[k] for k in good), *each[len(sound) :]]
    if count < FEWEST:
        told = f"at least {FEWEST} recordings in which nothing is missing, got {len(sound)}"
        lost = f", of which the twin diverges in {len(sound) - count}" if count < len(sound) else ""
        raise ValueError(f"how far twins stray from markers is told by {told}{lost}{where}")
    paths, references = zip(*(one.reference() for one in each[count:]), strict=True)
    references = np.array([*(rows[k] for k in good), *references])
    slopes = np.array([one.slopes(row) for one, row in zip(each, references, strict=True)])
    tell(f"slopes of {slopes.shape[2]} unknowns for {references.shape[1]} means of markers, in {len(each)} recordings")

    missed = np.array([one.data for one in each[:count]]) - references[:count]
    kernel = alike([one.blocks[0].starts(common) for one in each], [one.recordings[0].controllers for one in each])
    expect, far = expected(missed, kernel, config.ridges)
    share = np.sqrt(np.mean((missed - expect[:count]) ** 2) / np.mean(missed**2))
    tell(f"{share:.2f} of what sound recordings miss is not expected from the others")
    each = [replace(one, missed=own) for one, own in zip(each, expect, strict=True)]

    noise = np.array([one.noise(path)[0] for one, path in zip(each[count:], paths, strict=True)])
    sd = np.where(each[0].layout.fitted, np.sqrt(np.mean([np.diag(one) for one in noise], 0)), np.inf)
    _, shifts = _absorbed(each, references, slopes, sd, config.rounds)
    spread = _spread(shifts[:count])
    each, slopes = [replace(one, spread=spread) for one in each], slopes * spread
    left, _ = _absorbed(each, references, slopes, sd, config.rounds)
    tell(f"{count} sound recordings")

    forward, reference, ways = _joined(each[count:]), references[count:].ravel(), block_diag(*slopes[count:])
    members = np.concatenate([np.roll(one * left[:count], -r, axis=0) for r, one in enumerate(far)], axis=1)
    catalogue = signatures(forward, [one for (one,) in paths], reference, config)
    tell(f"signatures of {len(catalogue)} candidates")
    scatter = Scatter(members, block_diag(*noise), ways, np.zeros((len(reference), 0)), forward.layout, independent=True)
    none = np.zeros((0, ways.shape[1]))
    return Evidence(forward, reference, ways, scatter, left[count:].ravel(), members, forward.posterior(ways), tuple(catalogue), (), none)


def _joined(each: Sequence[Forward]) -> Forward:
    """One of several, of a recording each, whose unknowns are each one's own."""
    if len(each) == 1:
        return each[0]
    own = [replace(u, name=f"rec{r}_{u.name}") for r, one in enumerate(each) for u in one.unknowns]
    return replace(
        each[0],
        unknowns=tuple(own),
        scaled=np.concatenate([one.scaled for one in each]),
        covariance=block_diag(*(one.covariance for one in each)),
        spread=np.concatenate([np.broadcast_to(one.spread, len(one.unknowns)) for one in each]),
        missed=np.concatenate([np.broadcast_to(one.missed, len(one.data)) for one in each]),
        **{name: tuple(getattr(one, name)[0] for one in each) for name in ("recordings", "simulators", "blocks")},
    )


def _absorbed(each: Sequence[Forward], references, slopes, sd, rounds: int) -> tuple[np.ndarray, np.ndarray]:
    """What ``absorb`` returns of recordings, each (K) with the reference of its own."""

    def run(shifts):
        return np.concatenate([one.at(shift) for one, shift in zip(each, shifts, strict=True)])

    return absorb([one.data for one in each], references, slopes, sd, run, each[-1].bounds, rounds=rounds)


def _spread(shifts: np.ndarray) -> np.ndarray:
    """(n,) of the prior standard deviations, by how far sound recordings (K, n) want the unknowns elsewhere than the fit to all of them."""
    return np.clip(np.sqrt(np.mean(shifts**2, 0) * (1 + 1 / len(shifts))), LEAST, 1.0)
