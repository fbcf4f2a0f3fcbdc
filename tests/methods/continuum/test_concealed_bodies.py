"""Stuffed bodies of known volume, thickness and grips through the sensor model; ``pytest --slow -s`` prints the table."""

from types import SimpleNamespace

import numpy as np
import pytest
from twinbench.datasets.concealed import bodies, motions, sensing
from twinbench.datasets.concealed.engine import simulate
from twinbench.datasets.concealed.world import Unstable
from twinbench.datasets.synthetic.simulate import to_world
from twinbench.methods.continuum.body import body_of
from twinbench.methods.continuum.hands import hands_of
from twinbench.methods.continuum.inside import Inside
from twinbench.methods.continuum.start import starts_at_rest

pytest.importorskip("mujoco")
SEED, DRAWS = 22, 13


def drawn():
    """(body, motion, recording) of each draw that is stable."""
    for k in range(DRAWS):
        rng = np.random.default_rng([SEED, k])
        body = bodies.draw("plush", rng)
        script = motions.draw(str(rng.choice(list(motions.KINDS))), body, rng)
        try:
            motion = simulate(body, script)
        except Unstable:
            continue
        tracker = sensing.Tracker.draw(rng)
        yield body, motion, sensing.observe(body, script, motion, tracker, sensing.Faults(), rng, name=f"plush {k}").observed()


def shares(body, vertices, held, points):
    """(P,) how much of each of ``points`` hangs on the vertices ``held``: the sum of its shape functions there."""
    corners = vertices[body.elements]
    inverse = np.linalg.inv(np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2))
    local = np.einsum("eij,pej->pei", inverse, points[:, None] - corners[None, :, 0])
    local = np.concatenate([1 - local.sum(-1, keepdims=True), local], -1)
    element = local.min(-1).argmax(1)
    weights = local[np.arange(len(points)), element]
    return np.clip((weights * np.isin(body.elements[element], held)).sum(1), 0, 1)


@pytest.mark.slow
def test_bodies_and_hands_are_those_of_the_truth():
    """Noise of a millimetre on bodies 25 mm thick: 3 % of the volume and 5 % of the thickness; the start is at rest by construction."""
    overlaps, count = [], 0
    for body, motion, recording in drawn():
        vertices = to_world(motion.vertices[0])
        truth = Inside(vertices, SimpleNamespace(simplices=body.elements), np.ones(len(body.elements), bool), 0.0)
        found, hands = body_of(recording), hands_of(recording)
        volume, thickness = found.volume / truth.volume - 1, found.thickness / truth.thickness - 1
        assert found.kind == "solid" and abs(volume) < 0.03 and abs(thickness) < 0.05 and len(found.grid.cells) <= 200
        assert starts_at_rest(recording).rest and len(hands) == len(motion.gripped)
        for hand in hands:
            mine = np.argmin([np.linalg.norm(to_world(p[0]) - hand.centre[0]) for p in motion.position])
            true = shares(body, vertices, motion.gripped[mine], recording.structure)
            firm = np.zeros(len(true))
            firm[hand.points] = hand.firmness
            overlaps.append(np.minimum(firm, true).sum() / np.maximum(firm, true).sum())
        count += 1
        print(f"{recording.name}: volume {volume:+.3f}, thickness {thickness:+.3f}, {len(found.grid.cells)} cells, held {overlaps[-1]:.2f}")
    assert count >= 10 and np.median(overlaps) > 0.5
