"""The part [plan] of scene files: a problem and how it is solved, read from a table and written to one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np

import ocp.sampling.solver  # noqa: F401  registers its solver
from ocp.problem.bounds.bound import Bound
from ocp.problem.costs import Cost, CostAt
from ocp.problem.expressions import AtEnd, Constraint, Integral
from ocp.problem.goals.goal import Goal, SoftGoal
from ocp.problem.goals.waypoints import Waypoint
from ocp.problem.phase import Phase
from ocp.problem.problem import Problem
from ocp.problem.start import FreeStart
from ocp.search.task import MOST_STARTS
from ocp.solvers.base import NamedSolver
from ocp.transcription.base import Transcription
from ocp.transcription.initial_guess import NamedGuess
from tenscasadi.dynamics.coordinates import choose_coordinates
from tenscasadi.io.json_schema import scene_schema
from tenscasadi.io.structure_section import OfStructure
from tenscasadi.scene.strings import Control, ForceDensity
from tenscasadi.schema.containers import Either, TableOf
from tenscasadi.schema.definitions import OneOf, definition
from tenscasadi.schema.field_types import PER_ITEM, STATE, Word
from tenscasadi.schema.reading import Item, NotWritten, call
from tenscasadi.simulation.declared import Simulation
from tenscasadi.simulation.simulation_files import SIMULATION, START
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import positive_number, whole_number

_START = OfStructure(
    "nodes",
    Either(
        (str,),
        Word(("structure", "FreeStart")),
        Either((dict, FreeStart), OneOf(FreeStart), STATE),
    ),
)


@dataclass(frozen=True, eq=False)
class PlanPart:
    """A problem but for its model, and how it is solved.

    Parameters
    ----------
    duration : float or (float, float)
        Seconds, or [shortest, longest] to let the solver choose.
    start : array_like, shape (n, 3) or (nx,), or FreeStart
        Nodes at rest, m, or a state; "structure" for those of [structure]; FreeStart: found with
        the plan. Default: that of [start].
    goals : list
        What the motion meets, at its end unless a goal says when.
    bounds : list
        What holds all along.
    costs : list
        What is least: their sum.
    phases : list
        Parts of the plan in which nodes stand on the ground, one after another.
    control : ForceDensity or RestLength
        What is planned. Default: the scene's control, ForceDensity where it has none.
    coordinates, bar_length : str
        See `tenscasadi.Model`. Default: those of [simulation].
    parameters : table
        Values of the scene's parameters. Default: those of [simulation].
    transcription : table
        How the motion becomes a program. Default: what suits the problem.
    solver : table
        What solves it. Default: what suits the problem.
    guess : table
        Where the solver starts. Default: InverseDynamics.
    tolerance : float
        How far the replay may end from the goals, m. Default: 1 % of the structure's size.
    seconds : float
        Wall time that all of it may take, s. Default: no limit.
    starts : int
        From how many guesses it is solved.
    tracked : bool
        Whether the replay that decides on success is in closed loop.
    """

    duration: float | tuple[float, float] = 1.0
    start: Annotated[Any, _START] = None
    goals: Sequence[Goal] = ()
    bounds: Sequence[Bound] = ()
    costs: Sequence[Cost] = ()
    phases: Sequence[Phase] = ()
    control: Control | None = None
    coordinates: Literal["reduced", "full"] | None = None
    bar_length: Literal["current", "constant"] | None = None
    parameters: Annotated[Mapping[str, Any] | None, TableOf(PER_ITEM)] = None
    transcription: Transcription | None = None
    solver: Annotated[Any, OneOf(NamedSolver)] = None
    guess: Annotated[Any, OneOf(NamedGuess)] = None
    tolerance: float | None = None
    seconds: float | None = None
    starts: int = 1
    tracked: bool = False

    def __post_init__(self) -> None:
        for name in ("tolerance", "seconds"):
            if getattr(self, name) is not None:
                positive_number(name, getattr(self, name))
        whole_number("starts", self.starts, 1, MOST_STARTS)


ASKED = ("duration", "start", "goals", "bounds", "costs", "phases", "parameters")
WAY = ("transcription", "solver", "guess", "tolerance", "seconds", "starts", "tracked")
PLAN = definition(PlanPart, "plan")


def file_schema() -> dict[str, Any]:
    """Build the JSON Schema of scene files."""
    return scene_schema({"start": START, "simulation": SIMULATION, "plan": PLAN})


def read_plan(item: Item, simulation: Simulation) -> dict[str, Any]:
    """Return the arguments of `ocp.solve` that [plan] tells, beside a scene and its start. Raises SceneFileError."""
    item = item._replace(names=simulation.scene.structure.names)
    part, table = PLAN.read(item), item.table()
    _check_each(table, part, simulation.scene.structure)
    scene = replace(
        simulation.scene, control=part.control or simulation.scene.control or ForceDensity()
    )
    own: dict[str, Any] = {
        "coordinates": part.coordinates or simulation.coordinates,
        "bar_length": part.bar_length or simulation.bar_length,
    }
    modelled = replace(simulation, scene=scene, control=None, **own)
    asked = {name: getattr(part, name) for name in ASKED}
    asked["parameters"] = simulation.parameters if part.parameters is None else part.parameters
    asked["start"] = call(_start, item, table, {"start": part.start, "simulation": modelled})
    problem = call(partial(Problem, modelled.model), item, table, asked)
    return {"problem": problem, **{name: getattr(part, name) for name in WAY if name in table}}


def _start(start: Any, simulation: Simulation) -> Any:
    if isinstance(start, str):
        return FreeStart() if start == "FreeStart" else None
    as_built = (
        simulation.nodes is None and simulation.velocities is None and simulation.state is None
    )
    return start if start is not None or as_built else simulation.start


def _check_each(table: Mapping[str, Item], part: PlanPart, structure: Structure) -> None:
    """Raise SceneFileError at the first goal or bound that does not fit the structure: the problem's own message names no line."""
    for name in ("goals", "bounds", "costs"):
        for entry, value in zip(
            table[name].entries() if name in table else (), getattr(part, name), strict=True
        ):
            call(value.check, entry, {}, {"structure": structure})


