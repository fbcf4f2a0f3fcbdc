"""Which cases a sealed set has: what is concealed, in which body, how large, and by which engine it is simulated."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import count, islice

import numpy as np

from .bodies import BODIES
from .case import CLEAR, CONTROLS
from .effects import EFFECTS, OUTSIDE
from .engines import able

__all__ = ["FLOOR", "PAIRS", "PRESETS", "Entry", "Preset", "entropy", "plan"]

FLOOR = 0.0075  # m RMS, what a coarse twin of a sound body is off by: sizes are told in multiples of it
WIDTH = 1.25  # factor by which an effect may be smaller or larger than is asked

# Two effects of different places in the physics, so that one does not change the law of the other.
PAIRS = (
    *(("wind", "added_mass"), ("gravity_tilt", "bending"), ("quadratic_drag", "controller_delay"), ("viscoelastic", "grip_slip")),
    *(("hidden_tether", "wind"), ("friction_law", "controller_delay"), ("anisotropy", "grip_points"), ("bending", "quadratic_drag")),
    *(("plasticity", "added_mass"), ("strain_stiffening", "camera_pose"), ("ground_adhesion", "bending"), ("gravity_tilt", "track_drift")),
)


@dataclass(frozen=True)
class Preset:
    """How many: ``controls``; cases of every effect, one for each of ``levels``, its size over ``FLOOR``; of ``effects`` effects, all where
    that is None, but those of ``without``; cases with what no catalogue lists (``outside``), and with two effects (``pairs``).

    All are in ``bodies``, and what none of them can show is left out. ``solids`` of ``bodies.SOLIDS`` says what stuffed bodies are made of,
    ``thin`` of ``bodies.THIN`` how ropes and cloths are meshed: what locks, and coarsely, as in the sets that were sealed with quick and
    full, unless another is asked. ``recordings`` says how many of a case may be fitted, in turn.
    """

    controls: int
    levels: tuple[float, ...]
    outside: int
    pairs: int
    effects: int | None = None
    solids: str = "tetrahedra"
    thin: str = "coarse"
    bodies: tuple[str, ...] = tuple(BODIES)
    without: tuple[str, ...] = ()
    recordings: tuple[int, ...] = (1,)

    def shown(self, names: Iterable[str]) -> tuple[str, ...]:
        """Of ``bodies``, those that can show all of ``names`` of ``EFFECTS`` and ``OUTSIDE``; none where one is not wanted."""
        table = EFFECTS | OUTSIDE
        return tuple(b for b in self.bodies if all(b in table[name].bodies and name not in self.without for name in names))


OF_ONE_KIND = Preset(controls=80, levels=tuple(mm / (1000 * FLOOR) for mm in (10, 20, 40)), outside=12, pairs=8)  # of body, each in its own
PRESETS = {
    "quick": Preset(controls=6, levels=(2.0,), outside=2, pairs=2, effects=8),
    "full": Preset(controls=64, levels=(0.5, 1.0, 2.0, 4.0, 8.0), outside=21, pairs=24),
    "ropes": replace(
        OF_ONE_KIND,
        thin="resolved",
        bodies=("rope",),
        without=("bending", "bending_damping", "torsion", "grip_points"),  # a twin that bends and twists fits all of these
    ),
    "blocks": replace(OF_ONE_KIND, solids="hexahedra", bodies=("plush",)),
    "cloths": replace(
        OF_ONE_KIND,
        thin="resolved",
        bodies=("cloth",),
        without=("bending", "bending_damping", "plate_drag", "grip_points"),  # a sheet bends and has a drag of its plates
    ),
}


@dataclass(frozen=True)
class Entry:
    """One case: ``kind``, ``name`` and ``body`` as ``build`` takes them, and the ``engine`` that simulates it.

    clear  how far the points may be moved [m RMS]; a control must be as predictable as if they were
    like   the effect in whose interactions a control is filmed
    level  size over ``FLOOR``, where one is asked
    recordings  how many may be fitted
    """

    kind: str
    name: str
    body: str
    engine: str
    clear: tuple[float, float] = CLEAR
    like: str = ""
    level: float | None = None
    recordings: int = 1


def entropy(seed: str) -> int:
    """The number that a seed stands for."""
    return int.from_bytes(hashlib.sha256(seed.encode()).digest(), "big")


def plan(preset: str | Preset, seed: str, *, engines: Sequence[str]) -> list[Entry]:
    """The cases, in an order that says nothing. All names come in turn, on all their bodies in turn, as many from each of the ``engines``.

    A control has the body, the engine and the interactions of some case that is none: what is there and what hands do then tells nothing.
    Raises ValueError for an unknown preset or where there is no engine.
    """
    if isinstance(preset, str) and preset not in PRESETS:
        raise ValueError(f"unknown preset {preset!r}; known: {', '.join(PRESETS)}")
    if not engines:
        raise ValueError("a plan needs at least one engine")
    preset = PRESETS[preset] if isinstance(preset, str) else preset
    rng = np.random.default_rng([entropy(seed), 0])
    effects, outside = (sorted(n for n in table if preset.shown([n])) for table in (EFFECTS, OUTSIDE))
    names = [str(n) for n in rng.permutation(effects)][: preset.effects]
    wanted = [("effect", n, preset.shown([n]), level) for n in names for level in preset.levels]
    wanted += [("outside", n, preset.shown([n]), None) for n in _turns(rng, outside, preset.outside)]
    wanted += [("pair", "+".join(p), preset.shown(p), None) for p in _turns(rng, [p for p in PAIRS if preset.shown(p)], preset.pairs)]
    first = {name: int(rng.integers(len(BODIES))) for name in sorted({w[1] for w in wanted})}
    turn, cases = Counter(), []
    for kind, name, bodies, level in wanted:
        cases.append(Entry(kind, name, bodies[(first[name] + turn[name]) % len(bodies)], "", _band(kind, name, level), level=level))
        turn[name] += 1
    cases = _spread(rng, cases, engines)
    others = [c for c in cases if c.kind != "pair"]
    filmed = [others[k] for k in rng.permutation(len(others))]
    for k, name in enumerate(_turns(rng, CONTROLS, preset.controls)):
        one = filmed[k % len(filmed)]
        cases.append(Entry("control", name, one.body, one.engine, one.clear, like=one.name))
    shuffled = [cases[i] for i in rng.permutation(len(cases))]
    return [replace(case, recordings=preset.recordings[k % len(preset.recordings)]) for k, case in enumerate(shuffled)]


def _turns(rng, names, wanted):
    """``wanted`` of ``names``, all in turn from a random one on."""
    first = int(rng.integers(len(names)))
    return islice((names[(first + k) % len(names)] for k in count()), wanted)


def _spread(rng, cases, engines):
    """The cases with their engines: as many of each body from each engine that can, by chance, so that none goes with a name or a size."""
    given, used = list(cases), Counter()
    for k in rng.permutation(len(cases)):
        case = cases[k]
        can = [e for e in rng.permutation(list(engines)).tolist() if able(e, case.body, case.name.split("+"))]
        if not can:
            raise ValueError(f"none of the engines {', '.join(engines)} simulates {case.name} of a {case.body}")
        chosen = min(can, key=lambda e: used[case.body, e])
        used[case.body, chosen] += 1
        given[k] = replace(case, engine=chosen)
    return given


def _band(kind, name, level):
    """Within which the effect must move the points [m RMS]: around its level where its size can be chosen, else clearly."""
    if kind != "effect" or level is None or not EFFECTS[name].sized:
        return CLEAR
    return FLOOR * level / WIDTH, FLOOR * level * WIDTH / EFFECTS[name].most  # ``build`` multiplies the upper bound by ``most``
