"""Invariants: zero along every motion, and all that strings cannot change."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from planning import driven

import tenscasadi as tc
from ocp.problem.rows import RESOLUTION
from ocp.targets.invariants import bodies, free_motions, invariants
from tenscasadi.util.linear_algebra import null_space

PRISM = tc.shapes.prism()
BALL = tc.shapes.six_bar_ball()
D_BAR = tc.shapes.d_bar()
TWO = tc.Structure(
    np.concatenate([PRISM.nodes, PRISM.nodes + (3, 0, 0)]),
    np.concatenate([PRISM.bars, PRISM.bars + 6]),
    np.concatenate([PRISM.strings, PRISM.strings + 6]),
)
GRAVITY = tc.Gravity((0.0, 0.0, -9.81))


KEPT = {
    "free prism": (driven(PRISM), 6 + 9),
    "free prism falls": (driven(PRISM, gravity=GRAVITY), 6 + 9),
    "prism on a pin": (driven(PRISM.replace(pinned=[0])), 6 + 3),
    "prism on a pin, heavy": (driven(PRISM.replace(pinned=[0]), gravity=GRAVITY), 6 + 1),
    "prism on a pin, weight aslant": (
        driven(PRISM.replace(pinned=[0]), gravity=tc.Gravity((1.0, 2.0, 3.0))),
        6 + 1,
    ),
    "prism on two pins": (driven(PRISM.replace(pinned=[0, 1])), 6 + 1),
    "prism on two pins, heavy": (driven(PRISM.replace(pinned=[0, 1]), gravity=GRAVITY), 6),
    "prism on three pins": (driven(PRISM.replace(pinned=[0, 1, 2])), 6),
    "prism on a floor": (
        driven(PRISM.replace(pinned={0: "z", 1: "z", 2: "z"}), gravity=GRAVITY),
        6 + 5,
    ),
    "prism on a slope": (
        driven(PRISM.replace(pinned={0: "z", 1: "z", 2: "z"}), gravity=tc.Gravity((5.0, 0, -5.0))),
        6 + 5,
    ),
    "prism on a rail": (driven(PRISM.replace(pinned={0: "yz", 1: "z"}), gravity=GRAVITY), 6 + 2),
    "ball": (driven(BALL), 12 + 9),
    "pressed ball": (driven(BALL, pressure=tc.Pressure([(0, 4, 8)], 5.0)), 12),
    "d-bar in full coordinates": (
        tc.Model(
            tc.Scene(D_BAR.replace(pinned=[0]), control=tc.ForceDensity()), coordinates="full"
        ),
        None,
    ),
    "two prisms": (driven(TWO), 2 * (6 + 9)),
    "two prisms, each on a pin": (driven(TWO.replace(pinned=[0, 6])), 2 * (6 + 3)),
    "flat d-bar": (driven(D_BAR), None),
    "flat d-bar falls in its plane": (driven(D_BAR, gravity=tc.Gravity((1.0, -2.0, 0.0))), None),
}


def moving_start(model):
    """A start with as much velocity as the case allows: flat structures stay flat."""
    rng = np.random.default_rng(1)
    flat = not np.ptp(model.structure.nodes[:, 2])
    speeds = rng.normal(size=model.structure.nodes.shape) * (1.0, 1.0, 0.0 if flat else 1.0)
    speeds[model.structure.fixed] = 0.0
    return (
        tc.Projection(iterations=10)
        .step(model)(model.state(model.structure.nodes, speeds))
        .full()
        .ravel()
    )


@pytest.mark.parametrize("name", KEPT)
def test_invariants_stay_zero_along_a_motion(name):
    model, _ = KEPT[name]
    start = moving_start(model)
    table = np.random.default_rng(2).uniform(0, 10, size=(8, model.nu))
    end = tc.simulate(model, 0.2, step=2e-4, state=start, control=table, compiled=False).states[-1]
    x, time = ca.SX.sym("x", model.nx), ca.SX.sym("t")
    for group in invariants(model, start, x, time):
        value = ca.Function("kept", [x, time], [group.value])(end, 0.2).full()
        assert value.shape == (len(group.names), 1)
        assert np.abs(value).max() < 1e-8, group.kind
    assert np.abs(end - start).max() > 0.05


@pytest.mark.parametrize("name", [name for name, (_, count) in KEPT.items() if count is not None])
def test_invariants_are_all_that_the_strings_cannot_change(name):
    """Gradients of the end of a motion with respect to all controls span exactly what the invariants leave."""
    model, count = KEPT[name]
    start = moving_start(model)
    x = ca.SX.sym("x", model.nx)
    gradients = [ca.jacobian(group.value, x) for group in invariants(model, start, x, ca.SX(1.0))]
    intervals = 16
    controls = np.random.default_rng(3).uniform(0, 10, size=(intervals, model.nu))
    end, sensitivity = differentiate(model, start, controls, 16)
    A = ca.Function("A", [x], [ca.vertcat(*gradients)])(end).full()
    free = null_space(A / np.linalg.norm(A, axis=1, keepdims=True), RESOLUTION)
    assert free.shape[1] == model.nx - count
    assert (
        np.linalg.matrix_rank(sensitivity, 1e-6 * np.linalg.norm(sensitivity, 2))
        == model.nx - count
    )
    assert np.abs(A @ sensitivity).max() < 1e-4 * np.abs(A).max() * np.abs(sensitivity).max()


def differentiate(model, start, controls, substeps):
    """The end of a motion of 1 s, and its derivatives by all controls."""
    x, u = ca.MX.sym("x", model.nx), ca.MX.sym("u", model.nu)
    now, h = x, 1 / len(controls) / substeps
    step = tc.RungeKutta4().step(model.ode)
    for _ in range(substeps):
        now = step(now, u, h)
    each = ca.Function("interval", [x, u], [now, ca.jacobian(now, x), ca.jacobian(now, u)])
    state, gradient = np.array(start), np.zeros((model.nx, 0))
    for control in controls:
        end, by_state, by_control = (part.full() for part in each(state, control))
        state, gradient = end.ravel(), np.hstack([by_state @ gradient, by_control])
    return state, gradient


def test_free_motions():
    along, rotations = free_motions(PRISM.nodes, PRISM.fixed, np.zeros(3))
    assert along.all()
    assert len(rotations) == 3
    along, rotations = free_motions(PRISM.nodes, PRISM.replace(pinned=[1]).fixed, np.zeros(3))
    assert not along.any()
    assert len(rotations) == 3
    for t, omega in rotations:
        assert t + np.cross(omega, PRISM.nodes[1]) == pytest.approx(np.zeros(3), abs=1e-12)


def test_bodies_end_at_pins():
    nodes = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (5, 5, 5), (1, 1, 0)]
    structure = tc.Structure(
        nodes, bars=[(0, 1), (0, 2)], strings=[(1, 4)], node_mass=[0, 0, 0, 1, 1], pinned=[0]
    )
    found = bodies(structure, np.zeros(3))
    assert [body.nodes.tolist() for body in found] == [[1, 4], [2], [3]]
    assert [body.along.all() for body in found] == [False, False, True]
    assert [len(body.rotations) for body in found] == [3, 3, 3]
