"""Initial state of a plan, given or free."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import ArrayLike

from ocp.problem.goals.goal import Goal, check_bar_lengths
from ocp.problem.reading import read_items
from ocp.problem.rows import RESOLUTION
from tenscasadi.integrators.stabilization import build_projection
from tenscasadi.io.structure_section import OfStructure
from tenscasadi.schema.field_types import STATE
from tenscasadi.schema.value import Value
from tenscasadi.util.immutable import read_only
from tenscasadi.util.validate import Array, finite_array, nesting

if TYPE_CHECKING:
    from tenscasadi.dynamics.model import Model


@dataclass(frozen=True, eq=False)
class FreeStart(Value, kind="FreeStart"):
    """Initial state as a decision variable, such as a gait's.

    Bar lengths and joints are constraints on it. The clock (time as a state) keeps its value in
    ``near``.

    Parameters
    ----------
    near : array_like of shape (n, 3) or (nx,), optional
        Initial guess of the start: nodes at rest [m], or a state. Default: the model's initial
        state.
    goals : iterable of goals, optional
        Initial constraints, such as `NodePositions` of a node if nothing else fixes the position on
        the ground.

    Raises
    ------
    TypeError
        If a value is not a goal, or is a `Waypoint`, a `Periodic` or a soft goal. Give these to the
        problem.

    Examples
    --------
    >>> import ocp
    >>> ocp.FreeStart(goals=[ocp.AtRest()]).goals
    (AtRest(),)
    """

    near: Annotated[ArrayLike | None, OfStructure("nodes", STATE)] = None
    goals: Iterable[Goal] = ()

    def __post_init__(self) -> None:
        goals = read_items("FreeStart.goals", self.goals, Goal, "[AtRest()]")
        object.__setattr__(self, "goals", goals)
        for k, goal in enumerate(goals):
            if goal.timing != "end":
                raise TypeError(
                    f"FreeStart.goals[{k}] is a {type(goal).__name__}: give it to the problem, goals of the start are of that instant alone"
                )


def read_start(model: Model, start: ArrayLike | FreeStart | None) -> Array | FreeStart:
    """Read the initial state and project it onto the constraints.

    ``start`` is that of `Problem`. Raises TypeError, ValueError.
    """
    if isinstance(start, type):
        raise TypeError(f"Problem.start is the class {start.__name__}: give {start.__name__}()")
    if not isinstance(start, FreeStart):
        return _read_state(model, "Problem.start", start)
    if model.mechanism.joints or model.scene.supports is not None:
        raise ValueError(
            'Problem.start is free, which needs reduced coordinates without moved supports: give Model(scene, coordinates="reduced")'
        )
    return replace(start, near=_read_state(model, "FreeStart.near", start.near))


def _read_state(model: Model, field: str, given: ArrayLike | None) -> Array:
    """Read a state and project it onto the constraints.

    It is given as nodes (n, 3) [m], as a state (nx,), or as None for the model's initial state.
    ``field`` names it in messages.
    """
    if given is None:
        return model.initial_state
    try:
        return _check_state(model, field, given)
    except ValueError as error:  # such as a start of another model, which dataclasses.replace keeps
        name = field.rpartition(".")[2]
        raise ValueError(
            f"{error}, or {name}=None, which is the initial state of the model"
        ) from None


def _check_state(model: Model, field: str, given: ArrayLike) -> Array:
    """Read nodes or a state as `_read_state` does, and project it onto the constraints."""
    if nesting(given) == 1:
        state = finite_array(field, given, (model.nx,))
    else:
        nodes = finite_array(field, given, (len(model.structure.nodes), 3))
        try:
            state = model.state(nodes)
        except ValueError as error:
            raise ValueError(f"{field}: {error}") from None
    s, nodes, velocities = model.structure, model.nodes(state), model.velocities(state)
    check_bar_lengths(f"{field} makes", nodes, s, RESOLUTION * s.bar_lengths)
    bars, rates = (Z[s.bars[:, 1]] - Z[s.bars[:, 0]] for Z in (nodes, velocities))
    stretch = abs(np.sum(bars * rates, axis=1)) / s.bar_lengths
    bad = np.flatnonzero(stretch > RESOLUTION * np.linalg.norm(velocities, axis=1).max())
    if bad.size:
        i = int(bad[0])
        raise ValueError(
            f"{field} stretches bar {i} by {stretch[i]:g} m/s: give velocities that keep the bars' lengths"
        )
    return read_only(build_projection(model, 10)(state).full().ravel())  # type: ignore[no-any-return]
