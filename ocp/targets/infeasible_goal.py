"""Error for goals that are proven infeasible."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class Certificate(NamedTuple):
    """Proof that constraints have no common solution.

    The weighted sum of the constraint residuals is at least `bound` > 0 for every state. A common
    solution of all constraints would make it zero.

    Attributes
    ----------
    multipliers : mapping of str to float
        Weights of the residuals by name; residuals are scaled to order one.
    bound : float
        Least value of the sum, greater than 0.
    relaxation : str
        "linear" or "convex": dependence of the weighted sum on the state.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(), control=tc.ForceDensity()))
    >>> places = [ocp.NodePositions({0: (x, None, None)}) for x in (0.0, 1.0)]
    >>> try:
    ...     ocp.solve(ocp.Problem(model, goals=places))
    ... except ocp.InfeasibleGoalError as error:
    ...     print(error.certificate.relaxation, error.certificate.bound > 0)
    linear True
    """

    multipliers: Mapping[str, float]
    bound: float
    relaxation: str


class InfeasibleGoalError(ValueError):
    """Goals that are proven infeasible before the problem is solved.

    `solve` raises it, and `Mpc` if it tracks goals without a plan. The message names the goal row
    with the largest violation, its amount at the nearest state that was found, and the constraint
    that prevents it.

    Attributes
    ----------
    certificate : Certificate or None
        The proof.

    Notes
    -----
    Goals, bar lengths, joints, the clock, momenta and the plane of a flat structure are rows that
    are quadratic in the state at their instant. A goal is rejected if a combination of the rows is
    convex and has a positive minimum [1]_, larger than that of residuals within the tolerance. Goals
    that contradict each other, bars or momenta by less, as rounded values do, are met up to their
    contradiction, which the message of the plan gives. Momenta and plane are used only in scenes without
    ground, pressure, nodal forces and moving supports, and with a given initial state. A `Periodic`
    motion is rejected if it needs a change of a momentum that no string can cause. Limits reject a
    goal if linear rows alone determine all coordinates on which they depend.

    Other goals are tried, with a `TargetNotFoundWarning` if the search finds no state that meets
    them. Examples are goals that need more force or time than available.

    References
    ----------
    .. [1] S. Boyd, L. Vandenberghe, Convex Optimization, 2004, section 5.2 and appendix B.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(), control=tc.ForceDensity()))
    >>> away = ocp.Problem(model, goals=[ocp.NodePositions(tc.shapes.prism().nodes + [0, 0, 1.0])])
    >>> try:
    ...     ocp.solve(away)
    ... except ocp.InfeasibleGoalError as error:
    ...     print(error)
    NodePositions: node ... misses its goal by 1 m at best, as the center of mass ...
    """

    def __init__(self, message: str, certificate: Certificate | None = None) -> None:
        super().__init__(message)
        self.certificate = certificate


class TargetNotFoundWarning(UserWarning):
    """Warning that no state was found that meets the goals.

    The goals are not proven infeasible, so that the solver tries to meet them.
    """