def write_plan(problem: Problem, way: Mapping[str, Any]) -> dict[str, Any]:
    """Return [plan] of a problem, and of the arguments of `ocp.solve` beside it. Raises NotWritten for what no file holds."""
    _refuse_functions(problem)
    goals, costs = _with_wishes(problem)
    model = problem.model
    asked: dict[str, Any] = {
        "bounds": problem.bounds,
        "phases": problem.phases,
        "goals": goals,
        "costs": costs,
    }
    if model.coordinates != choose_coordinates(model.scene):
        asked["coordinates"] = model.coordinates
    if model.mechanism.constant_length:
        asked["bar_length"] = "constant"
    if not problem.phases:
        asked["duration"] = problem.duration
    if problem.free_start or not np.array_equal(problem.first_state, model.initial_state):
        asked["start"] = problem.start
    return PLAN.write(vars(PlanPart(**asked, **way)))


def _refuse_functions(problem: Problem) -> None:
    for name in ("bounds", "costs"):
        for k, value in enumerate(getattr(problem, name)):
            if isinstance(value, (Constraint, Integral, AtEnd)):
                kind = type(value).__name__
                raise NotWritten(
                    f"Problem.{name}[{k}] is {kind} {value.name!r}, a function in Python: leave it out, or keep the problem in Python"
                )


def _with_wishes(problem: Problem) -> tuple[list[Any], list[Any]]:
    """Return goals and costs as they are given: what is wished for is among the goals."""
    goals, costs = list(problem.goals), []
    for cost in problem.costs:
        if isinstance(cost, CostAt) and isinstance(cost.cost, SoftGoal):
            goals.append(Waypoint([cost.cost], share=cost.share))
        elif isinstance(cost, SoftGoal):
            goals.append(cost)
        else:
            costs.append(cost)
    return goals, costs
