"""``python -m twinbench.benchmark.engines``."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence

from . import __doc__ as told
from . import bar, rope, sheet
from .comparison import ACCURACY, Engine, Tried, apart, chosen, clocked, measure, search

SCENES = {
    "bar": (bar.Bar(), bar.engines),
    "rope": (rope.ROPE, rope.engines),
    "thrown": (rope.THROWN, rope.engines),
    "cable": (rope.CABLE, rope.engines),
    "sheet": (sheet.Sheet(), sheet.engines),
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Search every engine's settings, then time what was chosen in turns, and print a table."""
    parser = argparse.ArgumentParser(
        prog="python -m twinbench.benchmark.engines", description=told, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scene", choices=list(SCENES))
    parser.add_argument("--cuda", action="store_true", help="on the GPU")
    parser.add_argument("--repeats", type=int, default=5, help="timings of each, of which the least counts")
    given = parser.parse_args(arguments)
    body, engines = SCENES[given.scene]
    selected, references = [], {}
    for engine in engines(given.cuda):
        try:
            judge = engine.judge
            if judge.name not in references:
                references[judge.name], seconds = clocked(judge.ready([body], judge.finest))
                print(f"{judge.name}: refined self {judge.finest}, {seconds:.2f} s/s", flush=True)
            tried = search(engine, body, references[judge.name][0])
        except (ValueError, ImportError) as error:
            print(f"{engine.name}: {error}")
            continue
        for lasting in (False, True)[: len(engine.meshes)]:
            name = engine.name + (", lasting" if lasting else ", coarsest" if len(engine.meshes) > 1 else "")
            best = chosen(tried, engine.meshes, lasting=lasting)
            if best is None:
                print(f"{name}: no setting within {1e3 * ACCURACY:g} mm")
            else:
                selected.append((name, engine, lasting, best))
    own = [r[0] for r in references.values()]
    print("refined selves apart [mm]: " + ", ".join(f"{1e3 * apart(r, own[0]):.2f}" for r in own[1:]))
    counts = (1, 16, 256) if given.cuda else (1, 16)
    table(selected, measure(body, [(name, engine, t.setting) for name, engine, _, t in selected], counts, given.repeats))


def table(selected: Sequence[tuple[str, Engine, bool, Tried]], measured) -> None:
    """Print what was chosen, and how long each takes beside ours."""
    counts = list(measured)
    print("| engine | mesh and steps | error [mm] | " + " | ".join(f"{n} at once: s/s each | beside ours" for n in counts) + " |")
    print("|---|---|---:|" + "---:|" * (2 * len(counts)))
    for name, _engine, lasting, tried in selected:
        ours = next((n for n, engine, one, _ in selected if one == lasting and engine.is_ours), None)
        cells = [f"{measured[n][name]:.4f} | {measured[n][name] / measured[n][ours] if ours else math.nan:.1f}" for n in counts]
        print(f"| {name} | {tried.setting} | {1e3 * tried.error:.2f} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
