"""Solvers of condensed quadratic programs of predictive control."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import casadi as ca

from tenscasadi.util.compile import CompileError, compile_function


class HorizonProgram(NamedTuple):
    """Sizes of a quadratic program over a prediction horizon.

    The program is: minimize ½ Σ ‖Gₖ ΔU + rₖ‖² + ½ ‖ΔU + offset‖² with `weights`, and
    penalty (½ s² + s), over changes ΔU and one slack s ≥ 0, subject to aᵀ ΔU ≤ b + s and
    low ≤ ΔU ≤ high, where low ≤ 0 ≤ high. The controls after interval k do not affect Gₖ.

    Attributes
    ----------
    intervals, controls : int
        The unknowns are controls × intervals.
    outputs : int
        Rows of each Gₖ.
    rows : int
        Number of general constraints. There is no slack without them.
    penalty : float
        Cost of violations of general constraints.
    """

    intervals: int
    controls: int
    outputs: int
    rows: int
    penalty: float

    def generated(self) -> ca.Function:
        """Build the solver for C code, which CasADi's virtual machine cannot evaluate.

        Function (G₁ᵀ, …, r, weights, offset, a, b, low, high) → ΔU, status. The status is 0 after
        success.
        """
        n, size = self.intervals * self.controls, self._size
        names, sparsities = self._signature()
        constants = {
            "n": n,
            "size": size,
            "rows": self.rows,
            "blocks": self.intervals,
            "group": self.controls,
            "outputs": self.outputs,
        }
        head = [
            f"enum {{{', '.join(f'{name} = {value}' for name, value in constants.items())}}};",
            f"const casadi_real penalty = {self.penalty!r}, infinity = HUGE_VAL;",
            f"const casadi_real *G[] = {{{', '.join(names[: self.intervals])}}};",
        ]
        room = (size + 1) * (5 * size + 9)
        return ca.Function.jit(
            "solve_qp",
            "\n".join([*head, Path(__file__).with_suffix(".c").read_text(encoding="utf-8")]),
            names,
            ["change", "status", "work"],
            sparsities,
            [ca.Sparsity.dense(k) for k in (n, 1, room)],
            {"jit": False},
        )

    def compiled(self) -> ca.Function:
        """Compile the solver of `generated`; without a C compiler, return `interpreted`."""
        try:
            return compile_function(self.generated())
        except CompileError:
            return self.interpreted()

    def interpreted(self) -> ca.Function:
        """Build the solver for CasADi's virtual machine, by DAQP; see `generated`."""
        n, size = self.intervals * self.controls, self._size
        names, sparsities = self._signature()
        symbols = [ca.MX.sym(name, one) for name, one in zip(names, sparsities, strict=True)]
        # the virtual machine raises errors for NaN
        given = ca.logic_and(
            is_finite(ca.veccat(*symbols[:-2])), ca.mmin(symbols[-2] <= symbols[-1])
        )
        terms = [ca.if_else(given, one, ca.DM.ones(one.shape)) for one in symbols]
        blocks = terms[: self.intervals]
        residual, weights, offset, a, b, low, high = terms[self.intervals :]
        G = ca.vertcat(
            *(ca.horzcat(block.T, ca.DM(self.outputs, n - block.shape[0])) for block in blocks)
        )
        H, g = ca.densify(G.T) @ G + ca.diag(weights), G.T @ residual + weights * offset
        rows = a.T
        if self.rows:
            H, g, rows = (
                ca.diagcat(H, self.penalty),
                ca.vertcat(g, self.penalty),
                ca.horzcat(rows, -ca.DM.ones(self.rows, 1)),
            )
            low, high = ca.vertcat(low, 0.0), ca.vertcat(high, ca.inf)
        shapes = {"h": ca.Sparsity.dense(size, size), "a": ca.Sparsity.dense(self.rows, size)}
        solver = ca.conic("qp", "daqp", shapes, {"error_on_fail": False})
        x = solver(h=ca.densify(H), g=g, a=rows, lba=-ca.inf, uba=b, lbx=low, ubx=high)["x"][:n]
        failed = ca.logic_not(ca.logic_and(given, is_finite(x)))
        return ca.Function("solve_qp", symbols, [x, failed], names, ["change", "status"])

    @property
    def _size(self) -> int:
        return self.intervals * self.controls + (self.rows > 0)

    def _signature(self) -> tuple[list[str], list[ca.Sparsity]]:
        """List names and sparsities of the inputs."""
        n, names = self.intervals * self.controls, name_inputs(self.intervals)
        shapes = [
            *((self.controls * (k + 1), self.outputs) for k in range(self.intervals)),
            (self.outputs * self.intervals, 1),
            (n, 1),
            (n, 1),
            (n, self.rows),
            (self.rows, 1),
            (n, 1),
            (n, 1),
        ]
        return names, [ca.Sparsity.dense(*shape) for shape in shapes]


def name_inputs(intervals: int) -> list[str]:
    """Name the inputs of a solver of `HorizonProgram`.

    `intervals` is the number of sampling periods in the horizon.
    """
    blocks = [f"G{k + 1}" for k in range(intervals)]
    return [*blocks, "residual", "weights", "offset", "a", "b", "low", "high"]


def is_finite(values: ca.MX) -> ca.MX:
    """Return whether all values are finite."""
    return ca.mmin(ca.fabs(values) < 1e30)
