"""What the twin may be before it is fitted."""

import numpy as np
import pytest
from twinbench.datasets.scenario import Observed
from twinbench.diagnosis.baseline import FINER, LEVELS, STEADY, baseline_model, first_fit, steady
from twinbench.diagnosis.fit import Task
from twinbench.diagnosis.hypotheses import hypotheses_for
from twinbench.diagnosis.inquiry import PRESETS
from twinbench.diagnosis.model import JUDGED, MOST, Simulator
from twinbench.diagnosis.replica import build_replica
from twinbench.diagnosis.springs import FEWEST, affordable
from twinbench.physics.terms.compression_softening import CompressionSoftening


def test_no_stiffness_is_tried_that_the_substeps_of_a_frame_do_not_carry(tiny):
    simulator = tiny.drawn(tiny.concealing(frames=12, train_end=8))
    model = baseline_model([simulator.replica])
    bounded = steady(model, [simulator])
    values = model.decode(np.zeros(len(model.knobs)))
    for knob, before in zip(bounded.knobs, model.knobs, strict=True):
        if not knob.name.endswith("stiffness"):
            assert knob == before
            continue
        carried, more = (simulator.substeps(model.terms, {**values, knob.name: y}) for y in (knob.high, FINER * knob.high))
        assert carried <= STEADY * MOST
        assert more > STEADY * MOST or knob.high == before.high
    assert {k.name for k, b in zip(bounded.knobs, model.knobs, strict=True) if k != b} == {
        "body_stiffness"
    }  # two light grips are no burden


def stuffed(*, frames=10, gravity=0.0):
    """A block that rests in two hands, with an inside: 6 x 4 x 3 particles, 2 cm apart, the outer ones seen."""
    axes = [0.02 * np.arange(count) for count in (6, 4, 3)]
    body = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    inside = ((body > 0.001) & (body < body.max(0) - 0.001)).all(1)
    points = np.repeat(body[~inside][None], frames, 0)
    there = np.ones(points.shape[:2], bool)
    hands = np.repeat((body[[0, -1]] + [[-0.01, 0, 0], [0.01, 0, 0]])[None], frames, 0)
    about = dict(points=points, visible=there, motion_valid=there, controllers=hands, interior=body[inside], fps=30.0)
    return Observed(name="block", gravity=[0, 0, -gravity], **about)


def test_a_stuffed_body_is_as_soft_as_what_is_seen_allows():
    # at rest without weight every stiffness fits alike; under its weight a soft one would sag by several centimetres, which nobody sees
    found = []
    for gravity in (0.0, 9.8):
        simulator = Simulator(build_replica(stuffed(gravity=gravity), nodes=40))
        model = steady(baseline_model([simulator.replica]), [simulator])
        found.append(first_fit(Task([simulator], [10], 2.0), model, iterations=1).values["body_stiffness"])
    assert found[0] == pytest.approx(LEVELS[0], rel=0.1) and found[1] > 10 * found[0]


def test_only_sheets_give_way_where_they_are_squeezed(tiny):
    # what a twin has from the start can be no answer to what it lacks; folds finer than its nodes are a sheet's alone
    sheet, block = tiny.drawn(tiny.concealing(frames=12, train_end=8)).replica, build_replica(stuffed(), nodes=40)
    assert CompressionSoftening in baseline_model([sheet]).terms
    assert CompressionSoftening not in baseline_model([block]).terms
    assert "compression_softening" not in baseline_model([block]).names
    assert "compression_softening" in {
        h.effect for h in hypotheses_for(Simulator(block), *(np.zeros((10, len(block.nodes), 3)) for _ in range(2)))
    }


def test_what_is_judged_may_take_more_substeps_than_what_is_fitted():
    simulator = Simulator(build_replica(stuffed(), nodes=40))
    model = baseline_model([simulator.replica])
    stiff = {**model.decode(np.zeros(len(model.knobs))), "body_stiffness": 2e5}
    needed = simulator.substeps(model.terms, stiff, most=10**6)
    assert MOST < needed < JUDGED
    assert simulator.substeps(model.terms, stiff) == MOST
    assert simulator.substeps(model.terms, stiff, most=JUDGED) == needed


def test_long_recordings_and_stuffed_bodies_get_fewer_nodes():
    preset = PRESETS["full"]
    block = stuffed()
    assert affordable(preset, block).nodes == 180  # 0.6 of 300
    assert affordable(preset, stuffed(frames=360)).nodes == 90  # half of that: the root of 90 / 360
    assert affordable(PRESETS["quick"], stuffed(frames=360)).nodes == FEWEST
