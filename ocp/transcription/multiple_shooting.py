"""Multiple shooting: the states between intervals are unknowns, each interval is integrated by an explicit scheme."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from ocp.transcription.assemble import Defects
from ocp.transcription.base import OnGrid, split_symbol, unrolled
from ocp.transcription.sparse_nlp import Block
from ocp.transcription.variables import Variables, interval_names, state_names
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.scheme import Scheme, check_scheme
from tenscasadi.integrators.stabilization import projection
from tenscasadi.util.validate import Array, whole_number

_UNIFORM = ca.Function("ode", [ca.SX.sym("x"), ca.SX.sym("u")], [ca.SX.ones(1)])  # x' = 1


@dataclass(frozen=True)
class MultipleShooting(OnGrid):
    """γ constant or linear on each interval; the states between intervals are unknowns too, and continuity is a constraint.

    Each interval takes `substeps` steps of `scheme`, followed by a projection onto bars and joints: without it they drift, and imposed
    as constraints they would repeat the dynamics.
    """

    scheme: Scheme = field(default_factory=RungeKutta4)
    substeps: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        whole_number("MultipleShooting.substeps", self.substeps, 1)
        check_scheme(self.scheme)
        try:
            self.scheme.step(_UNIFORM)
        except TypeError:
            name = type(self.scheme).__name__
            text = f"MultipleShooting.scheme is {name}(), which steps whole models, not the equations with force densities of an interval"
            raise ValueError(f"{text}: give RungeKutta4(), DormandPrince54(), DormandPrince853() or Collocation()") from None

    def defects(self, variables: Variables, used: Array) -> Defects:
        """Return the gaps between the state that an interval leads to and the next one."""
        v, model = variables, variables.model
        z, (x, c, after, duration, share) = split_symbol(model.nx, v.interval_controls.shape[1], model.nx, 1, 1)
        if self.control.linear:
            end = ramped_step(model, self.scheme, self.substeps)(x, v.gamma(c, 0.0), v.gamma(c, 1.0), duration * share)
        else:
            end = shooting_step(model, self.scheme, self.substeps)(x, v.gamma(c, 0.0), duration * share)
        gap = unrolled(model, ca.Function("gap", [z], [(after - end) / ca.DM(v.scales.state)]))
        index = np.hstack([v.states[:-1], v.interval_controls, v.states[1:], v.repeated(v.duration), v.share])
        names = interval_names(v.count, state_names(model))
        return Defects([Block(gap, index, names, scale=v.scales.state, closes=v.states[1:])])


def shooting_step(model: Model, scheme: Scheme, substeps: int) -> ca.Function:
    """Steps of a scheme and a projection: Function (x, u, h) → x_next."""
    advance = scheme.step(model.ode)
    x, u, h = (ca.MX.sym(name, size) for name, size in (("x", model.nx), ("u", model.nu), ("h", 1)))
    end: Any = x
    for _ in range(substeps):
        end = advance(end, u, h / substeps)
    if model.mechanism.constrained:
        end = projection(model, 1)(end)
    return ca.Function("interval", [x, u, h], [end], ["x", "u", "h"], ["x_next"])


def ramped_step(model: Model, scheme: Scheme, substeps: int) -> ca.Function:
    """The same with a control that runs linearly from u to v, which the scheme integrates as part of the state: (x, u, v, h) → x_next."""
    x, u, v, h = (ca.MX.sym(name, size) for name, size in (("x", model.nx), ("u", model.nu), ("v", model.nu), ("h", 1)))
    z, rate = ca.MX.sym("z", model.nx + model.nu), ca.MX.sym("rate", model.nu)
    ode = ca.Function("ramped", [z, rate], [ca.vertcat(model.ode(z[: model.nx], z[model.nx :]), rate)])
    advance = scheme.step(ode)
    end: Any = ca.vertcat(x, u)
    for _ in range(substeps):
        end = advance(end, (v - u) / h, h / substeps)
    end = end[: model.nx]
    if model.mechanism.constrained:
        end = projection(model, 1)(end)
    return ca.Function("interval", [x, u, v, h], [end], ["x", "u", "v", "h"], ["x_next"])
