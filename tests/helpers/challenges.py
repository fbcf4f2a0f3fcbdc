"""A sealed challenge at no cost: sets without simulators, entrants that need no time."""

import json

import numpy as np
from twinbench.benchmark.challenge import answering, book, opening, scoring
from twinbench.benchmark.challenge.entrants.base import Entrant, answer
from twinbench.datasets.concealed import make as making
from twinbench.datasets.concealed.case import Case
from twinbench.datasets.concealed.engines import engine
from twinbench.datasets.concealed.plan import Preset
from twinbench.datasets.concealed.seal import digest
from twinbench.datasets.scenario import Scenario, Split

TINY = Preset(controls=3, levels=(1.0, 2.0), outside=1, pairs=1, effects=2)
MANY = Preset(controls=12, levels=(1.0,), outside=4, pairs=0, effects=8)
COMMIT = "c" * 40


def filmed(name, rng, *, frames=12, moved=0.0):
    """A recording of a few points; ``moved`` is what is concealed in it."""
    points = rng.normal(0, 0.1, (1, 15, 3)) + np.linspace(0, 0.1 + moved, frames)[:, None, None]
    there = np.ones(points.shape[:2], bool)
    about = {"fps": 30.0, "split": Split(8, frames), "gravity": [0, 0, 9.81]}
    return Scenario(name=name, points=points, visible=there, motion_valid=there, controllers=points[:, :3] + 0.01, **about)


def drawn(kind, name, body, *, seed, clear, like, engine, solids="tetrahedra", thin="coarse", recordings=1):
    """What ``build`` does, at no cost; a torn body cannot be drawn as a cloth."""
    if name == "tearing" and body == "cloth":
        raise RuntimeError("no tearing of a cloth")
    rng = np.random.default_rng(seed)
    frames = int(rng.integers(10, 15))
    size = 0.0 if kind == "control" else 0.05
    label = {"kind": kind, "effect": None if kind == "control" else name, "control": name if kind == "control" else None, "object": body}
    label |= {"displacement": size, "place": [None, None], "onset": [0, 0], "parameters": {"seed": seed}}
    pair = [filmed(part, rng, frames=frames, moved=size) for part in ("fit", "transfer")]
    more = tuple(filmed(f"fit_{k}", rng, frames=frames, moved=size) for k in range(2, recordings + 1))
    return Case(*pair, label | {"interactions": ["lift"] * (1 + recordings)}, more=more)


class InThisProcess:
    """An executor that runs at once, so that what is patched is seen."""

    def __init__(self, jobs):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *error):
        return False

    def submit(self, function, *given):
        from concurrent.futures import Future

        future = Future()
        future.set_result(function(*given))
        return future


class Guess(Entrant):
    """Says by how far the points go whether something is there: it moves 5 cm farther where there is."""

    name = "guess"

    def answer(self, given):
        far = np.ptp(given.fit.points[..., 0].mean(axis=1))
        said = answer("named", "wind", where={"points": [0], "centroid": [0.0, 0.0, 0.0], "radius": 0.01}, when={"frames": [0, 10]})
        errors = {part: {"baseline": 0.01, "extended": None, "noise_floor": 0.001} for part in ("train", "heldout", "transfer")}
        return (said if far > 0.125 else answer("adequate")) | {"fit": errors}


class Told(Guess):
    """Knows."""

    name, told = "told", True

    def answer(self, given):
        assert given.label is not None
        return answer("adequate") if given.label["kind"] == "control" else answer("unknown")


class Broken(Guess):
    """Fails."""

    name = "broken"

    def answer(self, given):
        raise RuntimeError("out of ideas")


FAKES = {entrant.name: entrant for entrant in (Guess(), Told(), Broken())}


def without_simulators(monkeypatch):
    """``make`` draws cases at once, in this process."""
    monkeypatch.setattr(making, "build", drawn)
    monkeypatch.setattr(making, "Pool", InThisProcess)
    monkeypatch.setattr(making, "require", lambda names: [engine(name) for name in names])


def with_fakes(monkeypatch, fakes=FAKES):
    """The entrants of our own are ``fakes``, by a commit without changes."""
    for module in (answering, book, opening):
        monkeypatch.setattr(module, "entrants", lambda: fakes)
    monkeypatch.setattr(answering, "commit", lambda: COMMIT)
    monkeypatch.setattr(scoring, "JUDGES", ("guess",))


def spoil(file, change):
    value = json.loads(file.read_text())
    change(value)
    file.write_text(json.dumps(value))


def republish(folder):
    manifest = json.loads(folder.manifest.read_text())
    manifest["cases"].pop("case_004")
    folder.manifest.write_text(json.dumps(manifest | {"root": digest({k: v for k, v in manifest.items() if k != "root"})}))
