"""The entrance to planning: checks of the arguments, and a plan with its methods."""

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
        What is asked.
    transcription : MultipleShooting, Collocation, ImplicitMidpoint or Variational, optional
        How the motion becomes a program. Default, with a solver: `MultipleShooting()`,
        `Variational()` for `CondensedNewton`; without, what suits the problem (see Notes).
    solver : Ipopt, CondensedNewton or Sampling, optional
        What solves the program, or samples motions instead. Default, with a transcription:
        `Ipopt()`; without, what suits the problem.
    guess : InverseDynamics, Equilibrium, Arrays or Plan, optional
        Where the solver starts. From a plan of the same mesh and constraints it starts exactly,
        with its multipliers (see `Ipopt.warm`). `Sampling` searches where it leads to no plan.
        Default: `InverseDynamics()`.
    tolerance : float, optional
        How far the replay may end from the goals, m, and as many m per duration in speed, for the
        plan to be a success. Default: 1 % of the structure's size.
    seconds : float, optional
        Wall time, s, that all of it may take: building, solving, replaying. When it is over, the
        plan is the best so far, without success. By default there is no limit.
    starts : int
        From how many guesses it is solved, which differ by their seeds (see `InverseDynamics`; with
        `Sampling` its own). The plan is the best of all, and `Plan.starts` the objectives of all.
    executor : concurrent.futures.Executor, optional
        What solves the starts at once, such as a ``ProcessPoolExecutor``. Default: one after the
        other.
    tracked : bool
        Whether the replay that decides on success is under `track`, in closed loop: for motions
        along which errors grow.
    parameters : array_like, shape (np,), or mapping of str to array_like, optional
        Values of the parameters of the problem's model, see `Problem.fixed`. Default: those that
        the problem was made with. They enter as constants; only `Sampling` compiles code, and does
        so again for other values.

    Returns
    -------
    Plan
        The plan. Where none was found, or its replay misses more, `success` is False, and `message`
        says why and what to try.

    Raises
    ------
    InfeasibleGoalError
        No strings can bring the goals about; found before solving.
    TypeError, ValueError
        An argument is wrong, or limits and goals contradict each other; the message names them.

    See Also
    --------
    Plan.refine : Solve again on a finer mesh.

    Notes
    -----
    Where neither transcription nor solver is given, both are chosen, and the number of intervals:
    three for each radian of the fastest vibration, 30 at least. Where nodes may touch a ground,
    `Sampling`; else `Variational`, corrected to a third of the tolerance, with `Ipopt`, or from
    nine bars on with `CondensedNewton`, where it takes the problem. A plan whose replay misses is
    found again on a mesh twice as fine; where there is none, the other solver follows, then
    `MultipleShooting`. The first success is returned, and its message says what was tried.

    A problem in full coordinates is planned in reduced ones, as motions do not depend on them, but
    with `MultipleShooting`: the plan, its replay and the verdict are of the model that is given,
    and own expressions get its states. Where constraints are redundant, or bounds and costs are of
    own classes, `MultipleShooting` plans in full coordinates.

    Examples
    --------
    The two bars of a planar cross turn against each other within a second, at the least effort:

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
    asked = problem, transcription, solver, guess, tolerance
    if count > 1:
        best = find_best_plan(
            *asked, seconds=seconds, tracked=tracked, count=count, executor=executor
        )
        return Plan.of(best)
    return Plan.of(find_plan(*asked, seconds=seconds, tracked=tracked))
