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
    """

    budget: str
    data: tuple[str, ...] = ("sample",)
    methods: tuple[str, ...] = ("static", "rigid", "phystwin")
    ablations: tuple[str, ...] = ()


PRESETS = {
    "quick": Preset("quick"),
    "full": Preset("full"),
    # the tables of the PhysTwin paper, from what its code and those it compares with execute
    "paper": Preset(
        "full",
        data=("data",),
        methods=("spring-gaus-as-published", "gs-dynamics-as-published", "phystwin-as-published"),
        ablations=("stages-as-published", "clips-as-published"),
    ),
}
