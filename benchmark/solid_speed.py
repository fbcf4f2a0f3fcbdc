"""Wall seconds per simulated second of a soft solid at equal accuracy, beside other engines.

python -m twinbench.benchmark.solid_speed            one bar and sixteen, on two CPU cores: our cells and MuJoCo's flexes
python -m twinbench.benchmark.solid_speed --cuda     our cells and Newton's tetrahedra on the GPU, sixteen and 256 at once

A foam bar is let go, swings and comes to rest in 2 s. Each engine is compared with its own refined self (``Engine.finest``) only, and may
use the setting that is fastest among those whose error (root mean square over 16 points and all frames) is at most a millimetre. A coarse
mesh may be right by luck, where two errors cancel: the second table asks that every finer mesh that was tried is right as well.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .solid_engines import SECONDS, Bar, Cells, Engine, Flex, Setting, Tetrahedra

__all__ = ["Tried", "apart", "chosen", "engines", "main", "search"]

ACCURACY = 1e-3  # m
LONGEST = 20.0  # s that one run of the search may take: finer meshes are left out then
SIXTEEN = 16


@dataclass(frozen=True)
class Tried:
    """A setting, its error [m] and how long a single run took [s of wall time per s]."""

    setting: Setting
    error: float
    seconds: float


def apart(found, reference) -> float:
    """Root mean square distance [m] of points (..., 3); infinite where a simulation blew up."""
    square = np.square(found - reference).sum(-1).mean()
    return float(np.sqrt(square)) if np.isfinite(square) else np.inf


def clocked(work: Callable[[], np.ndarray]) -> tuple[np.ndarray, float]:
    began = time.perf_counter()
    found = work()
    return found, (time.perf_counter() - began) / SECONDS


def search(engine: Engine, bar: Bar, reference: np.ndarray) -> list[Tried]:
    """Every mesh of an engine with every setting, up to the first too inaccurate one of a mesh and the first too slow mesh."""
    tried = []
    for mesh in engine.meshes:
        slow = False
        for setting in engine.settings(bar, mesh):
            if any(t.error > 3 * ACCURACY and _no_better(setting, t.setting) for t in tried):
                continue
            found, seconds = clocked(engine.ready([bar], setting))
            tried.append(Tried(setting, apart(found[0], reference), seconds))
            print(f"  {engine.name:16} {setting!s:32} {1e3 * tried[-1].error:8.2f} mm {seconds:8.3f} s/s", flush=True)
            slow |= seconds * SECONDS > LONGEST
        if slow:
            break
    return tried


def _no_better(one: Setting, other: Setting) -> bool:
    """On the same mesh, with steps no shorter that are solved no better."""
    return one.mesh == other.mesh and one.substeps <= other.substeps and one.effort <= other.effort


def chosen(tried: Sequence[Tried], meshes: Sequence, *, lasting: bool) -> Tried | None:
    """The fastest that is accurate; ``lasting``: on a mesh from which on all finer ones that were tried have an accurate setting."""
    accurate = [t for t in tried if t.error <= ACCURACY]
    if lasting:
        order = [m for m in meshes if any(t.setting.mesh == m for t in tried)]
        good = {t.setting.mesh for t in accurate}
        wrong = [k for k, m in enumerate(order) if m not in good]
        accurate = [t for t in accurate if order.index(t.setting.mesh) > max(wrong, default=-1)]
    # on one mesh fewer steps that are solved no better are cheaper, whatever else the machine did meanwhile
    accurate = [t for t in accurate if not any(o is not t and _no_better(o.setting, t.setting) for o in accurate)]
    return min(accurate, key=lambda t: t.seconds, default=None)


def interleaved(runs: dict[str, Callable], repeats: int) -> dict[str, float]:
    """Least wall seconds per simulated second of each, taken in turns: what else the machine does meets all alike."""
    found: dict[str, list[float]] = {name: [] for name in runs}
    for run in runs.values():
        run()
    for _ in range(repeats):
        for name, run in runs.items():
            found[name].append(clocked(run)[1])
    return {name: min(times) for name, times in found.items()}


def many(bar: Bar, count: int) -> list[Bar]:
    """Bars whose moduli differ by up to a tenth, as those of a fit's differences and trial steps do."""
    return [replace(bar, young=bar.young * factor) for factor in np.linspace(0.9, 1.1, count)]


