"""Condensed Newton method: interior-point steps with states eliminated."""

from ocp.solvers.condensed_newton.method import CondensedNewton

__all__ = ["CondensedNewton"]
