"""The options of the condensed Newton method."""

from __future__ import annotations

from dataclasses import dataclass

from ocp.solvers.base import NamedSolver, check_options


@dataclass(frozen=True)
class CondensedNewton(NamedSolver, kind="CondensedNewton"):
    """A Newton method in the force densities alone: the motion that belongs to them is condensed out, by sweeps over the intervals.

    It solves what `Variational` asks, without its program: for problems with limits of any kind,
    costs of force densities and of the duration, goals and waypoints, on structures of any size.
    Its work grows linearly with the intervals, and far slower with the bars than the factorisations
    of `Ipopt`.

    Parameters
    ----------
    max_iterations : int
        Most iterations.
    tolerance : float
        Tolerance of scaled optimality and constraints.
    verbose : bool
        Whether a line is printed for each iteration.

    Raises
    ------
    TypeError, ValueError
        If a value is not of its kind; from `solve`, if the method does not take the problem, or the
        transcription is not `Variational`.

    Notes
    -----
    Places of nodes and multipliers of bars are iterates of their own, which need not fit the force
    densities before the end: a smooth path is a good start. Each iteration linearises the motion
    about them, an interior-point method with exact second derivatives takes a step of the force
    densities, by projected conjugate gradients in a trust region, and the motion follows to first
    order. The largest matrix that is factored has as many rows as the goals, and as the limits
    along the way that are near: these have slacks with barriers of their own, so that a guess may
    break them.

    References
    ----------
    .. [1] R. H. Byrd, M. E. Hribar, J. Nocedal, SIAM Journal on Optimization 9, 1999, 877-900.
    .. [2] J. Albersmeyer, M. Diehl, SIAM Journal on Optimization 20, 2010, 1655-1684.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(), control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths({6: 0.95}), ocp.AtRest()]
    >>> problem = ocp.Problem(model, goals=goals, bounds=[ocp.ForceDensityLimits(1.0, 200.0)], costs=[ocp.Effort()])
    >>> ocp.solve(problem, ocp.Variational(20), ocp.CondensedNewton()).success
    True
    """

    max_iterations: int = 200
    tolerance: float = 1e-6
    verbose: bool = False

    def __post_init__(self) -> None:
        check_options("CondensedNewton", self.max_iterations, self.tolerance, self.verbose, {}, "")
