"""Programs made of many instances of few small functions: their values and exact sparse derivatives, instance by instance.

A function of a few dozen numbers is differentiated once and evaluated for each interval; what results is put where it belongs by index.
No colouring of large graphs, no derivative of a graph of many calls: building and evaluating cost what the non-zeros cost.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import casadi as ca
import numpy as np

from tenscasadi.util.validate import Array, Indices

Kind = Literal["defect", "path", "start", "waypoint", "end", "periodic", "cost"]  # what rows are of


@dataclass(frozen=True, eq=False)
class Block:
    """Rows lower ≤ function(z_k) ≤ upper of `count` instances k; z_k are the entries `index[k]` of the unknowns and constants.

    function: z (nz) → rows (m); index (count, nz); lower, upper, scale (count, m) or broadcast to it; names: count·m, instance by instance.
    scale: what one stands for, in the unit of what is limited. closes: None, or for each row of an instance the unknown x⁺ of which it is
    x⁺ − F(…), in the same scale. combination: None, or a dense matrix (m, rows of function) with which the function's rows are multiplied.
    kind: what the rows are of, by which others find them.
    """

    function: ca.Function
    index: Indices
    names: tuple[str, ...]
    lower: Any = 0.0
    upper: Any = 0.0
    scale: Any = 1.0
    closes: Indices | None = None
    combination: Array | None = None
    kind: Kind = "defect"

    @property
    def count(self) -> int:
        """Instances."""
        return len(self.index)

    @property
    def rows(self) -> int:
        """Rows of one instance."""
        return int(self.function.size1_out(0)) if self.combination is None else len(self.combination)

    def value(self, z: Any) -> Any:
        """Rows (m, count) at z (nz, count)."""
        own = self.function.map(self.count)(z)
        return own if self.combination is None else ca.mtimes(ca.DM(self.combination), own)

    def limits(self) -> tuple[Array, Array, Array]:
        """Lower and upper limits and scales of all rows, instance by instance."""
        shape, given = (self.count, self.rows), (self.lower, self.upper, self.scale)
        return tuple(np.broadcast_to(np.asarray(value, dtype=float), shape).ravel() for value in given)  # type: ignore[return-value]


@dataclass(eq=False)
class Unknowns:
    """Unknowns and constants in the order in which they are added; `add` and `constant` return references for `Block.index`."""

    names: list[str] = field(default_factory=list)
    _columns: list[list[Array]] = field(default_factory=lambda: [[], [], [], [], []])
    _constants: list[float] = field(default_factory=list)

    def add(self, names: Sequence[str], first: Any, scale: Any, lower: Any = -np.inf, upper: Any = np.inf, stage: int = 0) -> Indices:
        """New unknowns in physical units, which the solver sees divided by `scale` (`exact`); stage: their place along the plan."""
        start, count = len(self.names), len(names)
        self.names += names
        for column, value in zip(self._columns, (first, scale, lower, upper, stage), strict=True):
            column.append(np.zeros(count) + value)
        return np.arange(start, start + count)

    def constant(self, values: Any) -> Indices:
        """References to numbers, in the shape of `values`."""
        array = np.asarray(values, dtype=float)
        start = len(self._constants)
        self._constants += array.ravel().tolist()
        return -1 - np.arange(start, start + array.size).reshape(array.shape)

    @property
    def constants(self) -> tuple[float, ...]:
        """All constants, in the order in which they were added."""
        return tuple(self._constants)

    def column(self, which: int) -> Array:
        """first, scale, lower, upper or stage of all unknowns."""
        values = np.concatenate([np.zeros(0), *self._columns[which]])
        return exact(values) if which == 1 else values

    def physical(self, w: Any) -> Any:
        """Unknowns in physical units, then the constants, from the scaled w."""
        return ca.vertcat(ca.DM(self.column(1)) * w, ca.DM(self._constants))

    def place(self, index: Indices) -> Indices:
        """References as places in `physical`."""
        return np.where(index < 0, len(self.names) - 1 - index, index)


def exact(scale: Any) -> Array:
    """The next numbers s with s · (1/s) = 1 without rounding: Fatrop wants x⁺ − F(…) to have a coefficient of exactly one."""
    result = np.array(scale, dtype=float)
    while np.any(rounded := result * (1 / result) != 1):
        result = np.where(rounded, np.nextafter(result, np.inf), result)
    return result


class Separable:
    """f(w) = sum of cost blocks, g(w) = rows of row blocks, one below the other; and their derivatives, as CasADi Functions."""

    def __init__(self, unknowns: Unknowns, rows: Sequence[Block], costs: Sequence[Block], weight: float, w: Any) -> None:
        self.unknowns, self.rows, self.costs, self._weight = unknowns, tuple(rows), tuple(costs), weight
        self.size, self.w = len(unknowns.names), w
        y = unknowns.physical(w)
        self._z = {id(block): _gathered(y, unknowns.place(block.index)) for block in (*rows, *costs)}
        values = [ca.vec(block.value(self._z[id(block)])) for block in rows]
        self.g = ca.vertcat(ca.MX(0, 1), *values)
        totals = [ca.sum2(block.value(self._z[id(block)])) for block in costs]
        self.f = sum(totals, start=ca.MX(0)) * weight if costs else ca.MX(0)

    @cached_property
    def functions(self) -> dict[str, ca.Function]:
        """nlp_grad_f, nlp_jac_g and nlp_hess_l with the inputs and outputs that CasADi's solvers expect."""
        p, lam_f, lam_g = ca.MX.sym("p", 0), ca.MX.sym("lam_f"), ca.MX.sym("lam_g", self.g.shape[0])
        gradient, jacobian, hessian = _Entries(), _Entries(), _Entries()
        scale = self.unknowns.column(1)
        row = 0
        for block in self.rows:
            jacobian.add(block, self._z[id(block)], scale, first_row=row)
            size = block.rows * block.count
            multipliers = ca.reshape(lam_g[row : row + size], block.rows, block.count)
            hessian.add_second(block, self._z[id(block)], multipliers, scale)
            row += size
        for block in self.costs:
            gradient.add(block, self._z[id(block)], scale, factor=self._weight, transposed=True)
            hessian.add_second(block, self._z[id(block)], ca.repmat(lam_f * self._weight, 1, block.count), scale)
        w, size = self.w, self.size
        slope = gradient.matrix(size, 1)
        return {
            "nlp_grad_f": ca.Function("nlp_grad_f", [w, p], [self.f, ca.densify(slope)], ["x", "p"], ["f", "grad_f_x"]),
            "nlp_jac_g": ca.Function("nlp_jac_g", [w, p], [self.g, jacobian.matrix(row, size)], ["x", "p"], ["g", "jac_g_x"]),
            "nlp_hess_l": ca.Function(
                "nlp_hess_l", [w, p, lam_f, lam_g], [hessian.matrix(size, size)], ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
            ),
        }


