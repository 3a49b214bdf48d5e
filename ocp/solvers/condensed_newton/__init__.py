"""The condensed Newton method."""

from ocp.solvers.condensed_newton.method import CondensedNewton

__all__ = ["CondensedNewton"]
