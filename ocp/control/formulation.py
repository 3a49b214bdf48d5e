"""Predictive control problems as data."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from ocp.problem.path_constraints import ScaledRows


class Formulation(NamedTuple):
    """Predictive control problem of an `Mpc`.

    Attributes
    ----------
    output : casadi.Function
        Function x → scaled output, whose squares are minimized.
    reference : casadi.Function
        Function time → references of the output (·, N) at the ends of the intervals, and of the
        force densities (α, N) in them [N/m].
    control_scale : float
        Scale of departures of force densities [N/m].
    substeps : int
        Number of Runge-Kutta steps in each period.
    limits : list of ScaledRows
        Limits of functions of one instant, except those of force densities.
    rates : list of str
        Names of limited rates.
    """

    output: ca.Function
    reference: ca.Function
    control_scale: float
    substeps: int
    limits: list[ScaledRows]
    rates: list[str]
