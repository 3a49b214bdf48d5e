"""Prescribed motion of pinned nodes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Annotated, Any

import casadi as ca
import numpy as np

from tenscasadi.scene.breakpoints import find_breakpoints, probe_times
from tenscasadi.scene.interpolants import (
    PATH,
    Samples,
    VectorFunction,
    call_python,
    interpolate_function,
    is_traceable,
    read_function,
    sample_twice,
)
from tenscasadi.scene.time_functions import CURE, check_over_run, express
from tenscasadi.schema.containers import Either, MapOf
from tenscasadi.schema.definitions import OneOf
from tenscasadi.schema.field_types import MOVING_POINT, TIMES
from tenscasadi.schema.time_formula import TimeFormula
from tenscasadi.schema.value import Value
from tenscasadi.structure.class_one import measure_extent
from tenscasadi.structure.structure import Structure
from tenscasadi.util.immutable import keep
from tenscasadi.util.renamed import rename_fields
from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import (
    NEGLIGIBLE,
    TOLERANCE,
    Array,
    IndexOrName,
    format_value,
    node_index,
)

_MOTION = Either((dict, Samples), OneOf(Samples), MOVING_POINT)
_STEEP = 100.0  # × largest rate × offset: smaller differences are continuous
_JUMPS = {
    "the position (m)": "give a continuous motion",
    "the velocity (m/s)": "round the corner off",
}


@rename_fields(breaks="breakpoints")
@dataclass(frozen=True, eq=False)
class SupportMotion(Value, kind="SupportMotion"):
    """Prescribed motion of pinned nodes, such as a shaking base.

    Velocity and acceleration are derivatives of the position. They must be finite over a run, and
    position and velocity must be continuous. A function that CasADi cannot trace, as with Python's
    ``if``, is interpolated over each run, by polynomials of degree 7.

    Parameters
    ----------
    positions : mapping of int or str to callable
        Functions by node that convert the time [s] to (x, y, z) [m]. At t = 0 they return the
        node's position in the structure. Three numbers are a constant.
    breakpoints : array_like, shape (B,), optional
        Times [s] at which an acceleration jumps, or a pulse begins or ends. Jumps of comparisons,
        signs and roundings are found automatically. Steps of a simulation end at breakpoints.

    Examples
    --------
    >>> import numpy as np
    >>> import tenscasadi as tc
    >>> shaken = tc.SupportMotion({0: lambda t: (0.1 * np.sin(5 * t), 0, 0)})
    >>> tc.Scene(tc.shapes.pendulum(), supports=shaken).has_clock
    True
    """

    positions: Annotated[Mapping[IndexOrName, Callable[[Any], Any]], MapOf("node", _MOTION)]
    breakpoints: Annotated[Any, TIMES] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.positions, Mapping) or not self.positions:
            raise TypeError(
                f"SupportMotion.positions is {format_value(self.positions)}: "
                "give a mapping of nodes to functions of time"
            )
        given: Mapping[int, Any] = self.positions
        positions: dict[int, Any] = {}
        for node, function in given.items():
            constant = isinstance(function, (list, tuple)) and len(function) == 3
            positions[node] = TimeFormula(tuple(function)) if constant else function
            if not constant and not callable(function):
                raise TypeError(
                    f"SupportMotion.positions[{format_value(node)}] is {format_value(function)}: "
                    "give a function of time that returns (x, y, z)"
                )
        object.__setattr__(self, "positions", positions)
        super().__post_init__()

    @property
    def field(self) -> str:
        """Name of the motion in messages."""
        return "SupportMotion.positions"

    @property
    def nodes(self) -> list[int]:
        """Indices of the nodes with prescribed motion."""
        return list(self.positions)

    def check(self, structure: Structure) -> None:
        """Check the pins and initial positions of moved nodes.

        Parameters
        ----------
        structure : Structure
            Structure of the nodes.

        Raises
        ------
        TypeError, ValueError
            If a node is not pinned along all axes, or does not start at its position in the
            structure.
        """
        for node in self.nodes:
            node_index(
                f"SupportMotion.positions, node {format_value(node)}", node, len(structure.nodes)
            )
        start = self.rates()(0.0)[0].full().T
        size = measure_extent(structure.nodes)
        for node, place in zip(self.nodes, start, strict=True):
            name = f"SupportMotion.positions[{node}]"
            if structure.pinned.get(node) != "xyz":
                raise ValueError(
                    f"{name}: node {node} is not pinned along all axes: add it to Structure.pinned"
                )
            if not np.isfinite(place).all():
                raise ValueError(f"{name}(0.0) is {place}: give finite numbers; {CURE}")
            if abs(place - structure.nodes[node]).max() > 1e-9 * size:
                raise ValueError(
                    f"{name}(0.0) is {place}: start at {structure.nodes[node]}, "
                    f"the position of node {node} in the structure"
                )

    @property
    def is_interpolated(self) -> bool:
        """Whether CasADi cannot trace one of the functions."""
        return bool(self._python_functions)

    @property
    def _python_functions(self) -> dict[int, Any]:
        """Wrapped functions that CasADi cannot trace, by node."""

        def build() -> dict[int, Any]:
            names = {node: f"SupportMotion.positions[{node}]" for node in self.positions}
            return {
                node: call_python(names[node], function, (3,))
                for node, function in self.positions.items()
                if not is_traceable(names[node], function)
            }

        return keep(self, "python_functions", build)

    def interpolate(self, first: float, last: float) -> SupportMotion:
        """Interpolate the functions of time that CasADi cannot trace.

        Parameters
        ----------
        first, last : float
            Start and end of the run [s].

        Returns
        -------
        SupportMotion
            Motion with twice differentiable interpolants; this one if there are none.

        Raises
        ------
        ValueError
            If a function raises, is not deterministic, or has jumps or corners that are not
            declared. The message names the time.
        """
        if not self.is_interpolated:
            return self
        positions = dict(self.positions)
        # In shorter pieces, rounding errors of accelerations grow.
        shortest = NEGLIGIBLE**0.5 * (last - first)
        for node in self._python_functions:
            name = f"SupportMotion.positions[{node}]"
            sample = read_function(name, positions[node], (3,))
            sample_twice(name, sample, first, last)
            at, steep = interpolate_function(
                name, sample, first, last, self.breakpoints, PATH, shortest
            )
            if len(steep):
                raise add_address(
                    ValueError(
                        f"{name} is not smooth near t = {steep[0]:.4g} s: give a motion without jumps "
                        f"and corners, declare breakpoints=(…) where its acceleration jumps, or {CURE}"
                    )
                )
            positions[node] = VectorFunction(at, (3,), (first, last))
        return replace(self, positions=positions)

    def check_run(self, first: float, last: float) -> None:
        """Check the prescribed motion over a run.

        Parameters
        ----------
        first, last : float
            Start and end of the run [s].

        Raises
        ------
        ValueError
            If a position or its derivatives are not finite, if position or velocity jump, or if
            numbers and symbols give different values.
        """
        offset = NEGLIGIBLE * max(abs(first), abs(last))
        for node, function in self.positions.items():
            name, rates = (
                f"SupportMotion.positions[{node}]",
                SupportMotion({node: function}).rates(),
            )
            if isinstance(function, VectorFunction):
                function.check_run(name, first, last)
            sizes = check_over_run(name, function, rates, first, last)
            inside = self.breakpoints[(self.breakpoints > first) & (self.breakpoints < last)]
            for time in np.union1d(find_breakpoints(rates, first, last), inside):
                before, after = rates(max(first, time - offset)), rates(min(last, time + offset))
                for k, (quantity, cure) in enumerate(_JUMPS.items()):
                    jump = abs((after[k] - before[k]).full()).max()
                    near = [abs(side[k + 1].full()).max() for side in (before, after)]
                    smooth = _STEEP * offset * max(sizes[k + 1], *near)
                    if jump > max(NEGLIGIBLE * sizes[k], smooth):
                        raise add_address(
                            ValueError(
                                f"{name}: {quantity} jumps by {jump:.3g} at t = {time:g} s, "
                                f"which bars and joints cannot follow: {cure}"
                            )
                        )

    def check_bodies(self, structure: Structure, first: float, last: float) -> None:
        """Check that support motions keep bodies rigid over a run.

        Parameters
        ----------
        structure : Structure
            Structure of the nodes.
        first, last : float
            Start and end of the run [s].

        Raises
        ------
        ValueError
            If two supports of one body move apart.
        """
        fixed = np.flatnonzero(structure.fixed.all(axis=1)).tolist()
        times = probe_times(first, last)
        moved = self.rates().call([times[None]])[0].full().reshape(3, len(times), -1)
        place = {node: structure.nodes[node][:, None] for node in fixed}
        place |= {node: moved[:, :, k] for k, node in enumerate(self.nodes)}
        for k, body in enumerate(structure.bodies):
            for a, b in combinations([node for node in fixed if node in body.nodes], 2):
                distance = np.linalg.norm(place[a] - place[b], axis=0)
                worst = int(np.argmax(abs(distance - distance[0])))
                change = abs(distance[worst] - distance[0])
                if change > TOLERANCE * distance[0]:
                    raise ValueError(
                        f"SupportMotion.positions: nodes {a} and {b} of bodies[{k}] move apart by "
                        f"{change:.3g} m until t = {times[worst]:g} s: keep their distance, or "
                        "leave one of them free"
                    )

    def find_breakpoints(self, first: float, last: float) -> Array:
        """Find the jumps and kinks of the accelerations.

        Parameters
        ----------
        first, last : float
            Start and end of the run [s].

        Returns
        -------
        ndarray
            Increasing times [s].
        """
        found = [self.breakpoints, find_breakpoints(self.rates(), first, last)]
        return np.unique(np.concatenate(found))

    def changing(self) -> ca.Function:
        """Build the function of time that the steps must resolve.

        Returns
        -------
        casadi.Function
            Function of the time [s] that returns accelerations [m/s²] and velocities [m/s] of the
            moved nodes, (3, k) in the order of `nodes`. The impulse of the accelerations is zero
            for a displacement within a step, so velocities are included.
        """
        t = ca.SX.sym("t")
        _, velocities, accelerations = self.rates()(t)
        return ca.Function("supports", [t], [accelerations, velocities])

    def rates(self) -> ca.Function:
        """Build positions, velocities and accelerations of the moved nodes.

        Returns
        -------
        casadi.Function
            Function of the time [s] that returns positions [m], velocities [m/s] and accelerations
            [m/s²], each (3, k) in the order of `nodes`.
        """
        t = ca.SX.sym("t")
        columns = []
        for node, function in self.positions.items():
            own = self._python_functions.get(node, function)
            column = express(f"SupportMotion.positions[{node}]", own, t)
            if column.shape not in ((3, 1), (1, 3)):
                raise ValueError(
                    f"SupportMotion.positions[{node}] returns shape {column.shape}: give (x, y, z)"
                )
            columns.append(ca.vec(ca.SX(column)))
        p = ca.horzcat(*columns)
        v = ca.reshape(ca.jacobian(ca.vec(p), t), p.shape)
        a = ca.reshape(ca.jacobian(ca.vec(v), t), p.shape)
        return ca.Function(
            "supports",
            [t],
            [ca.densify(value) for value in (p, v, a)],
            ["t"],
            ["position", "velocity", "acceleration"],
        )
