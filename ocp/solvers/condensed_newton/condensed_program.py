"""Nonlinear program with the states eliminated.

It has first and second derivatives with respect to the controls.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from ocp.solvers.condensed_newton.bounds import VariableBounds
from ocp.transcription.elimination import Elimination, SparseRows
from ocp.transcription.sparse_nlp import Program
from tenscasadi.util.casadi_tools import ArrayFunction
from tenscasadi.util.validate import Array, Indices


class UndeterminedError(ValueError):
    """Error of defects that do not determine states and multipliers."""


class Residual(NamedTuple):
    """Violations of goals, of defects, and of path constraints.

    Attributes
    ----------
    goals, defects : ndarray
        Values minus required values, scaled.
    paths : ndarray, shape (p,)
        Values of the path constraints minus their slacks, scaled.
    """

    goals: Array
    defects: Array
    paths: Array


class CondensedProgram:
    """Nonlinear program min f(u, s) in which defects determine s.

    The defect constraints (discretized dynamics) determine the dependent variables s, such as
    states and bar forces, as functions of the independent variables u, such as controls. The goals
    are all other equality constraints, the path constraints all inequality constraints.

    Attributes
    ----------
    u, s : ndarray of int
        Indices of the independent and of the dependent variables.
    goal_rows, path_rows, defect_rows : ndarray of int
        Indices of the constraints of each kind.
    bounds, path_bounds : VariableBounds
        Bounds on u, and on the values of the path constraints.
    everywhere : ndarray of bool
        Which entries of u belong to no interval, such as the duration.
    """

    def __init__(self, program: Program) -> None:
        functions, n = program.derivatives(), program.parts.unknowns.count
        self.program, self.u = program, program.decided
        self.everywhere = np.isinf(program.parts.unknowns.interval[self.u])
        w, value = program.problem["x"], [program.problem["f"], program.problem["g"]]
        self._value = ArrayFunction(ca.Function("value", [w], [ca.densify(one) for one in value]))
        names = ("nlp_grad_f", "nlp_jac_g", "nlp_hess_l")
        self._slope, self._jacobian, self._hessian = (
            ArrayFunction(functions[name]) for name in names
        )
        row, column = _places(functions["nlp_jac_g"].sparsity_out(1))
        self._set_elimination(row, column, n)
        # goals stay independent by themselves here, and the replay judges those left out
        judged = [np.arange(one.start, one.stop) for one in program.rows("dependent")]
        left_out = np.concatenate([self.defect_rows, *judged])
        others = np.setdiff1d(np.arange(len(program.lower)), left_out)
        equal = program.lower[others] == program.upper[others]
        self.goal_rows, self.path_rows = others[equal], others[~equal]
        both = _numbers(np.append(self.s, self.u), n)
        self._parts = [
            _SparseBlock(row, column, _numbers(rows, len(program.lower)), both)
            for rows in (self.goal_rows, self.path_rows)
        ]
        i, j = _places(functions["nlp_hess_l"].sparsity_out(0))
        off = np.flatnonzero(i != j)
        self._symmetric = np.append(np.arange(len(i)), off)
        self._second = _SparseBlock(np.append(i, j[off]), np.append(j, i[off]), both, both)
        self.bounds = VariableBounds(program.w_lower[self.u], program.w_upper[self.u])
        self.path_bounds = VariableBounds(
            program.lower[self.path_rows], program.upper[self.path_rows]
        )
        self.independent: Array | None = None

    def _set_elimination(self, row: Indices, column: Indices, n: int) -> None:
        program = self.program
        places = [np.arange(one.start, one.stop) for one in program.rows("stage", "defect")]
        defects = np.concatenate([np.zeros(0, dtype=np.intp), *places])
        determined = np.setdiff1d(np.arange(n), self.u)
        if (
            len(defects) != len(determined)
            or np.isfinite([program.w_lower[determined], program.w_upper[determined]]).any()
        ):
            raise UndeterminedError("the defects do not determine as many unknowns without limits")
        own = np.flatnonzero(np.isin(row, defects))
        constant, sample = program.parts.constant_entries, self._jacobian(program.first)[1]
        to_all = _numbers(np.append(determined, self.u), n)
        entries = _numbers(defects, len(program.lower))[row[own]], to_all[column[own]]
        values = constant[own], sample.ravel()[own]
        try:
            self.elimination = Elimination(*entries, len(defects), *values, len(self.u))
        except ValueError as error:
            raise UndeterminedError(str(error)) from None
        self._of_elimination = own
        self.defect_rows = defects[self.elimination.by_row]
        self.s = determined[self.elimination.by_column]

    def move_rows(self, program: Program) -> None:
        """Replace the bounds of the constraints by those of a program.

        All goals are constraints again, also those that `keep_independent` dropped.
        """
        self.program, self.independent = program, None
        self.path_bounds = VariableBounds(
            program.lower[self.path_rows], program.upper[self.path_rows]
        )

    @property
    def goals(self) -> int:
        """Number of independent goal constraints."""
        return len(self.goal_rows if self.independent is None else self.independent)

    def keep_independent(self, expansion: Expansion) -> None:
        """Drop combinations of goal constraints that u cannot change.

        `expansion` has their derivatives.
        """
        triangle = np.asarray(np.linalg.qr(expansion.jacobian.T, mode="r"))
        left, sizes, _ = np.linalg.svd(triangle.T, full_matrices=False)
        kept = sizes > 1e-8 * sizes.max(initial=0.0)
        self.independent = None if kept.all() else left[:, kept].T

    def join(self, u: Array, s: Array) -> Array:
        """Join u and s to the vector of all decision variables."""
        w = np.empty(len(u) + len(s))
        w[self.u], w[self.s] = u, s
        return w

    def values(self, u: Array, s: Array) -> tuple[float, Array, Array, Array]:
        """Evaluate the cost, goals, defects and path constraints.

        They are functions of the independent variables u and the dependent ones s.
        """
        f, g = (one.ravel() for one in self._value(self.join(u, s)))
        goals, defects = (
            g[rows] - self.program.lower[rows] for rows in (self.goal_rows, self.defect_rows)
        )
        if self.independent is not None:
            goals = self.independent @ goals
        return float(f[0]), goals, defects, g[self.path_rows]

    def slope(self, u: Array, s: Array) -> Array:
        """Evaluate the gradient of the cost with respect to all variables w.

        w consists of u and s, see `join`.
        """
        return self._slope(self.join(u, s))[1].ravel()

    def hessian(self, u: Array, s: Array, duals: Array | None = None) -> SparseRows:
        """Compute the Hessian of the Lagrangian with respect to (s, u).

        Rows and columns are in this order. `duals` are those of all constraints; None for the
        Hessian of the cost.
        """
        weights = np.zeros(len(self.program.lower)) if duals is None else duals
        values = self._hessian(self.join(u, s), np.zeros(0), np.ones(1), weights)[0].ravel()
        return self._second.at(values[self._symmetric])

    def jacobian_values(self, u: Array, s: Array) -> Array:
        """Evaluate the nonzeros of the Jacobian of all constraints.

        The Jacobian is that with respect to all decision variables, at (u, s).
        """
        return self._jacobian(self.join(u, s))[1].ravel()


class Expansion:
    """Derivatives of the condensed program at an iterate (u, s).

    Attributes
    ----------
    jacobian : ndarray, shape (m, n)
        Total derivatives of the goals with respect to u.
    slope : ndarray, shape (n,)
        Total derivatives of the cost with respect to u.
    """

    def __init__(self, of: CondensedProgram, u: Array, s: Array) -> None:
        self._of, self._u, self._s = of, u, s
        values, slope = of.jacobian_values(u, s), of.slope(u, s)
        of.elimination.factor(values[of._of_elimination])
        self._goals, self._paths = (part.at(values) for part in of._parts)
        self._slope = np.append(slope[of.s], slope[of.u])
        self.slope = self._reduce(self._slope)
        combined = np.eye(len(of.goal_rows)) if of.independent is None else of.independent.T
        self.jacobian = of.elimination.reduce(self._goals, combined).T

    def _reduce(self, partial: Array) -> Array:
        """Compute total derivatives (n,) with respect to u from those with respect to (s, u)."""
        return self._of.elimination.solve_transposed(partial)[self._of.elimination.border]

    def growth(self) -> float:
        """Estimate the change of s per unit of the defects.

        It is the largest change of an entry of s if each defect changes by +1 or −1 at random.
        """
        signs = np.random.default_rng(0).choice([-1.0, 1.0], size=(len(self._s), 2))
        return float(np.max([np.abs(self.follow(None, one)).max(initial=0.0) for one in signs.T]))

    def of_paths(self, weights: Array) -> Array:
        """Compute total derivatives (r, n) of combined path constraints.

        The combinations are the columns of `weights` (p, r).
        """
        if not len(weights):
            return np.zeros((weights.shape[1], len(self._u)))
        return self._of.elimination.reduce(self._paths, weights).T

    def stack(self, of_paths: Array) -> Array:
        """Append total derivatives (r, n) of path constraints to those of the goals."""
        return np.vstack([self.jacobian, of_paths]) if len(of_paths) else self.jacobian

    def stiffness(self, of_paths: Array) -> Array:
        """Compute the Hessian's diagonal (n,) from path-constraint barriers.

        It sums (∂c/∂u)² b'' over the path constraints c, where b'' (`of_paths`, (p,)) are the
        second derivatives of their barriers.
        """
        squared = self._paths.squared().transposed_times(of_paths)
        return squared[self._of.elimination.border]

    def follow(self, step: Array | None, defects: Array | None) -> Array:
        """Compute the linearized change of (s, u) for a step of u.

        With this change, the values of the defect constraints remain the same, or the given
        `defects` vanish. A step None keeps u.
        """
        moved = np.zeros(len(self._s) + len(self._u))
        if defects is not None:
            moved[: len(defects)] = -defects
        if step is not None:
            moved[self._of.elimination.border] = step
        return self._of.elimination.solve(moved)

    def change(self, moved: Array) -> Array:
        """Compute the change (m,) of the goals for a change `moved` of (s, u)."""
        change, independent = self._goals.times(moved), self._of.independent
        return change if independent is None else independent @ change

    def path_change(self, moved: Array) -> Array:
        """Compute the change (p,) of path constraints for a change `moved` of (s, u)."""
        return self._paths.times(moved)

    def weigh(self, goal_duals: Array, path_duals: Array, stiffness: Array) -> None:
        """Set the duals and barrier curvatures that `curvature` uses.

        The second derivatives of the path-constraint barriers are `stiffness` (p,). `goal_duals`
        (m,) and `path_duals` (p,) are those of the constraints. The duals of the defects follow
        from them.
        """
        of = self._of
        if of.independent is not None:
            goal_duals = of.independent.T @ goal_duals
        pull = self._slope + self._goals.transposed_times(goal_duals)
        pull = pull + self._paths.transposed_times(path_duals)
        self.duals = np.zeros(len(of.program.lower))
        self.duals[of.goal_rows] = goal_duals
        self.duals[of.defect_rows] = -of.elimination.solve_transposed(pull)[: len(of.s)]
        self.duals[of.path_rows] = path_duals
        self._second, self._stiffness = of.hessian(self._u, self._s, self.duals), stiffness

    def curvature(self, moved: Array) -> Array:
        """Multiply the condensed Hessian of the Lagrangian by a step.

        `moved` is the change of (s, u) by the linearized dynamics. The result (n,) includes the
        barriers of path constraints.
        """
        push = self._stiffness * self.path_change(moved)
        return self._reduce(self._second.times(moved) + self._paths.transposed_times(push))


class _SparseBlock:
    """Part of a sparse matrix, filled from all its nonzeros.

    The whole matrix has nonzeros at (`row`, `column`). `rows` and `columns` are the new indices of
    its rows and columns, −1 for those outside the part.
    """

    def __init__(self, row: Indices, column: Indices, rows: Indices, columns: Indices) -> None:
        i, j = rows[row], columns[column]
        kept = np.flatnonzero((i >= 0) & (j >= 0))
        self.entries = kept[np.lexsort((j[kept], i[kept]))]
        i, j = i[self.entries], j[self.entries]
        self.shape = int(rows.max(initial=-1)) + 1, int(columns.max(initial=-1)) + 1
        self.columns = j.astype(np.int32)
        self.starts = np.searchsorted(i, np.arange(self.shape[0] + 1)).astype(np.int32)

    def at(self, values: Array) -> SparseRows:
        return SparseRows(values[self.entries], self.columns, self.starts, self.shape)


def _places(sparsity: ca.Sparsity) -> tuple[Indices, Indices]:
    row, column = (np.array(one, dtype=np.intp) for one in sparsity.get_triplet())
    return row, column


def _numbers(index: Indices, size: int) -> Indices:
    """Invert an index array.

    The result (size,) has the position of each number in `index`, −1 for absent numbers.
    """
    result = np.full(size, -1, dtype=np.intp)
    result[index] = np.arange(len(index))
    return result
