"""Function `solve`, which finds a plan for a problem."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from typing import Any

from ocp.guess.initial_guess import InitialGuess
from ocp.plan.plan import Plan
from ocp.problem.problem import Problem
from ocp.sampling.solver import Sampling
from ocp.search.find_plan import find_plan
from ocp.search.multistart import find_best_plan
from ocp.search.task import Method
from ocp.solvers.condensed_newton import CondensedNewton
from ocp.solvers.ipopt import Ipopt
from ocp.solvers.monitor import Progress, build_monitor
from ocp.transcription.base import Transcription
from tenscasadi.util.renamed import rename_keywords
from tenscasadi.util.validate import MAX_REPETITIONS, flag, instance, positive_number, whole_number


@rename_keywords(seconds="time_limit", starts="n_starts")
def solve(
    problem: Problem,
    transcription: Transcription | None = None,
    solver: Method | None = None,
    guess: InitialGuess | None = None,
    tolerance: float | None = None,
    *,
    time_limit: float | None = None,
    n_starts: int = 1,
    executor: Executor | None = None,
    tracked: bool = False,
    parameters: Any = None,
    progress: bool | Callable[[Progress], object] | None = None,
) -> Plan:
    """Find a plan for an optimal control problem.

    Parameters
    ----------
    problem : Problem
        Optimal control problem.
    transcription : MultipleShooting, DirectCollocation, ImplicitMidpoint or Variational, optional
        Discretization of the motion. Default, with a solver: `MultipleShooting()`, `Variational()`
        for `CondensedNewton`; without, automatic (see Notes).
    solver : Ipopt, CondensedNewton or Sampling, optional
        Solver of the nonlinear program, or search by samples. Default, with a transcription:
        `Ipopt()`; without, automatic.
    guess : InverseDynamics, EquilibriumGuess, TrajectoryGuess or Plan, optional
        Initial guess. A plan also provides the first method, with a warm start: give it for the
        same problem with other goals, limits or parameters. A plan of the same mesh and constraints
        also provides initial duals (see `Ipopt`).
        `Sampling` searches if the guess leads to no plan. Default: `InverseDynamics()`.
    tolerance : float, optional
        Largest permitted residual of the goals in the replay [m]; that of velocities is multiplied
        by the duration. Default: 1 % of the structure's size.
    time_limit : float, optional
        Limit of the wall time of building, solving and replaying [s]. After it, as after Ctrl-C,
        the plan is the best so far. A step that cannot be interrupted, such as a large
        factorization, continues in its thread, and Python waits for it at exit. By default there is
        no limit.
    n_starts : int
        Number of initial guesses with different seeds, of `InverseDynamics` or `Sampling`. The best
        plan is returned; `Plan.start_objectives` holds all objectives. The default is 1, because
        second starts rarely find a better plan.
    executor : concurrent.futures.Executor, optional
        Executor that solves the starts in parallel, such as a ``ProcessPoolExecutor``. Default: one
        after the other.
    tracked : bool
        Whether the replay under the feedback of `track` decides on success. By default the
        open-loop replay decides, unless it fails because errors grow along the motion.
    parameters : array_like, shape (np,), or mapping of str to array_like, optional
        Values of the parameters of the problem's model, see `Problem.with_parameters`. Default:
        those of the problem. They are constants of the plan. Other values need no new compilation,
        except for `Sampling`.
    progress : bool or callable, optional
        Whether a line on standard error shows the progress of a plan that takes longer than two
        seconds. With several starts, it has the number of finished ones. Default: only if standard
        error is a terminal. A function of a `Progress` is called after each iteration of every
        method, except for starts in an executor, and stops the search if it returns False.
        `tenscasadi.plots.Convergence` draws a chart, also live in a notebook.

    Returns
    -------
    Plan
        The plan. If none was found, or its replay ends too far from the goals, `success` is False,
        and `message` names the cause and a cure.

    Raises
    ------
    InfeasibleGoalError
        The goals are proven infeasible; the exception holds the proof.
    TypeError, ValueError
        An argument is wrong, or limits contradict each other; the message names them.

    Warns
    -----
    TargetNotFoundWarning
        No state that meets the goals was found. The solver tries to meet them nevertheless.

    See Also
    --------
    Plan.refine : Solve again on a finer mesh.

    Notes
    -----
    By default, the method and the number of intervals are selected automatically. The mesh has
    three intervals for each radian of the fastest vibration, at least 30. If nodes may touch a
    ground, `Sampling` is tried first. For rest-length control, a plan of force densities is found
    and converted, because elastic vibrations then do not limit the mesh; if that fails, rest
    lengths are planned directly. Otherwise the transcription is `Variational`, with deferred
    correction to a third of the tolerance, and the solver `Ipopt`, or from six bars on
    `CondensedNewton`. If the replay is too inaccurate, a mesh twice as fine follows; if the solver
    fails, `MultipleShooting`. The message names the selected method.

    `Plan.success` is True if the replay satisfies goals, waypoints and terminal limits within the
    tolerance, and if the plan satisfies all other limits at the mesh points.

    Problems in full coordinates are planned in reduced coordinates, because the motion is the same.
    The plan and its replay are those of the given model.

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
    monitor = build_monitor(time_limit, progress)
    count = whole_number("n_starts", n_starts, 1, MAX_REPETITIONS)
    if executor is not None:
        instance("executor", executor, Executor, "a concurrent.futures.Executor, or None")
    if tolerance is not None:
        positive_number("tolerance", tolerance)
    problem = problem if parameters is None else problem.with_parameters(parameters)
    options = transcription, solver, guess, tolerance
    if count == 1:
        return Plan.of(find_plan(problem, *options, monitor=monitor, tracked=tracked))
    return Plan.of(
        find_best_plan(
            problem, *options, monitor=monitor, tracked=tracked, count=count, executor=executor
        )
    )
