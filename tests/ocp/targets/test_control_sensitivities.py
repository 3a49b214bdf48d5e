"""Sensitivities: exact derivatives of a motion by its controls and duration."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from planning import driven

import tenscasadi as tc
from ocp.targets.control_sensitivities import ControlSensitivities

PRISM = tc.shapes.prism()


def test_sensitivities_agree_with_differences():
    model = driven(PRISM)
    intervals = 5
    reach = ControlSensitivities(model, free_duration=True)
    controls = np.random.default_rng(4).uniform(1, 5, size=(intervals, 9))
    x = ca.SX.sym("x", model.nx)
    rows = ca.Function("rows", [x], [x[:7] ** 2])

    def end(controls, duration):
        return rows(reach.rollout(model.initial_state, controls, duration)[-1]).full().ravel()

    exact = reach.gradient(rows, np.eye(rows.size1_out(0)), model.initial_state, controls, 0.5)
    change = np.random.default_rng(5).normal(size=controls.shape)
    e = 1e-5
    along = (end(controls + e * change, 0.5 + e) - end(controls - e * change, 0.5 - e)) / (2 * e)
    assert exact @ np.append(change.ravel(), 1.0) == pytest.approx(along, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("conserved", [0, 1])
def test_conserved_rows_are_not_controllable(conserved):
    """Places and speeds of nodes about their mean can be moved, each of them; with the speed of the centre of mass among them, one cannot."""
    structure = tc.shapes.prism(10)
    model = driven(structure)
    x = ca.SX.sym("x", model.nx)
    V = model.velocities(x).T
    places = model.nodes(x).T
    bars = structure.bars
    middles = (places[:, bars[:, 0].tolist()] + places[:, bars[:, 1].tolist()]) / 2
    speeds = (V[:, bars[:, 0].tolist()] + V[:, bars[:, 1].tolist()]) / 2
    about = [ca.vec(part[:, :-1] - part[:, 1:]) for part in (middles, speeds)]
    rows = ca.Function("rows", [x], [ca.vertcat(*about, *[ca.sum2(V)[0]] * conserved)])
    count = rows.size1_out(0)
    reach = ControlSensitivities(model, free_duration=False)
    controls = np.random.default_rng(2).uniform(1, 5, (30, model.nu))
    given = rows, np.eye(count), model.initial_state, controls, 1.0
    assert len(reach.controllable_rows(*given)) == count - conserved
