"""The error of goals that cannot be met."""

from __future__ import annotations


class InfeasibleGoalError(ValueError):
    """Goals that cannot be met, found before anything is solved.

    `solve` raises it, and so does `Mpc` where it holds the goals without a plan. The message names
    the row of the goal that misses most, by how much, and what stands against it. A state that
    meets the goals is looked for from the start, by Gauss-Newton steps that keep what is listed
    here. Refused are goals

    - of which the nearest state that is found misses one by more than 2·10⁻⁴ of the structure's
    size (or, for velocities, of size per longest
      duration), because they contradict each other, the lengths of bars, joints, or a clock;
    - that contradict momentum: where the scene has neither ground, pressure, given forces nor moved
    supports, strings do not change the path
      and speed of the centre of mass of each part that hangs together, along axes and about axes
      that no pin holds, whatever the duration within its limits;
    - that contradict the plane (or line) in which nodes, velocities and gravity of the start lie,
    in such scenes;
    - farther off, by a factor of 100, than force densities at their upper limits move nodes within
    the longest duration, as accelerations at
      the start tell: where all these limits are finite and the scene has no clock;
    - of a `Waypoint`, by the same tests from the start to that instant, each waypoint for itself;
    - of a `FreeStart`: where its own goals (and those of the end, if it repeats the start in its
    place) contradict each other, bars or joints;
      and `Periodic` ones where the centre of mass falls, or some momentum is bound to change.
      Momenta, plane and distance are not asked of other goals of such problems.

    Not refused, as nothing here tests it, are goals that need more force or time than there is, but
    for the factor above; that path constraints or contact forbid; or that no string moves to first
    order, such as a speed that only the wind changes. Such a problem gets a plan with ``success``
    False, and a message that says what is missing. Fewer force densities than rows of goals, and
    limits that leave none at the start, are a plain ValueError of `solve`. As the search is local,
    goals may be refused although a state far from the start meets them.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(), control=tc.ForceDensity()))
    >>> away = ocp.Problem(model, goals=[ocp.NodePositions(tc.shapes.prism().nodes + [0, 0, 1.0])])
    >>> ocp.solve(away)
    Traceback (most recent call last):
        ...
    ocp.targets.infeasible_goal.InfeasibleGoalError: NodePositions: node ... misses its goal by 1 m at
    best, as the centre of mass ...
    """
