"""Experiments that change one thing at a time: ``twinbench run --ablation NAME``. Each is one entry of ``ABLATIONS``, and no code."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from ..datasets.collection import Collection
from ..methods.appearance.config import Quirks
from ..methods.base import Method
from ..methods.registry import methods
from ..methods.variants import Variant, quirks
from .plan import Fit
from .tracker import Tracker

__all__ = ["ABLATIONS", "Ablation", "clips_of", "with_clips"]

IN_DOMAIN = ("resimulation", "prediction")
CLIPS = (1, 2, 5, 10, 30)  # published: 30 clips for the graph network, one for PhysTwin
CAMERAS = (1, 2, 3)
DISTANCES = ("chamfer", "track_error")
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
    """Variants of a method that can be fitted on several recordings, on all of them and not just the most that a preset takes."""
    return tuple(
        Variant(f"{method} ({count} clip{'s' if count > 1 else ''})", method, {"recordings": count} if count > 1 else {}, clips=count)
        for count in CLIPS
    )


def clips_of(name: str) -> tuple[str, int | None]:
    """The method of a variant's name, and on how many recordings that is fitted, or None.

    >>> clips_of("gs-dynamics (5 clips)")
    ('gs-dynamics', 5)
    """
    found = re.fullmatch(r"(.+) \((\d+) clips?\)", name)
    return (found[1], int(found[2])) if found else (name, None)


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
        "twins of 1, 2, 5, 10 and 30 recordings of the object, as far as there are so many",
        ("rigid", *_clips("phystwin"), *_clips("gs-dynamics"), *_clips("continuum")),
        tasks=(),
    ),
    "clips-as-published": Ablation(
        "a graph network as published on more recordings of the object, where PhysTwin has one: the paper's data efficiency",
        (_PUBLISHED, *_clips("gs-dynamics-as-published")),
    ),
    "meshes": Ablation(
        "continuum in cells of three sizes: whether a twin hangs on its mesh",
        ("continuum", *(Variant(f"continuum (cells x {times})", "continuum", {"pitch": times}) for times in (0.7, 1.5))),
        metrics=DISTANCES,
    ),
    "classes": Ablation(
        "continuum, and the same fit of a net of springs on the nodes of its cells: what the class of a twin is worth",
        ("continuum", Variant("continuum (springs)", "continuum", {"elements": "springs"})),
        metrics=DISTANCES,
    ),
    "grips": Ablation(
        "continuum with what hands hold fitted, and as they are said to hold it",
        ("continuum", Variant("continuum (grips as told)", "continuum", {"grips": False})),
        tasks=(),
        metrics=DISTANCES,
    ),
    "cameras": Ablation("fitted with what fewer cameras saw", (*_cameras("phystwin"), *_cameras("spring-gaus"))),
    "tracks": Ablation(
        "PhysTwin's tracks beside those of the tracker that it is fitted to", ("phystwin",), tracker=True, metrics=("track_error",)
    ),
}


def with_clips(fits: Iterable[Fit], collection: Collection, clips: dict[str, int]) -> list[Fit]:
    """The fits with so many recordings of the object as ``clips`` says of their method. Where there are too few, they are skipped with
    that reason.

    For in-domain tasks the first is the one that is scored, and others of the object join it; which show the same object, transfer pairs
    tell. For transfer they are some of those that the pair is fitted on, spread evenly: others may be what is scored.
    """
    return [part for fit in fits for part in (_parts(fit, collection, clips[fit.method]) if fit.method in clips else [fit])]


def _parts(fit: Fit, collection: Collection, count: int) -> Iterable[Fit]:
    """The in-domain and the transfer evaluations of ``fit``, each with ``count`` sources."""
    own = tuple(evaluation for evaluation in fit.evaluations if evaluation.task != "transfer")
    brought = tuple(evaluation for evaluation in fit.evaluations if evaluation.task == "transfer")
    if own:
        known = tuple(dict.fromkeys((*fit.sources, *_others(collection, fit.sources[0]))))
        yield replace(fit, evaluations=own, sources=known[:count], skip=_few(known, count, "the object was recorded"))
    if brought:
        chosen = tuple(fit.sources[k * len(fit.sources) // count] for k in range(count)) if count < len(fit.sources) else fit.sources
        yield replace(fit, evaluations=brought, sources=chosen, skip=_few(fit.sources, count, "what is transferred was recorded"))


def _few(known: tuple[str, ...], count: int, what: str) -> str:
    return f"{what} {len(known)} time{'s' if len(known) > 1 else ''}" if len(known) < count else ""


def _others(collection: Collection, name: str) -> Iterable[str]:
    """Other recordings of what ``name`` shows."""
    for pair in collection.pairs:
        if name in (*pair.sources, pair.target):
            yield from (other for other in (*pair.sources, pair.target) if other != name)
