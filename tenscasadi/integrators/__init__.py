"""Integration schemes and corrections of constraint drift."""

from __future__ import annotations

from tenscasadi.integrators.collocation import Collocation
from tenscasadi.integrators.rattle import Rattle
from tenscasadi.integrators.runge_kutta import DormandPrince54, DormandPrince853, RungeKutta4
from tenscasadi.integrators.stabilization import BarLengthCorrection, Projection
from tenscasadi.integrators.sundials import Cvodes, Idas

__all__ = [
    "BarLengthCorrection",
    "Collocation",
    "Cvodes",
    "DormandPrince54",
    "DormandPrince853",
    "Idas",
    "Projection",
    "Rattle",
    "RungeKutta4",
]
