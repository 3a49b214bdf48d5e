"""Functions of time that users write: what is wrong with them is told as theirs, and where they switch is found."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from tenscasadi.dynamics.model import Model
from tenscasadi.scene.loads import NodalForce
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.supports import SupportMotion
from tenscasadi.scene.time_functions import interpolate
from tenscasadi.simulation.simulate import simulate
from tenscasadi.structure import shapes

PENDULUM = shapes.pendulum()
REST = [0, 0, 0]


def run(t_end: float = 1.0, **loads: Any) -> Any:
    return simulate(Model(Scene(PENDULUM, **loads)), t_end, 0.01, compiled=False)


@pytest.mark.parametrize(
    ("place", "told"),
    [
        (lambda t: 0.1 * (t > 0.5), r"the position \(m\) jumps by 0\.1 at t = 0\.5 s"),
        (
            lambda t: 0.1 * ((t > 0.5) * (t < 0.50001)),
            r"the position \(m\) jumps by 0\.1 at t = 0\.5",
        ),
        (lambda t: 0.1 * (t > 0), r"the position \(m\) jumps"),
        (lambda t: np.floor(3 * t), r"the position \(m\) jumps by 1 at t = 0\.333333 s"),
        (lambda t: ca.fmax(t - 0.5, 0), r"the velocity \(m/s\) jumps by 1 at t = 0\.5 s"),
        (
            lambda t: ca.if_else(t > 0.25, 0.1 * ca.sin(40 * t - 10), 0),
            r"the velocity .* at t = 0\.25 s",
        ),
        (np.sqrt, r": its velocity is not finite at t = 0 s"),
        (lambda t: 1 / (1 - t) - 1, r" is not finite at t = 1 s"),
    ],
)
def test_supports_that_jump_or_are_not_finite_are_refused_by_name(place: Any, told: str) -> None:
    with pytest.raises(ValueError, match=r"SupportMotion\.positions\[0\].*" + told):
        run(supports=SupportMotion({0: lambda t: (place(t), 0, 0)}))


@pytest.mark.parametrize(
    "place",
    [
        lambda t: 0.001 * ca.sin(100 * t),
        lambda t: ca.fmax(t - 0.5, 0) ** 2,
        lambda t: 0.1 * t * ca.fabs(t - 0.5) ** 3,
    ],
)
def test_smooth_supports_run(place: Any) -> None:
    assert run(supports=SupportMotion({0: lambda t: (place(t), 0, 0)})).success


def test_a_jump_after_the_run_does_no_harm_and_the_clock_counts() -> None:
    model = Model(Scene(PENDULUM, supports=SupportMotion({0: lambda t: (0.1 * (t > 0.5), 0, 0)})))
    assert simulate(model, 0.4, 0.01, compiled=False).success
    later = model.initial_state.copy()
    later[-1] = 0.2
    with pytest.raises(ValueError, match=r"t = 0\.5 s"):
        simulate(model, 0.4, 0.01, state=later, compiled=False)


def fail_later(t: Any) -> Any:
    if isinstance(t, float) and t > 0.5:
        raise LookupError("the sensor is lost")
    return t


@pytest.mark.parametrize(
    ("push", "told"),
    [
        (lambda t: np.sqrt(0.5 - t), r" is not finite at t = 0\.5 s"),
        (lambda t: 1 / (t - 0.5), r" is not finite at t = 0\.5 s"),
        (lambda t: np.log(ca.fabs(t - 0.4321234)), r" is not finite at t = 0\.432123 s"),
        (lambda t: np.inf, r"\(0\.0\)\[1, 0\] is inf"),
        (lambda t: 1.0 if isinstance(t, float) else 2.0, r" is \[.* for the number t = 0 "),
        (fail_later, r"\(0\.75\) fails with LookupError: the sensor is lost: give a function"),
    ],
)
def test_forces_that_are_not_finite_or_not_symbolic_are_told_as_the_functions(
    push: Any, told: str
) -> None:
    with pytest.raises(ValueError, match=r"NodalForce\.values" + told):
        run(forces=NodalForce(lambda t: [REST, [push(t), 0, 0]]))


@pytest.mark.parametrize(
    "push",
    [
        lambda t: np.exp(-(((t - 0.4321234) / 1e-9) ** 2)),
        lambda t: 1 / (1e-16 + (t - 0.4321234) ** 2) / 1e16,
        lambda t: ca.if_else(t < 0.4321234, 0, 1e3),
        lambda t: np.sqrt(ca.fabs(t - 0.4321234)),
        lambda t: np.exp(20 * t),
    ],
    ids=["narrow pulse", "narrow resonance", "jump", "root", "growth"],
)
def test_what_is_narrow_or_steep_but_finite_is_none_of_these(push: Any) -> None:
    NodalForce(lambda t: [REST, [push(t), 0, 0]]).check_run(0.0, 1.0)


def test_a_shape_that_symbols_alone_have_is_refused() -> None:
    wrong = NodalForce(lambda t: np.zeros((2, 3)) if isinstance(t, float) else [REST])
    with pytest.raises(
        ValueError,
        match=r"NodalForce\.values returns shape \(1, 3\) on a CasADi time: give \(2, 3\)",
    ):
        wrong.check(2)


def test_numbers_of_casadi_may_stand_in_lists() -> None:
    def push(t: Any) -> list[Any]:
        return [ca.vertcat(0, 0, t), [0, ca.if_else(t < 0.5, 1, 2), ca.fmax(t, 0)]]

    NodalForce(push).check(2)
    NodalForce(push).check_run(0.0, 1.0)
    with pytest.raises(ValueError, match=r"NodalForce\.values\(0\.0\)\[1, 1\] is nan"):
        NodalForce(lambda t: [REST, [0, ca.if_else(t < 0.5, np.nan, 2), 0]]).check(2)


def test_tables_are_exact_at_their_times_and_beside_steep_pieces():
    times, table = (
        np.array([0.0, 0.3, 0.3 + 1e-9, 1.0]),
        np.array([[2.0, 0.0], [0.0, 0.0], [1e9, 0.0], [3.0, 0.0]]),
    )
    t = ca.SX.sym("t")
    values = interpolate(t, times, table, 1)
    at = ca.Function("at", [t], [values, ca.jacobian(values[0, 0], t)])
    found = [np.asarray(at(time)[0]).ravel().tolist() for time in (-1.0, *times, 2.0)]
    assert found == [[2.0, 0.0], [2.0, 0.0], [0.0, 0.0], [1e9, 0.0], [3.0, 0.0], [3.0, 0.0]]
    assert float(at(0.15)[0][0]) == pytest.approx(1.0, rel=1e-15)
    assert float(at(0.15)[1]) == pytest.approx(-2 / 0.3)
    assert float(at(1.5)[1]) == 0.0


@pytest.mark.parametrize("place", [None, "x", (0, None, 0)])
def test_what_is_no_position_is_told_in_one_line(place: Any) -> None:
    with pytest.raises(
        (TypeError, ValueError), match=r"SupportMotion\.positions\[0\]\(0\) .*: give an array of"
    ) as caught:
        run(supports=SupportMotion({0: lambda t: place}))
    assert "\n" not in str(caught.value)
