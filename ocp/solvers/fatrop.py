"""Fatrop as a value, and the program cut into the stages that it solves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import casadi as ca
import numpy as np

from ocp.solvers.base import NamedSolver, Solution, check_options
from ocp.solvers.monitor import Monitor
from ocp.transcription.sparse_nlp import Block, Program, Separable
from tenscasadi.schema.containers import TableOf
from tenscasadi.schema.field_types import Option
from tenscasadi.util.validate import Array, Indices

REFUSED = (
    "option not supported",
    "generic_type.cpp",
)  # what CasADi says of options that Fatrop does not have, or of another type
FIRST_BARRIER = 1e-2  # with Fatrop's own, 0.1, it does not return on more problems


@dataclass(frozen=True)
class Fatrop(NamedSolver, kind="Fatrop"):
    """The interior-point solver Fatrop, which factors interval by interval, with exact derivatives.

    CasADi's Fatrop does not report its iterations: it can be neither watched nor stopped in time.
    Fatrop 1.1 fails, or does not return at all, on some problems that IPOPT solves: try it where
    speed counts.

    Parameters
    ----------
    max_iterations : int
        Most iterations.
    tolerance : float
        Tolerance of scaled optimality and constraints.
    verbose : bool
        Whether Fatrop prints a line for each iteration.
    options : mapping
        Further Fatrop options, such as ``{"mu_init": 0.1}``; they override those chosen here.

    Raises
    ------
    TypeError, ValueError
        If a value is not of its kind.

    Notes
    -----
    Every unknown belongs to one interval. What later intervals need of it is handed on from one to
    the next as a further state.

    References
    ----------
    L. Vanroye, A. Sathya, J. De Schutter, W. Decré, FATROP: A Fast Constrained Optimal Control
    Problem Solver for Robot Trajectory Optimization and Control, IROS 2023.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> ocp.solve(ocp.Problem(model, goals=goals, costs=[ocp.Effort()]), ocp.ImplicitMidpoint(6), ocp.Fatrop()).success
    True
    """

    max_iterations: int = 300
    tolerance: float = 1e-8
    verbose: bool = False
    options: Annotated[Mapping[str, Any], TableOf(Option())] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_options(
            "Fatrop",
            self.max_iterations,
            self.tolerance,
            self.verbose,
            self.options,
            "{'mu_init': 0.1}",
        )

    def solve(
        self, program: Program, monitor: Monitor | None = None
    ) -> Solution:  # it cannot be stopped
        """Solve a program.

        Parameters
        ----------
        program : Program
            The program.
        monitor : Monitor, optional
            Has no effect: Fatrop ends by `max_iterations` alone.

        Returns
        -------
        Solution
            The solution, or the last iterate with success False.

        Raises
        ------
        ValueError
            If Fatrop refuses an option.
        """
        parts = cut_into_stages(program)
        options: dict[str, Any] = {
            "structure_detection": "manual",
            "N": len(parts.states) - 1,
            "nx": parts.states,
            "nu": parts.controls,
            "ng": parts.paths,
            "equality": parts.equality,
            "fatrop": {
                "max_iter": self.max_iterations,
                "tol": self.tolerance,
                "mu_init": FIRST_BARRIER,
                "print_level": 5 if self.verbose else 0,
                **self.options,
            },
            "print_time": False,
            "error_on_fail": False,
            "show_eval_warnings": self.verbose,
        }
        try:
            solver = ca.nlpsol("solver", "fatrop", parts.nlp, options)
            result = solver(
                x0=parts.first,
                lbx=parts.w_lower,
                ubx=parts.w_upper,
                lbg=parts.lower,
                ubg=parts.upper,
            )
        except RuntimeError as error:  # Fatrop gives up by raising what CasADi does not pass on
            if any(sign in str(error) for sign in REFUSED):
                raise ValueError(
                    f"Fatrop.options is {dict(self.options)}: give options that Fatrop has, and values of their kind"
                ) from None
            return Solution(program.first, False, "Fatrop_Error", 0)
        stats = solver.stats()
        w = np.asarray(result["x"].full()).ravel()
        success = bool(stats["success"]) and bool(np.all(np.isfinite(w)))
        failure = (
            "Maximum_Iterations_Exceeded"
            if stats["iter_count"] >= self.max_iterations
            else "Fatrop_Failed"
        )
        status = "Solve_Succeeded" if success else failure
        multipliers = (
            result["lam_g"].full().ravel()[parts.rows],
            result["lam_x"].full().ravel()[parts.original],
        )
        return Solution(w[parts.original], success, status, int(stats["iter_count"]), multipliers)


@dataclass(frozen=True, eq=False)
class Staged:
    """A program cut into stages, each of which hands a state to the next and sees nothing else.

    nlp: f and g with their derivatives in the stages' order. Every unknown belongs to the stage in
    which it appears first; where a later stage needs it too, it is handed on from stage to stage as
    a further state. states, controls, paths: how many each stage has; equality: which rows are
    equations. original, rows: where w and g of the program stand.
    """

    nlp: ca.Function
    first: Array
    w_lower: Array
    w_upper: Array
    lower: Array
    upper: Array
    equality: list[bool]
    states: list[int]
    controls: list[int]
    paths: list[int]
    original: Indices
    rows: Indices


def cut_into_stages(program: Program) -> Staged:
    """Return the program in stages."""
    unknowns = program.parts.unknowns
    home = np.where(np.isfinite(unknowns.interval), unknowns.interval, 0).astype(int)
    last = int(home.max(initial=0))
    rows, costs = (
        [_Placed(block, home) for block in blocks]
        for blocks in (program.parts.rows, program.parts.costs)
    )
    closed = {int(v) for placed in rows if placed.closing for v in placed.block.closes.ravel()}  # type: ignore[union-attr]

    until = home.copy()  # the last stage that sees an unknown
    for placed in (*rows, *costs):
        for index, stage in zip(placed.block.index, placed.stage, strict=True):
            seen = index[index < len(home)]
            until[seen] = np.maximum(until[seen], stage)
    # unknowns as (original, stage); states of a stage first: those that the motion leads to, then
    # those handed on
    order: list[list[tuple[int, int]]] = [[] for _ in range(last + 1)]
    states = [0] * (last + 1)
    for stage in range(last + 1):
        arriving = [(v, stage) for v in np.flatnonzero(home == stage).tolist() if v in closed]
        handed = [(v, stage) for v in np.flatnonzero((home < stage) & (until >= stage)).tolist()]
        chosen = [(v, stage) for v in np.flatnonzero(home == stage).tolist() if v not in closed]
        states[stage] = len(arriving) + len(handed)
        order[stage] = [*arriving, *handed, *chosen]
    place = {entry: k for k, entry in enumerate(entry for stage in order for entry in stage)}
    source, stage_of = (np.array(column, dtype=np.intp) for column in zip(*place, strict=True))
    handed_on = stage_of > home[source]

    moved = unknowns.selected(source)  # what is handed on has no limits of its own
    moved = replace(
        moved,
        lower=np.where(handed_on, -np.inf, moved.lower),
        upper=np.where(handed_on, np.inf, moved.upper),
    )
    moved_rows, moved_costs = (
        [placed.moved(place, home) for placed in blocks] for blocks in (rows, costs)
    )
    if handed_on.any():
        copies = np.array(
            [(place[v, s], place[v, s - 1]) for v, s in place if s > home[v]], dtype=np.intp
        )
        constant = moved.count + len(moved.constants) + np.arange(len(copies))
        moved = replace(moved, constants=np.append(moved.constants, 1 / moved.scale[copies[:, 0]]))
        z = ca.SX.sym("z", 3)
        handing = ca.Function("hand", [z], [(z[0] - z[1]) * z[2]])
        moved_rows.append(
            Block(
                handing,
                np.column_stack([copies, constant]),
                ("handed on",) * len(copies),
                closes=copies[:, :1],
            )
        )

    separable = Separable(moved, moved_rows, moved_costs, 1 / program.objective)
    limits = [block.limits() for block in moved_rows]
    lower, upper = (
        np.concatenate([np.zeros(0), *(pair[side] for pair in limits)]) for side in (0, 1)
    )
    permutation, gaps, paths = _row_order(
        moved_rows, [*(placed.stage for placed in rows), np.array([])], order, states, place
    )
    lower, upper = lower[permutation], upper[permutation]
    return Staged(
        _in_row_order(separable, permutation),
        program.first[source],
        moved.lower / moved.scale,
        moved.upper / moved.scale,
        lower,
        upper,
        equality=(np.isin(np.arange(len(permutation)), gaps) | (lower == upper)).tolist(),
        states=states,
        controls=[len(order[k]) - states[k] for k in range(last + 1)],
        paths=paths,
        original=np.array([place[v, int(home[v])] for v in range(len(home))], dtype=np.intp),
        rows=np.argsort(permutation)[: len(program.lower)],
    )


class _Placed:
    """A block and the stage of each of its instances: the first that knows all that they need."""

    def __init__(self, block: Block, home: Indices) -> None:
        self.block = block
        known = np.append(home, 0)[
            np.minimum(block.index, len(home))
        ]  # constants are known from the beginning
        self.stage = known.max(axis=1)
        self.closing = False
        if block.closes is not None:
            ends = [
                np.isin(index, closes)
                for index, closes in zip(block.index, block.closes, strict=True)
            ]
            before = np.where(np.array(ends), 0, known).max(axis=1)
            self.closing = bool(np.all(before + 1 == home[block.closes[:, 0]]))
            if self.closing:
                self.stage = before

    def moved(self, place: dict[tuple[int, int], int], home: Indices) -> Block:
        """Return the block with references to the unknowns of its instances' stages."""
        index = self.block.index + len(place) - len(home)
        for row, old, stage in zip(index, self.block.index, self.stage, strict=True):
            for k in np.flatnonzero(old < len(home)):
                v = int(old[k])
                row[k] = place[v, max(int(stage), int(home[v]))]
        closes = None
        if self.closing and self.block.closes is not None:
            closes = np.array(
                [[place[int(v), int(home[v])] for v in row] for row in self.block.closes],
                dtype=np.intp,
            )
        return replace(self.block, index=index, closes=closes)


