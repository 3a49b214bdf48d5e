"""Cost of the distances of nodes from reference positions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import casadi as ca

from ocp.problem.costs import RunningCost
from tenscasadi.schema.containers import MapOf
from tenscasadi.schema.field_types import MOVING_PLACE
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import (
    IndexOrName,
    Positive,
    call_user_function,
    coordinates,
    format_value,
    node_index,
    number,
)

if TYPE_CHECKING:
    from ocp.problem.instant import Instant

Place = tuple[float | None, float | None, float | None]
UNTRACKED = "an axis that does not matter"


@dataclass(frozen=True, eq=False)
class Tracking(RunningCost, kind="Tracking"):
    """Cost weight · ∫ Σ ‖node − reference‖² dt.

    References are fixed or functions of time.

    Parameters
    ----------
    positions : mapping of int or str to position
        Reference positions ``{node: (x, y, z)}`` [m], with None for an untracked axis; or
        ``{node: function}``. A function takes the time [s] as a CasADi symbol and returns three
        such entries.
    weight : float, optional
        Weight of the cost, > 0.

    Raises
    ------
    TypeError, ValueError
        If the weight is not a positive number, or if a position is not three numbers or None. In a
        `Problem`: if a node does not exist, or if a function does not return a position.

    Notes
    -----
    The integral is computed by Simpson's rule on each interval, with the midpoint of the cubic
    Hermite interpolation between its ends. Its unit is m²·s.

    Examples
    --------
    >>> import casadi as ca
    >>> import ocp
    >>> circle = lambda t: (ca.cos(t), ca.sin(t), None)
    >>> sorted(ocp.Tracking({3: circle, 4: (0.0, 0.0, 1.0)}).positions)
    [3, 4]
    """

    positions: Annotated[
        Mapping[IndexOrName, Place | Callable[[Any], Any]], MapOf("node", MOVING_PLACE)
    ]
    weight: Positive = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.positions, Mapping) or not self.positions:
            raise ValueError(
                f"Tracking.positions is {format_value(self.positions)}: give {{node: (x, y, z)}}"
            )
        places = {
            node: place
            if callable(place)
            else coordinates(
                f"Tracking.positions[{format_value(node)}]", place, UNTRACKED, some=True
            )
            for node, place in self.positions.items()
        }
        object.__setattr__(self, "positions", places)

    def check(self, structure: Structure) -> None:
        """Check that the cost can apply to a structure.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If a node does not exist.
        """
        for node in self.positions:
            node_index("Tracking.positions: node", node, len(structure.nodes))

    def rate(self, now: Instant) -> Any:
        """Build the integrand of the cost.

        Parameters
        ----------
        now : Instant
            An instant of the plan.

        Returns
        -------
        casadi.SX or casadi.MX
            weight · Σ ‖node − reference‖², a scalar.
        """
        total: Any = 0
        for node, place in self.positions.items():
            entries = (
                _moving(f"Tracking.positions[{node}](time)", place, now.time)
                if callable(place)
                else place
            )
            total = total + sum(
                (now.nodes[axis, node] - entry) ** 2
                for axis, entry in enumerate(entries)
                if entry is not None
            )
        return self.weight * total


def _moving(field: str, place: Callable[[Any], Any], time: Any) -> tuple[Any, ...]:
    """Evaluate a time-dependent reference position at a symbolic time.

    `place` is the user's function of the time, and `field` its name in messages. Raises TypeError,
    ValueError.
    """

    def read(field: str, entry: Any) -> Any:
        if not isinstance(entry, (ca.SX, ca.MX)):
            return number(field, entry)
        if not isinstance(entry, type(time)) or not entry.is_scalar():
            raise TypeError(
                f"{field} has the entry {entry}: give a scalar expression of the time alone"
            )
        return entry

    found = call_user_function(field, place, time, "give (x, y, z) of the time, s, a CasADi symbol")
    return coordinates(
        field,
        ca.vertsplit(ca.vec(found)) if isinstance(found, (ca.SX, ca.MX)) else found,
        UNTRACKED,
        some=True,
        read=read,
    )