@dataclass(frozen=True, eq=False)
class Program:
    """minimise f(w) subject to lower ≤ g(w) ≤ upper and w_lower ≤ w ≤ w_upper, all in scaled numbers of order one.

    problem: {"x": w, "f": f, "g": g} as `casadi.nlpsol` takes it. first: w to start from. names: one for each row of g, and w_names for each of w.
    objective, scale, w_scale: what f, g and w are multiplied by to be costs, and in physical units (rows of goals have none). unpack: Function
    w → states (nx, intervals + 1), force densities (α, intervals; or intervals + 1 where they are piecewise linear), duration. parts: what w,
    g and f consist of; g begins with `moving` rows of the motion. states: references to x (intervals + 1, nx). contact: whether nodes may meet a
    ground. multipliers: those of g and of w's limits to start from, where they are known.
    """

    problem: dict[str, Any]
    w_lower: Array
    w_upper: Array
    lower: Array
    upper: Array
    scale: Array
    first: Array
    names: tuple[str, ...]
    w_names: tuple[str, ...]
    w_scale: Array
    objective: float
    unpack: ca.Function
    parts: Separable
    moving: int
    states: Indices
    contact: bool = False
    multipliers: tuple[Array, Array] | None = None

    def derivatives(self) -> dict[str, ca.Function]:
        """Gradient, Jacobian and Hessian as CasADi's solvers name and call them."""
        return self.parts.functions

    def with_states(self, w: Array, states: Array) -> Array:
        """w with states (intervals + 1, nx) in place of its own."""
        result = w.copy()
        known = self.states >= 0
        result[self.states[known]] = states[known] / self.w_scale[self.states[known]]
        return result


def _gathered(y: Any, places: Indices) -> Any:
    return ca.reshape(y[places.ravel().tolist()], places.shape[1], places.shape[0])


def _symbol(function: ca.Function) -> Any:
    return (ca.SX if function.is_a("SXFunction") else ca.MX).sym("z", function.size1_in(0))


def _varied(block: Block, z: Any) -> tuple[Any, Indices]:
    """What of z some instance has as unknowns, and its places: derivatives by constants would cost time and join what does not depend on each other.

    All of an MX, which CasADi differentiates by whole symbols.
    """
    if isinstance(z, ca.MX):
        return z, np.arange(z.shape[0])
    places = np.flatnonzero((block.index >= 0).any(axis=0))
    return z[places.tolist()], places


