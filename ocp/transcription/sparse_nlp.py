"""Sparse nonlinear programs of many instances of few small functions.

Each function of a few dozen numbers is differentiated once and evaluated for each interval.
`Separable.jacobian` and `Separable.hessian` assemble the matrices from its values by index. This
needs no graph coloring and no derivative of a large expression graph. The time to build and
evaluate derivatives is proportional to the number of non-zeros.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import casadi as ca
import numpy as np

from tenscasadi.util.casadi_tools import symbol_kind
from tenscasadi.util.validate import Array, Booleans, Indices

Kind = Literal[
    "start", "stage", "defect", "path", "rate", "waypoint", "end", "dependent", "periodic", "cost"
]  # origin of the rows of a block


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Decision variables and constants of a nonlinear program.

    Together they form the vector y, to which blocks refer by index. Decision variables come first.

    Attributes
    ----------
    names : tuple of str
        Names of the n decision variables.
    first, lower, upper : ndarray, shape (n,)
        Initial values and bounds, in physical units.
    scale : ndarray, shape (n,)
        Factors from scaled variables w to physical values.
    interval : ndarray, shape (n,)
        Mesh interval of the variable; infinite if it belongs to all.
    constants : ndarray
        Constants, in physical units.
    """

    names: tuple[str, ...]
    first: Array
    scale: Array
    lower: Array
    upper: Array
    interval: Array
    constants: Array

    @property
    def count(self) -> int:
        """Number of decision variables; larger indices refer to constants."""
        return len(self.names)

    def entries(self, w: Any) -> Any:
        """Compute y, which is `scale` · w followed by the constants."""
        return ca.vertcat(ca.DM(self.scale) * w, ca.DM(self.constants))


@dataclass(frozen=True, eq=False)
class Block:
    """Constraints lower ≤ function(z_k) ≤ upper for `count` instances k.

    A block can also be a term of the cost. z_k are the variables and constants y[index[k]].

    Attributes
    ----------
    function : casadi.Function
        z (nz) → rows (m).
    index : ndarray of int, shape (count, nz)
        Indices of z_k in y.
    names : tuple of str
        Names of the count·m constraint rows, instance by instance.
    lower, upper : array_like, shape (count, m) or broadcast to it
        Limits of the scaled rows.
    scale : array_like, shape (count, m) or broadcast to it
        Factor that makes a row physical, in the unit of the limited quantity.
    combination : ndarray, shape (m, rows of function), or None
        Dense matrix that multiplies the rows of the function.
    kind : str
        Kind of constraint, by which `Program.rows` finds them.
    unit : str, optional
        Unit of the limited quantity; None if the rows are no limits of the problem.
    """

    function: ca.Function
    index: Indices
    names: tuple[str, ...]
    lower: Any = 0.0
    upper: Any = 0.0
    scale: Any = 1.0
    combination: Array | None = None
    kind: Kind = "defect"
    unit: str | None = None

    @property
    def count(self) -> int:
        """Number of instances."""
        return len(self.index)

    @property
    def rows(self) -> int:
        """Number of constraint rows of one instance."""
        return (
            int(self.function.size1_out(0)) if self.combination is None else len(self.combination)
        )

    @property
    def size(self) -> int:
        """Number of constraint rows of all instances."""
        return self.rows * self.count

    def value(self, z: Any) -> Any:
        """Evaluate the constraint rows (m, count) at z (nz, count)."""
        own = self.function.map(self.count)(z)
        return own if self.combination is None else ca.mtimes(ca.DM(self.combination), own)

    def limits(self) -> tuple[Array, Array, Array]:
        """Return lower limits, upper limits and scales of all rows."""
        shape, given = (self.count, self.rows), (self.lower, self.upper, self.scale)
        return tuple(
            np.broadcast_to(np.asarray(value, dtype=float), shape).ravel() for value in given
        )  # type: ignore[return-value]

    def relabel(self, label: Indices) -> Block:
        """Replace each variable index k by label[k]."""
        return replace(self, index=label[self.index])


