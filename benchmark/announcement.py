"""What a run will do, said before it starts: on what, for how long by what was measured, and what is missing for which table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ..datasets.catalogue import CASES
from ..datasets.collection import Collection
from ..datasets.scenario import Scenario
from ..methods.base import Method
from .cache import digest
from .measured import FIT_SECONDS, SOURCE
from .plan import Fit
from .processes import cards
from .progress import say, spoken_time
from .provenance import device_name

if TYPE_CHECKING:
    from .api import Study

__all__ = ["announce", "announcement", "missing"]


def announce(studies: Sequence[Study]) -> None:
    """Say it on standard error, line by line."""
    for line in announcement(studies):
        say(line)


def announcement(studies: Sequence[Study]) -> list[str]:
    """What will be run, how long that takes, and what is missing, in sentences.

    To know what is missing, each recording is read once; where all twins are in the cache, nothing is. Raises ValueError where the device
    is not there.
    """
    device = studies[0].options["device"]
    said = [f"On {device_name(device)}, preset {studies[0].budget}:", *(line for study in studies for line in _planned(study))]
    bills = _bills(studies)
    said += _times(bills, jobs=studies[0].jobs or len(cards(device)) or 1)
    return said + (missing(studies) if any(bill.open for bill in bills.values()) else [])


def _planned(study: Study) -> Iterable[str]:
    """One line for each collection of a study: its methods, recordings, tasks and twins."""
    for found, fits in study.work:
        skipped = sum(bool(fit.skip) for fit in fits)
        targets = {evaluation.target for fit in fits for evaluation in fit.evaluations}
        name = study.experiment.name or "main table"
        yield (
            f"- {name}: {', '.join(study.experiment.methods)}; {len(targets)} recordings of {found.collection.name} in "
            f"{found.path or 'memory'}; {', '.join(study.experiment.tasks)}: {len(fits) - skipped} twins"
            + (f", and {skipped} that cannot be fitted" if skipped else "")
        )


@dataclass
class _Bill:
    """Fits of one method that the studies share: ``open`` ones, those ``remembered``, and what each took or takes [s], None if unknown."""

    open: set = field(default_factory=set)
    remembered: set = field(default_factory=set)
    seconds: float | None = None
    source: str = ""


def _bills(studies: Sequence[Study]) -> dict[str, _Bill]:
    """By the first name under which a twin is asked for; variants that make the same twin are counted once."""
    past, there = _past(studies[0])
    names, bills = {}, {}
    for study in studies:
        for found, fits in study.work:
            for fit in fits:
                if fit.skip:
                    continue
                key = _key(study, fit)
                bill = bills.setdefault(names.setdefault(key, fit.method), _Bill())
                one = (found.collection.name, fit.sources, fit.seed)
                (bill.remembered if (key, *one) in there else bill.open).add(one)
                measured = FIT_SECONDS.get(study.options["device"], {}).get(names[key]) if study.budget == "full" else None
                if took := past.get(key):
                    bill.seconds, bill.source = sum(took) / len(took), f"the mean of {len(took)} in the cache"
                elif measured is not None:
                    bill.seconds, bill.source = measured, SOURCE
    return bills


def _key(study: Study, fit: Fit) -> str:
    return digest(getattr(study.experiment.methods[fit.method], "key", fit.method))


def _past(study: Study) -> tuple[dict[str, list[float]], set[tuple]]:
    """Seconds of the fits in the cache by method, with this preset and device, and which twins these are."""
    cache = study.cache
    wanted = {"preset": study.budget, "device": study.options["device"]}
    took, there = {}, set()
    for entry in cache.entries("fits"):
        if entry.made is None or any(entry.made["inputs"].get(name) != value for name, value in wanted.items()):
            continue
        stored = cache.read_folder("fits", entry.key)
        if stored is None:
            continue
        subject, inputs = entry.made["subject"], entry.made["inputs"]
        method = digest(inputs.get("method"))
        took.setdefault(method, []).append(stored[1]["fit_seconds"])
        there.add((method, subject.get("collection"), tuple(subject.get("recordings", ())), inputs.get("seed")))
    return took, there


def _times(bills: dict[str, _Bill], *, jobs: int) -> list[str]:
    said, total, unknown = [], 0.0, []
    for name, bill in bills.items():
        here = f" ({len(bill.remembered)} more in the cache, if neither code nor recordings changed)" if bill.remembered else ""
        if not bill.open:
            said.append(f"- {name}: all {len(bill.remembered)} twins are in the cache, if neither code nor recordings changed")
        elif bill.seconds is None:
            unknown.append(name)
            said.append(f"- {name}: {_fits(bill)}{here}; how long one takes was not measured on this kind of device")
        else:
            total += len(bill.open) * bill.seconds
            said.append(f"- {name}: {_fits(bill)} of about {spoken_time(bill.seconds)} ({bill.source}){here}")
    if total:
        shared = f" on {jobs} processes" if jobs > 1 else ""
        also = f", and what {', '.join(unknown)} take" if unknown else ""
        said.append(f"About {spoken_time(total / jobs)} for these fits{shared}{also}; roll-outs, appearances and images come on top.")
    return ["Time:", *said]


def _fits(bill: _Bill) -> str:
    return f"{len(bill.open)} fit{'s' if len(bill.open) > 1 else ''}"


def missing(studies: Sequence[Study]) -> list[str]:
    """What the recordings, the packages or the methods lack, and which tables or columns go without for it."""
    said, images = [], False
    for collection, held in _collections(studies):
        methods, lacks = _made(held)
        seen = _Seen.of(collection, methods)
        images |= seen.images
        tasks = {task for study in held for task in study.experiment.tasks}
        lacks = [*_about_data(collection, seen, tasks), *_about_fits(collection, held), *lacks]
        lacks += [f"{name} skips {_some(names)}: {reason}" for (name, reason), names in seen.skipped.items()]
        if collection.pairs and "transfer" in tasks:
            lacks += [f"{name} is not in the transfer table: {why}" for name, method in methods.items() if (why := method.skip_transfer)]
        said += [f"- {collection.name}: {lack}" for lack in lacks]
    metrics = {name: metric for study in studies for name, metric in study.experiment.metrics.items()}
    asked = {name: metric for name, metric in metrics.items() if images or not metric.images}
    said += [f"- no {name} in any table: {reason}" for name, metric in asked.items() if (reason := metric.unavailable())]
    return ["Missing:", *said] if said else ["Nothing is missing."]


def _collections(studies: Sequence[Study]) -> list[tuple[Collection, list[Study]]]:
    """Each collection with the studies that look at it."""
    held: dict[str, tuple[Collection, list[Study]]] = {}
    for study in studies:
        for found, _ in study.work:
            held.setdefault(found.collection.name, (found.collection, []))[1].append(study)
    return list(held.values())


def _made(studies: Sequence[Study]) -> tuple[dict[str, Method], list[str]]:
    """The methods of all studies by name, and what is said of those that cannot be made."""
    made, said = {}, []
    for name, make in {name: make for study in studies for name, make in study.experiment.methods.items()}.items():
        try:
            made[name] = make()
        except Exception as error:  # the method's own affair: its rows will say so too
            said.append(f"{name} cannot be run: {error}")
    return made, said


@dataclass
class _Seen:
    """What the recordings of a collection lack: names of those that cannot be read, have no tracks, no images, or are skipped."""

    lost: dict[str, str] = field(default_factory=dict)
    untracked: list[str] = field(default_factory=list)
    unseen: list[str] = field(default_factory=list)
    skipped: dict[tuple[str, str], list[str]] = field(default_factory=dict)
    images: bool = False

    @classmethod
    def of(cls, collection: Collection, methods: Mapping[str, Method]) -> _Seen:
        """Reads every recording once, and keeps none."""
        seen = cls()
        for name in collection.scenarios:
            try:
                one = collection.load(name)
            except ImportError:  # a package that is asked for: no fault of the recording
                raise
            except Exception as error:  # a damaged file may make any reader fail in any way; its rows will say so too
                seen.lost[name] = str(error) or type(error).__name__
                continue
            seen._add(name, one, methods)
        return seen

    def _add(self, name: str, one: Scenario, methods: Mapping[str, Method]) -> None:
        if one.tracks is None:
            self.untracked.append(name)
        if one.images is None or not one.cameras:
            self.unseen.append(name)
        else:
            self.images = True
        for key, method in methods.items():
            with suppress(Exception):  # a method that fails here says so in its rows
                if reason := method.skip(one):
                    self.skipped.setdefault((key, reason), []).append(name)


def _about_data(collection: Collection, seen: _Seen, tasks: set[str]) -> list[str]:
    said, here = [f"{name} cannot be read: {reason}" for name, reason in seen.lost.items()], set(collection.scenarios)
    if here & set(CASES) and (absent := [name for name in CASES if name not in here]):
        said.append(
            f"{len(absent)} of the paper's {len(CASES)} recordings are not here ({_some(absent)}): no published figures stand beside"
        )
    if "transfer" in tasks and not collection.pairs:
        said.append("no two recordings show one object: no transfer table")
    without = {"track error (no ground-truth tracks)": seen.untracked, "image columns (no images or cameras)": seen.unseen}
    return said + [f"no {what} for {_some(names)}" for what, names in without.items() if names]


def _about_fits(collection: Collection, studies: Sequence[Study]) -> list[str]:
    """Which twins cannot be fitted on these recordings, and how many."""
    skips: dict[str, list[str]] = {}
    for study in studies:
        for fit in (fit for found, fits in study.work if found.collection is collection for fit in fits if fit.skip):
            skips.setdefault(fit.method, []).append(fit.skip)
    return [f"{method}: no twin for {len(why)} recordings: {_some(list(dict.fromkeys(why)))}" for method, why in skips.items()]


def _some(names: Sequence[str], most: int = 3) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
