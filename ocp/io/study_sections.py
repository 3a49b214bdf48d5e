"""Tables [refinement], [robustness] and [closed_loop] of scene files."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, NamedTuple

import casadi as ca
import numpy as np

from ocp.control.closed_loop import ClosedLoop, run
from ocp.io.controllers import ControllerOptions, MpcOptions
from ocp.problem.problem import Problem
from ocp.problem.rows import goal_rows
from ocp.results.result import PlanResult
from ocp.results.spreads import check_variation
from tenscasadi.scene.parameters import Parameters
from tenscasadi.scene.strength import drop_states, insert_states
from tenscasadi.schema.containers import TableOf
from tenscasadi.schema.definitions import OneOf, definition
from tenscasadi.schema.field_types import NUMBER, PER_ITEM, SPAN
from tenscasadi.schema.reading import Document
from tenscasadi.schema.value import check_fields
from tenscasadi.util.validate import MAX_ENTRIES, Boolean, Count, Positive, format_value, whole


@dataclass(frozen=True)
class Refinement:
    """Refinement of the plan's mesh, see `ocp.Plan.refine`.

    Parameters
    ----------
    tolerance : float
        Largest permitted residual of the goals in the replay [m]; that of velocities is multiplied
        by the duration.
    attempts : int
        Maximum number of attempts.
    """

    tolerance: Positive
    attempts: Count = 5

    def __post_init__(self) -> None:
        check_fields(self, public=False)

    def run(self, plan: Any) -> Any:
        """Refine a plan to the tolerance; see `Plan.refine`."""
        return plan.refine(self.tolerance, self.attempts)


@dataclass(frozen=True)
class RobustnessStudy:
    """Replays under random errors, see `ocp.Plan.robustness`.

    Parameters
    ----------
    parameters : table
        Relative spreads of quantities by name, such as bar_mass = 0.05.
    start : float or (float, float)
        Spread of the nodes' coordinates [m], and of their velocities [m/s].
    samples : int
        Number of replays.
    seed : int
        Seed of the random numbers.
    tracked : bool
        Whether to replay under the feedback of a time-varying LQR.
    tolerance : float
        Permitted distance of a replay from the goals [m]. Default: 1 % of the structure's size.
    """

    parameters: Annotated[Mapping[str, float] | None, TableOf(NUMBER)] = None
    start: Annotated[Any, SPAN] = 0.0
    samples: Annotated[int, whole(1, MAX_ENTRIES)] = 1000
    seed: Annotated[int, whole(0)] = 0
    tracked: Boolean = False
    tolerance: Positive | None = None

    def __post_init__(self) -> None:
        spreads, _ = check_variation(self.parameters, self.start)
        if spreads:
            Parameters(scale=tuple(spreads))  # rejects unknown quantities
        check_fields(self, public=False)

    def run(self, plan: Any, progress: bool = False) -> Any:
        """Replay a plan with random errors.

        With `progress`, a progress bar is shown.
        """
        return plan.robustness(**vars(self), progress=progress)


@dataclass(frozen=True)
class ClosedLoopRun:
    """Simulation under a feedback controller, see `ocp.run`.

    Parameters
    ----------
    t_end : float
        End of the run [s].
    controller : table
        Controller. Default: Mpc.
    steps : int
        Number of steps of RungeKutta4 in each period.
    parameters : table
        Values of the simulated scene's parameters. Default: those of [plan], which the controller
        uses.
    """

    t_end: Positive
    controller: Annotated[Any, OneOf(ControllerOptions)] = field(default_factory=MpcOptions)
    steps: Annotated[int, whole(1, MAX_ENTRIES)] = 10
    parameters: Annotated[Mapping[str, Any] | None, TableOf(PER_ITEM)] = None

    def __post_init__(self) -> None:
        check_fields(self, public=False)

    def run(
        self, problem: Problem, find_plan: Callable[[], PlanResult], progress: bool = False
    ) -> ClosedLoop:
        """Simulate the scene of a problem under the controller.

        `find_plan` is called if the controller tracks a plan. With `progress`, a progress bar is
        shown. Raises TypeError, ValueError.
        """
        plant = problem.given["model"]
        if self.parameters is None:
            plant = plant.with_parameters(problem.given["parameters"])
        plan = find_plan() if self.controller.needs_plan else None
        controller = self.controller.build(problem, plan)
        start = problem.initial_state if plan is None else plan.trajectory.states[0]
        return run(
            controller,
            self.t_end,
            plant,
            insert_states(plant.scene, start),
            steps=self.steps,
            parameters=self.parameters,
            progress=progress,
        )


class Studies(NamedTuple):
    """Studies of a plan that a scene file requests.

    Attributes
    ----------
    refinement, robustness, closed_loop
        Options of each study; None if the file has no table for it.
    """

    refinement: Refinement | None
    robustness: RobustnessStudy | None
    closed_loop: ClosedLoopRun | None


SECTIONS = {
    "refinement": definition(Refinement, "refinement"),
    "robustness": definition(RobustnessStudy, "robustness"),
    "closed_loop": definition(ClosedLoopRun, "closed_loop"),
}


def read_studies(document: Document) -> Studies:
    """Read the studies of a plan from a scene file.

    Raises SceneFileError.
    """
    items = {name: document.section(name) for name in SECTIONS}
    return Studies(
        **{
            name: None if item is None else SECTIONS[name].read(item)
            for name, item in items.items()
        }
    )


def build_studies(given: Any) -> Studies:
    """Build studies from mappings of their fields.

    `given` are such mappings by name, as `ocp.load_studies` returns them. They are read like the
    tables of a file. Raises TypeError, SceneFileError.
    """
    names = ", ".join(SECTIONS)
    if not isinstance(given, Mapping) or not all(
        isinstance(own, Mapping) for own in given.values()
    ):
        raise TypeError(f"studies is {format_value(given)}: give mappings by name, {names}")
    for name in given:
        if name not in SECTIONS:
            raise TypeError(f"studies has {format_value(name)}: give some of {names}")
    tables = {
        name: {key: value for key, value in own.items() if value is not None}
        for name, own in given.items()
    }
    try:
        plain = json.loads(json.dumps(tables, default=_make_plain))
    except Exception:  # noqa: BLE001  values of any class fail in any way
        cure = "give numbers, texts, lists and mappings of these"
        raise TypeError(f"studies is {format_value(given)}: {cure}") from None
    return read_studies(Document("studies", plain, {}))


def _make_plain(value: Any) -> Any:
    """Convert a value to lists, numbers and mappings for files.

    It may be an array, a number of NumPy or a controller.
    """
    if isinstance(value, ControllerOptions):
        own = {key: entry for key, entry in value.to_fields().items() if entry is not None}
        return {"kind": type(value).kind, **own}
    return dict(value) if isinstance(value, Mapping) else value.tolist()


def write_studies(studies: Studies) -> dict[str, dict[str, Any]]:
    """Convert studies to tables of scene files without default values.

    Raises NotWritten.
    """
    given = {name: own for name, own in studies._asdict().items() if own is not None}
    return {name: SECTIONS[name].write(vars(own)) for name, own in given.items()}


def describe_studies(studies: Studies) -> list[str]:
    """Describe each study in a line by its non-default fields."""
    texts = {
        name: [f"{key} = {own}" for key, own in table.items()]
        for name, table in write_studies(studies).items()
    }
    return [f"{name:13} {', '.join(parts)}" for name, parts in texts.items()]


def measure_goal_error(problem: Problem, state: Any) -> tuple[float, float]:
    """Compute the largest residuals of a state in the terminal goals.

    They are those of positions [m] and of velocities [m/s], 0 without goals. The state may contain
    the record of broken or yielded strings.
    """
    x = ca.SX.sym("x", problem.model.nx)
    if len(state) > problem.model.nx:
        state = drop_states(problem.scene, state)
    rows = goal_rows(problem.terminal_goals, problem.model, x)
    residuals = np.abs(ca.Function("rows", [x], [rows.value])(state).full().ravel())
    units = np.array(rows.units)
    position, velocity = (residuals[units == unit].max(initial=0.0) for unit in ("m", "m/s"))
    return float(position), float(velocity)