class Separable:
    """Objective f(w), constraints g(w), and their derivatives.

    f is the weighted sum of the cost blocks; g stacks the constraint blocks.
    """

    def __init__(
        self, unknowns: Unknowns, rows: Sequence[Block], costs: Sequence[Block], weight: float
    ) -> None:
        self.unknowns, self._weight = unknowns, weight
        self.rows, self.costs = tuple(rows), tuple(costs)
        self.w, self._p = ca.MX.sym("w", unknowns.count), ca.MX.sym("p", 0)
        y = unknowns.entries(self.w)
        self._row_inputs, self._cost_inputs = (
            [gather(y, block.index) for block in blocks] for blocks in (rows, costs)
        )
        self.g = ca.vertcat(
            ca.MX(0, 1),
            *(ca.vec(block.value(z)) for block, z in zip(rows, self._row_inputs, strict=True)),
        )
        totals = [
            ca.sum2(block.value(z)) for block, z in zip(costs, self._cost_inputs, strict=True)
        ]
        self.f = sum(totals, start=ca.MX(0)) * weight if costs else ca.MX(0)

    @cached_property
    def slices(self) -> tuple[slice, ...]:
        """Slices of g with the constraints of each block."""
        ends = np.cumsum([block.size for block in self.rows]).tolist()
        return tuple(
            slice(end - block.size, end) for block, end in zip(self.rows, ends, strict=True)
        )

    @cached_property
    def derivatives(self) -> dict[str, ca.Function]:
        """Functions nlp_grad_f, nlp_jac_g and nlp_hess_l for CasADi's solvers."""
        return {
            function.name(): function
            for function in (self.gradient(), self.jacobian(), self.hessian())
        }

    def gradient(self) -> ca.Function:
        """Build nlp_grad_f: (w, p) → f and its gradient in w."""
        matrix = _SparseMatrix(self.unknowns)
        for block, z in zip(self.costs, self._cost_inputs, strict=True):
            matrix.add_jacobian(block, z, self._weight, transposed=True)
        slope = ca.densify(matrix.assemble(self.unknowns.count, 1))
        return ca.Function(
            "nlp_grad_f", [self.w, self._p], [self.f, slope], ["x", "p"], ["f", "grad_f_x"]
        )

    def jacobian(self) -> ca.Function:
        """Build nlp_jac_g: (w, p) → g and its sparse Jacobian in w."""
        J = self._row_derivatives.assemble(self.g.shape[0], self.unknowns.count)
        return ca.Function(
            "nlp_jac_g", [self.w, self._p], [self.g, J], ["x", "p"], ["g", "jac_g_x"]
        )

    @property
    def constant_entries(self) -> Booleans:
        """Whether each nonzero of the Jacobian is constant."""
        return self._row_derivatives.constant_entries(self.g.shape[0])

    @cached_property
    def _row_derivatives(self) -> _SparseMatrix:
        matrix = _SparseMatrix(self.unknowns)
        for block, z, rows in zip(self.rows, self._row_inputs, self.slices, strict=True):
            matrix.add_jacobian(block, z, first_row=rows.start)
        return matrix

    def hessian(self) -> ca.Function:
        """Build nlp_hess_l, the Hessian of the Lagrangian in w.

        It is (w, p, λ_f, λ_g) → upper triangle of the Hessian of λ_f f + λ_gᵀ g; p is empty.
        """
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", self.g.shape[0])
        matrix = _SparseMatrix(self.unknowns)
        for block, z, rows in zip(self.rows, self._row_inputs, self.slices, strict=True):
            matrix.add_hessian(block, z, ca.reshape(lam_g[rows], block.rows, block.count))
        for block, z in zip(self.costs, self._cost_inputs, strict=True):
            matrix.add_hessian(block, z, ca.repmat(lam_f * self._weight, 1, block.count))
        H = matrix.assemble(self.unknowns.count, self.unknowns.count)
        inputs = [self.w, self._p, lam_f, lam_g]
        return ca.Function(
            "nlp_hess_l", inputs, [H], ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
        )


