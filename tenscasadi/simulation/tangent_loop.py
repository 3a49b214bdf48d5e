"""Tangent and adjoint recursions of many steps, as CasADi Functions."""

from __future__ import annotations

import contextlib
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from tenscasadi.dynamics.instruction_count import count_instructions
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import ExplicitRungeKutta
from tenscasadi.integrators.scheme import Scheme, equations
from tenscasadi.integrators.stabilization import Correction, correct

CHUNK = 256  # steps per call, between saved states


class TangentSteps(NamedTuple):
    """Model, scheme and correction of the steps to differentiate.

    The state z is that of the model. With a Function `running` (x, w) → (1), the last entry of z is
    its integral over time.
    """

    model: Model
    scheme: Scheme
    correction: Correction | None
    running: ca.Function | None

    @property
    def size(self) -> int:
        """Number of entries of z, the state and a running integral."""
        return self.model.nx + (self.running is not None)


def choose_width(model: Model, directions: int) -> int:
    """Choose the number of directions per call.

    Directions share common terms, but the compile time grows with their number. It is seconds for
    3000 instructions × directions.
    """
    return int(
        np.clip(3000 // max(count_instructions(model.ode), 1), 1, min(8, max(directions, 1)))
    )


def tangent_function(steps: TangentSteps, width: int, held: bool) -> ca.Function:
    """Build CHUNK steps of a run with `width` tangents.

    Function "tangent" (y, v (·, CHUNK), grid (2, CHUNK)) → final y. The state y = [z; vec S]
    contains the tangents S (nz, width). The input is v = [w], or [w; vec W] with the tangents W
    (nw, width) unless `held`; w is the control followed by the parameters. The grid holds the
    length of each step [s] and 1 before a correction, else 0. Steps of zero length change nothing.
    """
    nz, nw = steps.size, steps.model.nw
    y, v, grid = (
        ca.MX.sym("y", nz * (1 + width)),
        ca.MX.sym("v", nw * (1 if held else 1 + width)),
        ca.MX.sym("grid", 2),
    )
    S, w = ca.reshape(y[nz:], nz, width), v[:nw]
    W = ca.MX(nw, width) if held else ca.reshape(v[nw:], nw, width)
    if isinstance(
        steps.scheme, ExplicitRungeKutta
    ):  # the variational equation gives the exact derivative of the step
        end = steps.scheme.step(_variational(steps, width, held))(y, v, grid[0])
        z, S = end[:nz], ca.reshape(end[nz:], nz, width)
    else:
        z, S = _push_tangents(_plain(steps), [y[:nz], w, grid[0]], [S, W, ca.MX(1, width)])
    follow = _build_correction(steps)
    if follow is not None:
        z, S = _push_tangents(follow, [z, w, grid[1]], [S, W, ca.MX(1, width)])
    after = ca.if_else(grid[0] > 0, ca.vertcat(z, ca.vec(ca.densify(S))), y)
    return ca.Function("tangent", [y, v, grid], [after], ["y", "v", "grid"], ["y_next"]).fold(CHUNK)


def gradient_function(steps: TangentSteps, width: int) -> ca.Function:
    """Build the adjoint of CHUNK steps of a run, for `width` outputs.

    Function "gradient" (z, vec L, w (nw, CHUNK), grid (2, CHUNK)) → final z, initial vec L,
    gradients (nw · width, CHUNK) with respect to w. L (nz, width) holds gradients with respect to
    the final z, then to the initial one. See `tangent_function` for the grid. The states in between
    are computed again.
    """
    nz, nw = steps.size, steps.model.nw
    one = _step(steps)
    z, w, grid, L = (
        ca.MX.sym("z", nz),
        ca.MX.sym("w", nw),
        ca.MX.sym("grid", 2),
        ca.MX.sym("L", nz * width),
    )
    pulled = one.reverse(width)(z, w, grid, ca.MX(nz, 1), ca.reshape(L, nz, width))
    back = ca.Function(
        "back", [L, z, w, grid], [ca.vec(ca.densify(pulled[0])), ca.vec(ca.densify(pulled[1]))]
    )
    ws, grids = ca.MX.sym("w", nw, CHUNK), ca.MX.sym("grid", 2, CHUNK)
    after = one.mapaccum(CHUNK)(z, ws, grids)
    before = ca.horzcat(z, after[:, :-1])
    all_L, by_w = back.mapaccum(CHUNK)(L, *(_reverse(columns) for columns in (before, ws, grids)))
    outputs = [after[:, -1], all_L[:, -1], ca.densify(_reverse(by_w))]
    return ca.Function(
        "gradient",
        [z, L, ws, grids],
        outputs,
        ["z", "L", "w", "grid"],
        ["z_end", "L_start", "by_w"],
    )


def _reverse(columns: Any) -> Any:
    return columns[:, ::-1]


def _step(steps: TangentSteps) -> ca.Function:
    """Build one step with correction: Function (z, w, grid (2)) → z_next."""
    z, w, grid = ca.MX.sym("z", steps.size), ca.MX.sym("w", steps.model.nw), ca.MX.sym("grid", 2)
    follow = _build_correction(steps)
    end = _plain(steps)(z, w, grid[0])
    end = end if follow is None else follow(end, w, grid[1])
    return ca.Function("step", [z, w, grid], [ca.if_else(grid[0] > 0, end, z)])


def _plain(steps: TangentSteps) -> ca.Function:
    """Build one step without correction.

    Function (z, w, h) → z_next.
    """
    if not isinstance(steps.scheme, ExplicitRungeKutta) and steps.scheme.implicit:
        # CasADi differentiates the equations of Newton's method, not its iterations.
        return steps.scheme.step(equations(steps.model, steps.running))
    return steps.scheme.advance(steps.model, steps.running)


def _build_correction(steps: TangentSteps) -> ca.Function | None:
    """Build the constraint correction after a step.

    Function (z, w, flag) → z, corrected for flag > 0. None without constraints or correction.
    """
    project = None if steps.correction is None else steps.correction.step(steps.model)
    if steps.correction is None or project is None:
        return None
    z, w, flag, nx = (
        ca.MX.sym("z", steps.size),
        ca.MX.sym("w", steps.model.nw),
        ca.MX.sym("flag"),
        steps.model.nx,
    )
    after = ca.vertcat(correct(steps.model, project, z[:nx], w), z[nx:])
    return ca.Function(
        "correct",
        [z, w, flag],
        [after if steps.correction.every == 1 else ca.if_else(flag > 0, after, z)],
    )


def _push_tangents(
    function: ca.Function, inputs: list[Any], tangents: list[Any]
) -> tuple[Any, Any]:
    """Build a Function's value and the tangents of its result.

    `tangents` are those of the `inputs`, one matrix for each, with a column for each direction.
    """
    value = function(*inputs)
    return value, function.forward(tangents[0].shape[1])(*inputs, value, *tangents)


def _variational(steps: TangentSteps, width: int, held: bool) -> ca.Function:
    """Build the variational equation of the right-hand side of `steps`.

    It has `width` tangents. With `held`, the inputs have none. Function (y, v) → ẏ, see
    `tangent_function`.
    """
    ode, nz, nw = equations(steps.model, steps.running), steps.size, steps.model.nw
    with contextlib.suppress(RuntimeError):  # an output that needs MX
        ode = ode if steps.model.mechanism.large else ode.expand()
    scalar = ode.is_a("SXFunction")
    kind: Any = ca.SX if scalar else ca.MX
    at, y, v = (
        kind.sym("at", nz + nw),
        kind.sym("y", nz * (1 + width)),
        kind.sym("v", nw * (1 if held else 1 + width)),
    )
    along = ca.vertcat(
        ca.reshape(y[nz:], nz, width), kind(nw, width) if held else ca.reshape(v[nw:], nw, width)
    )
    rate = ode(at[:nz], at[nz:])
    rates = ca.vertcat(rate, ca.vec(ca.densify(ca.jtimes(rate, at, along))))
    here = ca.substitute(rates, at, ca.vertcat(y[:nz], v[:nw]))
    return ca.Function(
        "variational", [y, v], ca.cse([here]) if scalar else [here], ["y", "v"], ["ydot"]
    )
