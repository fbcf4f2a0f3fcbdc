"""Bodies, hands and observers by which the engines of concealed bodies are held against closed forms."""

from dataclasses import replace

import numpy as np
from twinbench.datasets.concealed.bodies import Body, lumped
from twinbench.datasets.concealed.motions import Script
from twinbench.datasets.synthetic.interactions import Interaction


def sheet(*, size=0.1, width=None, cells=4, height=0.0, tension=50.0, mass=0.01, poisson=0.0, thickness=1e-3, radius=1e-3, **more):
    """A cloth of squares, each halved; ``width`` across, ``size`` along x. No damping or drag unless asked."""
    n, k = cells + 1, round(cells * (width or size) / size) + 1
    x, y = np.meshgrid(np.linspace(0, size, n), np.linspace(0, width or size, k), indexing="ij")
    index = np.arange(n * k).reshape(n, k)
    a, b, c, d = (i.ravel() for i in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    vertices = np.stack([x.ravel(), y.ravel(), np.full(n * k, height)], 1)
    about = {"poisson": poisson, "thickness": thickness, "drag": 0.0, "damping": 0.0} | more
    body = Body("cloth", vertices, faces, faces, np.ones(n * k), radius, tension / thickness, **about)
    return replace(body, mass=lumped(faces, body.measure, mass, n * k))


def cord(*, length=0.4, count=21, height=0.0, rigidity=1e-5, mass=0.03, radius=4e-3, **more):
    """A straight rope along x from the origin, without damping or drag unless asked."""
    x = np.linspace(0, length, count)
    vertices = np.stack([x, 0 * x, np.full(count, height)], 1)
    elements = np.stack([np.arange(count - 1), np.arange(1, count)], 1)
    young = rigidity / (np.pi * radius**4 / 4)
    about = {"drag": 0.0, "damping": 0.0, "shear": 1e-3 * young} | more
    body = Body("rope", vertices, elements, np.zeros((0, 3), int), np.ones(count), radius, young, **about)
    return replace(body, mass=lumped(elements, body.measure, mass, count))


def holding(*places, frames=31, turn=None, move=None, reach=0.025):
    """Hands that close around ``places`` and stay, or of which the first goes to ``move`` and turns by ``turn`` within a second."""
    zero = (0.0, 0.0, 0.0)
    hands = []
    for i, place in enumerate(places):
        there, about = (zero, zero) if i else (tuple(move or zero), tuple(turn or zero))
        hands.append(Interaction("hand", grip=tuple(place), grip_radius=reach, times=(0.0, 1.0), moves=(zero, there), turns=(zero, about)))
    return Script("hold", tuple(hands), frames)


def watch(seen):
    """A law without force that keeps what ``seen`` (world -> value) says in every step."""
    kept = []
    return (lambda world: lambda time, x, v: kept.append((time, seen(world)))), kept


def stretched(body, share):
    """Positions of a body that is longer along x by a ``share``."""
    return body.vertices * [1 + share, 1, 1]
