"""Direct collocation at Gauss points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from ocp.transcription.runge_kutta import RungeKuttaTranscription
from tenscasadi.integrators.collocation import Collocation
from tenscasadi.util.validate import Array, whole


@dataclass(frozen=True)
class DirectCollocation(RungeKuttaTranscription, kind="DirectCollocation", earlier="Collocation"):
    """Direct collocation at Gauss points.

    The method has order 2·degree, and is stable for intervals of any length. The states in each
    interval are polynomials of time that satisfy the equations of motion at `degree` points. For a
    given accuracy, more points in fewer intervals are faster than the contrary.

    Parameters
    ----------
    intervals : int or sequence of float
        Number of equal intervals, or their lengths relative to each other.
    degree : int
        Number of points in an interval, 1 to 9.
    control : PiecewiseConstant or PiecewiseLinear
        Profile of the controls over the intervals.
    accuracy : float, optional
        Largest permitted distance of the plan from an integration in fine steps [m]; that of
        velocities is multiplied by the duration. `solve` reaches it by deferred correction.
        Default: no correction.

    Raises
    ------
    TypeError, ValueError
        If a value has another type or is out of bounds.

    Notes
    -----
    Accelerations and multipliers of the points are unknowns, so that all equations are polynomials
    with few non-zeros. Two multipliers for each bar and interval keep its length and rate [2]_.

    References
    ----------
    .. [1] E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, Springer
       1993, section II.7.
    .. [2] C. W. Gear, B. Leimkuhler, G. K. Gupta, J. Comput. Appl. Math. 12-13, 1985, 77-90.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> problem = ocp.Problem(model, goals=goals, costs=[ocp.Effort()])
    >>> plan = ocp.solve(problem, ocp.DirectCollocation(4, degree=2))
    >>> plan.success, plan.force_density.shape
    (True, (4, 2))
    """

    degree: Annotated[int, whole(1, 9)] = 2  # with more intervals, none above is needed

    @property
    def coefficients(self) -> tuple[Array, Array]:
        """Coefficients A (s, s) and b (s,) of the Gauss method."""
        return Collocation(self.degree).coefficients


@dataclass(frozen=True)
class ImplicitMidpoint(RungeKuttaTranscription, kind="ImplicitMidpoint"):
    """The implicit midpoint rule: `DirectCollocation` of degree 1.

    Parameters
    ----------
    intervals : int or sequence of float
        Number of equal intervals, or their lengths relative to each other.
    control : PiecewiseConstant or PiecewiseLinear
        Profile of the controls over the intervals.
    accuracy : float, optional
        Largest permitted distance of the plan from an integration in fine steps [m]; that of
        velocities is multiplied by the duration. `solve` reaches it by deferred correction.
        Default: no correction.

    Raises
    ------
    TypeError, ValueError
        If a value has another type or is out of bounds.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> problem = ocp.Problem(model, goals=goals, costs=[ocp.Effort()])
    >>> ocp.solve(problem, ocp.ImplicitMidpoint(6)).success
    True
    """

    @property
    def coefficients(self) -> tuple[Array, Array]:
        """Coefficients A (1, 1) and b (1,) of the method."""
        return Collocation(1).coefficients