def _row_order(
    blocks: Sequence[Block],
    stages: Sequence[Indices],
    order: Sequence[Sequence[tuple[int, int]]],
    states: Sequence[int],
    place: dict[tuple[int, int], int],
) -> tuple[Indices, Indices, list[int]]:
    """Rows stage by stage: those that close its gap, in the order of the next stage's states, then all others."""
    gap_of: dict[int, int] = {}
    others: list[list[int]] = [[] for _ in order]
    row = 0
    for block, stage in zip(blocks, stages, strict=False):
        for k in range(block.count):
            for j in range(block.rows):
                if block.closes is not None:
                    gap_of[int(block.closes[k, j])] = row
                else:
                    others[int(stage[k])].append(row)
                row += 1
    result: list[int] = []
    gaps: list[int] = []
    for k in range(len(order)):
        if k + 1 < len(order):
            gaps += range(len(result), len(result) + states[k + 1])
            result += [gap_of[place[entry]] for entry in order[k + 1][: states[k + 1]]]
        result += others[k]
    return (
        np.array(result, dtype=np.intp),
        np.array(gaps, dtype=np.intp),
        [len(rows) for rows in others],
    )


def _in_row_order(separable: Separable, permutation: Indices) -> ca.Function:
    """Return the Function (w, p) → (f, g) with permuted rows, and exact derivatives under the names for which CasADi's Fatrop looks."""
    exact, w, p = separable.derivatives, separable.w, ca.MX.sym("p", 0)
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", len(permutation))
    order, inverse = permutation.tolist(), np.argsort(permutation).tolist()
    g = separable.g[order]
    slope = exact["nlp_grad_f"](w, p)[1]
    J = exact["nlp_jac_g"](w, p)[1][order, :]
    H = ca.triu2symm(exact["nlp_hess_l"](w, p, lam_f, lam_g[inverse]))
    gradient = lam_f * slope + ca.mtimes(J.T, lam_g)
    known = {
        "nlp_grad_f": ca.Function("nlp_grad_f", [w, p], [slope], ["x", "p"], ["grad_f_x"]),
        "nlp_jac_g": ca.Function("nlp_jac_g", [w, p], [g, J], ["x", "p"], ["g", "jac_g_x"]),
        "nlp_hess_l": ca.Function(
            "nlp_hess_l",
            [w, p, lam_f, lam_g],
            [gradient, H],
            ["x", "p", "lam_f", "lam_g"],
            ["grad_gamma_x", "hess_gamma_x_x"],
        ),
    }
    return ca.Function("nlp", [w, p], [separable.f, g], ["x", "p"], ["f", "g"], {"cache": known})
