"""Who plans: the twin of a method, or one that is fitted with an effect, and how it searches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ...datasets.scenario import Observed
from ...methods.base import Budget, Twin
from ...methods.registry import get_method

__all__ = ["Arm", "fitted"]


@dataclass(frozen=True)
class Arm:
    """An entrant, written METHOD[+EFFECT][/SEARCH][@SEED]: ``continuum``, ``continuum+wind``, ``rigid/shooting``, ``continuum@1``.

    A search is one of ``OPTIMISERS``. By ``straight`` and ``arc`` no twin has a say: hands bring what they hold to where it is wanted.

    ``added`` is an effect that ``continuum`` is fitted with, its amounts among what is fitted; ``seed`` is that of the search.
    """

    method: str
    added: str = ""
    optimiser: str = "mppi"
    seed: int = 0

    @classmethod
    def of(cls, said: str) -> Arm:
        """Raises ValueError for unknown names, a seed that is no number, an effect of a method that cannot be fitted with it."""
        from ...datasets.plugins import unknown
        from .mppi import OPTIMISERS

        whole, _, seed = said.partition("@")
        twin, _, optimiser = whole.partition("/")
        optimiser = optimiser or "mppi"
        if optimiser not in OPTIMISERS:
            raise unknown("optimiser", optimiser, OPTIMISERS)
        if seed and not seed.isdecimal():
            raise ValueError(f"the seed of {said!r} must be a whole number, got {seed!r}")
        method, added = _parted(twin)
        if added and (method != "continuum" or added not in ADDED):
            raise ValueError(f"{said!r}: only continuum can be fitted with an effect, one of {', '.join(ADDED)}")
        return cls(method, added, optimiser, int(seed or 0))

    @property
    def twin(self) -> str:
        """What it is fitted as."""
        return f"{self.method}+{self.added}" if self.added else self.method

    def __str__(self):
        search = "" if self.optimiser == "mppi" else f"/{self.optimiser}"
        return f"{self.twin}{search}{f'@{self.seed}' if self.seed else ''}"


ADDED = ("wind", "quadratic_drag")


def _parted(twin: str) -> tuple[str, str]:
    """A method's name and the effect after it; names of methods have plus signs, too."""
    from ...datasets.plugins import unknown
    from ...methods.registry import methods

    if twin in methods():
        return twin, ""
    method, _, added = twin.rpartition("+")
    if method in methods():
        return method, added
    raise unknown("method", twin, methods())


def fitted(
    arm: Arm,
    seen: Observed,
    *,
    budget: Budget,
    seed: int = 0,
    device: str = "cpu",
    known: dict[str, Twin] | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Twin:
    """The twin of what was ``seen``, remembered in ``known`` by ``Arm.twin``. Raises ValueError with the reason where a method skips it."""
    known = {} if known is None else known
    if arm.twin not in known:
        method = get_method(arm.method)
        if reason := method.skip(seen):
            raise ValueError(f"{arm.method} cannot be planned with: {reason}")
        options: dict[str, Any] = dict(seed=seed, device=device, progress=progress)
        if arm.added:
            sound = fitted(Arm(arm.method), seen, budget=budget, known=known, **options)
            known[arm.twin] = _with(arm, method, sound, seen, budget, options)
        else:
            known[arm.twin] = method.fit([seen], budget=budget, **options)
    return known[arm.twin]


def _with(arm, method, sound, seen, budget, options) -> Twin:
    """From the sound twin's values on, the amounts of the effect among the unknowns; nothing of them is told."""
    from ..solid_oracle import told

    extra, amounts, fixed = told({"effect": arm.added, "parameters": {}, "place": []}, sound.scene)
    begin = sound.values | {f"rec0_{name}": value for name, value in sound.values.items()}
    return method.fitted([seen], method.presets[budget.preset], begin=begin, extra=extra, extra_unknowns=amounts, fixed=fixed, **options)
