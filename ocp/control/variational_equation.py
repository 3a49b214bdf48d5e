"""Variational equation: derivatives of motions with respect to controls."""

from __future__ import annotations

import casadi as ca

from tenscasadi.dynamics.model import Model
from tenscasadi.util.casadi_tools import symbol_kind


def build_slopes(model: Model) -> ca.Function:
    """Build the Function (x, u) → ẋ, ∂ẋ/∂x, ∂ẋ/∂u."""
    kind = symbol_kind(model.ode)
    x, u = kind.sym("x", model.nx), kind.sym("u", model.nu)
    rate = model.ode(x, u)
    outputs = [rate, ca.jacobian(rate, x), ca.jacobian(rate, u)]
    return ca.Function("slopes", [x, u], outputs, {"cse": True})


def build_variational(slopes: ca.Function, width: int) -> ca.Function:
    """Build the variational equation; u are the last parameters."""
    nx, nu = slopes.size1_in(0), slopes.size1_in(1)
    z, u = ca.MX.sym("z", nx * (1 + width)), ca.MX.sym("u", nu)
    rate, by_state, by_control = slopes(z[:nx], u)
    turn = by_state @ ca.reshape(z[nx:], nx, width)
    turn += ca.horzcat(ca.DM(nx, width - nu), by_control)
    return ca.Function("variational", [z, u], [ca.vertcat(rate, ca.vec(turn))])
