"""What ``python -m twinbench.datasets.concealed --out DIR`` writes: pairs of recordings with something concealed in them; and labels."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from concurrent.futures import BrokenExecutor, as_completed
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import numpy as np

from ..pool import Pool
from ..temporary import replacing
from .bodies import SOLIDS, THIN, meshing
from .case import CLEAR, CONTROLS, build
from .convergence import refinement
from .effects import EFFECTS, OUTSIDE
from .engines import ENGINES, require
from .make import write_recordings

LABELS = "labels.json"
TRUTH = "truth"  # beside the cases, a file for each: ``Case.truth``


def plan(
    seed: int, effects: int, controls: int, outside: int, *, bodies=("cloth", "plush", "rope"), only=None
) -> list[tuple[str, str, str]]:
    """(kind, name, body) of every case, in the order of the cases: all names in turn, on all bodies in turn, then shuffled."""
    rng = np.random.default_rng([seed, 0])
    chosen = []
    plain: dict[str, Any] = dict.fromkeys(CONTROLS)
    tables = (("effect", EFFECTS, effects), ("outside", OUTSIDE, outside), ("control", plain, controls))
    for kind, table, count in tables:
        turns, wanted = {}, [n for n in table if n in (only or ())]
        for name in islice(cycle(wanted or table), count):
            able = [b for b in bodies if table[name] is None or b in table[name].bodies]
            if able:
                turns[name] = turns.get(name, int(rng.integers(len(able)))) + 1
                chosen.append((kind, name, able[turns[name] % len(able)]))
    return [chosen[i] for i in rng.permutation(len(chosen))]


def make(out: Path, index: int, kind: str, name: str, body: str, seed: int, pairs: Sequence[str], **how) -> dict:
    """Build and write one case, ``how`` as ``build`` takes it, in the interactions of its turn of ``pairs``; its label."""
    begun = time.time()
    folder = out / f"case_{index:03d}"
    interactions = tuple(pairs[index % len(pairs)].split(":")) if pairs else ()
    own = int(np.random.default_rng([seed, 1, index]).integers(2**31))
    case = build(kind, name, body, seed=own, interactions=interactions, **how)
    write_recordings(case, folder, index)
    (out / TRUTH).mkdir(exist_ok=True)
    np.savez_compressed(out / TRUTH / f"{folder.name}.npz", **case.truth)
    label = case.label | refinement(body, how["engine"], meshing(body, how["solids"], how["thin"]), case.label["interactions"])
    return label | {"seconds": round(time.time() - begun, 1)}


def main(arguments=None) -> int:
    """Returns the exit code: 2 after one line on standard error where something is wrong, 130 where it was stopped."""
    options = _options(arguments)
    try:
        require([options.engine])
        _write(options)
    except KeyboardInterrupt:
        print("stopped; the same command goes on from here", file=sys.stderr)
        return 130
    except (ImportError, ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def _options(arguments):
    parser = argparse.ArgumentParser(prog="python -m twinbench.datasets.concealed", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder for the cases and labels.json; cases that are there are kept")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--effects", type=int, default=40, help="how many cases with an effect")
    parser.add_argument("--controls", type=int, default=12, help="how many with none")
    parser.add_argument("--outside", type=int, default=6, help="how many with one that is in no catalogue")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--bodies", nargs="+", choices=("cloth", "plush", "rope"), default=("cloth", "plush", "rope"))
    parser.add_argument("--only", nargs="+", choices=(*EFFECTS, *CONTROLS), help="effects and controls to choose from")
    parser.add_argument(
        "--solids", choices=SOLIDS, default="tetrahedra", help="of what stuffed bodies are made: hexahedra and boxes do not lock"
    )
    parser.add_argument(
        "--thin",
        choices=THIN,
        default="coarse",
        help="how ropes and cloths are meshed: resolved ones are held alike on every mesh",
    )
    parser.add_argument("--pairs", nargs="+", default=(), metavar="FIT:TRANSFER", help="interactions of the cases in turn, as lift:slow")
    parser.add_argument("--recordings", type=int, default=1, help="of each case that may be fitted: fit, fit_2 and so on")
    parser.add_argument("--clear", nargs=2, type=float, default=CLEAR, metavar=("LOW", "HIGH"), help="displacement by an effect [m RMS]")
    parser.add_argument("--engine", choices=tuple(ENGINES), default="mujoco", help="what simulates them; cosserat: ropes, newton: others")
    parser.add_argument("--cases", nargs="+", metavar="CASE", help="some of them, as case_007: a large set can be made part by part")
    return parser.parse_args(arguments)


def _write(options):
    """Make the cases that are not there, and print a line for each. Raises ValueError for one that the plan does not have."""
    options.out.mkdir(parents=True, exist_ok=True)
    cases = plan(options.seed, options.effects, options.controls, options.outside, bodies=options.bodies, only=options.only)
    file = options.out / LABELS
    labels = json.loads(file.read_text()) if file.exists() else {}
    wanted = {f"case_{i:03d}": (i, *case) for i, case in enumerate(cases)}
    if strange := sorted({*(options.cases or ())} - {*wanted}):
        raise ValueError(f"--cases must be among case_000 to case_{len(cases) - 1:03d}, got {', '.join(strange)}")
    if options.cases:
        wanted = {name: wanted[name] for name in options.cases}
    todo = {name: case for name, case in wanted.items() if name not in labels or not (options.out / name / "transfer").is_dir()}
    how = {"clear": tuple(options.clear), "engine": options.engine, "solids": options.solids, "thin": options.thin}
    how |= {"recordings": options.recordings}
    with Pool(options.jobs) as pool:
        running = {pool.submit(make, options.out, *case, options.seed, options.pairs, **how): name for name, case in todo.items()}
        for done, future in enumerate(as_completed(running), 1):
            name = running[future]
            try:
                labels[name] = future.result()
            except BrokenExecutor:
                raise
            except RuntimeError as reason:
                print(f"{name}: {reason}", flush=True)
                continue
            with replacing(file) as temporary:
                temporary.write_text(json.dumps(dict(sorted(labels.items())), indent=1))
            print(f"{done}/{len(todo)} {row(name, labels[name])}", flush=True)
    print("\n".join(row(name, label) for name, label in sorted(labels.items())))


def row(name: str, label: dict) -> str:
    """One line of the table."""
    what = label["effect"] or f"nothing ({label['control']})"
    moved, later, chaos = (1000 * label.get(key, 0) for key in ("displacement", "displacement_transfer", "chaos"))
    where = f"{name}  {label['kind']:8} {what:28} {label['object']:6} {' > '.join(label['interactions']):24}"
    return f"{where} {moved:5.1f} / {later:5.1f} mm, chaos {chaos:4.1f} mm  {label['seconds']:5.1f} s"
