"""Variational equation: sensitivities of trajectories to controls."""

from __future__ import annotations

import casadi as ca

from tenscasadi.dynamics.model import Model
from tenscasadi.util.casadi_tools import symbol_kind


def build_slopes(model: Model) -> ca.Function:
    """Build the Function (x, u) → ẋ and its Jacobians ∂ẋ/∂x, ∂ẋ/∂u."""
    kind = symbol_kind(model.ode)
    x, u = kind.sym("x", model.nx), kind.sym("u", model.nu)
    rate = model.ode(x, u)
    outputs = [rate, ca.jacobian(rate, x), ca.jacobian(rate, u)]
    return ca.Function("slopes", [x, u], outputs, {"cse": True})


def build_variational(slopes: ca.Function, width: int) -> ca.Function:
    """Build the equation for a state and its sensitivities.

    The Function is (z, u) → dz/dt, where z is the state x (nx,) and ∂x/∂p (nx, width), stacked. The
    last parameters p are the present control u. `slopes` is the result of `build_slopes`.
    """
    nx, nu = slopes.size1_in(0), slopes.size1_in(1)
    z, u = ca.MX.sym("z", nx * (1 + width)), ca.MX.sym("u", nu)
    rate, by_state, by_control = slopes(z[:nx], u)
    turn = by_state @ ca.reshape(z[nx:], nx, width)
    turn += ca.horzcat(ca.DM(nx, width - nu), by_control)
    return ca.Function("variational", [z, u], [ca.vertcat(rate, ca.vec(turn))])
