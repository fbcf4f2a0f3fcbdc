"""What a net of springs lacks: where it and a recording part, which physics was left out, and what it gains to put it in."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from ..datasets.scenario import Scenario
from ..datasets.temporary import replacing
from .config import of_preset
from .fit import gaps, mean_error
from .ground import is_raised
from .inquiry import PRESETS, Inquiry, Preset, Refit, inquire
from .keeping import write_tracks, write_twins
from .locate import clusters
from .page.document import plain
from .planner import experiment
from .report import write_report
from .verdict import NONE, Calibration, Decision, alike, calibration, context, decide, readings

__all__ = ["NAMES", "Diagnosis", "affordable", "ask_springs", "noise_floor"]

NAMES = (
    *("quadratic_drag", "plate_drag", "wind", "gravity_tilt", "strain_stiffening", "compression_softening", "anisotropy", "bending"),
    *("bending_damping", "torsion", "plasticity", "creep", "viscoelastic", "internal_friction", "added_mass", "pressure", "friction_law"),
    *("ground_adhesion", "hidden_obstacle", "ground_pose", "self_contact", "hidden_tether", "grip_slip", "grip_compliance", "tearing"),
    *("rest_shape", "controller_delay", "camera_pose", "track_drift", "grip_points"),
)
LONG = 90  # frames: longer recordings get coarser replicas
STUFFED = 0.6  # of the nodes are enough for a body with an inside: it fits as well with these, in less than half the time
FEWEST = 60  # nodes
SEEN = 3.3  # standard errors: an effect of this size is noticed in 95 of 100 recordings at a level of 5 % (1.65 + 1.65)
DEPARTS = 0.15  # of the extension's largest difference from the baseline: from then on it acts
# effects that begin; the others act from the first frame
SUDDEN = ("grip_slip", "tearing", "hidden_obstacle", "self_contact", "plasticity")


@dataclass(frozen=True)
class Diagnosis:
    """result: what ``diagnosis.json`` holds; arrays: what the report draws, see ``write_report``; inquiry: all the evidence.

    chosen: the refit of what it names, or None.
    """

    result: dict
    arrays: dict
    inquiry: Inquiry
    chosen: Refit | None = None

    def write(self, out: str | Path) -> None:
        """Write ``diagnosis.json``, ``report.html`` and ``tracks.npz`` into the folder ``out``, each in one rename."""
        out = Path(out)
        with replacing(out / "diagnosis.json") as temporary:
            temporary.write_text(json.dumps(plain(self.result), indent=1, allow_nan=False), encoding="utf-8")
        nodes = self.result["evidence"]["where_nodes"]
        where = self.result["where"]
        shown = {**self.result, "where": where and {**where, "points": nodes}}
        write_report(shown, self.arrays, out / "report.html")
        write_tracks(self.arrays, out)
        write_twins({}, out)


def ask_springs(
    scenario: Scenario,
    *,
    transfer: Sequence[Scenario] = (),
    fitted_on: Sequence[Scenario] = (),
    preset: str = "quick",
    device: str = "cpu",
    weights: Calibration | None = None,
    progress: Callable[[str], None] = lambda said: None,
) -> Diagnosis:
    """Which physics a net of springs lacks of the object in ``scenario``, see ``diagnose``. Raises ValueError for an unknown preset or a
    recording that is too short."""
    begun = time.time()
    inquiry = inquire(
        scenario,
        transfer,
        fitted_on,
        train_end=scenario.split.train_end,
        preset=affordable(of_preset(PRESETS, preset), scenario),
        device=device,
        progress=progress,
    )
    found, weights = readings(inquiry), weights or calibration()
    around = context(inquiry, found)
    pairs = alike(inquiry, found)
    decision = decide(found, around, weights, pairs)
    chosen = next((r for r in inquiry.refits if decision.chosen and r.score.hypothesis.term.name == decision.chosen.term), None)
    before = inquiry.free(inquiry.base)
    after = inquiry.free(chosen.found) if chosen else None
    change = np.linalg.norm(after[0] - before[0], axis=-1) if after is not None else None
    nodes, where = _where(inquiry, chosen, change)
    advice, planned = experiment(inquiry, decision)
    result = {
        "schema": 1,
        "verdict": decision.verdict,
        "effect": decision.effect,
        "alternatives": list(decision.alternatives),
        "probabilities": {name: round(p, 4) for name, p in decision.probabilities.items()},
        "where": where,
        "when": _when(inquiry, decision, chosen, change),
        "parameters": _parameters(chosen, inquiry),
        "fit": _errors(inquiry, chosen, before[0]),
        "detectable": _detectable(inquiry),
        "experiment": advice,
        "evidence": {
            "hypotheses": _table(inquiry, decision),
            "clusters": _clusters(inquiry),
            "noise_floor": noise_floor(inquiry),
            "notes": _notes(inquiry, decision),
            "recordings": _recordings(inquiry),
            "readings": [{"effect": r.effect, "term": r.term, **r.features} for r in found],
            "context": around,
            "balance": asdict(inquiry.balance) if inquiry.balance else None,
            "alike": [list(pair) for pair in pairs],
            "plan": planned,
            "where_nodes": nodes,
            "twin": inquiry.base.fit.values,
        },
        "seconds": None,
    }
    arrays, curves = _arrays(inquiry, before, after)
    result["evidence"]["curves"] = curves
    result["seconds"] = round(time.time() - begun, 3)
    return Diagnosis(result, arrays, inquiry, chosen)


def affordable(preset: Preset, scenario: Scenario) -> Preset:
    """Fewer nodes where a recording is long or a body has an inside, so that a diagnosis takes minutes."""
    share = min(1.0, (LONG / len(scenario.points)) ** 0.5) * (STUFFED if len(scenario.interior) else 1.0)
    return replace(preset, nodes=int(max(FEWEST, preset.nodes * share)))


def noise_floor(inquiry: Inquiry) -> float:
    """Mean length [m] of the noise vector of a node: sqrt(8 / pi) standard deviations of a coordinate."""
    return float(np.sqrt(8 / np.pi) * inquiry.case.sightings.noise)


def _errors(inquiry, chosen: Refit | None, free):
    """Mean errors of free runs by part, ``free`` (F, n, 3) that of the baseline on the case; several transfer recordings count alike."""
    floor, out = noise_floor(inquiry), {}
    for name, parts in (("train", ["train"]), ("heldout", ["heldout"]), ("transfer", inquiry.transferred)):
        if not parts:
            continue

        def mean(source, parts=parts):
            return float(np.mean([source.free[p] for p in parts])) if source else None

        baseline = chosen.against if chosen else inquiry.base
        out[name] = {
            "baseline": mean(baseline),
            "extended": mean(chosen.found if chosen else None),
            "noise_floor": floor,
            "last_residual": _last_residual(inquiry, free) if name == "heldout" else None,
            "learned_residual": mean(inquiry.yardstick.found),
        }
    return out


def _last_residual(inquiry, free):
    """Mean error [m] on held-out frames of the run ``free`` shifted, node by node, by its last error on a training frame."""
    replica, part = inquiry.case, inquiry.parts[1]
    residual = replica.sightings.position[: part.first] - free[: part.first]
    last = np.zeros(residual.shape[1:])
    for frame in residual:  # the last frame in which each node was seen
        seen = np.isfinite(frame[:, 0])
        last[seen] = frame[seen]
    return mean_error(replica, free + last, part.first, part.last)


def _where(inquiry, chosen, change):
    """Nodes, and the place as ``diagnosis.json`` has it: none of an effect without one, the held nodes of one at the hands."""
    if chosen is None:
        return [], None
    replica, effect = inquiry.case, chosen.score.hypothesis.term.effect
    values = chosen.found.fit.values
    if effect.place:
        centre = np.array([values[f"{effect.place}_{axis}"] for axis in "xyz"])
        reach = float(values.get(effect.within, replica.spacing))
        distance = np.linalg.norm(replica.nodes - centre, axis=1)
        in_room = effect.name == "hidden_obstacle"
        near = max(reach, 0.75 * replica.spacing, 0.0 if in_room else distance.min())  # of what lies beside the body, its nearest node
        nodes = np.flatnonzero(distance <= near)
        centroid = centre if in_room else replica.nodes[nodes].mean(0)
        return nodes.tolist(), {"points": replica.particles(nodes), "centroid": centroid.tolist(), "radius": reach}
    if effect.name.startswith("grip"):
        nodes = _worst_grip(inquiry.case, change)
        if len(nodes):
            centre = replica.nodes[nodes].mean(0)
            radius = float(np.linalg.norm(replica.nodes[nodes] - centre, axis=1).max())
            return nodes.tolist(), {
                "points": replica.particles(nodes),
                "centroid": centre.tolist(),
                "radius": max(radius, replica.spacing / 2),
            }
    return [], None


def _worst_grip(replica, change):
    """Nodes held by the hand around which the ``change`` (F, n) by the extension is largest."""
    from ..methods.continuum.hands import labels_of

    ties = replica.system.springs[replica.links]
    if not len(ties):
        return np.zeros(0, int)
    count = len(replica.nodes)
    hand = np.where(ties[:, 0] >= count, ties[:, 0], ties[:, 1]) - count
    node = np.where(ties[:, 0] >= count, ties[:, 1], ties[:, 0])
    label = labels_of(replica.recording.controllers[:1])
    change = np.nanmean(change, axis=0)
    groups = [np.unique(node[label[hand] == one]) for one in np.unique(label[hand])]
    return max(groups, key=lambda g: float(np.nanmean(change[g])))


def _when(inquiry, decision: Decision, chosen, change):
    """Frames of the case in which the effect acts: from the first in which its ``change`` (F, n) m is clear, if it is one that begins."""
    if chosen is None:
        return None
    frames = inquiry.case.frames
    if decision.effect not in SUDDEN:
        return {"frames": [0, frames]}
    far = np.sort(np.nan_to_num(change), axis=1)[:, -max(1, change.shape[1] // 20) :].mean(1)
    limit = max(DEPARTS * far.max(), 2 * noise_floor(inquiry))
    late = np.flatnonzero(far > limit)
    return {"frames": [int(late[0]) if len(late) else 0, frames]}


def _parameters(chosen, inquiry):
    """The effect's own parameters, with 90 % intervals from the curvature of the fit.

    How far a ground is below the told one is not known where what was seen below was raised onto that.
    """
    if chosen is None:
        return {}
    fit, hypothesis = chosen.found.fit, chosen.score.hypothesis
    units = {p.name: p.unit for p in hypothesis.term.parameters}
    out = {}
    for k, knob in enumerate(fit.model.knobs):
        if knob.name in units:
            spread = 1.645 * float(np.sqrt(max(fit.covariance[k, k], 0.0))) if np.isfinite(fit.covariance[k, k]) else np.inf
            ends = sorted((knob.decode(np.clip(fit.z[k] - spread, -1e3, 1e3)), knob.decode(np.clip(fit.z[k] + spread, -1e3, 1e3))))
            out[knob.name] = {"value": knob.decode(fit.z[k]), "unit": units[knob.name], "interval90": ends}
    for name, value in hypothesis.values.items():
        if name not in out:
            out[name] = {"value": float(value), "unit": units[name], "interval90": [float(value)] * 2}
    if "ground_raise" in out and is_raised(inquiry.case.recording):
        out["ground_raise"]["interval90"][0] = None
    return out


def _detectable(inquiry):
    """By effect: the smallest amplitude that would have stood out here, in the unit of its first parameter; None if untested."""
    out = dict.fromkeys(NAMES)
    for score in inquiry.scores:
        h = score.hypothesis
        size = SEEN * float(np.sqrt(np.mean(np.square(score.error))))
        responds = float(np.abs(score.direction).sum()) > 0 or score.kept > 0
        if responds and np.isfinite(size) and size < max(abs(k.high) for k in h.knobs):
            out[h.effect] = size if (known := out.get(h.effect)) is None else min(known, size)
    return out


def _table(inquiry, decision):
    """A row for every effect that was tried: gains after the refit, or linear ones with the reason why it went no further."""
    rows = [
        {
            "effect": "baseline",
            "kind": "baseline",
            "train_gain": 0.0,
            "heldout_gain": 0.0,
            "transfer_gain": 0.0 if inquiry.transfers else None,
        }
    ]
    refitted = {r.score.hypothesis.term.name: r for r in inquiry.refits}
    for term, score in inquiry.best().items():
        h, refit = score.hypothesis, refitted.get(term)
        amplitude = _amplitude(refit.found.fit, h) if refit else float(np.linalg.norm(score.amplitude))
        gains = {p.name: (refit.gain(p.name) if refit else score.gains.get(p.name, np.nan)) for p in inquiry.parts}
        transfer = [gains[t] for t in inquiry.transferred]
        rows.append(
            {
                "effect": h.effect,
                "kind": "refitted" if refit else "linear estimate",
                "term": term,
                "train_gain": _finite(gains["train"]),
                "heldout_gain": _finite(gains["heldout"]),
                "transfer_gain": _finite(float(np.mean(transfer))) if transfer else None,
                "absorbed": 1 - min(1.0, score.kept),
                "amplitude": amplitude,
                "unit": {p.name: p.unit for p in h.term.parameters}[h.knobs[0].name],
                "probability": decision.probabilities.get(h.effect) if refit else None,
                "why": _why(refit, score, gains, transfer, decision),
            }
        )
    transfer = [inquiry.yardstick.gain(t) for t in inquiry.transferred]
    rows.append(
        {
            "effect": "learned_residual",
            "kind": "yardstick",
            "train_gain": _finite(inquiry.yardstick.gain("train")),
            "heldout_gain": _finite(inquiry.yardstick.gain("heldout")),
            "transfer_gain": _finite(float(np.mean(transfer))) if transfer else None,
        }
    )
    return sorted(rows, key=lambda r: (r["kind"] == "yardstick", -(r.get("probability") or 0.0), -(r.get("train_gain") or 0.0)))


def _finite(value):
    return float(value) if np.isfinite(value) else None


def _amplitude(fit, hypothesis):
    return float(np.linalg.norm([fit.values[k.name] for k in hypothesis.knobs]))


def _why(refit, score, gains, transfer, decision):
    """One clause: what decided about this effect."""
    if decision.effect == score.hypothesis.effect:
        return "chosen"
    if score.kept < 0.05:
        return "the twin's own parameters absorb it"
    if refit is None:
        return "its linear estimate explains less than others"
    if gains["train"] < 0.05:
        return "explains nothing when fitted"
    if gains["heldout"] < 0.02:
        return "does not hold on the held-out frames"
    if transfer and np.mean(transfer) < 0.02:
        return "does not hold on the other interaction"
    return "no more than a twin without fault gains by chance" if decision.verdict == NONE else "others explain more"


def _clusters(inquiry):
    """Patches and times in which the baseline and the training frames part."""
    simulator, replica = inquiry.simulators[0], inquiry.case
    found = clusters(simulator, inquiry.watched[0][: inquiry.train_end], floor=max(noise_floor(inquiry), 1e-4))[:8]
    out = []
    for one in found:
        middle = replica.nodes[one.nodes].mean(0)
        radius = float(np.linalg.norm(replica.nodes[one.nodes] - middle, axis=1).max())
        out.append({"points": one.nodes.tolist(), "centroid": middle.tolist(), "radius": radius, "frames": list(one.frames)})
        out[-1] |= {"strength": one.strength, "p": one.p}
    return out


def _notes(inquiry, decision):
    said = [f"The twin that was questioned has {len(inquiry.case.nodes)} nodes, {1000 * inquiry.case.spacing:.0f} mm apart."]
    if not inquiry.transfers:
        said.append("No transfer recording was given: what is said rests on held-out frames of the same interaction.")
    turned = inquiry.balance
    if turned:
        said.append(
            f"The torques on the hanging body say, without any twin, that the air brakes it by {turned.drag:.1f} per second (give or take "
            f"{turned.doubt:.1f}; usual is 0 to 2) and that {turned.lean:.1f} m/s^2 pull it aside (1 and less is error)."
        )
    wrong = inquiry.case.sightings.wrong
    if wrong.any():
        said.append(f"{int(wrong.sum())} of {len(wrong)} tracks leave their neighbours for good; they were left out.")
    if decision.verdict == NONE:
        said.append("Effects below the sizes listed as detectable may still be there.")
    return said


def _recordings(inquiry):
    roles = ["case"] + ["transfer"] * inquiry.transfers + ["fitted_on"] * (len(inquiry.simulators) - 1 - inquiry.transfers)
    out = []
    for role, simulator in zip(roles, inquiry.simulators, strict=True):
        replica = simulator.replica
        one = {
            "name": replica.name,
            "role": role,
            "frames": replica.frames,
            "points": len(replica.nodes),
            "fps": float(replica.recording.fps),
        }
        out.append(one | {"train_end": inquiry.train_end if role == "case" else 0})
    return out


def _arrays(inquiry, before, after):
    """What the report draws, and the error curves by recording [m per frame], of free runs without and with what was chosen (or None)."""
    arrays, curves = {}, {}
    for r, simulator in enumerate(inquiry.simulators[: 1 + inquiry.transfers]):
        replica = simulator.replica
        arrays[f"observed_{r}"] = replica.sightings.position
        arrays[f"baseline_{r}"] = before[r]
        arrays[f"force_{r}"] = inquiry.push[r]
        if replica.recording.controllers.size:
            arrays[f"controllers_{r}"] = replica.recording.controllers[: replica.frames]
        curves[replica.name] = {"baseline": _curve(replica, before[r]), "noise_floor": noise_floor(inquiry)}
        if after:
            arrays[f"extended_{r}"] = after[r]
            curves[replica.name]["extended"] = _curve(replica, after[r])
    gravity = np.asarray(inquiry.case.recording.gravity, float)
    if np.linalg.norm(gravity) > 0:
        arrays["up"] = -gravity / np.linalg.norm(gravity)
    ground = inquiry.case.recording.ground
    if ground is not None:
        arrays["ground"] = np.append(ground.normal / np.linalg.norm(ground.normal), ground.offset / np.linalg.norm(ground.normal))
    return arrays, curves


def _curve(replica, predicted):
    with np.errstate(all="ignore"):
        return [None if not np.isfinite(g).any() else float(np.nanmean(g)) for g in gaps(replica, predicted)]
