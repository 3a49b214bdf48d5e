"""Error for infeasible goals."""

from __future__ import annotations


class InfeasibleGoalError(ValueError):
    """Infeasible goals, found before the problem is solved.

    `solve` raises it, and `Mpc` if it tracks goals without a plan. The message names the goal row
    with the largest violation, its amount, and the constraint that prevents it. The search for a
    state that meets the goals starts at the initial state. It uses Gauss-Newton steps that satisfy
    the constraints below. A goal is rejected

    - if it contradicts other goals, the lengths of bars, joints, or a clock: the nearest state
      violates it by more than 2·10⁻⁴ of the structure's size, or of this size per longest duration
      for velocities;
    - if it contradicts momentum. Without ground, pressure, nodal forces and moving supports,
      strings do not change the path of the center of mass of each connected part along free axes.
      Nor do they change its angular momentum about free axes;
    - if it contradicts the plane or line of the initial nodes, velocities and gravity in such
      scenes;
    - if it is too far away by a factor of 100. The distance that force densities at their upper
      limits can cover in the longest duration follows from the initial accelerations. All these
      limits must be finite, and the scene must have no clock;
    - if it belongs to a `Waypoint` and fails the same tests from the start to that instant;
    - if it belongs to a `FreeStart` and contradicts its other goals, bars or joints. Goals of the
      end count if it repeats the start;
    - if it is `Periodic` and the center of mass falls, or a momentum must change. Momentum, plane
      and distance are not checked for other goals of such problems.

    Other infeasible goals are not detected. Examples are goals that need more force or time than
    available, up to the factor above, or that path constraints or contact forbid. A goal that no
    string affects to first order is another, such as a speed that only the wind changes. The plan
    of such a problem has ``success`` False and a message with the violation. With fewer force
    densities than goal rows, or without admissible controls at the start, `solve` raises a
    ValueError. Because the search is local, a goal may be rejected although a distant state meets
    it.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(), control=tc.ForceDensity()))
    >>> away = ocp.Problem(model, goals=[ocp.NodePositions(tc.shapes.prism().nodes + [0, 0, 1.0])])
    >>> ocp.solve(away)
    Traceback (most recent call last):
        ...
    ocp.targets.infeasible_goal.InfeasibleGoalError: NodePositions: node ... misses its goal by 1 m
    at best, as the centre of mass ...
    """
