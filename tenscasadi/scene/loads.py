"""Loads on nodes: each value builds its columns of W (3×n) and, where it has one, its potential energy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.scene.time_functions import check_over_run, express, find_breaks, interpolate, trace
from tenscasadi.util.read_only import ReadOnlyArrays
from tenscasadi.util.validate import Array, Indices, finite_array, listed, node_index, number, whole_number

_ROUNDINGS = 4.0  # of the clock in a step: jumps are stepped over from as many before to as many after


@dataclass(frozen=True)
class Gravity:
    """Uniform gravity.

    Parameters
    ----------
    acceleration : sequence of float, shape (3,)
        Acceleration of a free body, m/s².

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.Gravity((0, 0, -1.62))
    Gravity(acceleration=(0.0, 0.0, -1.62))
    """

    acceleration: Sequence[float] = (0.0, 0.0, -9.81)

    def __post_init__(self) -> None:
        vector = finite_array("Gravity.acceleration", self.acceleration, (3,))
        object.__setattr__(self, "acceleration", tuple(float(v) for v in vector))

    def forces(self, node_weight: Array) -> ca.DM:
        """Return the weights of nodes.

        Parameters
        ----------
        node_weight : ndarray, shape (n,)
            Mass that each node carries, kg: the row sums of the mass matrix.

        Returns
        -------
        casadi.DM, shape (3, n)
            W, N.
        """
        return ca.DM(np.outer(self.acceleration, node_weight))

    def energy(self, N: Any, node_weight: Array) -> Any:
        """Return the potential energy −Σ mᵢ gᵀnᵢ.

        Parameters
        ----------
        N : casadi expression, shape (3, n)
            Nodes, m.
        node_weight : ndarray, shape (n,)
            Mass that each node carries, kg.

        Returns
        -------
        casadi expression
            Energy, J, zero at the origin.
        """
        return -ca.sum1(ca.sum2(N * self.forces(node_weight)))


@dataclass(frozen=True)
class Pressure:
    """A pressure across triangles, which follows them as they move.

    Each node a, b, c of a face takes p/6 (b − a)×(c − a), towards the side from which a, b, c run counterclockwise: outwards, for
    a closed surface under inner pressure.

    Parameters
    ----------
    faces : array_like of int, shape (f, 3)
        Nodes of each triangle.
    difference : float
        Pressure p, Pa.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> pressure = tc.Pressure(tc.shapes.membrane_faces(p=8, q=5), difference=50.0)
    >>> tc.Scene(tc.shapes.membrane(p=8, q=5), pressure=pressure).pressure.difference
    50.0
    """

    faces: Sequence[Sequence[int]] | Indices
    difference: float

    def __post_init__(self) -> None:
        given = listed("Pressure.faces", self.faces, "[(0, 1, 2)] of triangles of node indices")
        faces = tuple(listed(f"Pressure.faces[{k}]", face, "(0, 1, 2), three node indices") for k, face in enumerate(given))
        for k, face in enumerate(faces):
            for node in face:
                whole_number(f"Pressure.faces[{k}]", node, -(2**31))
            if len(face) != 3 or len(set(face)) != 3:
                raise ValueError(f"Pressure.faces[{k}] is {face}: give three different node indices")
        object.__setattr__(self, "faces", faces)
        object.__setattr__(self, "difference", number("Pressure.difference", self.difference))

    def check(self, nodes: int) -> None:
        """Raise ValueError where a face names a node that is not there.

        Parameters
        ----------
        nodes : int
            Number of nodes.
        """
        for k, face in enumerate(self.faces):
            for node in face:
                node_index(f"Pressure.faces[{k}]", node, nodes)

    def forces(self, N: Any) -> Any:
        """Return the forces on nodes.

        Parameters
        ----------
        N : casadi expression, shape (3, n)
            Nodes, m.

        Returns
        -------
        casadi expression, shape (3, n)
            W, N.
        """
        a, b, c = ([face[k] for face in self.faces] for k in range(3))
        push = self.difference / 6 * ca.cross(N[:, b] - N[:, a], N[:, c] - N[:, a], 1)  # 3×f
        rows = list(range(len(a)))
        spread = ca.DM.triplet(rows * 3, a + b + c, ca.DM.ones(3 * len(a)), len(a), N.shape[1])
        return ca.mtimes(push, spread)


@dataclass(frozen=True, eq=False)
class NodalForce(ReadOnlyArrays):
    """Forces on nodes, constant or over time.

    A function is called once with a CasADi symbol: write it with NumPy's or CasADi's mathematics, without ``if`` on the time.
    A table is linear between its times and constant before and after them.

    Parameters
    ----------
    values : array_like, shape (n, 3) or (K, n, 3), or callable
        Forces, N; a function of the time t, s, that returns them; or a table of them at `times`.
    times : array_like, shape (K,), optional
        Increasing times of a table, s. Steps of a simulation end there.
    breaks : array_like, shape (B,), optional
        Times at which a function of time jumps, has a kink, or begins or ends a pulse, s. Steps of a simulation end there, and where
        comparisons, signs and roundings switch, which are found without being given.

    Examples
    --------
    >>> import numpy as np
    >>> import tenscasadi as tc
    >>> wind = tc.NodalForce(lambda t: [[0, 0, 0], [np.sin(t), 0, 0]])
    >>> tc.Scene(tc.shapes.pendulum(), forces=wind).has_clock
    True
    """

    values: Any
    times: Any = None
    breaks: Any = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "breaks", finite_array("NodalForce.breaks", self.breaks, (None,)))
        if len(self.breaks) and not callable(self.values):
            raise ValueError(f"NodalForce.breaks is {self.breaks}: give breaks of a function of time alone, a table has its times")
        if self.times is not None:
            times = finite_array("NodalForce.times", self.times, (None,))
            if len(times) < 2 or np.any(np.diff(times) <= 0):
                raise ValueError(f"NodalForce.times is {times}: give two or more increasing times")
            object.__setattr__(self, "times", times)
            object.__setattr__(self, "values", finite_array("NodalForce.values", self.values, (len(times), None, 3)))
        elif not callable(self.values):
            object.__setattr__(self, "values", finite_array("NodalForce.values", self.values, (None, 3)))

    @property
    def varies(self) -> bool:
        """Whether the forces are a function of time."""
        return self.times is not None or callable(self.values)

    def check(self, nodes: int) -> None:
        """Raise TypeError or ValueError unless there is one row of finite numbers for each node (at t = 0 for a function).

        Parameters
        ----------
        nodes : int
            Number of nodes.
        """
        if callable(self.values):
            try:
                sample = self.values(0.0)
            except Exception as error:  # whatever the caller's function raises
                raise ValueError(f"NodalForce.values raised {error!r} at t = 0: give a function of time that returns ({nodes}, 3)") from error
            finite_array("NodalForce.values(0.0)", sample, (nodes, 3))
            rows = express("NodalForce.values", self.values, ca.MX.sym("t"))
            if rows.shape != (nodes, 3):
                raise ValueError(f"NodalForce.values returns shape {rows.shape} on a CasADi time: give ({nodes}, 3)")
        elif self.values.shape[-2] != nodes:
            raise ValueError(f"NodalForce.values has {self.values.shape[-2]} rows: give one row for each of the {nodes} nodes")

    def forces(self, time: Any) -> Any:
        """Return the forces at a time.

        Parameters
        ----------
        time : casadi expression
            t, s; not needed where the forces are constant.

        Returns
        -------
        casadi expression, shape (3, n)
            W, N.
        """
        if self.times is not None:
            return interpolate(time, self.times, self.values)
        if not callable(self.values):
            return ca.DM(self.values.T)
        return express("NodalForce.values", self.values, time).T

    def check_run(self, first: float, last: float) -> None:
        """Raise ValueError where a function of time is not finite in a run or is not written in the mathematics of symbols.

        Parameters
        ----------
        first, last : float
            Times at which the run begins and ends, s.
        """
        if callable(self.values):
            check_over_run("NodalForce.values", self.values, trace(self.forces), first, last)

    def find_breaks(self, first: float, last: float, steps: int) -> Array:
        """Return the times at which steps have to end: those of a table, or just before and just after each jump or kink of a function.

        Parameters
        ----------
        first, last : float
            Times at which the run begins and ends, s.
        steps : int
            Number of steps of the run: the clock is the sum of them, and off by their rounding.

        Returns
        -------
        ndarray
            Times, s, in order.
        """
        if self.times is not None:
            return np.asarray(self.times)
        if not callable(self.values):
            return np.empty(0)
        around = _ROUNDINGS * (steps + 1) * float(np.spacing(max(abs(first), abs(last))))
        jumps = np.concatenate([self.breaks, find_breaks(trace(self.forces), first, last)])
        return np.unique(np.concatenate([jumps - around, jumps + around]))
