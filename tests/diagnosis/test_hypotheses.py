"""Where hypotheses look: places, anchors, and how far in doubt a number is."""

from dataclasses import replace

import numpy as np
import pytest
from twinbench.diagnosis.hypotheses import ANY, DOUBTS, hypotheses_for
from twinbench.physics.terms.gravity_tilt import GravityTilt
from twinbench.physics.terms.hidden_obstacle import HiddenObstacle
from twinbench.physics.terms.hidden_tether import HiddenTether
from twinbench.physics.terms.wind import Wind


@pytest.fixture(scope="module")
def hanging(tiny):
    return tiny.drawn(tiny.concealing(frames=24))


def tried(simulator, term, *, push=None):
    seen = simulator.replica.sightings.position
    push = np.zeros_like(seen) if push is None else push
    return [h for h in hypotheses_for(simulator, seen, push) if h.term is term]


def test_gravity_may_point_elsewhere_but_keeps_its_size(hanging):
    (one,) = tried(hanging, GravityTilt)  # gravity is along z here
    assert {k.name: k.prior for k in one.knobs} == {"tilt_x": ANY, "tilt_y": ANY}


def test_a_wind_blows_level_or_nearly_so(hanging):
    # one that carries the weight of the body would be told from a hand that holds it by nothing
    for one in tried(hanging, Wind):
        assert [k.prior for k in one.knobs] == [ANY, ANY, DOUBTS["wind"] * ANY]


def test_without_gravity_any_uniform_pull_is_possible(tiny):
    (one,) = tried(tiny.drawn(tiny.concealing(frames=24, gravity=np.zeros(3))), GravityTilt)
    assert [k.prior for k in one.knobs] == [ANY] * 3


def test_a_tether_is_tried_where_its_pull_points_to_and_where_it_lay(hanging):
    # a patch that is pushed by k (anchor - x): least squares gives the anchor back exactly
    x, anchor, k = hanging.replica.sightings.position, np.array([0.3, -0.2, 0.1]), 40.0
    places = tried(hanging, HiddenTether, push=k * (anchor - x))
    ends = np.array([[h.values[f"tether_anchor_{a}"] for a in "xyz"] for h in places])
    home = np.array([h.place for h in places])
    lay = np.linalg.norm(ends - home, axis=1) < 1e-9
    assert lay.sum() == len(places) / 2
    np.testing.assert_allclose(ends[~lay], np.broadcast_to(anchor, ends[~lay].shape), atol=1e-6)
    assert {f"tether_anchor_{a}" for a in "xyz"} <= {k.name for k in places[0].free_knobs(0.03)}  # and a refit may move it


def test_an_obstacle_is_looked_for_behind_the_hardest_push(hanging):
    # one node and its neighbours are pushed to the side in one frame, all others a little and for long
    replica, way = hanging.replica, np.array([0.0, 1.0, 0.0])
    push = np.full_like(replica.sightings.position, 0.05)
    node, frame = 7, 12
    near = np.argsort(np.linalg.norm(replica.nodes - replica.nodes[node], axis=1))[:7]
    push[frame, near] = 30 * way
    found = tried(hanging, HiddenObstacle, push=push)
    for radius in {h.values["obstacle_radius"] for h in found}:
        first = next(h for h in found if h.values["obstacle_radius"] == radius)
        expected = replica.sightings.position[frame, node] - radius * way
        assert np.linalg.norm(first.place - expected) < replica.spacing  # a neighbour may have all of them about it as well


def test_the_ends_of_a_rope_are_places(hanging):
    replica = hanging.replica
    chain = np.argsort(replica.nodes[:, 2])[[3, 9, 0, 14, 6]]
    roped = replace(hanging, replica=replace(replica, system=replace(replica.system, chains=[chain])))
    places = {tuple(np.round(h.place, 6)) for h in tried(roped, HiddenTether)}
    assert {tuple(np.round(replica.nodes[k], 6)) for k in chain[[0, -1]]} <= places