def _derivative(block: Block) -> tuple[ca.Function, Indices, Indices]:
    """z → non-zeros of the Jacobian, and the row and the entry of z of each."""
    z: Any = _symbol(block.function)
    varied, places = _varied(block, z)
    J = ca.jacobian(block.function(z), varied)
    if block.combination is not None:
        own, z = ca.Function("own", [z], [J]), ca.MX.sym("z", z.shape[0])
        J = ca.mtimes(ca.DM(block.combination), own(z))
    row, column = (np.array(entries, dtype=np.intp) for entries in J.sparsity().get_triplet())
    return ca.Function("derivative", [z], [_nonzeros(J)]), row, places[column]


def _nonzeros(matrix: Any) -> Any:
    return ca.vec(matrix.nz[:]) if matrix.nnz() else type(matrix)(0, 1)


class _Entries:
    """Values and places (row, column) of a sparse matrix; what falls on one place is added."""

    def __init__(self) -> None:
        self._values: list[Any] = []
        self._count = 0
        self._positions: list[Indices] = []  # in all values
        self._factors: list[Array] = []
        self._rows: list[Indices] = []
        self._columns: list[Indices] = []

    def add(self, block: Block, z: Any, scale: Array, first_row: int = 0, factor: float = 1.0, transposed: bool = False) -> None:
        """The Jacobian of all instances of a block."""
        derivative, local_row, local_column = _derivative(block)
        if not len(local_row):
            return
        values = derivative.map(block.count)(z)
        column = block.index[:, local_column].ravel()
        row = (first_row + block.rows * np.arange(block.count)[:, None] + local_row).ravel()
        kept = np.flatnonzero(column >= 0)
        places = (column, np.zeros_like(column)) if transposed else (row, column)
        self._keep(values, kept, factor * scale[column[kept]], places)

    def add_second(self, block: Block, z: Any, multipliers: Any, scale: Array) -> None:
        """The upper triangle of the Hessian of Σ multipliers · rows of all instances."""
        s = _symbol(block.function)
        weight = type(s).sym("weight", block.function.size1_out(0))
        if block.combination is not None:
            multipliers = ca.mtimes(ca.DM(block.combination.T), multipliers)
        varied, places = _varied(block, s)
        H = ca.hessian(ca.dot(weight, block.function(s)), varied)[0]
        local_row, local_column = (places[np.array(entries, dtype=np.intp)] for entries in H.sparsity().get_triplet())
        if not len(local_row):
            return
        row, column = (block.index[:, local].ravel() for local in (local_row, local_column))
        # where one unknown has several places in z, both halves of the block fall on the diagonal: they are both wanted
        kept = np.flatnonzero((row >= 0) & (column >= 0) & (row <= column))
        needed = np.zeros(H.nnz(), dtype=bool)
        needed[kept % H.nnz()] = True
        chosen = np.flatnonzero(needed)
        if not chosen.size:
            return
        values = ca.Function("second", [s, weight], [_nonzeros(H)[chosen.tolist()]]).map(block.count)(z, multipliers)
        rank = np.cumsum(needed) - 1
        position = (kept // H.nnz()) * chosen.size + rank[kept % H.nnz()]
        self._keep(values, position, scale[row[kept]] * scale[column[kept]], (row, column), kept)

    def _keep(self, values: Any, position: Indices, factor: Array, places: tuple[Indices, Indices], kept: Indices | None = None) -> None:
        chosen = position if kept is None else kept
        if not chosen.size:
            return
        self._values.append(ca.vec(values))
        self._positions.append(self._count + position)
        self._count += values.shape[0] * values.shape[1]
        self._factors.append(factor)
        self._rows.append(places[0][chosen])
        self._columns.append(places[1][chosen])

    def matrix(self, rows: int, columns: int) -> Any:
        """The matrix as an MX of its sparsity."""
        if not self._values:
            return ca.MX(rows, columns)
        row, column, factors, position = (np.concatenate(parts) for parts in (self._rows, self._columns, self._factors, self._positions))
        values = ca.vertcat(*self._values)
        places, first, inverse = np.unique(column * rows + row, return_index=True, return_inverse=True)
        starts = np.searchsorted(places, rows * np.arange(columns + 1))  # of the columns
        sparsity = ca.Sparsity(rows, columns, starts.tolist(), (places % rows).tolist())
        # lists, as CasADi takes half as long again for arrays
        if len(places) == len(position):
            return ca.MX(sparsity, values[position[first].tolist()] * ca.DM(factors[first].tolist()))
        adding = ca.DM.triplet(inverse.tolist(), position.tolist(), ca.DM(factors.tolist()), len(places), self._count)
        return ca.MX(sparsity, ca.mtimes(adding, values))
