"""Motions in parts: contact nodes are pinned in stance, and no ground acts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from jumping import FEET, flight, push, standing

from ocp.results.motion_spans import split_motion


def test_contact_nodes_are_pinned_in_their_phase():
    model = standing()
    moved = model.structure.nodes + [0.3, 0.0, 0.0]
    places = [model.structure.nodes] * 2 + [moved] * 5
    states = np.array([np.ravel(model.state(nodes)) for nodes in places])
    stance, air, landed = split_motion(model, states, [push(), flight(0.2), push()])
    assert [(span.first, span.last) for span in (stance, air, landed)] == [(0, 2), (2, 4), (4, 6)]
    assert stance.model.nx == model.nx - 6 * len(FEET)
    assert air.model.nx == model.nx
    assert not air.model.scene.grounds
    assert landed.model.nodes(states[-1][landed.entries]) == pytest.approx(moved)


def test_motion_is_one_span_without_phases_or_ground():
    model = standing()
    air = model.with_scene(replace(model.scene, ground=None))
    states = np.repeat(air.initial_state[None], 5, axis=0)
    for own, phases in ((air, [flight(0.1), flight(0.2)]), (model, [])):
        (span,) = split_motion(own, states, phases)
        assert span.model is own
        assert (span.first, span.last) == (0, 4)