@dataclass(frozen=True, eq=False)
class Program:
    """Nonlinear program: minimize f(w) subject to bounds on g(w) and w.

    All numbers are scaled to order one.

    Attributes
    ----------
    parts : Separable
        Composition of w, f and g.
    w_lower, w_upper, first : ndarray, shape (n,)
        Bounds on w, and the initial guess.
    lower, upper, scale : ndarray, shape (m,)
        Bounds on g, and the factors that convert its rows to physical units. Rows of goals have no unit.
    objective : float
        Factor that converts f to physical units.
    unpack : casadi.Function
        w → states (nx, K + 1), controls (α, K) or (α, K + 1), durations (1, phases). Phases follow
        one another.
    states : ndarray of int, shape (K + 1, nx)
        Indices of the states in y, see `Unknowns`.
    contact : bool
        Whether nodes may touch a ground.
    multipliers : tuple of ndarray or None
        Initial duals of g and of the variable bounds, for a warm start.
    noise : ndarray, shape (n,), or None
        Change of the initial guess that leads away from a saddle point.
    decided : ndarray of int
        Indices of the independent variables: the defect constraints determine all others from them.
    """

    parts: Separable
    w_lower: Array
    w_upper: Array
    first: Array
    lower: Array
    upper: Array
    scale: Array
    objective: float
    unpack: ca.Function
    states: Indices
    contact: bool = False
    multipliers: tuple[Array, Array] | None = None
    noise: Array | None = None
    decided: Indices = field(default_factory=lambda: np.zeros(0, dtype=np.intp))

    def perturb_guess(self) -> Program:
        """Add the noise to the initial guess, within the bounds.

        Without given noise, a little noise on all variables leads away from points without
        derivatives, such as the center of an obstacle.
        """
        noise = self.noise
        if noise is None:
            noise = 1e-5 * np.random.default_rng(0).uniform(-1.0, 1.0, len(self.first))
        return replace(
            self, first=np.clip(self.first + noise, self.w_lower, self.w_upper), noise=None
        )

    @property
    def problem(self) -> dict[str, Any]:
        """Expressions w, f and g, as `casadi.nlpsol` expects them."""
        return {"x": self.parts.w, "f": self.parts.f, "g": self.parts.g}

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the rows of g."""
        return tuple(name for block in self.parts.rows for name in block.names)

    @property
    def w_names(self) -> tuple[str, ...]:
        """Names of the decision variables."""
        return self.parts.unknowns.names

    @property
    def w_scale(self) -> Array:
        """Factors that convert w to physical units."""
        return self.parts.unknowns.scale

    def rows(self, *kinds: Kind) -> list[slice]:
        """Find the constraint rows of the given kinds, a slice for each block."""
        return [
            rows
            for block, rows in zip(self.parts.rows, self.parts.slices, strict=True)
            if block.kind in kinds
        ]

    def derivatives(self) -> dict[str, ca.Function]:
        """Return gradient, Jacobian and Hessian, as CasADi's solvers call them."""
        return self.parts.derivatives

    @property
    def known(self) -> Array:
        """Mask (K + 1, nx) of the states that are decision variables."""
        return np.asarray(self.states < self.parts.unknowns.count)

    def shift_rows(
        self, shift: Array, w: Array, multipliers: tuple[Array, Array] | None
    ) -> Program:
        """Add `shift` to all constraint bounds; warm-start at w with duals `multipliers`."""
        lower, upper = self.lower + shift, self.upper + shift
        return replace(self, lower=lower, upper=upper, first=w, multipliers=multipliers)


def gather(y: Any, index: Indices) -> Any:
    """Select the entries y[index], one column per instance.

    The index is (count, nz), the result (nz, count).
    """
    return ca.reshape(y[index.ravel().tolist()], index.shape[1], index.shape[0])


