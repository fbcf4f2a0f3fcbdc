"""What the twin may be before it is fitted."""

import numpy as np
from twinbench.diagnosis.baseline import FINER, STEADY, baseline_model, steady
from twinbench.diagnosis.model import MOST


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
