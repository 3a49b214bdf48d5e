"""Base class of goals, soft goals, and goals for distances."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ocp.problem.costs import Cost, CostAt, TerminalCost
from ocp.problem.rows import RELIABLE, Rows, distance_rows
from tenscasadi.io.structure_section import OfStructure
from tenscasadi.schema.containers import Either, MapOf
from tenscasadi.schema.field_types import NUMBER, PER_ITEM, POINT, POINTS
from tenscasadi.schema.value import Value
from tenscasadi.structure.class_one import distances, measure_diagonal
from tenscasadi.structure.structure import Structure
from tenscasadi.util.linear_algebra import fit_rotation
from tenscasadi.util.validate import (
    Array,
    Check,
    IndexOrName,
    Positive,
    coordinates,
    finite_array,
    format_value,
    node_index,
    nonnegative,
    number_or_vector,
    per_item,
)

if TYPE_CHECKING:
    from ocp.problem.instant import Instant
    from tenscasadi.dynamics.model import Model

FREE_AXIS = "an axis that is free"
FreePoint = Annotated[
    Sequence[float | None], POINT, Check(partial(coordinates, none=FREE_AXIS, some=True))
]


class Goal(Value):
    """Base class of goals: equality constraints on a state.

    A goal is satisfied where its residuals (`rows`) are zero.

    Attributes
    ----------
    timing : str
        "end" for terminal constraints; "way" for waypoints; "period" for periodicity constraints,
        which compare end and start; "soft" for penalties.
    repeats_start : bool
        Whether the goal compares the end with an initial state that it does not store.
    """

    timing: ClassVar[str] = "end"

    @property
    def repeats_start(self) -> bool:
        """Whether the goal is relative to the initial state.

        The problem provides this state, which the goal does not store.
        """
        return False

    def check(self, structure: Structure) -> None:
        """Check that the goal can apply to a structure.

        Raises TypeError, ValueError.
        """

    def bind(self, model: Model, start: Array | None) -> Goal:
        """Complete the goal with data of model and initial state.

        For example, `CenterOfMass` reads masses from the model. The initial state ``start`` (nx,)
        is None if it is free. Returns the completed goal.
        """
        return self

    def rows(self, structure: Structure, nodes: Any, velocities: Any) -> Rows:
        """Build the residuals as functions of node positions and velocities.

        Both are 3×n [m, m/s].
        """
        raise NotImplementedError

    def residuals(self, now: Instant) -> Rows:
        """Build the residuals at an instant of the plan.

        By default, they are `rows` of the positions and velocities at the instant ``now``.
        """
        return self.rows(now.model.scene.structure, now.model_nodes, now.model_velocities)

    def places(self, structure: Structure) -> list[tuple[int, int, float]]:
        """List the node coordinates that the goal prescribes.

        Each entry is node, axis and value [m].
        """
        return []

    def move(self, structure: Structure, nodes: Array) -> Array:
        """Move nodes (n, 3) to positions that satisfy the goal [m].

        Bars may change their lengths.
        """
        return nodes

    def soft(self, weight: float = 1.0) -> Goal:
        """Convert the goal into a quadratic penalty; see `SoftGoal`.

        Parameters
        ----------
        weight : float, optional
            Cost of a residual of 1 m, or of 1 m/s; > 0.

        Returns
        -------
        Goal
            Soft goal, for the goals of a problem or of a `Waypoint`.
        """
        return SoftGoal(self, weight)


@dataclass(frozen=True, eq=False)
class SoftGoal(Goal, TerminalCost, kind="SoftGoal"):
    """Quadratic penalty weight · Σ residual² of a goal.

    `Goal.soft` builds it. It affects neither the success of a plan nor its replay error. The
    residuals of the replay are in `Plan.report`.

    Parameters
    ----------
    goal : Goal
        Goal whose residuals are penalized.
    weight : float, optional
        Weight of the penalty, > 0: the cost of a residual of 1 m, or of 1 m/s. A residual of 1 cm
        costs 10⁻⁴ · weight. Choose the weight relative to the other costs, which have units of
        their own (`Effort` has N²·s/m²).

    Raises
    ------
    TypeError, ValueError
        If ``goal`` is not a goal or is soft already, or if the weight is not a positive number.

    Examples
    --------
    >>> import ocp
    >>> ocp.StringLengths({0: 0.8}).soft(1e5).weight
    100000.0
    """

    timing: ClassVar[str] = "soft"
    goal: Goal
    weight: Positive = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.goal, Goal) or isinstance(self.goal, SoftGoal):
            raise TypeError(
                f"SoftGoal.goal is {format_value(self.goal)}: give a goal that is met, such as AtRest()"
            )
        if self.goal.timing == "way":
            raise TypeError(
                f"SoftGoal.goal is {format_value(self.goal)}: give its goals, or call its soft(weight)"
            )

    def check(self, structure: Structure) -> None:
        """Check that the goal can apply to a structure.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If the goal does not fit the structure.
        """
        self.goal.check(structure)

    def bind(self, model: Model, start: Array | None) -> Goal:
        """Complete the goal with data of model and initial state.

        Parameters
        ----------
        model : Model
            The model of the problem.
        start : ndarray of shape (nx,), optional
            Initial state; None if it is free.

        Returns
        -------
        Goal
            The same penalty of the bound goal.
        """
        return replace(self, goal=self.goal.bind(model, start))

    def rows(self, structure: Structure, nodes: Any, velocities: Any) -> Rows:
        """Build the residuals of the penalized goal.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model, before strings are divided into segments.
        nodes : casadi.SX
            Node positions, 3×n [m].
        velocities : casadi.SX
            Node velocities, 3×n [m/s].

        Returns
        -------
        Rows
            Named residuals, zero if the goal is satisfied.
        """
        return self.goal.rows(structure, nodes, velocities)

    def residuals(self, now: Instant) -> Rows:
        """Build the residuals of the penalized goal at an instant.

        Parameters
        ----------
        now : Instant
            Symbolic instant.

        Returns
        -------
        Rows
            Named residuals, zero if the goal is satisfied.
        """
        return self.goal.residuals(now)

    def terminal(self, end: Instant) -> Any:
        """Build the penalty at an instant.

        Parameters
        ----------
        end : Instant
            Instant of the goal.

        Returns
        -------
        casadi.SX or casadi.MX
            weight · Σ residual², a scalar.
        """
        return self.weight * ca.sumsqr(self.goal.residuals(end).value)


def soft_goals(costs: Iterable[Cost]) -> Iterator[tuple[float, SoftGoal]]:
    """Yield the soft goals among costs.

    Each comes with its instant as a fraction of the duration.
    """
    for cost in costs:
        share, goal = (cost.share, cost.cost) if isinstance(cost, CostAt) else (1.0, cost)
        if isinstance(goal, SoftGoal):
            yield share, goal


@dataclass(frozen=True, eq=False)
class StringLengths(Goal, kind="StringLengths"):
    """Goal for the final lengths of strings.

    If a string is modeled in segments, its length is the distance between its ends.

    Parameters
    ----------
    lengths : float, array_like of shape (α,), or mapping of int or str to float
        Lengths [m], > 0: one number for all strings, or one for each. ``{string: length}`` for some
        of them.

    Raises
    ------
    TypeError, ValueError
        If a length is not a positive number. In a `Problem`: if the number of lengths differs from
        that of strings, or if a string does not exist.

    Examples
    --------
    >>> import ocp
    >>> ocp.StringLengths({0: 0.8, 4: 1.1}).lengths
    {0: 0.8, 4: 1.1}
    """

    lengths: Annotated[
        ArrayLike | Mapping[IndexOrName, float],
        OfStructure("string_lengths", Either((dict,), MapOf("string", NUMBER), PER_ITEM)),
    ]

    def __post_init__(self) -> None:
        values = list(self.lengths.values()) if isinstance(self.lengths, Mapping) else self.lengths
        array = number_or_vector("StringLengths.lengths", values)
        if array.size == 0:
            raise ValueError(
                "StringLengths.lengths is empty: give one length for each string, or {string: length}"
            )
        nonnegative("StringLengths.lengths", array, "entry", strict=True)
        kept: Any = array if array.ndim else float(array)
        object.__setattr__(
            self,
            "lengths",
            dict(zip(self.lengths, array.tolist(), strict=True))
            if isinstance(self.lengths, Mapping)
            else kept,
        )

    def check(self, structure: Structure) -> None:
        """Check that the goal can apply to a structure.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If the number of lengths differs from that of strings, or if a string does not exist.
        """
        count = len(structure.strings)
        if isinstance(self.lengths, Mapping):
            for string in self.lengths:
                node_index("StringLengths.lengths: string", string, count, "string")
        else:
            per_item("StringLengths.lengths", self.lengths, count)

    def _wanted(self, structure: Structure) -> dict[int, float]:
        """Return the desired length of each constrained string [m]."""
        if isinstance(self.lengths, Mapping):
            return dict(self.lengths)
        return dict(
            enumerate(
                per_item("StringLengths.lengths", self.lengths, len(structure.strings)).tolist()
            )
        )

    def rows(self, structure: Structure, nodes: Any, velocities: Any) -> Rows:
        """Build the length minus the desired length of each string.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model, before strings are divided into segments.
        nodes : casadi.SX
            Node positions, 3×n [m].
        velocities : casadi.SX
            Node velocities, 3×n [m/s].

        Returns
        -------
        Rows
            Named residuals, zero if the goal is satisfied.
        """
        wanted = self._wanted(structure)
        return distance_rows(
            nodes,
            structure.strings[list(wanted)],
            np.array(list(wanted.values())),
            tuple(f"StringLengths: string {string}" for string in wanted),
        )


@dataclass(frozen=True, eq=False)
class Shape(Goal, kind="Shape"):
    """Goal for the final shape, up to rigid motions.

    Position and orientation are free. The constraints are the distances of all pairs of nodes
    without a bar between them. A shape and its mirror image have the same distances.

    Parameters
    ----------
    nodes : array_like, shape (n, 3)
        Nodes of the shape [m]. The bars must have the lengths of the structure, up to 2 % of its size.

    Raises
    ------
    TypeError, ValueError
        If ``nodes`` is not an array (n, 3). In a `Problem`: if the number of nodes differs from
        that of the structure or is less than three, or if a bar gets another length.

    See Also
    --------
    NodePositions : A shape at a given position and orientation.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> ocp.Shape(tc.shapes.prism(twist=2.5).nodes).nodes.shape
    (6, 3)
    """

    nodes: Annotated[ArrayLike, OfStructure("nodes", POINTS), Check(POINTS.check)]

    def check(self, structure: Structure) -> None:
        """Check that the goal can apply to a structure.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If the number of nodes or the lengths of the bars differ, or if there are fewer than
            three nodes.
        """
        nodes = finite_array("Shape.nodes", self.nodes, structure.nodes.shape)
        # each end of a bar may be off by the default tolerance
        most = 2 * RELIABLE * measure_diagonal(structure.nodes)
        check_bar_lengths("Shape.nodes make", nodes, structure, most)
        if len(nodes) < 3:
            raise ValueError(
                f"Shape.nodes has {len(nodes)} nodes: a shape needs three, use StringLengths or NodePositions"
            )

    def rows(self, structure: Structure, nodes: Any, velocities: Any) -> Rows:
        """Build the distance minus the desired distance of node pairs.

        They are the pairs without a bar between them.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model, before strings are divided into segments.
        nodes : casadi.SX
            Node positions, 3×n [m].
        velocities : casadi.SX
            Node velocities, 3×n [m/s].

        Returns
        -------
        Rows
            Named residuals, zero if the goal is satisfied.
        """
        kept = {frozenset(bar) for bar in structure.bars.tolist()}
        pairs = np.array(
            [
                (a, b)
                for a, b in combinations(range(len(structure.nodes)), 2)
                if frozenset((a, b)) not in kept
            ]
        )
        own = np.asarray(self.nodes)
        return distance_rows(
            nodes,
            pairs,
            distances(own, pairs),
            tuple(f"Shape: distance of nodes {a} and {b}" for a, b in pairs),
        )

    def move(self, structure: Structure, nodes: Array) -> Array:
        """Move nodes (n, 3) to the desired shape by best fit.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model, before strings are divided into segments.
        nodes : ndarray, shape (n, 3)
            Nodes [m], with the nodes inside strings last.

        Returns
        -------
        ndarray, shape (n, 3)
            Nodes of the shape, fitted to the given ones; nodes inside strings do not move.
        """
        own, before = np.asarray(self.nodes), nodes[: len(structure.nodes)]
        turn = fit_rotation(own - own.mean(axis=0), before - before.mean(axis=0))
        moved = (own - own.mean(axis=0)) @ turn.T + before.mean(axis=0)
        return np.vstack([moved, nodes[len(moved) :]])


def check_bar_lengths(
    subject: str, nodes: Array, structure: Structure, most: Array | float
) -> None:
    """Check that node positions agree with bar lengths.

    Nodes are (n, 3) [m]; ``most`` are the permitted errors of lengths [m]. Raises ValueError, whose
    message begins with ``subject``.
    """
    lengths = distances(nodes, structure.bars)
    bad = np.flatnonzero(abs(lengths - structure.bar_lengths) > most)
    if bad.size:
        k = int(bad[0])
        raise ValueError(
            f"{subject} bar {k} {lengths[k]:g} m long, not {structure.bar_lengths[k]:g} m: give nodes that keep the bars' lengths"
        )
