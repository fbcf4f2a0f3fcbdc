"""``python -m twinbench.datasets.concealed.converge``: how far a simulated truth moves when its mesh is refined, and from engine to engine.

A drawn body is moved by one script on its own mesh and on one with edges half as long; the distance between vertices that both have is
told for the frames that can be predicted and for all. Frames can be predicted until a tenth of a millimetre at the hand has grown to the
noise of a recording.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from . import bodies, motions
from .bodies import SOLIDS, THIN, meshing
from .case import nudged
from .convergence import NOISE, Row, markdown
from .engines import ENGINES, able, engine, require
from .world import Unstable

__all__ = ["compare", "main", "refined", "shared_vertices"]


def refined(kind: str, by: str, motion: str, seed: int, *, refine: int = 2, frames: int = 0, **how) -> Row:
    """The row of a body drawn from ``seed``: its own mesh against one ``refine`` times as fine, both simulated by the engine ``by``, for
    ``frames`` frames if that is not 0; ``how`` (solids, thin) as ``bodies.draw`` takes it.
    """
    base, script = _drawn(kind, motion, seed, how, frames)
    begun = time.process_time()
    coarse = engine(by).simulate(base, script).vertices
    seconds = time.process_time() - begun
    fine_body = bodies.draw(kind, np.random.default_rng([seed, 0]), refine=refine, **how)
    fine = engine(by).simulate(fine_body, script).vertices[:, shared_vertices(base, fine_body)]
    return _row(kind, (by,), motion, seed, how, coarse, fine, _predictable(base, script, coarse, by), seconds)


def compare(kind: str, one: str, other: str, motion: str, seed: int, *, frames: int = 0, **how) -> Row:
    """The row of two engines that simulate the same body on the same mesh."""
    base, script = _drawn(kind, motion, seed, how, frames)
    begun = time.process_time()
    first, second = (engine(by).simulate(base, script).vertices for by in (one, other))
    seconds = time.process_time() - begun
    return _row(kind, (one, other), motion, seed, how, first, second, _predictable(base, script, first, one), seconds)


def _drawn(kind, motion, seed, how, frames):
    body = bodies.draw(kind, np.random.default_rng([seed, 0]), **how)
    script = motions.draw(motion, body, np.random.default_rng([seed, 1]))
    return body, replace(script, frames=min(frames or script.frames, script.frames))


def shared_vertices(base, fine) -> np.ndarray:
    """(V,) vertices of the body ``fine`` where the V of ``base`` are; raises ValueError where one of these was not kept."""
    from scipy.spatial import cKDTree

    distance, index = cKDTree(fine.vertices).query(base.vertices)
    if distance.max() > 1e-6:
        raise ValueError(f"a refined {base.kind} must keep the vertices of the coarse one, one is {1000 * distance.max():.2g} mm off")
    return index


def _predictable(body, script, vertices, by):
    """How many frames can be predicted: until a nudge of the hand has grown to the noise in one vertex of ten."""
    grown = np.linalg.norm(engine(by).simulate(body, nudged(script)).vertices - vertices, axis=2)
    beyond = np.flatnonzero(np.quantile(grown, 0.9, axis=1) > NOISE)
    return int(beyond[0]) if len(beyond) else len(vertices)


def _row(kind, by, motion, seed, how, one, other, frames, seconds):
    apart = 1000 * np.linalg.norm(one - other, axis=2)
    early = apart[: max(frames, 1)]
    known: list[Any] = [kind, meshing(kind, **how), "+".join(by), motion, seed, frames, len(one)]
    figures = [float(np.round(f(v), 3)) for v in (early, apart) for f in (np.median, lambda v: np.quantile(v, 0.9))]
    return Row(*[*known, *figures, round(seconds, 1)])


def main(arguments=None) -> int:
    """Returns the exit code: 2 after one line on standard error where something is wrong."""
    options = _options(arguments)
    try:
        require(options.engines)
        rows = [Row(**row) for row in json.loads(options.out.read_text())] if options.out and options.out.exists() else []
        for one in _wanted(options):
            how = {"solids": options.solids, "thin": options.thin}
            if not any((r.kind, r.engine, r.motion, r.seed) == one and r.solids == meshing(one[0], **how) for r in rows):
                rows += _measured(*one, how, options.frames)
                _write(options.out, rows)
    except (ImportError, ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    print(markdown(rows))
    return 0


def _wanted(options):
    """(kind, engines, motion, seed) of all rows: each engine by itself, or all pairs of the first with the others."""
    for kind in options.kinds:
        each = [by for by in options.engines if able(by, kind, ())]
        for by in each if not options.between else [f"{each[0]}+{other}" for other in each[1:]]:
            for motion in options.motions:
                yield from ((kind, by, motion, seed) for seed in options.seeds)


def _measured(kind, by, motion, seed, how, frames):
    """The row, as a list; none where a simulation is unstable."""
    try:
        run: Callable[..., Any] = compare if "+" in by else refined
        row = run(kind, *by.split("+"), motion, seed, frames=frames, **how)
    except Unstable as reason:
        print(f"{kind} {by} {motion} {seed}: {reason}", file=sys.stderr, flush=True)
        return []
    print(row, flush=True)
    return [row]


def _write(out: Path | None, rows) -> None:
    if out:
        out.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")


def _options(arguments):
    parser = argparse.ArgumentParser(prog="python -m twinbench.datasets.concealed.converge", description=__doc__)
    parser.add_argument("--kinds", nargs="+", choices=tuple(bodies.BODIES), default=("plush",))
    parser.add_argument("--engines", nargs="+", choices=tuple(ENGINES), default=("finite",))
    parser.add_argument("--motions", nargs="+", choices=(*motions.GENTLE, *motions.KINDS), default=("lift", "lift_shake"))
    parser.add_argument("--seeds", nargs="+", type=int, default=(1,))
    parser.add_argument("--solids", choices=SOLIDS, default="hexahedra", help="of what stuffed bodies are made")
    parser.add_argument("--thin", choices=THIN, default="resolved", help="how ropes and cloths are meshed")
    parser.add_argument("--frames", type=int, default=0, help="no more than that many frames; 0 for all")
    parser.add_argument("--between", action="store_true", help="the first engine against the others, on one mesh, instead of refining")
    parser.add_argument("--out", type=Path, help="JSON file of the rows; those that are there are kept")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main())
