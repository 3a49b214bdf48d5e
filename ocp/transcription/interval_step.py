"""Steps of a scheme over one interval of a plan."""

from __future__ import annotations

from typing import Any

import casadi as ca

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.scheme import Scheme
from tenscasadi.integrators.stabilization import build_projection


def shooting_step(model: Model, scheme: Scheme, substeps: int) -> ca.Function:
    """Return steps of a scheme and a projection: Function (x, u, h) → x_next."""
    advance = scheme.step(model.ode)
    x, u, h = (ca.MX.sym(name, size) for name, size in (("x", model.nx), ("u", model.nu), ("h", 1)))
    end: Any = x
    for _ in range(substeps):
        end = advance(end, u, h / substeps)
    if model.mechanism.constrained:
        end = build_projection(model, 1)(end)
    return ca.Function("interval", [x, u, h], [end], ["x", "u", "h"], ["x_next"])


def ramped_step(model: Model, scheme: Scheme, substeps: int) -> ca.Function:
    """Return the same for a control that runs linearly from u to v, which the scheme integrates with the state: (x, u, v, h) → x_next."""
    x, u, v, h = (
        ca.MX.sym(name, size)
        for name, size in (("x", model.nx), ("u", model.nu), ("v", model.nu), ("h", 1))
    )
    z, rate = ca.MX.sym("z", model.nx + model.nu), ca.MX.sym("rate", model.nu)
    ode = ca.Function(
        "ramped", [z, rate], [ca.vertcat(model.ode(z[: model.nx], z[model.nx :]), rate)]
    )
    advance = scheme.step(ode)
    end: Any = ca.vertcat(x, u)
    for _ in range(substeps):
        end = advance(end, (v - u) / h, h / substeps)
    end = end[: model.nx]
    if model.mechanism.constrained:
        end = build_projection(model, 1)(end)
    return ca.Function("interval", [x, u, v, h], [end], ["x", "u", "v", "h"], ["x_next"])
