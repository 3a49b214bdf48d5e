"""Plans: solutions of optimal control problems."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from ocp.control.lqr import replay_tracked, track
from ocp.plan.checks import check_plan
from ocp.plan.many_replays import measure_robustness
from ocp.plan.older_files import upgrade
from ocp.plan.plan_files import find_differences, read_parts, write_parts
from ocp.plan.robustness import Robustness
from ocp.problem.problem import Problem
from ocp.results.refinement import refine_until_accurate
from ocp.results.replay import replay_open
from ocp.results.report import Report, report_of
from ocp.results.result import PlanResult
from ocp.results.view_content import describe_plan
from ocp.search.find_plan import find_plan
from ocp.solvers.monitor import Progress, build_monitor
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.scheme import Scheme
from tenscasadi.io.document import read_tables
from tenscasadi.scene.control import Control
from tenscasadi.scene.samples import sample_functions
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.archive import Fields
from tenscasadi.util.troubleshooting import add_address, describe_address
from tenscasadi.util.validate import FilePath, flag, instance, positive_number, whole_number
from tenscasadi.util.viewable import Viewable


@dataclass(frozen=True, eq=False, repr=False)
class Plan(PlanResult, Viewable, form="tenscasadi plan 1", title="plan"):
    """Solution of an optimal control problem.

    A plan has the controls over time, the resulting motion, and the errors of its replay. `solve`
    returns a plan also after a failure. It is then the best iterate, and `message` gives the cause.

    Attributes
    ----------
    success : bool
        Whether the replay meets goals, waypoints and terminal limits within the tolerance, and the
        plan meets all limits.
    status : str
        Return status of the solver.
    message : str
        Number of terminal constraints and the result; after a failure, its cause and a cure.
    objective : float
        Sum of the costs.
    iterations : int
        Iterations of the solver.
    seconds : float
        Wall time to build and solve the program [s].
    time : ndarray, shape (K + 1,)
        Mesh points [s].
    force_density : ndarray, shape (K, α) or (K + 1, α)
        Force densities [N/m], constant on each interval, or given at the mesh points and linear
        between them.
    trajectory : Trajectory
        Planned motion at the mesh points.
    replay_error : float
        Largest residual of position goals and violation of terminal limits in the replay [m]; NaN
        if the replay diverges.
    replay_speed_error : float
        Residual of velocity goals in the replay [m/s]; NaN if the replay diverges.
    open_loop_error : float
        Error of the open-loop replay [m]: the larger one of the position error and the velocity
        error × duration. It is inf if the replay diverges.
    tracked : bool
        Whether `replay_error` and `success` are those of the replay under `track`. By default they
        are those of the open-loop replay.
    structure : Structure
        Structure of the plan.
    model : Model or None
        Model of the plan; None if it was loaded and its scene has functions of time (moving
        supports, nodal forces).
    duals : Duals or None
        Duals of the constraints; None if no optimum was found.
    problem, transcription, solver : Problem, transcription and solver, or None
        Problem and method of solution; None if a file does not hold them. `not_restored` gives the
        reason.
    start_objectives : ndarray, shape (n,), or None
        Objectives of the plans from n starts, of which this is the best; NaN for starts that
        failed. None for one start.
    not_restored : str
        Reason why a loaded plan has no problem, transcription or solver; "" if it has them.
    inputs : ndarray, shape (K, nu) or (K + 1, nu), or None
        Inputs under other controls than force densities, one for each cable and each string in no
        cable. `force_density` has the resulting force densities. None under
        ``control=ForceDensity()``.
    input_attribute : str
        Attribute that returns the inputs: "force_density", "rest_length", "input_tension",
        "rest_length_rate" or "motor_torque".

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> ocp.solve(ocp.Problem(model, goals=goals, costs=[ocp.Effort()]), ocp.MultipleShooting(10)).force_density.shape
    (10, 2)
    """

    _view_content_ = describe_plan  # for pictures

    @classmethod
    def of(cls, result: PlanResult) -> Plan:
        """Convert a `PlanResult` to a plan with all methods.

        Parameters
        ----------
        result : PlanResult
            Data with the fields of a plan, such as the result of `ocp.search.find_plan`.

        Returns
        -------
        Plan
            Plan with the same fields.
        """
        return cls(**{field.name: getattr(result, field.name) for field in fields(PlanResult)})

    def summary(self) -> str:
        """Describe the plan and its replay in a few lines.

        Returns
        -------
        str
            A few lines of text.
        """
        tension = self.tension()
        lines = (
            f"{self.message}\n"
            f"solver        {self.status}, {self.iterations} iterations, {self.seconds:.3g} s\n"
            f"plan          {self.time[-1]:g} s in {len(self.time) - 1} intervals, objective {self.objective:.6g}\n"
            f"force density {self.force_density.min():.4g} … {self.force_density.max():.4g} N/m\n"
            f"tension       {tension.min():.4g} … {tension.max():.4g} N\n"
            f"replay        ends {self.replay_error:.2g} m and {self.replay_speed_error:.2g} m/s from the goal"
        )
        return "\n".join([lines, *describe_address(self.message)])

    def replay(
        self,
        scheme: Scheme | None = None,
        step: float | None = None,
        *,
        tracked: bool = False,
        parameters: Any = None,
    ) -> Trajectory:
        """Simulate the plan, in open loop or tracked.

        The simulation applies the planned force densities or rest lengths from the plan's initial
        state. With `tracked`, the time-varying LQR of `track` corrects them.

        Parameters
        ----------
        scheme : Scheme, optional
            Integration scheme. Default: `RungeKutta4()`, or `Collocation()` if elastic strings are too
            stiff for its steps.
        step : float, optional
            Longest step [s]. Default: a tenth of an interval, or less if contact with a ground
            requires it; half an interval
            for `Collocation`.
        tracked : bool
            Whether to replay under `track`. Its steps are those of `RungeKutta4`, a tenth of the
            shortest interval long, or less if contact with a ground requires it.
        parameters : array_like, shape (np,), or mapping of str to array_like, optional
            Parameter values of the simulated model, see `Problem.with_parameters`. They show the
            effect of model errors on the plan. Default: the planned values.

        Returns
        -------
        Trajectory
            The simulated motion. The clock of a scene with functions of time starts at that of the
            plan.

        Raises
        ------
        TypeError, ValueError
            If an argument is invalid, or the model is unknown, as for a loaded plan whose scene has
            functions of time.
        """
        flag("tracked", tracked)
        if tracked:
            if parameters is not None:
                raise ValueError(
                    "parameters are given, and tracked is True: give ocp.run(ocp.track(plan), t_end, model=..., parameters=...)"
                )
            if scheme is not None or step is not None:
                raise ValueError(
                    "scheme and step are given, and tracked is True, which has steps of its own: leave them out"
                )
            return replay_tracked(self)
        if parameters is None:
            model = self.require_model("replay")
        else:
            model = self._require_problem("parameters need").with_parameters(parameters).model
        return replay_open(self, model, scheme, step)

    def report(self) -> Report:
        """List active limits with their duals, and violated limits.

        The report includes violations of the plan and of its open-loop replay.

        Returns
        -------
        Report
            The limits by name. It prints as text.

        Raises
        ------
        ValueError
            If the problem is unknown.
        """
        problem = self._require_problem("report needs")
        return report_of(
            problem, self.time, self.trajectory.states, self.control, self.replay(), self.duals
        )

    def replan(
        self,
        *,
        parameters: Any = None,
        tolerance: float | None = None,
        time_limit: float | None = None,
        progress: bool | Callable[[Progress], object] | None = None,
        **changes: Any,
    ) -> Plan:
        """Solve the problem again with changes, from this plan.

        It is ``solve(changed_problem, guess=plan)``: the motion is the initial guess, and the first
        attempt repeats transcription and solver. Duals are initial values, too, if the changed
        problem has the same constraints.

        Parameters
        ----------
        parameters : array_like, shape (np,), or mapping of str to array_like, optional
            Values of the parameters of the problem's model, as in `solve`.
        tolerance : float, optional
            Largest permitted residual of the goals in the replay [m], as in `solve`.
        time_limit : float, optional
            Limit of the wall time [s], as in `solve`.
        progress : bool or callable, optional
            Progress of each attempt, as in `solve`.
        **changes : object
            New values of fields of `Problem`, such as ``goals``, ``bounds``, ``duration`` or
            ``start``.

        Returns
        -------
        Plan
            The plan of the changed problem, a local optimum near this plan.

        Raises
        ------
        InfeasibleGoalError
            The goals are proven infeasible.
        TypeError, ValueError
            A change or an argument is invalid, or the problem of the plan is unknown.

        Examples
        --------
        A bar cross folds by several angles:

        >>> import ocp
        >>> import tenscasadi as tc
        >>> def fold(angle):
        ...     return [ocp.StringLengths(tc.shapes.d_bar(angle=angle).string_lengths), ocp.AtRest()]
        >>> model = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
        >>> plan = ocp.solve(ocp.Problem(model, goals=fold(0.7), costs=[ocp.Effort()]))
        >>> nearby = [plan := plan.replan(goals=fold(angle)) for angle in (0.72, 0.74)]
        >>> all(one.success for one in nearby)
        True
        """
        known = {field.name for field in fields(Problem) if field.init}
        if unknown := sorted(set(changes) - known):
            raise TypeError(f"replan has no argument {unknown[0]!r}: give a field of ocp.Problem")
        if tolerance is not None:
            positive_number("tolerance", tolerance)
        problem = Problem(**{**self._require_problem("replan needs").given, **changes})
        if parameters is not None:
            problem = problem.with_parameters(parameters)
        monitor = build_monitor(time_limit, progress)
        return Plan.of(find_plan(problem, guess=self, tolerance=tolerance, monitor=monitor))

    def _require_problem(self, user: str) -> Problem:
        """Return the problem; raise ValueError if it is unknown.

        `user` and a verb begin the message, such as "report needs".
        """
        if self.problem is None:
            raise add_address(
                ValueError(
                    f"{user} the problem, which the plan does not hold ({self.not_restored}): give Plan.load(path, problem=...)"
                )
            )
        return self.problem

    def refine(
        self,
        tolerance: float,
        attempts: int = 5,
        time_limit: float | None = None,
        progress: bool | Callable[[Progress], object] | None = None,
    ) -> Plan:
        """Refine the mesh until the replay meets a tolerance.

        Each attempt solves on a finer mesh, starting from the last plan. If finer meshes are not
        sufficient, deferred correction follows, as with `accuracy` of a transcription. Refinement
        ends if the error is within the tolerance or at the level of rounding, or if a finer mesh no
        longer halves it.

        Parameters
        ----------
        tolerance : float
            Largest permitted residual of the goals in the replay [m]; that of velocities is
            multiplied by the duration.
        attempts : int
            Maximum number of attempts.
        time_limit : float, optional
            Wall time of all attempts [s]. After it, as after Ctrl-C, the plan is the best so far.
            By default there is no limit.
        progress : bool or callable, optional
            Progress of each attempt, as in `solve`.

        Returns
        -------
        Plan
            The best plan. Its message reports if it misses the tolerance. A plan of a search that
            did not converge is returned unchanged.

        Raises
        ------
        TypeError, ValueError
            If an argument is invalid, or problem, transcription or solver are unknown. Files do not
            hold user-defined functions, costs and schemes.
        """
        limit = positive_number("tolerance", tolerance)
        whole_number("attempts", attempts, 1)
        monitor = build_monitor(time_limit, progress)
        self.require_model("refine")
        found = refine_until_accurate(self, limit, attempts, find_plan, monitor)
        return found if isinstance(found, Plan) else Plan.of(found)

    def robustness(
        self,
        parameters: Mapping[str, float] | None = None,
        start: float | tuple[float, float] = 0.0,
        samples: int = 1000,
        seed: int = 0,
        tracked: bool = False,
        tolerance: float | None = None,
        progress: bool = False,
    ) -> Robustness:
        """Simulate the plan under random parameter and state errors.

        This is a Monte Carlo study. Each parameter is multiplied by a random factor, and each
        coordinate and velocity of the initial state has a random error. The distributions are
        independent and uniform within ± their spread. Initial states are then projected onto bars
        and joints.

        Parameters
        ----------
        parameters : mapping of str to float, optional
            Relative spreads of quantities of `tenscasadi.Parameters` by name, at least 0 and less
            than 1. With ``"stiffness"`` or ``"damping"``, replays of plans of force densities are
            under rest-length control as in `replay_rest_lengths`, because prescribed force
            densities do not depend on them. Plans of tensions reject both.
        start : float or (float, float)
            Spread of the nodes' coordinates [m], and of their velocities [m/s].
        samples : int
            Number of replays.
        seed : int
            Seed of the random numbers.
        tracked : bool
            Whether to replay under the feedback of `track`. Under rest-length control, its force
            densities are converted to rest lengths at the planned string lengths.
        tolerance : float, optional
            Largest permitted residual of the goals in a replay [m]; that of velocities is
            multiplied by the duration. Default: 1 % of the structure's size.
        progress : bool
            Whether to show a progress bar.

        Returns
        -------
        Robustness
            Errors of all replays, their success rate, and the importance of each varied quantity.
            After Ctrl-C it holds the replays that have ended, and is `interrupted`.

        Raises
        ------
        TypeError, ValueError
            If an argument is invalid, nothing varies, the scene has no quantity of a given name, or
            the model is unknown.
        """
        flag("tracked", tracked)
        flag("progress", progress)
        return measure_robustness(
            self,
            parameters,
            start,
            samples,
            seed,
            tolerance,
            track if tracked else None,
            progress,
        )

    @classmethod
    def load(cls, path: FilePath, problem: Problem | None = None) -> Plan:
        """Load a saved plan.

        No code in the file is ever run.

        Parameters
        ----------
        path : str or PathLike
            Name of the file, including its suffix.
        problem : Problem, optional
            The problem. It is needed if it has Python functions, which files do not hold. Default:
            the problem and model of the file.

        Returns
        -------
        Plan
            The plan. `not_restored` explains which parts the file does not hold.

        Raises
        ------
        FileNotFoundError
            If the file does not exist.
        ValueError
            If the file is damaged, has no valid plan, or the model of `problem` is another one. The
            message names the differences.
        """
        if problem is not None:
            instance("problem", problem, Problem, "an ocp.Problem or None")
        plan = super().load(path)
        if problem is None:
            return plan
        if wrong := _find_differences(plan, problem.model):
            cure = "give the problem that the plan was made for"
            names = ", ".join(wrong[:4])
            raise ValueError(f"problem.model is not the plan's, other in {names}: {cure}")
        return replace(plan, model=problem.model, problem=problem)

    @classmethod
    def from_arrays(cls, content: Mapping[str, Any]) -> Plan:
        """Build a plan from named arrays, such as a file's.

        Field names of earlier versions are also accepted.

        Parameters
        ----------
        content : mapping of str to ndarray
            The fields by name. Those with a default may be missing.

        Returns
        -------
        Plan
            The plan with these fields.

        Raises
        ------
        ValueError
            If a field is missing or has a wrong type, shape or value. The message names the field.
        """
        renamed = {_RENAMED.get(name, name): content[name] for name in content}
        for control in Control.members.values():  # older files name the field after the control
            name = getattr(control, "attribute", "")
            if name in renamed and name != "force_density":
                renamed |= {"inputs": renamed.pop(name), "input_attribute": name}
        return super().from_arrays(renamed)

    @classmethod
    def _check_loaded(cls, given: Mapping[str, Any]) -> None:
        check_plan(given)

    def _write_values(self) -> dict[str, str]:
        return {"plan": write_parts(self)}

    @classmethod
    def _read_values(cls, content: Fields, given: Mapping[str, Any]) -> dict[str, Any]:
        if "plan" not in content:
            return upgrade(content, given["trajectory"])
        return read_tables("plan", content["plan"], read_parts)


_RENAMED = {"unknown": "not_restored", "starts": "start_objectives"}  # field names of older files


def _find_differences(plan: Plan, model: Model) -> list[str]:
    """Find fields in which a plan's model and another differ.

    Names of nodes and members do not count.
    """
    motion = plan.trajectory
    one: Any = plan.model
    other: Any = model
    if one is None and motion.scene is not None:
        one, other = motion.scene, sample_functions(model.scene, motion.states[:, -1])[0]
    elif one is None:
        one, other = plan.structure, model.scene.structure
    fields = dict.fromkeys(find_differences(one, other, type(one).__name__))
    found = [name for name in fields if not name.endswith("_names")]
    return found or ["Model.nx"] * (motion.states.shape[1] != model.nx)
