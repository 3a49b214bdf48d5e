"""Multiple shooting by an integration scheme."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from ocp.transcription.runge_kutta import RungeKuttaTranscription
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.scheme import NamedScheme, Scheme, check_scheme
from tenscasadi.schema.definitions import OneOf
from tenscasadi.util.validate import Array, format_value, whole


@dataclass(frozen=True)
class MultipleShooting(RungeKuttaTranscription, kind="MultipleShooting"):
    """Multiple shooting by the steps of an integration scheme.

    Besides the states at the mesh points, the Runge-Kutta stages of all steps are decision
    variables ("lifted" [2]_). Solutions are those of the scheme, and derivatives are small and
    exact. For high accuracy, `DirectCollocation` has fewer variables.

    Parameters
    ----------
    intervals : int or sequence of float
        Number of equal intervals, or their lengths relative to each other.
    scheme : RungeKutta4, DormandPrince54, DormandPrince853 or Collocation
        Scheme that integrates an interval, or one of your own with `coefficients`: A (s, s) and b
        (s,) of its s stages.
    substeps : int
        Number of its steps in each interval.
    control : PiecewiseConstant or PiecewiseLinear
        Profile of the controls over the intervals.
    accuracy : float, optional
        Largest permitted distance of the plan from an integration in fine steps [m]; that of
        velocities is multiplied by the duration. `solve` reaches it by deferred correction.
        Default: no correction.

    Raises
    ------
    TypeError, ValueError
        If a value has another type or is out of bounds, or the scheme has no `coefficients`.

    Notes
    -----
    The steps of a scheme conserve bar lengths only up to their integration error. As constraints at
    mesh points, the lengths would be redundant with the dynamics. Instead, two further unknowns for
    each bar correct its length and its rate at the end of each interval.

    References
    ----------
    .. [1] H. G. Bock, K. J. Plitt, A multiple shooting algorithm for direct solution of optimal
       control problems, IFAC Proceedings 17, 1984.
    .. [2] J. Albersmeyer, M. Diehl, SIAM Journal on Optimization 20, 2010, 1655-1684.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> problem = ocp.Problem(model, goals=goals, costs=[ocp.Effort()])
    >>> plan = ocp.solve(problem, ocp.MultipleShooting(4))
    >>> plan.success, plan.force_density.shape
    (True, (4, 2))
    """

    scheme: Annotated[Scheme, OneOf(NamedScheme)] = field(default_factory=RungeKutta4)
    substeps: Annotated[int, whole(1, 10_000)] = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        check_scheme(self.scheme, "MultipleShooting.scheme")
        if not hasattr(self.scheme, "coefficients"):
            raise ValueError(
                f"MultipleShooting.scheme is {format_value(self.scheme)}: give RungeKutta4(), "
                "DormandPrince54(), DormandPrince853(), Collocation() or a scheme with coefficients"
            )

    @property
    def steps(self) -> int:
        """Number of steps in each interval."""
        return self.substeps

    @property
    def coefficients(self) -> tuple[Array, Array]:
        """Coefficients A (s, s) and b (s,) of the scheme."""
        A, b = self.scheme.coefficients  # type: ignore[attr-defined]
        return np.asarray(A, dtype=float), np.asarray(b, dtype=float)

    def longest_step(self, duration: float) -> float:
        """Compute the longest integration step [s] for a duration [s].

        Parameters
        ----------
        duration : float
            Duration of the motion [s].

        Returns
        -------
        float
            Longest step [s].
        """
        return super().longest_step(duration) / self.substeps