def engines(cuda: bool) -> list[Engine]:
    """All that are compared on a device. The trilinear and full flexes lock, so that their refined self is the quadratic one."""
    if cuda:
        return [Cells("cuda"), Tetrahedra("cuda")]
    fine = Setting((6, 1, 1), 64, 8)
    return [
        Cells(),
        Flex("quadratic", ((2, 1, 1), (3, 1, 1), (4, 1, 1)), fine),
        Flex("trilinear", ((8, 2, 1), (16, 4, 2)), fine),
        Flex("full", ((8, 2, 1), (16, 4, 2)), fine),
    ]


def names(engine: Engine, lasting: bool) -> str:
    return f"{engine.name}, {'lasting' if lasting else 'coarsest'}"


def measure(
    bar: Bar, chosen_ones: Iterable[tuple[Engine, bool, Setting]], counts: Sequence[int], repeats: int
) -> dict[int, dict[str, float]]:
    """Per count of bars the wall seconds per simulated second and bar of each."""
    chosen_ones, found = list(chosen_ones), {}
    for count in counts:
        bars = [bar] if count == 1 else many(bar, count)
        runs = {names(e, lasting): e.ready(bars, _steps(e, bars, setting)) for e, lasting, setting in chosen_ones}
        found[count] = {name: seconds / count for name, seconds in interleaved(runs, repeats).items()}
    return found


def _steps(engine: Engine, bars: Sequence[Bar], setting: Setting) -> Setting:
    """An explicit step is as short as the stiffest bar asks; an implicit one stays."""
    if not isinstance(engine, Cells) or len(bars) == 1:
        return setting
    stiffest = max(b.young for b in bars) / float(np.median([b.young for b in bars]))
    return replace(setting, substeps=int(np.ceil(setting.substeps * stiffest**0.5)))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cuda", action="store_true", help="on the GPU")
    parser.add_argument("--repeats", type=int, default=5, help="timings of each, of which the least counts")
    given = parser.parse_args(arguments)
    bar, selected, references = Bar(), [], {}
    for engine in engines(given.cuda):
        try:
            key = engine.finest if isinstance(engine, Flex) else engine.name
            if key not in references:
                own = Flex("quadratic", (), engine.finest) if isinstance(engine, Flex) else engine
                references[key], seconds = clocked(own.ready([bar], engine.finest))
                print(f"{own.name}: refined self {engine.finest}, {seconds:.2f} s/s", flush=True)
            tried = search(engine, bar, references[key][0])
        except (ValueError, ImportError) as error:
            print(f"{engine.name}: {error}")
            continue
        for lasting in (False, True):
            best = chosen(tried, engine.meshes, lasting=lasting)
            if best is None:
                print(f"{engine.name}: no setting {'lastingly ' if lasting else ''}within {1e3 * ACCURACY:g} mm")
            else:
                selected.append((engine, lasting, best))
    references = [r[0] for r in references.values()]
    print("refined selves apart [mm]: " + ", ".join(f"{1e3 * apart(r, references[0]):.2f}" for r in references[1:]))
    counts = (1, SIXTEEN, 256) if given.cuda else (1, SIXTEEN)
    table(selected, measure(bar, [(e, lasting, t.setting) for e, lasting, t in selected], counts, given.repeats))


def table(selected, measured) -> None:
    """Print what was chosen, and how long each takes beside our cells."""
    counts = list(measured)
    print("| engine | mesh and steps | error [mm] | " + " | ".join(f"{n} at once: s/s each | beside cells" for n in counts) + " |")
    print("|---|---|---:|" + "---:|" * (2 * len(counts)))
    for engine, lasting, tried in selected:
        ours = names(next(e for e, _, _ in selected), lasting)
        cells = [
            f"{measured[n][names(engine, lasting)]:.4f} | {measured[n][names(engine, lasting)] / measured[n][ours]:.1f}" for n in counts
        ]
        print(f"| {names(engine, lasting)} | {tried.setting} | {1e3 * tried.error:.2f} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
