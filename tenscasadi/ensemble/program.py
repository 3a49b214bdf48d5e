"""The program of a kernel: CasADi Functions under the names that `motions.hpp` calls."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import ExplicitRungeKutta
from tenscasadi.integrators.scheme import Scheme, check_scheme, equations
from tenscasadi.integrators.stabilization import Correction, held_correction
from tenscasadi.integrators.tableaux import Tableau


class Program(NamedTuple):
    """Functions by name, the constants of `motions.hpp`, the tableau that steps `motion_ode` (None: there is a `motion_step`), steps a correction."""

    functions: dict[str, ca.Function]
    sizes: dict[str, int]
    tableau: Tableau | None
    every: int


def write_program(
    model: Model,
    scheme: Scheme,
    correction: Correction | None,
    stage: ca.Function | None,
    final: ca.Function | None,
    measured: bool,
) -> Program:
    """Write the Functions of a kernel; arguments and errors as of `build_kernel`."""
    check_scheme(scheme)
    if scheme.adaptive or scheme.implicit:
        raise ValueError(
            f"scheme is {scheme}: motions side by side take the same steps, give a scheme of fixed explicit ones such as RungeKutta4()"
        )
    power = model.stacked(model.power) if measured and model.power is not None else None
    jumps = measured and model.nu > 0
    tableau = _tableau(scheme)
    move = (
        scheme.advance(model, power)
        if tableau is None
        else _at_once(equations(model, power), model, power)
    )
    step = _with_account(
        "motion_step" if tableau is None else "motion_ode", move, model.nx, jumps and power is None
    )
    functions = {step.name(): step}
    nw = max([step.size1_in(1), *(cost.size1_in(1) for cost in (stage, final) if cost is not None)])
    project = None if correction is None else held_correction(model, correction)
    for name, function in (
        ("motion_project", project),
        ("motion_stage", stage),
        ("motion_final", final),
    ):
        if function is not None:
            functions[name] = function
    if measured:
        functions["motion_measure"] = _measure(model.stacked(model.observe))
        if jumps:
            functions["motion_energy"] = model.stacked(model.energy_function)
    given = {name: _renamed(name, _widened(function, nw)) for name, function in functions.items()}
    sizes = {
        "NX": model.nx,
        "NW": nw,
        "NU": model.nu,
        "WORK": int(power is not None or jumps),
        "JUMPS": int(jumps),
        "M": 5 * measured,
    }
    return Program(
        given, sizes, tableau, 0 if project is None or correction is None else correction.every
    )


def _at_once(ode: ca.Function, model: Model, power: ca.Function | None) -> ca.Function:
    """Return the ode with the work of `power` as one scalar Function, where it can be: both take the same forces, which are then computed once."""
    if power is None or not power.is_a("SXFunction") or not model.ode.is_a("SXFunction"):
        return ode
    z, w = ca.SX.sym("z", model.nx + 1), ca.SX.sym("w", model.nw)
    rates = ca.vertcat(model.stacked(model.ode)(z[:-1], w), power(z[:-1], w))
    return ca.Function("ode_and_work", [z, w], ca.cse([rates]))


def _tableau(scheme: Scheme) -> Tableau | None:
    """Return the tableau of a scheme that steps as it says, None for others."""
    if not isinstance(scheme, ExplicitRungeKutta):
        return None
    own = (
        type(scheme).advance is not ExplicitRungeKutta.advance
        or type(scheme).step is not ExplicitRungeKutta.step
    )
    return None if own else scheme.tableau


def _with_account(name: str, function: ca.Function, nx: int, account: bool) -> ca.Function:
    """Return a step (z, w, h) or an ode (z, w) under this name, where `account` asks for it with one entry more in z, which does not change."""
    if not account:
        return _renamed(name, function)
    inputs: list[Any] = function.sx_in() if function.is_a("SXFunction") else function.mx_in()
    z, others = type(inputs[0]).sym("z", nx + 1), inputs[1:]
    return ca.Function(
        name,
        [z, *others],
        [ca.vertcat(function(z[:nx], *others), z[nx] if name == "motion_step" else 0)],
    )


def _measure(observe: ca.Function) -> ca.Function:
    """Return (x, w) -> errors of bars and joints, and the three energies: what `observe` tells, without the rest."""
    kind: Any = ca.SX if observe.is_a("SXFunction") else ca.MX
    x, w = kind.sym("x", observe.size1_in(0)), kind.sym("w", observe.size1_in(1))
    found = dict(zip(observe.name_out(), observe.call([x, w]), strict=True))
    return ca.Function(
        "measure",
        [x, w],
        [ca.vertcat(*(found[name] for name in ("bar_length_error", "joint_error", "energy")))],
    )


def _widened(function: ca.Function, nw: int) -> ca.Function:
    """Return a Function (x, w, ...) as one of a longer w, of which it uses the first entries."""
    if function.n_in() < 2 or function.size1_in(1) == nw:
        return function
    inputs: list[Any] = function.sx_in() if function.is_a("SXFunction") else function.mx_in()
    x, own, *others = inputs
    w = type(own).sym("w", nw)
    return ca.Function(
        "widened", [x, w, *others], function.call([x, w[: own.shape[0]], *others], True, False)
    )


def _renamed(name: str, function: ca.Function) -> ca.Function:
    """Return the Function under another name, without a call of the one in the other where that can be: it would copy what comes out."""
    scalar = function.is_a("SXFunction")
    inputs: Any = function.sx_in() if scalar else function.mx_in()
    outputs = function.call(inputs, not scalar and function.is_a("MXFunction"), False)
    return ca.Function(name, inputs, outputs)