def expand(function: ca.Function) -> ca.Function:
    """Expand a CasADi Function to scalar operations if possible.

    Derivatives are then faster.
    """
    try:
        return function if function.is_a("SXFunction") else function.expand()
    except RuntimeError:  # CasADi cannot expand the Function
        return function


def split_symbol(kind: Any, *sizes: int) -> tuple[Any, tuple[Any, ...]]:
    """Create a symbol of SX or MX (`kind`), and split it into parts of given sizes."""
    z = kind.sym("z", sum(sizes))
    return z, tuple(ca.vertsplit(z, np.cumsum((0, *sizes)).tolist()))


class _SparseMatrix:
    """Sparse matrix as a sum of values with rows and columns."""

    def __init__(self, unknowns: Unknowns) -> None:
        self._unknowns = unknowns
        self._values: list[Any] = []
        self._count = 0
        self._positions: list[Indices] = []  # in all values
        self._factors: list[Array] = []
        self._rows: list[Indices] = []
        self._columns: list[Indices] = []
        self._derivatives: list[tuple[ca.Function, Block, Indices]] = []

    def add_jacobian(
        self,
        block: Block,
        z: Any,
        factor: float = 1.0,
        first_row: int = 0,
        transposed: bool = False,
    ) -> None:
        """Add the Jacobian of a block, or its transpose, times `factor`.

        It is evaluated at z (nz, count). Its rows in the matrix begin at `first_row`.
        """
        function, local_row, local_column = self._derivative(block)
        if not len(local_row):
            return
        column = block.index[:, local_column].ravel()
        row = (first_row + block.rows * np.arange(block.count)[:, None] + local_row).ravel()
        kept = np.flatnonzero(column < self._unknowns.count)
        places = (column, np.zeros_like(column)) if transposed else (row, column)
        scale = factor * self._unknowns.scale[column[kept]]
        self._keep(function.map(block.count)(z), kept, scale, [place[kept] for place in places])
        if kept.size:
            self._derivatives.append((function, block, kept))

    def add_hessian(self, block: Block, z: Any, multipliers: Any) -> None:
        """Add the upper triangle of the Hessian of multipliersᵀ rows at z (nz, count)."""
        if block.combination is not None:
            multipliers = ca.mtimes(ca.DM(block.combination.T), multipliers)
        second, local_row, local_column = self._second(block)
        size = len(local_row)
        if not size:
            return
        row, column = (block.index[:, local].ravel() for local in (local_row, local_column))
        # If an unknown has several places in z, entries of both triangles of the block are added on
        # the diagonal.
        kept = np.flatnonzero((row <= column) & (column < self._unknowns.count))
        needed = np.zeros(size, dtype=bool)
        needed[kept % size] = True
        chosen = np.flatnonzero(needed)
        if not chosen.size:
            return
        values = second(z, multipliers, chosen)
        rank, scale = np.cumsum(needed) - 1, self._unknowns.scale
        position = (kept // size) * chosen.size + rank[kept % size]
        row, column = row[kept], column[kept]
        self._keep(values, position, scale[row] * scale[column], [row, column])

    def _derivative(self, block: Block) -> tuple[ca.Function, Indices, Indices]:
        """Build z → nonzeros of a block's Jacobian, and their rows and columns."""
        s: Any = symbol_kind(block.function).sym("z", block.function.size1_in(0))
        varied, places = self._select_unknowns(block, s)
        J = ca.jacobian(block.function(s), varied)
        if block.combination is not None:
            own, s = ca.Function("own", [s], [J]), ca.MX.sym("z", s.shape[0])
            J = ca.mtimes(ca.DM(block.combination), own(s))
        row, column = (np.array(entries, dtype=np.intp) for entries in J.sparsity().get_triplet())
        return ca.Function("derivative", [s], [_nonzeros(J)]), row, places[column]

    def _second(self, block: Block) -> tuple[Callable[[Any, Any, Indices], Any], Indices, Indices]:
        """Build (z, weights, chosen) → nonzeros of a block's Hessian, and their indices."""
        s: Any = symbol_kind(block.function).sym("z", block.function.size1_in(0))
        weight = type(s).sym("weight", block.function.size1_out(0))
        varied, places = self._select_unknowns(block, s)
        H = ca.hessian(ca.dot(weight, block.function(s)), varied)[0]
        row, column = (
            places[np.array(entries, dtype=np.intp)] for entries in H.sparsity().get_triplet()
        )

        def values(z: Any, weights: Any, chosen: Indices) -> Any:
            return ca.Function("second", [s, weight], [_nonzeros(H)[chosen.tolist()]]).map(
                block.count
            )(z, weights)

        return values, row, column

    def _select_unknowns(self, block: Block, z: Any) -> tuple[Any, Indices]:
        """Select the entries of z that are ever decision variables.

        Derivatives with respect to constants would take time, and couple independent variables. All
        entries of an MX are selected, as CasADi differentiates with respect to whole symbols.
        """
        if isinstance(z, ca.MX):
            return z, np.arange(z.shape[0])
        places = np.flatnonzero((block.index < self._unknowns.count).any(axis=0))
        return z[places.tolist()], places

    def _keep(
        self, values: Any, position: Indices, factor: Array, places: Sequence[Indices]
    ) -> None:
        if not position.size:
            return
        self._values.append(ca.vec(values))
        self._positions.append(self._count + position)
        self._count += values.shape[0] * values.shape[1]
        self._factors.append(factor)
        self._rows.append(places[0])
        self._columns.append(places[1])

    def constant_entries(self, rows: int) -> Booleans:
        """Find which nonzeros of the matrix with `rows` rows are constant."""
        if not self._values:
            return np.zeros(0, dtype=bool)
        row, column = np.concatenate(self._rows), np.concatenate(self._columns)
        varying = np.concatenate([self._find_varying(*one) for one in self._derivatives])
        places, inverse = np.unique(column * rows + row, return_inverse=True)
        constant = np.ones(len(places), dtype=bool)
        constant[inverse[varying]] = False
        return constant

    def _find_varying(self, derivative: ca.Function, block: Block, kept: Indices) -> Booleans:
        """Find which of the nonzeros `kept` depend on decision variables."""
        unknown = np.any(block.index < self._unknowns.count, axis=0)
        kinds = [symbol_kind(derivative).sym("z", int(one.sum())) for one in (unknown, ~unknown)]
        place = np.argsort(np.argsort(~unknown, kind="stable"))  # of each entry, unknowns first
        values = derivative(ca.vertcat(*kinds)[place.tolist()])
        varying = np.array(ca.which_depends(values, kinds[0], 1, True), dtype=bool)
        return varying[kept % len(varying)]

    def assemble(self, rows: int, columns: int) -> Any:
        """Assemble the sum as a sparse CasADi matrix (rows, columns)."""
        if not self._values:
            return ca.MX(rows, columns)
        row, column, factors, position = (
            np.concatenate(parts)
            for parts in (self._rows, self._columns, self._factors, self._positions)
        )
        values = ca.vertcat(*self._values)
        places, first, inverse = np.unique(
            column * rows + row, return_index=True, return_inverse=True
        )
        starts = np.searchsorted(places, rows * np.arange(columns + 1))  # of the columns
        sparsity = ca.Sparsity(rows, columns, starts.tolist(), (places % rows).tolist())
        # CasADi takes 1.5 times as long for arrays as for lists.
        if len(places) == len(position):
            return ca.MX(
                sparsity, values[position[first].tolist()] * ca.DM(factors[first].tolist())
            )
        adding = ca.DM.triplet(
            inverse.tolist(), position.tolist(), ca.DM(factors.tolist()), len(places), self._count
        )
        return ca.MX(sparsity, ca.mtimes(adding, values))


def _nonzeros(matrix: Any) -> Any:
    return ca.vec(matrix.nz[:]) if matrix.nnz() else type(matrix)(0, 1)
