"""Optimal control problem of an MPC, as data for export."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from ocp.problem.path_constraints import ScaledRows
from tenscasadi.util.validate import Array


class Formulation(NamedTuple):
    """Optimal control problem that an `Mpc` solves in each period.

    Attributes
    ----------
    ode : casadi.Function
        Equations of motion, with strings that do not go slack.
    output : casadi.Function
        Function x → scaled output, whose squares are minimized.
    reference : casadi.Function
        Function time → references of the output (·, N) at the ends of the intervals, and of the
        control (nu, N) in them.
    control_scale : ndarray, shape (nu,)
        Scale of deviations of the control.
    substeps : int
        Number of Runge-Kutta steps in each period.
    limits : list of ScaledRows
        Path constraints on state and control, without limits of the control itself.
    rates : list of str
        Names of the quantities whose rates are limited.
    """

    ode: ca.Function
    output: ca.Function
    reference: ca.Function
    control_scale: Array
    substeps: int
    limits: list[ScaledRows]
    rates: list[str]
