"""Loads: weight, pressure, forces on nodes."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from tenscasadi.dynamics.model import Model
from tenscasadi.scene.loads import Gravity, NodalForce, Pressure
from tenscasadi.scene.scene import Scene
from tenscasadi.structure.structure import Structure

TETRAHEDRON = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], dtype=float).T
HINGED = np.array([(0, 1), (1, 2)])
OUTWARD = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]


def test_weight_and_its_energy() -> None:
    gravity = Gravity((0, 0, -10))
    weight = np.array([1.0, 2.0])
    assert np.allclose(gravity.forces(weight).full(), [[0, 0], [0, 0], [-10, -20]])
    assert float(gravity.energy(ca.DM([[0, 0], [0, 0], [1, 3]]), weight)) == pytest.approx(10 + 60)


def test_pressure_on_a_closed_surface_has_no_resultant_and_pushes_outwards() -> None:
    W = Pressure(OUTWARD, 6.0).forces(ca.DM(TETRAHEDRON)).full()
    assert np.allclose(W.sum(axis=1), 0)
    assert np.allclose(
        W[:, 0], [-1, -1, -1]
    )  # three right triangles of ½ m² at 6 Pa, a third of each
    moved = Pressure(OUTWARD, 6.0).forces(ca.DM(TETRAHEDRON * 2)).full()
    assert np.allclose(moved, 4 * W)  # follows the area


def test_forces_may_be_functions_of_time() -> None:
    load = NodalForce(lambda t: [[np.cos(t), 0, 0], [0, t, 0]])
    load.check(2)
    W = ca.Function("W", [t := ca.SX.sym("t")], [load.at(t)])(0.5).full()
    assert np.allclose(W, [[np.cos(0.5), 0], [0, 0.5], [0, 0]])


def test_forces_may_be_a_table_over_time() -> None:
    table = np.zeros((3, 2, 3))
    table[:, 1, 2] = [1.0, 3.0, -1.0]
    load = NodalForce(table, times=[0.0, 1.0, 3.0])
    load.check(2)
    for kind in (ca.SX, ca.MX):
        W = ca.Function("W", [t := kind.sym("t")], [load.at(t)])
        for time, force in ((-1, 1), (0, 1), (0.5, 2), (1, 3), (2, 1), (3, -1), (9, -1)):
            assert np.allclose(W(time).full(), [[0, 0], [0, 0], [0, force]])


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: Gravity((0, 0)), r"Gravity\.acceleration"),
        (lambda: Gravity((0, 0, float("inf"))), r"Gravity\.acceleration"),
        (lambda: Gravity("down"), r"Gravity\.acceleration"),
        (lambda: Pressure([(0, 1)], 1.0), r"Pressure\.faces\[0\]"),
        (lambda: Pressure([(0, 1, 1)], 1.0), r"Pressure\.faces\[0\]"),
        (lambda: Pressure(3, 1.0), r"Pressure\.faces"),
        (lambda: Pressure([(0, 1, 2)], "high"), r"Pressure\.difference"),
        (lambda: Pressure([(0, 1, 9)], 1.0).check(4), r"Pressure\.faces\[0\] is 9"),
        (lambda: NodalForce(np.zeros((2, 3, 3)), times=[1, 1]), r"NodalForce\.times"),
        (lambda: NodalForce(np.zeros((3, 3, 3)), times=[0, 1]), r"NodalForce\.values"),
        (
            lambda: NodalForce(np.zeros((2, 3, 3)), times=[0, 1]).check(4),
            r"NodalForce\.values has 3 rows",
        ),
        (lambda: NodalForce(np.zeros((3, 2))), r"NodalForce\.values"),
        (lambda: NodalForce(np.zeros((3, 3))).check(4), r"NodalForce\.values has 3 rows"),
        (
            lambda: NodalForce(np.zeros((3, 3)), bars=[0]),
            r"NodalForce\.bars is \[0\]: give a mapping",
        ),
        (
            lambda: NodalForce(np.zeros((3, 3)), bars={3: 0}).check(3, HINGED),
            r"NodalForce\.bars is 3: node indices",
        ),
        (
            lambda: NodalForce(np.zeros((3, 3)), bars={1: 2}).check(3, HINGED),
            r"NodalForce\.bars\[1\] is 2, .* give one of \[0, 1\]",
        ),
        (
            lambda: NodalForce(np.zeros((3, 3)), bars={0: 1}).check(3, HINGED),
            r"NodalForce\.bars\[0\] is 1, .* give one of \[0\]",
        ),
        (
            lambda: NodalForce(np.zeros((3, 3)), bars={0: "a"}).check(3, HINGED),
            r"NodalForce\.bars\[0\] is 'a'",
        ),
        (lambda: NodalForce(lambda t: [[0, 0, 0]]).check(2), r"NodalForce\.values"),
        (lambda: NodalForce(lambda t: 1 / 0).check(2), r"NodalForce\.values raised"),
    ],
)
def test_bad_loads_are_refused_by_name(make: object, field: str) -> None:
    with pytest.raises((ValueError, TypeError), match=field):
        make()  # type: ignore[operator]


@pytest.mark.parametrize(
    "law",
    [
        lambda t: [[t, 0, 0], (0, t, 1)],
        lambda t: np.array([[t, 0, 0], [0, t, 1]]),
        lambda t: [ca.horzcat(t, 0, 0), ca.vertcat(0, t, 1)],
        lambda t: ca.vertcat(ca.horzcat(t, 0, 0), ca.horzcat(0, t, 1)),
    ],
)
def test_forces_over_time_are_rows_of_any_kind(law):
    t = ca.SX.sym("t")
    found = ca.Function("forces", [t], [NodalForce(law).at(t)])(2.0)
    assert found.full().T.tolist() == [[2.0, 0.0, 0.0], [0.0, 2.0, 1.0]]


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_a_force_on_a_joint_may_act_on_either_bar(coordinates):
    nodes = np.array([(0, 0, 0), (1, 0.1, -0.4), (1.8, -0.3, 0.2)])
    chain = Structure(nodes, bars=HINGED, bar_mass=[1.0, 2.0], pinned=[0])
    load = np.array([3.0, -5.0, 7.0])
    found = []
    for bars in (None, {1: 1}, {1: 0}):  # node 1 is the first end of bar 1, which comes first
        forces = NodalForce([(0, 0, 0), load, (0, 0, 0)], bars=bars)
        model = Model(Scene(chain, gravity=Gravity((0, 0, -9.0)), forces=forces), coordinates)
        x = model.state(nodes, [(0, 0, 0), (0, 0.4, 0.1), (0, 0, 0)])
        found.append((model.ode(x, []).full().ravel(), model.multipliers(x)))
    rates, multipliers = zip(*found, strict=True)
    assert np.abs(rates[1] - rates[0]).max() == 0
    assert np.abs(rates[2] - rates[0]).max() < 1e-12 * np.abs(rates[0]).max()
    assert np.abs(multipliers[2].bar_force_density - multipliers[0].bar_force_density).max() < 1e-9
    joints = [
        part.joint_force @ chain.class_one().P.T for part in multipliers
    ]  # on the ends: first of bars 0 and 1, then second
    assert np.abs(joints[1] - joints[0]).max() == 0
    assert (
        np.abs(joints[2][:, 1] - joints[0][:, 1] - load).max() < 1e-9
    )  # bar 1 gets it through the joint
    assert np.abs(joints[2][:, 2] - joints[0][:, 2] + load).max() < 1e-9
    # Newton's law of bar 1 alone: what pushes it is the joint, its weight, and the load where it is
    # its own
    acceleration = model.velocities(rates[0])
    centre = 2.0 * (acceleration[1] + acceleration[2]) / 2 - 2.0 * np.array([0, 0, -9.0])
    for joint, own in zip(joints, (load, load, 0), strict=True):
        assert centre == pytest.approx(joint[:, 1] + joint[:, 3] + own, abs=1e-9)
