"""States and controls: conversions, clocks, residuals of constraints, and refusals."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from comparison import BOTH
from scenes import PRISM, every_term

from tenscasadi.dynamics import mechanism
from tenscasadi.dynamics.model import Model
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import ForceDensity
from tenscasadi.scene.supports import SupportMotion
from tenscasadi.simulation.simulate import simulate
from tenscasadi.structure.structure import Structure


def test_bad_input_is_refused_by_name() -> None:
    structure = Structure(**PRISM, pinned=(0,))
    with pytest.raises(TypeError, match=r"Model\.scene"):
        Model(structure)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"Model\.coordinates"):
        Model(Scene(structure), "minimal")  # type: ignore[arg-type]
    model = Model(Scene(structure, control=ForceDensity()))
    with pytest.raises(ValueError, match=r"nodes has shape"):
        model.state(structure.nodes[:5])
    with pytest.raises(ValueError, match=r"nodes\[2, 1\] is nan"):
        model.state(np.where(np.arange(18).reshape(6, 3) == 7, np.nan, structure.nodes))
    with pytest.raises(ValueError, match=r"nodes\[0, 0\].*pinned"):
        model.state(structure.nodes + 0.1)
    with pytest.raises(ValueError, match=r"velocities\[0, 0\].*pinned"):
        model.state(structure.nodes, np.ones((6, 3)))
    with pytest.raises(ValueError, match=r"u has shape"):
        model.force_density(model.initial_state, np.ones(8))
    with pytest.raises(ValueError, match=r"x has shape"):
        model.energy(np.ones(7))
    with pytest.raises(ValueError, match=r"x has shape"):
        model.nodes(np.ones(7))


@BOTH
@pytest.mark.parametrize("moved", [False, True], ids=["standing", "moved"])
def test_constraints_vanish_where_kept_and_their_rates_are_rates(
    moved: bool, coordinates: mechanism.Coordinates
) -> None:
    model = Model(every_term(moved=moved), coordinates)
    assert (
        max(np.abs(rows).max(initial=0.0) for rows in model.constraints(model.initial_state))
        < 1e-13
    )
    assert len(model.constraints(model.initial_state).joints) == np.count_nonzero(
        model.mechanism.active
    )
    x = model.initial_state + 1e-4 * np.random.default_rng(7).normal(size=model.nx)
    now = model.constraints(x)
    B = model.mechanism.C_b @ np.asarray(model.unpack(ca.DM(x))[0]).T
    assert np.allclose(
        now.bars, np.linalg.norm(B, axis=1) - model.mechanism.lengths, rtol=0, atol=1e-7
    )
    if coordinates == "full":
        assert np.abs(now.joints).max() == pytest.approx(model.joint_error(x))
    sx = ca.MX.sym("x", model.nx)
    rows = model.constraints(sx)
    change = [
        ca.jtimes(value, sx, model.ode(sx, model.initial_control))
        for value in (rows.bars, rows.joints)
    ]
    rates = ca.Function("rates", [sx], change)(x)
    for rate, expected in zip(rates, (now.bar_rates, now.joint_rates), strict=True):
        assert np.allclose(rate.full().ravel(), expected, rtol=1e-9, atol=1e-12)


def test_constraints_of_what_has_none_are_empty() -> None:
    model = Model(Scene(Structure([(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], node_mass=1.0)))
    assert [len(rows) for rows in model.constraints(model.initial_state)] == [0, 0, 0, 0]
    with pytest.raises(ValueError, match="x"):
        model.constraints(np.zeros(3))


@pytest.mark.parametrize(
    "x",
    ["x", 10**400, 1j, None, [1.0], np.array(["a"]), ca.MX.sym("x", 3), ca.SX.sym("x", 1, 2)],
    ids=repr,
)
def test_what_is_no_state_is_named(x: object) -> None:
    model = Model(Scene(Structure(**PRISM)))
    for read in (model.nodes, model.velocities, model.constraints):
        with pytest.raises(
            (TypeError, ValueError), match=r"^x (is not an array of real numbers|has shape)"
        ):
            read(x)
    with pytest.raises(ValueError, match="x has masked entries"):
        model.nodes(np.ma.array(model.initial_state, mask=np.arange(model.nx) == 3))


@BOTH
@pytest.mark.parametrize("moved", [False, True])
def test_a_scene_of_one_pinned_node(moved: bool, coordinates: mechanism.Coordinates) -> None:
    scene = Scene(
        Structure([(0, 0, 0)], pinned=[0]),
        supports=SupportMotion({0: lambda t: (t, 0, 0)}) if moved else None,
    )
    model = Model(scene, coordinates)
    assert model.nodes(np.zeros((0, model.nx))).shape == (0, 1, 3)
    assert simulate(model, 0.1, 0.05, compiled=False).nodes[-1, 0] == pytest.approx(
        [0.1 * moved, 0, 0]
    )
