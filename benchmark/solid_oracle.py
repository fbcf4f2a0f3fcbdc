"""What an oracle gains that is told an effect: ``python -m twinbench.benchmark.solid_oracle SET --out FILE``.

A SET is a folder of concealed bodies, stuffed ones, ropes or cloths, with an effect and their truths. A sound twin is fitted to the first
recording; then one whose physics has the term of the effect, at its true place and with its true direction, with the amounts fitted, from
the sound twin's values on. The share of the error that it closes on the other recording says what naming the effect could gain at most with
these twins.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..datasets.concealed.world import FPS
from ..methods.base import Diverged
from ..methods.continuum import Continuum
from ..methods.continuum.config import DENSITY
from ..methods.continuum.joint import scenes_of
from ..methods.continuum.unknowns import Unknown
from ..physics import terms
from .opening import open_scenario
from .solid_twins import errors
from .studies import cases_of, study

__all__ = ["main", "simulated", "told"]

CLEAR = 20.0  # mm, RMS, by which an effect moves what is to be judged
MATERIAL = ("viscoelastic", "anisotropy", "compression_softening", "creep")  # whose terms are of a solid's cells or of a sheet


def told(label: dict, scene: Any, recording: int = 0) -> tuple[tuple, list[Unknown], dict]:
    """(terms, unknown amounts, what is told) of a label's effect, for the ``scene`` of one of its two recordings, 0 or 1.

    Raises KeyError for an effect that no term of the scene's body says: beside what is not in the engine, what a sound twin of its kind
    fits already, as the stiffness of a rope.
    """
    effect, known = label["effect"], label["parameters"]
    place: Any = next((p for p in [*label["place"][recording:], *label["place"]] if p), None)
    if scene.body.kind == "sheet" and effect in MATERIAL:
        return _told_of_sheet(effect)
    if scene.body.kind != "solid" and effect in MATERIAL:
        raise KeyError(f"{effect} of a {scene.body.kind}")
    if effect == "viscoelastic":
        return (terms.Maxwell(),), [_amount("maxwell_share", 1.0, 0.05, 20.0, "-"), _amount("maxwell_time", 0.15, 0.01, 2.0, "s")], {}
    if effect == "added_mass":
        at = _at("added_mass", place["centroid"]) | {"added_mass_within": place["radius"]}
        return (terms.AddedMass(),), [_amount("added_mass", 0.2, 0.01, 10.0, "-")], at
    if effect == "wind":
        pulls = [_bounded(terms.Wind, f"wind_{axis}", 0.0) for axis in "xyz"]
        return (terms.Wind(),), [*pulls, _amount("wind_speed", 3.0, 0.2, 50.0, "m/s")], {}
    if effect == "gravity_tilt":
        tilts = [_bounded(terms.GravityTilt, f"tilt_{axis}", 0.0) for axis in "xyz"]
        return (terms.GravityTilt(),), tilts, _at("told_gravity", scene.gravity)
    if effect == "anisotropy":
        x, y, z = scene.body.grid.axes @ np.asarray(known["axis_frame0"])
        way = {"fibre_azimuth": float(np.arctan2(y, x)), "fibre_elevation": float(np.arcsin(np.clip(z, -1, 1))), "fibre_compression": 1.0}
        return (terms.Fibres(),), [_amount("fibre_share", 1.0, 0.05, 50.0, "-")], way
    if effect == "compression_softening":
        return (terms.TensionCompression(),), [_bounded(terms.TensionCompression, "tension_share", 0.1)], {}
    if effect == "grip_compliance":
        amounts = [_amount("grip_rate", 100.0, 5.0, 1500.0, "1/s"), _amount("grip_damping", 1.0, 0.01, 20.0, "-")]
        return (), amounts, {"grip_hand": 0.0}  # the one that gives way is the first
    if effect == "controller_delay":
        return (terms.ControllerDelay(),), [_bounded(terms.ControllerDelay, "controller_delay", 0.0)], {}
    if effect == "quadratic_drag":
        return (terms.QuadraticDrag(),), [_amount("quadratic_drag", 3.0, 0.05, 1000.0, "1/m")], {}
    if effect == "creep":
        return (terms.NortonCreep(),), [_amount("norton_rate", 1.0, 0.05, 20.0, "1/s")], {}
    if effect == "hidden_tether" and not known["moves"]:
        tied = _at("tether", place["centroid"]) | _at("tether_anchor", known["anchor"])
        tied |= {"tether_within": place["radius"], "tether_length": known["rest_m"]}
        return (terms.HiddenTether(),), [_amount("hidden_tether", 500.0, 5.0, 10000.0, "1/s^2")], tied
    if effect == "hidden_obstacle" and known["shape"] == "sphere":
        there = _at("obstacle", place["centroid"]) | {"obstacle_radius": known["size_m"]}
        return (terms.HiddenObstacle(),), [_amount("hidden_obstacle", 5000.0, 100.0, 20000.0, "1/s^2")], there
    if effect == "ground_adhesion":
        plane = _at("adhesion_normal", scene.ground.normal)
        plane |= {"adhesion_offset": float(scene.ground.offset), "adhesion_reach": known["reach_m"]}
        return (terms.GroundAdhesion(),), [_amount("ground_adhesion", 5.0, 0.1, 100.0, "m/s^2")], plane
    raise KeyError(effect)


def _told_of_sheet(effect) -> tuple[tuple, list[Unknown], dict]:
    """``told`` of an effect of its material. Raises KeyError for one whose direction would have to be told in its axes."""
    if effect == "viscoelastic":
        branch = [_amount("sheet_branch_share", 1.0, 0.05, 20.0, "-"), _amount("sheet_branch_time", 0.15, 0.01, 2.0, "s")]
        return (terms.SheetRelaxing(),), branch, {}
    if effect == "creep":
        return (terms.SheetCreep(),), [_amount("sheet_creep_rate", 1.0, 0.05, 20.0, "1/s")], {}
    if effect == "compression_softening":
        return (terms.MembraneSlack(),), [_bounded(terms.MembraneSlack, "slack_stiffness", 10.0)], {}
    raise KeyError(f"{effect} of a sheet")


def _at(prefix, place):
    """Parameters that say a ``place`` (3,)."""
    return {f"{prefix}_{axis}": float(c) for axis, c in zip("xyz", place, strict=True)}


def _bounded(term, name, value):
    """An amount that may be whatever its ``term`` allows."""
    known = next(p for p in term.parameters if p.name == name)
    return Unknown(name, value, known.low, known.high, known.unit)


def _amount(name, value, low, high, unit):
    """An amount of which nothing is known but its order: an oracle that is told an effect has no opinion on its size."""
    return Unknown(name, value, low, high, unit, "log")


def simulated(label: dict) -> dict:
    """What the truth was made of, as a twin's values, where its effect has amounts of the same meaning; {} where not.

    Of what is no solid, the effect's amounts alone.
    """
    body, known = label["body"], label["parameters"]
    skin, thin = body["area_m2"] / body["mass_kg"], body["kind"] == "cloth"
    branch = ("sheet_branch_share", "sheet_branch_time") if thin else ("maxwell_share", "maxwell_time")
    amounts = {
        "viscoelastic": lambda: dict(zip(branch, (known["ratio"], known["time_s"]), strict=True)),
        "added_mass": lambda: {"added_mass": 1e-3 * known["added_g"] / (body["mass_kg"] - 1e-3 * known["added_g"])},  # labels weigh all
        "wind": lambda: _blowing(np.array(known["velocity_m_s"]), known["coefficient_kg_m3"] * skin),
        "quadratic_drag": lambda: {"quadratic_drag": known["coefficient_kg_m3"] * skin},
        "creep": lambda: {"sheet_creep_rate" if thin else "norton_rate": 1 / known["time_s"]},
        "gravity_tilt": lambda: dict(zip(("tilt_x", "tilt_y", "tilt_z"), known["gravity_m_s2"], strict=True)),
        "controller_delay": lambda: {"controller_delay": -known["frames"] / FPS},  # hands are reported late, so the body is early
    }.get(label["effect"])
    if amounts is None:
        return {}
    if body["kind"] != "plush":
        return amounts()
    material = dict(youngs_modulus=DENSITY * body["young"] / body["density"], poisson=body["poisson"], damping_time=body["damping"])
    return material | dict(drag_damping=body["drag"], coulomb_friction=body["friction"]) | amounts()


def _within(values, extra) -> bool:
    """Whether the parameters of terms may have ``values``: truths are made larger than what a diagnosis looks for."""
    return all(p.low <= values.get(p.name, p.value) <= p.high for term in extra for p in term.parameters)


def _blowing(velocity, rate):
    """Wind of a ``velocity`` (3,) m/s that pulls by ``rate`` [1/m] |w - v| (w - v) on a unit of mass."""
    speed = float(np.linalg.norm(velocity))
    return {f"wind_{axis}": float(v) for axis, v in zip("xyz", rate * speed * velocity, strict=True)} | {"wind_speed": speed}


def case_row(folder: str, case: str, seed: int = 0) -> dict:
    """Errors [mm] of the sound and the told twin on held-out and transfer frames, and the share that is closed.

    And of the told twin in its own grips with what was simulated for its values, where that can be said: what is left then is not a
    matter of fitting.
    """
    root = Path(folder)
    label = json.loads((root / "labels.json").read_text(encoding="utf-8"))[case]
    truth = np.load(root / "truth" / f"{case}.npz")
    home, away = (open_scenario(str(root / case / part)) for part in ("fit", "transfer"))
    row: dict[str, Any] = dict(set=root.name, case=case, kind=label["object"], effect=label["effect"])
    row |= dict(moved=1e3 * label["displacement_transfer"], seconds=time.process_time())
    method, config = Continuum(), Continuum.presets["quick"]
    extra, amounts, fixed = told(label, scenes_of([home.observed()], config, seed=seed)[1][0])
    sound = method.fitted([home.observed()], config, seed=seed)
    knowing = method.fitted(
        [home.observed()],
        config,
        begin=sound.values | {f"rec0_{name}": value for name, value in sound.values.items()},
        seed=seed,
        extra=extra,
        extra_unknowns=amounts,
        fixed=fixed,
    )
    twins = {"sound": sound, "told": knowing}
    true = simulated(label)
    if true and _within(true, extra):
        twins["true"] = replace(knowing, values=knowing.values | true)
    for name, twin in twins.items():
        row[f"held_out_{name}"] = _error(twin, home, truth["fit_points"], home.split.train_end)
        there = twin.retarget(away.initial())
        if name != "sound":
            there = replace(there, values=there.values | told(label, there.scene, 1)[2])
        row[f"transfer_{name}"] = _error(there, away, truth["transfer_points"], 0)
    for part in ("held_out", "transfer"):
        row[f"closed_{part}"] = 1 - row[f"{part}_told"] / row[f"{part}_sound"]
        row[f"closed_by_truth_{part}"] = 1 - row.get(f"{part}_true", np.nan) / row[f"{part}_sound"]
    row["amounts"] = json.dumps(
        {u.name: knowing.values[u.name] for u in amounts} | {k: label["parameters"][k] for k in label["parameters"]}
    )
    return row | dict(seconds=time.process_time() - row["seconds"])


def _error(twin, scenario, places, first):
    try:
        return float(np.nanmean(errors(twin.rollout(scenario.controllers), places, scenario.visible)[first:]))
    except Diverged:
        return np.nan


def main(arguments=None) -> None:
    import pandas as pd

    parser = argparse.ArgumentParser(prog="python -m twinbench.benchmark.solid_oracle", description=str(__doc__).split("\n")[0])
    parser.add_argument("set", help="folder of cases with labels.json and truth/")
    parser.add_argument("--cases", nargs="+", help="some of them")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", help="CSV of all rows; cases that are in it are not done again")
    given = parser.parse_args(arguments)
    work = {(folder.name, case): partial(case_row, str(folder), case) for folder, case in cases_of([given.set], given.cases)}
    rows = study(work, ("set", "case"), jobs=given.jobs, out=given.out)
    table = pd.DataFrame(rows)
    if len(table):
        names = [
            "case",
            "kind",
            "effect",
            "moved",
            "held_out_sound",
            "held_out_told",
            "transfer_sound",
            "transfer_told",
            "closed_transfer",
            "closed_by_truth_transfer",
        ]
        print(table[names].round(2).to_string(index=False))
        for kind, own in table.groupby("kind"):
            clear = own[own.moved >= CLEAR].closed_transfer
            print(f"{kind}: closed on the other recording, median of {len(own)}: {own.closed_transfer.median():.2f}", end="")
            print(f", of {len(clear)} that are moved by {CLEAR:g} mm and more there: {clear.median():.2f}")


if __name__ == "__main__":
    main()
