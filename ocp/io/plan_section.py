"""Table [plan] of scene files, the arguments of `ocp.solve`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any, ClassVar, Literal

import numpy as np

import ocp.sampling.solver  # noqa: F401  registers its solver
from ocp.guess.initial_guess import NamedGuess
from ocp.io.study_sections import SECTIONS as STUDIES
from ocp.problem.bounds.bound import Bound
from ocp.problem.bounds.string_bounds import StrengthLimits, TensionLimits
from ocp.problem.costs import Cost
from ocp.problem.expressions import AtEnd, Constraint, Integral
from ocp.problem.goals.goal import Goal
from ocp.problem.instant_formula import InstantFormula
from ocp.problem.phase import Phase
from ocp.problem.problem import Problem
from ocp.problem.resolved import drop_derived, join_soft
from ocp.problem.start import FreeStart
from ocp.solvers.base import NamedSolver
from ocp.transcription.base import Transcription
from tenscasadi.dynamics.coordinates import choose_coordinates
from tenscasadi.dynamics.model import Model
from tenscasadi.io.json_schema import scene_schema
from tenscasadi.io.structure_section import OfStructure
from tenscasadi.scene.control import Control
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import ForceDensity
from tenscasadi.schema.containers import Either, TableOf
from tenscasadi.schema.definitions import OneOf, definition
from tenscasadi.schema.field_types import PER_ITEM, STATE, Word
from tenscasadi.schema.reading import Item, NotWritten, SceneFileError, call
from tenscasadi.schema.value import check_fields
from tenscasadi.simulation.declared import Simulation
from tenscasadi.simulation.simulation_files import SIMULATION, START
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import MAX_REPETITIONS, Boolean, Positive, whole

METHOD = "transcription", "solver"
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
    """Problem without its model, and the arguments of `ocp.solve`.

    Parameters
    ----------
    duration : float or (float, float)
        Duration [s], or [shortest, longest] if it is a decision variable.
    start : array_like, shape (n, 3) or (nx,), or FreeStart
        Nodes at rest [m], or a state. "structure": nodes of [structure]. FreeStart: optimized with
        the plan. Default: that of [start].
    goals : list
        Terminal constraints, and waypoints.
    bounds : list
        Path constraints.
    costs : list
        Terms of the objective, which are summed.
    phases : list
        Stance phases, one after another.
    control : ForceDensity or RestLength
        Kind of control. Default: that of the scene, or ForceDensity if it has none.
    coordinates, bar_length : str
        See `tenscasadi.Model`. Default: those of [simulation].
    parameters : table
        Values of the scene's parameters. Default: those of [simulation].
    transcription : table
        Transcription. Default: selected for the problem.
    solver : table
        Solver. Default: selected for the problem.
    guess : table
        Initial guess. Default: InverseDynamics.
    tolerance : float
        Largest distance of the replay's end from the goals [m]. Default: 1 % of the structure's
        size.
    time_limit : float
        Time limit [s]. Default: no limit.
    n_starts : int
        Number of initial guesses.
    tracked : bool
        Whether the replay that decides on success is in closed loop.
    """

    earlier_names: ClassVar[Mapping[str, str]] = {"seconds": "time_limit", "starts": "n_starts"}
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
    tolerance: Positive | None = None
    time_limit: Positive | None = None
    n_starts: Annotated[int, whole(1, MAX_REPETITIONS)] = 1
    tracked: Boolean = False

    def __post_init__(self) -> None:
        check_fields(self, public=False)


_PROBLEM_ARGUMENTS = ("duration", "start", "goals", "bounds", "costs", "phases", "parameters")
SOLVE_ARGUMENTS = (
    "transcription",
    "solver",
    "guess",
    "tolerance",
    "time_limit",
    "n_starts",
    "tracked",
)
PLAN = definition(PlanPart, "plan")


def file_schema() -> dict[str, Any]:
    """Build the JSON Schema of scene files."""
    return scene_schema({"start": START, "simulation": SIMULATION, "plan": PLAN, **STUDIES})


def read_plan(item: Item, simulation: Simulation) -> dict[str, Any]:
    """Read the table [plan] as arguments of `ocp.solve`.

    `item` is the table. The simulation provides the scene and the default initial state. Raises
    SceneFileError.
    """
    item = item._replace(names=simulation.scene.structure.names)
    part, table = PLAN.read(item), item.table()
    _check_each(table, part, simulation.scene.structure)
    scene = replace(
        simulation.scene, control=part.control or simulation.scene.control or ForceDensity()
    )
    options: dict[str, Any] = {
        "coordinates": part.coordinates or simulation.coordinates,
        "bar_length": part.bar_length or simulation.bar_length,
    }
    own = replace(simulation, scene=scene, control=None, **options)
    fields = {name: getattr(part, name) for name in _PROBLEM_ARGUMENTS}
    fields["parameters"] = simulation.parameters if part.parameters is None else part.parameters
    fields["start"] = call(_read_start, item, table, {"start": part.start, "simulation": own})
    problem = call(partial(Problem, own.model), item, table, fields)
    names = {PlanPart.earlier_names.get(name, name) for name in table}
    given = {name: getattr(part, name) for name in SOLVE_ARGUMENTS if name in names}
    return {"problem": problem, **given}


def _read_start(start: Any, simulation: Simulation) -> Any:
    if isinstance(start, str):
        return FreeStart() if start == "FreeStart" else None
    as_built = (
        simulation.nodes is None and simulation.velocities is None and simulation.state is None
    )
    return start if start is not None or as_built else simulation.start


def _check_each(table: Mapping[str, Item], part: PlanPart, structure: Structure) -> None:
    """Check goals, bounds and costs against the structure.

    Errors name the line of the entry, unlike those of `Problem`. Raises SceneFileError. `table` is
    the parsed table [plan], `part` its content.
    """
    for name in ("goals", "bounds", "costs"):
        for entry, value in zip(
            table[name].entries() if name in table else (), getattr(part, name), strict=True
        ):
            call(value.check, entry, {}, {"structure": structure})


def read_solution(scene: Scene, item: Item, left_out: Mapping[str, str]) -> dict[str, Any]:
    """Read model, problem, transcription and solver from [plan].

    Those that cannot be read are None, and `not_restored` gives the reason. Raises SceneFileError.
    `item` is the table [plan], and `left_out` are the reasons why parts are not in the file.
    """
    item = item._replace(names=scene.structure.names)
    found: dict[str, Any] = dict.fromkeys(("problem", *METHOD))
    reasons, table = list(left_out.values()), item.table()

    def attempt(read: Callable[[], dict[str, Any]]) -> None:
        try:
            found.update(read())
        except SceneFileError as error:
            reasons.append(str(error))

    for name in table.keys() & {*METHOD}:
        attempt(partial(PLAN.read_fields, {name: table[name]}))
    problem = {name: value for name, value in item.value.items() if name not in METHOD}
    if "problem" not in left_out:
        attempt(partial(read_plan, item._replace(value=problem), Simulation(scene, 1.0)))
    options = {name: own for name, own in table.items() if name in ("coordinates", "bar_length")}
    own = scene if "problem" in left_out else replace(scene, strength=None)
    model = found["problem"].model if found["problem"] else Model(own, **PLAN.read_fields(options))
    reason = {"not_restored": reasons[0]} if reasons else {}
    return {**found, "structure": scene.structure, "model": model, **reason}


def write_plan(problem: Problem, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Convert a problem and arguments of `ocp.solve` to a table [plan].

    Raises NotWritten for Python functions and other values that files cannot hold.
    """
    _reject_functions(problem)
    goals, costs = join_soft(problem.goals, problem.costs)
    model = problem.model
    fields: dict[str, Any] = {
        "bounds": _select_bounds(problem),
        "phases": problem.phases,
        "goals": goals,
        "costs": costs,
    }
    if model.coordinates != choose_coordinates(model.scene):
        fields["coordinates"] = model.coordinates
    if model.mechanism.constant_length:
        fields["bar_length"] = "constant"
    if not problem.phases:
        fields["duration"] = problem.duration
    if problem.free_start or not np.array_equal(problem.initial_state, model.initial_state):
        fields["start"] = problem.start
    return PLAN.write(vars(PlanPart(**fields, **arguments)))


def _select_bounds(problem: Problem) -> tuple[Bound, ...]:
    """Select the bounds that a file stores.

    Bounds that derive from the strength of strings are stored if the scene does not have this
    strength, as strings with prescribed forces do not yield.
    """
    if problem.scene.strength is not None:
        return drop_derived(problem.bounds)
    return tuple(
        TensionLimits(upper=bound.upper) if isinstance(bound, StrengthLimits) else bound
        for bound in problem.bounds
    )


def _reject_functions(problem: Problem) -> None:
    for name in ("bounds", "costs"):
        for k, value in enumerate(getattr(problem, name)):
            is_custom = isinstance(value, (Constraint, Integral, AtEnd))
            if is_custom and not isinstance(value.expression, InstantFormula):
                kind = type(value).__name__
                raise NotWritten(
                    f"Problem.{name}[{k}] is {kind} {value.name!r}, a function in Python: "
                    "leave it out, or give an ocp.InstantFormula"
                )
