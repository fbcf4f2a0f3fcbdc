"""What ``--preset`` stands for: how much work a fit may do, and for ``paper`` also what is run."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["PRESETS", "Preset"]


@dataclass(frozen=True)
class Preset:
    """Defaults of a run.

    budget     what methods are told (see ``methods.base.Budget``)
    data       recordings
    methods    methods of the main table
    ablations  what is run after it
    announced  whether it is said first what will be run, for how long, and what is missing
    """

    budget: str
    data: tuple[str, ...] = ("sample",)
    methods: tuple[str, ...] = ("static", "rigid", "phystwin")
    ablations: tuple[str, ...] = ()
    announced: bool = False


_COMPARED = ("spring-gaus", "gs-dynamics", "phystwin")

PRESETS = {
    "quick": Preset("quick"),
    "full": Preset("full"),
    # the tables of the PhysTwin paper, from what its code and those it compares with execute; in the main one also as their equations say
    "paper": Preset(
        "full",
        data=("data",),
        methods=(*(f"{name}-as-published" for name in _COMPARED), *_COMPARED),
        ablations=("stages-as-published", "clips-as-published"),
        announced=True,
    ),
}
