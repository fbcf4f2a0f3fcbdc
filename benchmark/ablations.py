"""Experiments that change one thing at a time: ``twinbench run --ablation NAME``. Each is one entry of ``ABLATIONS``, and no code."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from ..datasets.collection import Collection
from ..methods.appearance.config import Quirks
from ..methods.base import Method
from ..methods.registry import methods
from ..methods.variants import Variant, quirks
from .plan import Fit
from .tracker import Tracker

__all__ = ["ABLATIONS", "Ablation", "with_clips"]

IN_DOMAIN = ("resimulation", "prediction")
CLIPS = (1, 2, 5, 10, 30)  # published: 30 clips for the graph network, one for PhysTwin
CAMERAS = (1, 2, 3)
IMAGES = tuple(f"{name}{which}" for which in ("", "_corrected") for name in ("iou", "psnr", "ssim", "lpips"))


@dataclass(frozen=True)
class Ablation:
    """Methods that differ in one thing, scored beside each other.

    says        one line on what it asks
    compared    names of methods, and variants of methods
    quirks_of   a method with ``quirks``: it is compared with itself with each of them, and no other, as published
    looks_of    a method: its twins are shown with the corrected appearance, with each quirk of the published one, and with all
    tracker     the recording's own tracks are scored as well, as a yardstick
    tasks       in which; () means all
    metrics     by which; () means all
    published   methods of published tables to print beside them
    """

    says: str
    compared: tuple[str | Variant, ...] = ()
    quirks_of: str = ""
    looks_of: str = ""
    tracker: bool = False
    tasks: tuple[str, ...] = IN_DOMAIN
    metrics: tuple[str, ...] = ()
    published: tuple[str, ...] = ()

    def methods(self) -> dict[str, Callable[[], Method]]:
        """What is compared, by the name of its rows."""
        found: dict[str, Callable[[], Method]] = {}
        for one in self.compared:
            found[one if isinstance(one, str) else one.name] = methods()[one] if isinstance(one, str) else one
        if self.quirks_of:
            found[self.quirks_of] = methods()[self.quirks_of]
            for name in quirks(self.quirks_of):
                found[name] = Variant(name, self.quirks_of, {f"quirks.{name}": True})
        if self.looks_of:
            looks = ("corrected", *Quirks.__dataclass_fields__, "as-published")
            found |= {look: Variant(look, self.looks_of, look=look) for look in looks}
        if self.tracker:
            found[Tracker.name] = Tracker
        return found


def _clips(method: str) -> tuple[Variant, ...]:
    return tuple(Variant(f"{method} ({count} clip{'s' if count > 1 else ''})", method, clips=count) for count in CLIPS)


def _cameras(method: str) -> tuple[Variant, ...]:
    return tuple(Variant(f"{method} ({count} camera{'s' if count > 1 else ''})", method, cameras=count) for count in CAMERAS)


_PUBLISHED = "phystwin-as-published"
_PAPERS_STAGES = ("phystwin", "phystwin-zero", "phystwin-first")

ABLATIONS = {
    "stages": Ablation(
        "PhysTwin's search, its gradients, and both",
        ("phystwin", "phystwin-zero", "phystwin-first"),
        published=_PAPERS_STAGES,
    ),
    "stages-as-published": Ablation(
        "the same with every quirk of the reference implementation: the paper's ablation",
        (
            _PUBLISHED,
            Variant("phystwin-zero-as-published", _PUBLISHED, stages=("zero",)),
            Variant("phystwin-first-as-published", _PUBLISHED, stages=("first",)),
        ),
        published=_PAPERS_STAGES,
    ),
    "quirks": Ablation("PhysTwin with one quirk of the reference implementation at a time", quirks_of="phystwin", tasks=()),
    "gs-dynamics-quirks": Ablation("GS-Dynamics with one quirk of the published code at a time", quirks_of="gs-dynamics"),
    "spring-gaus-quirks": Ablation("Spring-Gaus with one quirk of the augmented reference at a time", quirks_of="spring-gaus"),
    "appearance-quirks": Ablation(
        "PhysTwin's twins shown with one quirk of the published appearance at a time, and with all", looks_of="phystwin", metrics=IMAGES
    ),
    "clips": Ablation(
        "a graph network trained on more recordings of the object, where PhysTwin has one", ("phystwin", *_clips("gs-dynamics"))
    ),
    "clips-as-published": Ablation("the same as published: the paper's data efficiency", (_PUBLISHED, *_clips("gs-dynamics-as-published"))),
    "cameras": Ablation("fitted with what fewer cameras saw", (*_cameras("phystwin"), *_cameras("spring-gaus"))),
    "tracks": Ablation(
        "PhysTwin's tracks beside those of the tracker that it is fitted to", ("phystwin",), tracker=True, metrics=("track_error",)
    ),
}


def with_clips(fits: Iterable[Fit], collection: Collection, clips: dict[str, int]) -> list[Fit]:
    """The fits of in-domain tasks with so many recordings of the object as ``clips`` says of their method: first the one that is scored.

    Which recordings show the same object, transfer pairs tell. Where there are too few, the fit is skipped with that reason.
    """
    return [_extended(fit, collection, clips[fit.method]) if fit.method in clips else fit for fit in fits]


def _extended(fit: Fit, collection: Collection, count: int) -> Fit:
    known = list(dict.fromkeys((*fit.sources, *_others(collection, fit.sources[0]))))
    few = f"the object was recorded {len(known)} time{'s' if len(known) > 1 else ''}" if len(known) < count else ""
    return replace(fit, sources=tuple(known[:count]), skip=few)


def _others(collection: Collection, name: str) -> Iterable[str]:
    """Other recordings of what ``name`` shows."""
    for pair in collection.pairs:
        if name in (*pair.sources, pair.target):
            yield from (other for other in (*pair.sources, pair.target) if other != name)
