"""Options and callbacks of IPOPT."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, Any

import casadi as ca
import numpy as np

from ocp.solvers.base import NamedSolver, Solution
from ocp.solvers.monitor import STOPPED, Monitor, Progress
from ocp.transcription.sparse_nlp import Program
from tenscasadi.schema.containers import TableOf
from tenscasadi.schema.field_types import InPython, Option
from tenscasadi.util.renamed import RenamedAttribute, rename_fields
from tenscasadi.util.validate import (
    TOLERANCE,
    Array,
    Boolean,
    Count,
    Positive,
    format_value,
    of_type,
)

HSL = ("ma27", "ma57", "ma77", "ma86", "ma97")  # linear solvers that CasADi does not bring along
PUSHES = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")
WARM = {"warm_start_init_point": "yes", **{f"warm_start_{push}": 1e-8 for push in PUSHES}}
# initial barrier parameter; from IPOPT's own, 0.1, iterates leave the guess
FIRST_BARRIER = 1e-4
# with contact, a smaller one takes several times as many iterations
FIRST_BARRIER_IN_CONTACT = 1e-3
# with known duals; without them, a small one keeps iterates at limits that they should leave
FIRST_BARRIER_KNOWN = 1e-9

# Pivot orders of MUMPS. Its own choice takes 10 to 80 times as long where collocation or a free
# duration couples much.
AMD, METIS = 0, 5
# number of intervals above which AMD may take a hundred times as long as METIS, which else takes up
# to twice as long
MANY_INTERVALS = 800

BENT = 3  # consecutive iterations with negative curvature at a saddle
SADDLE, UNDEFINED = "Saddle", "Invalid_Number_Detected"
NOWHERE = "Infeasible_Problem_Detected", "Restoration_Failed"  # no progress to the constraints

Watcher = Callable[[Progress], Any]


@rename_fields(
    seconds="time_limit", watch="callback", warm="warm_start", restart="restart_at_saddle"
)
@dataclass(frozen=True)
class Ipopt(NamedSolver, kind="Ipopt", earlier="Fatrop"):
    """The interior-point solver IPOPT, with exact derivatives.

    If it is stopped, also from the keyboard, the result is the best iterate. For contact with a
    ground, use `Phase` or `Sampling`: derivatives through contact mislead the solver.

    Parameters
    ----------
    max_iterations : int
        Largest number of iterations of one run.
    tolerance : float
        Tolerance of scaled optimality and constraints.
    verbose : bool
        Whether IPOPT prints a line for each iteration.
    options : mapping
        Further IPOPT options, such as ``{"linear_solver": "spral"}``, which override the defaults
        of this class.
    time_limit : float, optional
        Time limit of one run [s]. By default there is none.
    callback : callable, optional
        Function of a `Progress`, called after each iteration, such as a
        `tenscasadi.plots.Convergence`. The solver stops if it returns False.
    warm_start : bool
        Whether the guess is nearly a solution, such as another plan. Its duals are used if mesh and
        constraints are the same.
    restart_at_saddle : bool
        Whether the solver restarts from a perturbed guess at a saddle or a point without
        derivatives; else it stops there.

    Raises
    ------
    TypeError, ValueError
        If a value has another type or is out of bounds, or the library of a linear solver cannot
        be loaded.

    Notes
    -----
    MUMPS runs without its own scaling, which triples its speed on these problems. It orders pivots
    by AMD, and by METIS above 800 intervals. Repeated negative curvature indicates a saddle; the
    solver then restarts from the guess with its noise, and the iterations of both runs count.

    References
    ----------
    .. [1] A. Wächter, L. T. Biegler, Mathematical Programming 2006, 106, 25-57.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> seen = []
    >>> solver = ocp.Ipopt(tolerance=1e-6, callback=seen.append)
    >>> plan = ocp.solve(ocp.Problem(model, goals=goals, costs=[ocp.Effort()]), ocp.Variational(6), solver)
    >>> plan.success, len(seen) == plan.iterations + 1
    (True, True)
    """

    max_iterations: Count = 300
    tolerance: Positive = 1e-8
    verbose: Boolean = False
    options: Annotated[Mapping[str, Any], TableOf(Option())] = field(default_factory=dict)
    time_limit: Positive | None = None
    callback: Annotated[
        Watcher | None, InPython(), of_type(Callable, "a function of an ocp.Progress, or None")
    ] = None
    warm_start: Boolean = False
    restart_at_saddle: Boolean = True

    def __post_init__(self) -> None:
        super().__post_init__()
        named = isinstance(self.options, Mapping) and all(isinstance(o, str) for o in self.options)
        if not named:
            example = "a mapping of Ipopt's option names, such as {'mu_strategy': 'adaptive'}"
            raise TypeError(f"Ipopt.options is {format_value(self.options)}: give {example}")
        _check_library(self.options)

    def solve(self, program: Program, monitor: Monitor | None = None) -> Solution:
        """Solve a nonlinear program.

        Parameters
        ----------
        program : Program
            The program.
        monitor : Monitor, optional
            Time limit and stop request of the search, which shows the progress. By default there
            is no limit.

        Returns
        -------
        Solution
            Solution, or best iterate with the return status of IPOPT.

        Raises
        ------
        ValueError
            If IPOPT rejects an option.
        """
        run = self.build(program)
        if monitor is None:
            own = Monitor()
            with own.catching_interrupts():
                solution = self._run(run, program, own)
        else:
            solution = self._run(run, program, monitor)
        return solution._replace(correct=_WarmStarts(replace(self, warm_start=True)))

    def _run(self, run: Callable[..., Solution], program: Program, monitor: Monitor) -> Solution:
        """Solve, and solve again from a perturbed guess after a saddle.

        `run` calls the solver that was built for the program. Points without derivatives, such as
        the center of an obstacle, count as saddles.
        """
        if program.multipliers is not None or self.warm_start:
            return run(program, monitor)
        even = run(program, monitor, leaves_saddles=program.noise is not None)
        if even.status not in (SADDLE, UNDEFINED) or not self.restart_at_saddle:
            return even
        solution = run(program.perturb_guess(), monitor)
        return solution._replace(iterations=even.iterations + solution.iterations)

    def build(self, program: Program) -> Callable[..., Solution]:
        """Build the solver for repeated use with other bounds.

        Parameters
        ----------
        program : Program
            One of the programs.

        Returns
        -------
        callable
            Function of a program that differs from this one only in limits, start and duals, and of
            a `Monitor`. It returns a `Solution`.

        Raises
        ------
        ValueError
            If IPOPT rejects an option.
        """
        best = BestIterate(
            program.problem["x"].shape[0], len(program.lower), program.objective, self.callback
        )
        return partial(_run, self._create_solver(program, best), best)

    prepared = RenamedAttribute("build")

    def _create_solver(self, program: Program, best: BestIterate) -> ca.Function:
        ipopt = {
            "max_iter": self.max_iterations,
            "tol": self.tolerance,
            "print_level": 5 if self.verbose else 0,
            "sb": "yes",
            "mumps_scaling": 0,
            "mumps_permuting_scaling": 0,
            "mumps_pivot_order": METIS if len(program.states) > MANY_INTERVALS else AMD,
            "nlp_scaling_method": "none",  # programs are scaled
            "mu_init": FIRST_BARRIER_IN_CONTACT if program.contact else FIRST_BARRIER,
            # solutions of linear systems are refined where their residuals ask for it
            "min_refinement_steps": 0,
            # least-squares duals of a guess cost a factorization, and save no iteration
            "constr_mult_init_max": 0,
            **({} if self.time_limit is None else {"max_wall_time": self.time_limit}),
            **(WARM if self.warm_start else {}),
            **(
                {"mu_init": FIRST_BARRIER_KNOWN}
                if self.warm_start and program.multipliers is not None
                else {}
            ),
            **self.options,
        }
        exact = program.derivatives()
        # error_on_fail: an iterate that does not converge is a result, which says so.
        options: dict[str, Any] = {
            "grad_f": exact["nlp_grad_f"],
            "jac_g": exact["nlp_jac_g"],
            "hess_lag": exact["nlp_hess_l"],
            "no_nlp_grad": True,  # it serves parameters, of which there are none
            "ipopt": ipopt,
            "print_time": False,
            "error_on_fail": False,
            "show_eval_warnings": self.verbose,
            "iteration_callback": best,
        }
        try:
            return ca.nlpsol("solver", "ipopt", program.problem, options)
        except RuntimeError as error:
            if "IpoptInterface::finalize" not in str(error):
                raise
            reason = str(error).strip().splitlines()[-1].split(": ", 1)[-1].rstrip(".")
            raise ValueError(
                f"Ipopt.options is {dict(self.options)}, and IPOPT says: {reason}. Give options that IPOPT has"
            ) from None


class _WarmStarts:
    """Function that solves programs with shifted constraint bounds.

    Its solver is built once, for the first of them.
    """

    def __init__(self, solver: Ipopt) -> None:
        self._solver = solver
        self._run: Callable[..., Solution] | None = None

    def __call__(self, moved: Program, monitor: Monitor | None = None) -> Solution:
        if self._run is None:
            self._run = self._solver.build(moved)
        return self._run(moved, monitor)


class BestIterate(ca.Callback):
    """Callback of IPOPT that stores the best iterate.

    The program has `size` variables and `rows` constraints; `objective` converts its cost to
    physical units. `watch` is a function of the user that can stop the run.
    """

    def __init__(self, size: int, rows: int, objective: float, watch: Watcher | None) -> None:
        super().__init__()
        self._sizes = {"x": size, "f": 1, "g": rows, "lam_x": size, "lam_g": rows, "lam_p": 0}
        self._objective, self._watch = objective, watch
        self._used = [ca.nlpsol_out().index(name) for name in ("x", "f", "g")]
        self.begin(np.zeros(rows), np.zeros(rows), Monitor(), None)
        self.construct("best", {})

    def begin(
        self, lower: Array, upper: Array, monitor: Monitor, leaving: ca.Function | None
    ) -> None:
        """Prepare for a run with given constraint bounds.

        `lower` and `upper` are the bounds of the constraint values g. `monitor` can stop the run.
        `leaving` is the solver if it stops at a saddle, else None.
        """
        self._lower, self._upper, self._monitor = lower, upper, monitor
        self._leaving = leaving
        self._merit = np.inf
        self._count = 0
        self.w: Array | None = None
        self.status = ""
        self.error: Exception | None = None

    def get_n_in(self) -> int:
        """Return the number of inputs, the outputs of `nlpsol`."""
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        """Return the number of outputs, 1."""
        return 1

    def get_name_in(self, i: int) -> str:
        """Return the name of input i, an output of `nlpsol`."""
        return str(ca.nlpsol_out(i))

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """Return the sparsity of input i, an output of `nlpsol`."""
        return ca.Sparsity.dense(self._sizes[ca.nlpsol_out(i)], 1)

    def has_eval_buffer(self) -> bool:
        """Return whether CasADi calls `eval_buffer`."""
        return True

    def eval_buffer(self, arg: Sequence[memoryview], res: Sequence[memoryview]) -> int:
        """Write whether to stop into `res`.

        `arg` are the outputs of `nlpsol` at the current iterate. Returns 0, which tells CasADi that
        no error occurred.
        """
        w, f, g = (np.frombuffer(arg[k] or b"") for k in self._used)
        violation = float(
            np.maximum(np.maximum(self._lower - g, g - self._upper), 0.0).max(initial=0.0)
        )
        # the least violation counts, until it is small; then the objective
        merit = violation if violation > TOLERANCE else TOLERANCE * float(np.arctan(f[0]) / np.pi)
        if np.isfinite(merit) and merit < self._merit:
            self._merit, self.w = merit, w.copy()
        now = Progress(self._count, float(f[0]) * self._objective, violation)
        self._count += 1
        try:
            watch = self._watch
            if watch is not None and self._monitor.ask(lambda: watch(now)) is False:
                self.status = STOPPED
            self.status = self.status or self._monitor.follow(now, self.w)
        except KeyboardInterrupt:
            self.status = STOPPED
        except Exception as error:  # noqa: BLE001  # raised again once the solver has stopped, which would make a failure of it
            self.error, self.status = error, STOPPED
        if not self.status and self._leaving is not None and _has_negative_curvature(self._leaving):
            self.status = SADDLE
        np.frombuffer(res[0])[:] = float(bool(self.status))
        return 0


def _has_negative_curvature(solver: ca.Function) -> bool:
    """Return whether IPOPT's last iterations found negative curvature.

    IPOPT then regularizes the Hessian in each iteration.
    """
    added = solver.stats()["iterations"]["regularization_size"][-BENT:]
    return len(added) == BENT and min(added) > 0.0


def _run(
    solver: ca.Function,
    best: BestIterate,
    program: Program,
    monitor: Monitor | None = None,
    leaves_saddles: bool = False,
) -> Solution:
    known = (
        {}
        if program.multipliers is None
        else dict(zip(("lam_g0", "lam_x0"), program.multipliers, strict=True))
    )
    best.begin(
        program.lower,
        program.upper,
        Monitor() if monitor is None else monitor,
        solver if leaves_saddles else None,
    )
    result = solver(
        x0=program.first,
        lbx=program.w_lower,
        ubx=program.w_upper,
        lbg=program.lower,
        ubg=program.upper,
        **known,
    )
    if best.error is not None:
        raise best.error
    stats = solver.stats()
    w = last = result["x"].full().ravel()
    success = bool(stats["success"])
    if (
        not success
        and best.w is not None
        and (best.status or "Exceeded" in str(stats["return_status"]))
    ):
        w = best.w
    multipliers = result["lam_g"].full().ravel(), result["lam_x"].full().ravel()
    status = best.status or str(stats["return_status"])
    return Solution(w, success, status, int(stats["iter_count"]), multipliers, last)


def _check_library(options: Mapping[str, Any]) -> None:
    """Raise ValueError if a linear solver's library is missing.

    `options` are those of IPOPT.
    """
    name = options.get("linear_solver", "mumps")
    kind = "hsl" if str(name) in HSL else "pardiso" if name == "pardiso" else None
    if kind is None:
        return
    path = options.get(f"{kind}lib", f"lib{kind}.so")
    try:
        ctypes.CDLL(str(path))
    except OSError:
        raise ValueError(
            f"Ipopt.options asks for linear_solver={name!r}, whose library {path} cannot be loaded: install it, name it as {kind}lib, "
            "or give 'mumps' or 'spral'"
        ) from None
