"""Variational equation: sensitivities of trajectories to controls."""

from __future__ import annotations

from typing import Any

import casadi as ca

from tenscasadi.dynamics.model import Model
from tenscasadi.util.casadi_tools import symbol_kind


def build_slopes(model: Model) -> ca.Function:
    """Build the Function (x, u, h) → ẋ and h (∂ẋ/∂x)ᵀ, h (∂ẋ/∂u)ᵀ.

    The arguments are state, control and step [s].
    """
    kind = symbol_kind(model.ode)
    x, u, h = kind.sym("x", model.nx), kind.sym("u", model.nu), kind.sym("h")
    rate = model.ode(x, u)
    reverse = {"helper_options": {"ad_weight": 1.0}}  # a quarter fewer instructions for a ball
    outputs = [rate, *(ca.jacobian(h * rate, z, reverse).T for z in (x, u))]
    return ca.Function("slopes", [x, u, h], outputs, {"cse": True})


def linearize_step(slopes: ca.Function, x: Any, u: Any, h: float) -> tuple[Any, list[Any]]:
    """Compute a step of `RungeKutta4` with the Jacobians of its stages.

    `slopes` is the Function of `build_slopes`; `h` is the step [s] from the state x under the
    control u. Stage i has the Jacobians of hᵢ ẋ with h₁ = h₂ = h/2, h₃ = h and h₄ = h/6.
    """
    stages: list[Any] = []
    state, total = x, x
    for share, weight in ((1 / 2, 1 / 6), (1 / 2, 1 / 3), (1.0, 1 / 3), (1 / 6, 1 / 6)):
        rate, *own = slopes(state, u, share * h)
        stages.append(own)
        state, total = x + share * h * rate, total + weight * h * rate
    return total, stages


def propagate(effect: Any, stages: list[Any], driven: bool) -> Any:
    """Propagate sensitivities of a state over a step of `linearize_step`.

    The states of the stages have the sensitivities X + hᵢ Jᵢ Xᵢ.

    Parameters
    ----------
    effect : casadi.MX, shape (k, nx)
        Sensitivities of the state before the step with respect to k variables. They are
        transposed because products with sparse Jacobians then have loops over consecutive
        numbers.
    stages : list
        Jacobians of the stages, from `linearize_step`.
    driven : bool
        Whether the variables are the control of the step.

    Returns
    -------
    casadi.MX, shape (k, nx)
        Sensitivities of the state after the step.
    """
    reached: list[Any] = [effect]
    for by_state, by_control in stages:
        start = effect
        if len(reached) == 4:
            start = (reached[1] + 2 * reached[2] + reached[3] - effect) / 3
        start = ca.densify(start + by_control if driven else start)
        reached.append(ca.mac(reached[-1], by_state, start))
    return reached[-1]
