"""The plan that a solver found: force densities over time, the motion they cause, and how far its replay ends from the goal."""

from __future__ import annotations

import os
from collections.abc import Mapping
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
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.scheme import Scheme
from tenscasadi.io.document import read_tables
from tenscasadi.scene.samples import sample_functions
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.archive import Fields
from tenscasadi.util.validate import flag, instance, positive_number, whole_number
from tenscasadi.util.viewable import Viewable


@dataclass(frozen=True, eq=False, repr=False)
class Plan(PlanResult, Viewable, form="tenscasadi plan 1", title="plan"):
    """Force densities over time, the motion that they cause, and how far its replay ends from the goals.

    `solve` returns one; also where no plan was found: it then holds the best that there is, and
    says why.

    Attributes
    ----------
    success : bool
        Whether an optimum was found whose replay meets the tolerance.
    status, message : str
        The solver's own word; what was imposed and what came of it, after a failure why, and what
        to try.
    objective : float
        Sum of the costs.
    iterations, seconds : int, float
        Iterations of the solver, and wall time of building and solving, s.
    time : ndarray, shape (K + 1,)
        Nodes of the mesh, s.
    force_density : ndarray, shape (K, α) or (K + 1, α)
        Force densities, N/m: held from each node of the mesh to the next, or given at the nodes and
        linear between them.
    trajectory : Trajectory
        The planned motion at the nodes of the mesh.
    replay_error, replay_speed_error : float
        Distance of the replay that counts from the goals, and from states that keep the limits of
        the end [m], and difference of velocities [m/s]; NaN if it diverges.
    open_loop_error : float
        Larger of both errors of the open-loop replay, velocities as the distance over the duration
        [m]; inf if it diverges.
    tracked : bool
        Whether the replay that counts is the one under `track`.
    structure, model : Structure, and Model or None
        What was planned for, and its model; None for a loaded plan whose scene has functions of
        time (moved supports, nodal forces).
    duals : Duals or None
        Multipliers of the constraints; None where no optimum was found.
    problem, transcription, solver : Problem, transcription and solver, or None
        What was asked, how it was made a program, and what solved it; None where a file does not
        hold it, and `not_restored` says why.
    start_objectives : ndarray, shape (n,), or None
        Objectives of the plans from several starts, of which this is the best; NaN where none was
        found. None: there was one start.
    not_restored : str
        See above.
    rest_length : ndarray, shape (K, α) or (K + 1, α), or None
        Rest lengths, m, where these were decided (``control=RestLength()``), and not force
        densities: those are then what follows at the same times.

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
        """Return a result of a search with the methods of a plan.

        Parameters
        ----------
        result : PlanResult
            The result, such as of `ocp.search.find_plan`.

        Returns
        -------
        Plan
            The plan.
        """
        return cls(**{field.name: getattr(result, field.name) for field in fields(PlanResult)})

    def summary(self) -> str:
        """Describe what was found and how.

        Returns
        -------
        str
            A few lines of text.
        """
        tension = self.tension()
        return (
            f"{self.message}\n"
            f"solver        {self.status}, {self.iterations} iterations, {self.seconds:.3g} s\n"
            f"plan          {self.time[-1]:g} s in {len(self.time) - 1} intervals, objective {self.objective:.6g}\n"
            f"force density {self.force_density.min():.4g} … {self.force_density.max():.4g} N/m\n"
            f"tension       {tension.min():.4g} … {tension.max():.4g} N\n"
            f"replay        ends {self.replay_error:.2g} m and {self.replay_speed_error:.2g} m/s from the goal"
        )

    def replay(
        self,
        scheme: Scheme | None = None,
        step: float | None = None,
        *,
        tracked: bool = False,
        parameters: Any = None,
    ) -> Trajectory:
        """Simulate the motion under the planned force densities, or rest lengths, from the plan's start, without corrections or under `track`.

        Parameters
        ----------
        scheme : Scheme, optional
            Integration scheme. Default: `RungeKutta4()`.
        step : float, optional
            Longest step, s. Default: a tenth of an interval, less where nodes on a ground ask for
            it.
        tracked : bool
            Whether `track` keeps to the plan, in steps of its own: of `RungeKutta4`, a tenth of an
            interval long.
        parameters : array_like, shape (np,), or mapping of str to array_like, optional
            Values of the parameters of the model that the problem was made of, see `Problem.with_parameters`:
            what becomes of the plan where they are other than planned for. Default: those that it
            was planned for.

        Returns
        -------
        Trajectory
            The motion. Clocks of scenes with functions of time start where the plan's does.

        Raises
        ------
        TypeError, ValueError
            An argument is wrong, or the model is not known: a loaded plan whose scene has functions
            of time.
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
        elif self.problem is not None:
            model = self.problem.with_parameters(parameters).model
        else:
            raise ValueError(
                f"parameters need the problem, which the plan does not hold ({self.not_restored}): give Plan.load(path, problem=...)"
            )
        return replay_open(self, model, RungeKutta4() if scheme is None else scheme, step)

    def report(self) -> Report:
        """Report the limits that hold the plan back, with what they cost, and those that it or its replay breaks.

        Returns
        -------
        Report
            The limits by name; it prints as a text.

        Raises
        ------
        ValueError
            The problem is not known.
        """
        if self.problem is None:
            raise ValueError(
                f"report needs the problem, which the plan does not hold ({self.not_restored}): give Plan.load(path, problem=...)"
            )
        return report_of(
            self.problem, self.time, self.trajectory.states, self.control, self.replay(), self.duals
        )

    def refine(self, tolerance: float, attempts: int = 5) -> Plan:
        """Solve again, from what was found, until the replay ends near enough to the goals or that no longer halves its error.

        On a finer mesh, or where that does not get there with corrections, as by `accuracy` of a
        transcription.

        Parameters
        ----------
        tolerance : float
            How far the replay may end from the goals, m, and as many m per duration in speed.
        attempts : int
            Most times that is solved.

        Returns
        -------
        Plan
            One that meets the tolerance, or the best, whose message says that it does not. A plan
            that was not found is returned as it is.

        Raises
        ------
        TypeError, ValueError
            An argument is wrong, or it is not known how the plan was solved: a file holds no own
            functions, costs or schemes.
        """
        limit = positive_number("tolerance", tolerance)
        whole_number("attempts", attempts, 1)
        self.require_model("refine")
        if self.problem is None or self.transcription is None or self.solver is None:
            raise ValueError(
                f"refine needs to know how the plan was solved ({self.not_restored}): refine solve(problem, ..., guess=plan)"
            )
        found = refine_until_accurate(self, limit, attempts, find_plan)
        return found if isinstance(found, Plan) else Plan.of(found)

    def robustness(
        self,
        parameters: Mapping[str, float] | None = None,
        start: float | tuple[float, float] = 0.0,
        samples: int = 1000,
        seed: int = 0,
        tracked: bool = False,
        tolerance: float | None = None,
    ) -> Robustness:
        """Replay the plan many times, where the structure or the start is not quite as planned.

        Each parameter of a replay is the planned one times a factor of its own, and each coordinate
        of its start the planned one plus a change, which bars and joints then put right; both are
        drawn uniformly and independently within ± their spread.

        Parameters
        ----------
        parameters : mapping of str to float, optional
            Relative spreads by name, at least 0 and less than 1, of quantities of
            `tenscasadi.Parameters`. With ``"stiffness"`` or ``"damping"`` motors wind elastic
            strings to the rest lengths of the plan, as `replay_rest_lengths` does: force densities do not
            depend on these.
        start : float or (float, float)
            Spread of the nodes' coordinates, m, and of their velocities, m/s.
        samples : int
            Number of replays.
        seed : int
            Seed of the draws.
        tracked : bool
            Whether `track` keeps to the plan, by the state of each replay. Wound strings then get
            the rest lengths that pull as it decides at the planned lengths.
        tolerance : float, optional
            How far a replay may end from the goals, m, and as many m per duration in speed.
            Default: 1 % of the structure's size.

        Returns
        -------
        Robustness
            The errors of all replays, the share that meets the tolerance, and what matters most.

        Raises
        ------
        TypeError, ValueError
            An argument is wrong, nothing varies, the scene does not have what a parameter names, or
            the model is not known.
        """
        flag("tracked", tracked)
        return measure_robustness(
            self, parameters, start, samples, seed, tolerance, track if tracked else None
        )

    @classmethod
    def load(cls, path: str | os.PathLike[str], problem: Problem | None = None) -> Plan:
        """Load a plan that was saved.

        No code in the file is ever run.

        Parameters
        ----------
        path : str or PathLike
            Name of the file, as it is.
        problem : Problem, optional
            The problem. Needed if it holds functions of Python, which no file does. Default: that
            of the file, with its model.

        Returns
        -------
        Plan
            The plan. `not_restored` explains which parts the file does not hold.

        Raises
        ------
        FileNotFoundError
            There is no such file.
        ValueError
            The file cannot be read, is no plan or one that cannot be, or the model of `problem` is
            another; the message names the differences.
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
        """Build from arrays; names of earlier versions are read, too.

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
            A field is missing or has a wrong type, shape or value. The message names the field.
        """
        return super().from_arrays({_RENAMED.get(name, name): content[name] for name in content})

    @classmethod
    def _check_loaded(cls, given: Mapping[str, Any]) -> None:
        check_plan(given)

    def _write_values(self) -> dict[str, str]:
        return {"plan": write_parts(self)}

    @classmethod
    def _read_values(cls, content: Fields, given: Mapping[str, Any]) -> dict[str, Any]:
        if "plan" not in content:
            return upgrade(content, given["trajectory"])
        return read_tables("plan", str(content["plan"]), read_parts)


_RENAMED = {"unknown": "not_restored", "starts": "start_objectives"}  # fields of older files


def _find_differences(plan: Plan, model: Model) -> list[str]:
    """Find the fields, but for names, in which the model of a plan differs from another one."""
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
