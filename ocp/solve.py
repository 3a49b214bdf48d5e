"""Function `solve`, which finds a plan for a problem."""

from __future__ import annotations

from concurrent.futures import Executor
from typing import Any

from ocp.plan.plan import Plan
from ocp.problem.problem import Problem
from ocp.sampling.solver import Sampling
from ocp.search.find_plan import find_plan
from ocp.search.multistart import find_best_plan
from ocp.search.task import MOST_STARTS, Method
from ocp.solvers.condensed_newton import CondensedNewton
from ocp.solvers.ipopt import Ipopt
from ocp.transcription.base import Transcription
from ocp.transcription.initial_guess import InitialGuess
from tenscasadi.util.validate import flag, instance, positive_number, whole_number


def solve(
    problem: Problem,
    transcription: Transcription | None = None,
    solver: Method | None = None,
    guess: InitialGuess | None = None,
    tolerance: float | None = None,
    *,
    seconds: float | None = None,
    starts: int = 1,
    executor: Executor | None = None,
    tracked: bool = False,
    parameters: Any = None,
) -> Plan:
    """Find a plan of force densities for a problem.

    Parameters
    ----------
    problem : Problem
        Optimal control problem.
    transcription : MultipleShooting, Collocation, ImplicitMidpoint or Variational, optional
        Transcription of the problem into a nonlinear program. Default with a solver:
        `MultipleShooting()`, or `Variational()` for `CondensedNewton`. Default without a solver:
        selected for the problem (see Notes).
    solver : Ipopt, CondensedNewton or Sampling, optional
        Solver of the nonlinear program. `Sampling` searches trajectories instead. Default with a
        transcription: `Ipopt()`. Default without: selected for the problem.
    guess : InverseDynamics, Equilibrium, Arrays or Plan, optional
        Initial guess. A plan with the same mesh and constraints is a warm start that includes its
        duals (see `Ipopt.warm`). `Sampling` is tried if the solver finds no plan. Default:
        `InverseDynamics()`.
    tolerance : float, optional
        Largest distance of the replay's end from the goals [m] at which a plan is a success. The
        limit of the velocity is this distance per duration. Default: 1 % of the structure's size.
    seconds : float, optional
        Time limit [s] for building, solving and replaying. When it expires, the best plan so far is
        returned, without success. Default: no limit.
    starts : int
        Number of initial guesses, which have different seeds (see `InverseDynamics` and
        `Sampling`). The best plan is returned. `Plan.starts` has the objectives of all.
    executor : concurrent.futures.Executor, optional
        Executor that solves the starts in parallel, such as a ``ProcessPoolExecutor``. Default: one
        after the other.
    tracked : bool
        Whether the replay that decides on success is a tracked replay, see `track`. Motions with a
        large error growth need it.
    parameters : array_like, shape (np,), or mapping of str to array_like, optional
        Values of the model's parameters, see `Problem.fixed`. Default: those of the problem. They
        are constants of the program. Only `Sampling` compiles code, again for each set of values.

    Returns
    -------
    Plan
        Plan. If none is found or its replay misses the goals, `success` is False. `message` then
        has the reason and the next step to try.

    Raises
    ------
    InfeasibleGoalError
        If no string forces can reach the goals. This is found before solving.
    TypeError, ValueError
        If an argument is wrong, or limits and goals contradict each other.

    See Also
    --------
    Plan.refine : Solve again on a finer mesh.

    Notes
    -----
    Without transcription and solver, both are selected. `Sampling` is selected if nodes may touch a
    ground. Otherwise it is `Variational`, with deferred correction to a third of the tolerance. Its
    solver is `CondensedNewton` from nine bars on, if it supports the problem, else `Ipopt`. The
    mesh has three intervals per radian of the fastest vibration, at least 30.

    If the replay of a plan misses the goals, the mesh is refined by a factor of two. If no plan is
    found, the other solver is tried, then `MultipleShooting`. The first success is returned, and
    its message lists the attempts.

    Problems in full coordinates are solved in reduced coordinates, which have the same motions. The
    plan, its replay and the acceptance test use the given model, and so do the user's expressions.
    `MultipleShooting` keeps full coordinates if constraints are redundant, or if bounds or costs
    are of the user's own classes.

    Examples
    --------
    The two bars of a planar cross rotate against each other within a second with minimum effort:

    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> plan = ocp.solve(ocp.Problem(model, 1.0, goals=goals, costs=[ocp.Effort()]), ocp.MultipleShooting(10))
    >>> plan.success
    True
    """
    instance("problem", problem, Problem, "an ocp.Problem")
    if transcription is not None:
        instance(
            "transcription",
            transcription,
            Transcription,
            "a transcription, such as ocp.MultipleShooting()",
        )
    if solver is not None:
        instance(
            "solver",
            solver,
            (Ipopt, CondensedNewton, Sampling),
            "an ocp.Ipopt, ocp.CondensedNewton or ocp.Sampling",
        )
    flag("tracked", tracked)
    count = whole_number("starts", starts, 1, MOST_STARTS)
    if executor is not None:
        instance("executor", executor, Executor, "a concurrent.futures.Executor, or None")
    if tolerance is not None:
        positive_number("tolerance", tolerance)
    if seconds is not None:
        positive_number("seconds", seconds)
    problem = problem if parameters is None else problem.fixed(parameters)
    arguments = problem, transcription, solver, guess, tolerance
    limits: dict[str, Any] = {"seconds": seconds, "tracked": tracked}
    if count > 1:
        return Plan.of(find_best_plan(*arguments, **limits, count=count, executor=executor))
    return Plan.of(find_plan(*arguments, **limits))
