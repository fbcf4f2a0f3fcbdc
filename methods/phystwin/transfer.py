"""A body of one recording in frame 0 of another: where its particles lie there, and which of them the hands pull."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...datasets.catalogue import self_collides
from ...datasets.scenario import Plane
from ..bending import bend, bend_once, is_sheet
from ..closest_points import colored, point_to_point
from ..registration import align, lifted
from .body import Body, Place, regrip
from .config import Quirks

__all__ = ["CONTACT", "STEP", "SUBSTEPS", "grasp", "laid"]

MARGIN = 0.005  # m: how much farther than its nearest particle a hand point reaches, at least
RADIUS, CLOSEST, NEIGHBOURS, PULL = 0.01, 10, 30, 3e4  # published: m, controllers that reach beyond it, springs of one, N
SUBSTEPS, STEP, CONTACT = 6667, 5e-6, 0.005  # published: per frame, s, m
COLOURED = ("zebra", "sloth")  # published: what is registered by its colours


def laid(body: Body, home: Place, place: Place, quirks: Quirks) -> np.ndarray:
    """Particles (M, 3) [m] of a body that stands at ``home``, as the tracked and surface points of ``place`` show it to lie there.

    Laid rigidly, by shape and colours, then bent as little as the points ask for, unless it is cloth (which collides with itself, or is a
    sheet), and lifted onto the ground. With ``named_transfer`` and ``rough_registration`` as published, but for what stands in for matched
    image features: see ``registration`` and ``bend_once``; with ``interior_registered`` interior points of both take part too. Coloured
    closest points are left to that mode: on the sample, of 350 particles 7 mm apart, they move a body that lies right to within 0.3 mm by
    5 cm.
    """
    structure = home.structure
    parts = 3 if quirks.interior_registered else 2
    (laid, ours), (cloud, theirs) = _first(home, parts), _first(place, parts)
    cloth = self_collides(home.name) if quirks.named_transfer else home.self_collision or is_sheet(home.structure)
    lying = align(structure, cloud, surface=len(laid), colors=ours, cloud_colors=theirs)
    if quirks.rough_registration:
        named = quirks.named_transfer and any(word in home.name for word in COLOURED)
        by_color = named and ours is not None and theirs is not None
        lying = colored(lying, ours, cloud, theirs) if by_color else point_to_point(lying, cloud, surface=len(laid))
    (outside, ours), (cloud, theirs) = _first(home, 2), _first(place, 2)
    if quirks.rough_registration and not cloth:
        lying = bend_once(lying, body.springs, cloud, surface=len(outside))
    elif not cloth:
        hues = dict(colors=ours, cloud_colors=theirs)
        lying = bend(lying, body.springs, cloud, surface=len(outside), spacing=_spacing(structure), **hues)
    return lifted(lying, None if place.ground is None else Plane(np.array(place.ground[:3]), place.ground[3]))


def _first(place, parts):
    """The first ``parts`` of tracked, surface and interior points (K, 3) [m], and their RGB, NaN where unknown; None if nowhere known."""
    points = place.structure[: sum(place.counts[:parts])]
    unknown = np.full((sum(place.counts[1:parts]), 3), np.nan)
    return points, None if place.colors is None else np.concatenate([place.colors, unknown])


def _spacing(structure):
    from scipy.spatial import cKDTree

    apart = cKDTree(structure).query(structure, k=2)[0][:, 1]
    return float(np.median(apart))


def grasp(body: Body, place: Place, quirks: Quirks) -> Body:
    """The body with hand springs drawn at a new place.

    Hand points reach as far, hold as many particles and pull as hard on average as was learned at the source. On the train frames of the
    sample a source that is held anew so loses 1.1 to 1.3 times what its own hand springs do, and 2.1 to 17 times by the published rule,
    which ``fixed_grip`` asks for.
    """
    hands = np.flatnonzero(place.grips < 0)
    if not len(hands):
        return replace(body, pulls=np.zeros((0, 2), np.int64), pull=np.zeros(0))
    apart = np.linalg.norm(place.controllers[0, hands][:, None] - place.structure[None], axis=2)
    nearest = apart.min(1)
    if not quirks.fixed_grip:
        radius = max(body.values["controller_radius"], float(nearest.min()) + MARGIN)
        wide = replace(body, values=body.values | {"controller_radius": radius})
        return replace(regrip(wide, place), values=body.values)
    close = np.argsort(nearest, kind="stable")[:CLOSEST]
    radii = np.full(len(hands), RADIUS)
    radii[close] = nearest[close] + MARGIN
    pairs = []
    for hand, radius, row in zip(hands, radii, apart, strict=True):
        order = np.argsort(row, kind="stable")[:NEIGHBOURS]
        pairs += [(len(place.structure) + hand, j) for j in order[row[order] < radius]]
    pulls = np.array(pairs, np.int64).reshape(-1, 2)
    return replace(body, pulls=pulls, pull=np.full(len(pulls), PULL))
