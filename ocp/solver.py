"""Solvers of nonlinear programs, as values."""

from __future__ import annotations

import ctypes
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import FrameType
from typing import Any, NamedTuple, Protocol

import casadi as ca
import numpy as np

from ocp.program import Program
from ocp.staged import staged
from tenscasadi.validate import Array, positive_number, whole_number

HSL = ("ma27", "ma57", "ma77", "ma86", "ma97")  # linear solvers that CasADi does not bring along

STOPPED = "User_Requested_Stop"
NEAR = 1e-6  # violation, scaled, below which iterates are judged by their objective
FATROP_BARRIER = 1e-2  # with Fatrop's own, 0.1, it does not return on more problems
PUSHES = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")
WARM = {"warm_start_init_point": "yes", **{f"warm_start_{push}": 1e-8 for push in PUSHES}}
BARRIER = 1e-3  # to start with: with IPOPT's own, 0.1, iterates leave the guess, and plans take a fifth more iterations
BARRIERS = 1e-6, 1e-9  # the same of warm starts, where the multipliers are not known, and where they are


class Solution(NamedTuple):
    """w and whether it is optimal; status is the solver's own word; iterations; wall time, s; the multipliers of rows and of w's limits.

    last: where the solver stood when it gave up, which is not always its best.
    """

    w: Array
    success: bool
    status: str
    iterations: int
    seconds: float
    multipliers: tuple[Array, Array] | None = None
    last: Array | None = None


class Progress(NamedTuple):
    """One iteration: its number, the objective (costs in their own units) and the largest violated constraint, scaled."""

    iteration: int
    objective: float
    infeasibility: float


Watcher = Callable[[Progress], Any]


class Solver(Protocol):
    """Anything that solves a program."""

    @property
    def tolerance(self) -> float:
        """Of scaled optimality and constraints."""

    def solve(self, program: Program) -> Solution:
        """The solution; where there is none, the best iterate with success False."""


@dataclass(frozen=True)
class Ipopt:
    """IPOPT with exact derivatives.

    max_iterations; tolerance: of scaled optimality and constraints; verbose: prints a line for each iteration; options: further IPOPT
    options, such as {"linear_solver": "spral"}, which override those chosen here. MUMPS runs without its own scaling, which triples its
    speed on these problems. seconds: wall time after which it stops, None: no limit. watch: called with a `Progress` after each iteration; when
    it returns False the solver stops. warm: the guess is nearly a solution, such as another plan: keep to it, and to its multipliers, if grid and
    constraints are the same. However it is stopped, also from the keyboard, what is returned is the best iterate. Raises TypeError, ValueError.
    """

    max_iterations: int = 300
    tolerance: float = 1e-8
    verbose: bool = False
    options: Mapping[str, Any] = field(default_factory=dict)
    seconds: float | None = None
    watch: Watcher | None = None
    warm: bool = False

    def __post_init__(self) -> None:
        _check(self)
        if not isinstance(self.warm, bool):
            raise TypeError(f"Ipopt.warm is {self.warm!r}: give True or False")
        if not isinstance(self.options, Mapping) or not all(isinstance(name, str) for name in self.options):
            raise TypeError(f"Ipopt.options is {self.options!r}: give a mapping of IPOPT's option names, such as {{'mu_strategy': 'adaptive'}}")
        _check_library(self.options)

    def solve(self, program: Program) -> Solution:
        """The solution, or the best iterate with IPOPT's word for what went wrong. Raises ValueError for an option IPOPT refuses."""
        ipopt = {
            "max_iter": self.max_iterations,
            "tol": self.tolerance,
            "print_level": 5 if self.verbose else 0,
            "sb": "yes",
            "mumps_scaling": 0,
            "mumps_permuting_scaling": 0,
            "mu_init": BARRIER,
            **({} if self.seconds is None else {"max_wall_time": self.seconds}),
            **({**WARM, "mu_init": BARRIERS[program.multipliers is not None]} if self.warm else {}),
            **self.options,
        }
        began = time.perf_counter()
        exact = program.derivatives()
        best = Best(program.problem["x"].shape[0], len(program.lower), program.lower, program.upper, program.objective, self.watch)
        # error_on_fail: an iterate that does not converge is a result, which says so.
        options: dict[str, Any] = {
            "grad_f": exact["nlp_grad_f"],
            "jac_g": exact["nlp_jac_g"],
            "hess_lag": exact["nlp_hess_l"],
            "ipopt": ipopt,
            "print_time": False,
            "error_on_fail": False,
            "show_eval_warnings": self.verbose,
            "iteration_callback": best,
        }
        try:
            solver = ca.nlpsol("solver", "ipopt", program.problem, options)
        except RuntimeError as error:
            if "IpoptInterface::finalize" not in str(error):
                raise
            reason = str(error).strip().splitlines()[-1].split(": ", 1)[-1]
            raise ValueError(f"Ipopt.options is {dict(self.options)}, and IPOPT says: {reason}. Give options that IPOPT has") from None
        known = {} if program.multipliers is None else dict(zip(("lam_g0", "lam_x0"), program.multipliers, strict=True))
        with best.interruptible():
            result = solver(x0=program.first, lbx=program.w_lower, ubx=program.w_upper, lbg=program.lower, ubg=program.upper, **known)
        if best.error is not None:
            raise best.error
        stats = solver.stats()
        w = last = np.asarray(result["x"].full()).ravel()
        success = bool(stats["success"])
        if not success and best.w is not None and (best.stopped or "Exceeded" in str(stats["return_status"])):
            w = best.w
        multipliers = result["lam_g"].full().ravel(), result["lam_x"].full().ravel()
        status = best.status or str(stats["return_status"])
        return Solution(w, success, status, int(stats["iter_count"]), time.perf_counter() - began, multipliers, last)


@dataclass(frozen=True)
class Fatrop:
    """Fatrop (Vanroye et al., 2023, IROS): an interior-point method that factors stage by stage, with exact derivatives.

    max_iterations, tolerance, verbose: as for `Ipopt`; options: further Fatrop options. What a stage needs of earlier ones is handed on as
    states. CasADi's Fatrop does not report its iterations: it can be neither watched nor stopped in time, and Fatrop 1.1 fails, or does not
    return at all, on some problems that IPOPT solves: try it where speed counts. Raises TypeError, ValueError.
    """

    max_iterations: int = 300
    tolerance: float = 1e-8
    verbose: bool = False
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _check(self)
        if not isinstance(self.options, Mapping) or not all(isinstance(name, str) for name in self.options):
            raise TypeError(f"Fatrop.options is {self.options!r}: give a mapping of Fatrop's option names, such as {{'mu_init': 0.1}}")

    def solve(self, program: Program) -> Solution:
        """The solution, or the last iterate with success False."""
        began = time.perf_counter()
        parts = staged(program)
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
                "mu_init": FATROP_BARRIER,
                "print_level": 5 if self.verbose else 0,
                **self.options,
            },
            "print_time": False,
            "error_on_fail": False,
            "show_eval_warnings": self.verbose,
        }
        try:
            solver = ca.nlpsol("solver", "fatrop", parts.nlp, options)
            result = solver(x0=parts.first, lbx=parts.w_lower, ubx=parts.w_upper, lbg=parts.lower, ubg=parts.upper)
        except RuntimeError:  # Fatrop gives up by raising what CasADi does not pass on
            return Solution(program.first, False, "Fatrop_Error", 0, time.perf_counter() - began)
        stats = solver.stats()
        w = np.asarray(result["x"].full()).ravel()
        success = bool(stats["success"]) and bool(np.all(np.isfinite(w)))
        failure = "Maximum_Iterations_Exceeded" if stats["iter_count"] >= self.max_iterations else "Fatrop_Failed"
        status = "Solve_Succeeded" if success else failure
        multipliers = result["lam_g"].full().ravel()[parts.rows], result["lam_x"].full().ravel()[parts.original]
        return Solution(w[parts.original], success, status, int(stats["iter_count"]), time.perf_counter() - began, multipliers)


class Best(ca.Callback):
    """Follows IPOPT: tells the watcher, remembers the best iterate."""

    def __init__(self, size: int, rows: int, lower: Array, upper: Array, objective: float, watch: Watcher | None) -> None:
        super().__init__()
        self._sizes = {"x": size, "f": 1, "g": rows, "lam_x": size, "lam_g": rows, "lam_p": 0}
        self._lower, self._upper, self._objective, self._watch = lower, upper, objective, watch
        self._merit = np.inf
        self._count = 0
        self.w: Array | None = None
        self.status = ""
        self.error: Exception | None = None
        self.construct("best", {})

    @property
    def stopped(self) -> bool:
        """Whether the solver was told to stop."""
        return bool(self.status)

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        """Ctrl-C meanwhile stops the solver after its iteration; a second time it raises, as usual."""
        usual = signal.getsignal(signal.SIGINT)
        if usual is None or threading.current_thread() is not threading.main_thread():
            yield
            return

        def stop(number: int, frame: FrameType | None) -> None:
            self.status = STOPPED
            signal.signal(signal.SIGINT, usual)

        signal.signal(signal.SIGINT, stop)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, usual)

    def get_n_in(self) -> int:
        """As `nlpsol` has outputs."""
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        """One: whether to stop."""
        return 1

    def get_name_in(self, i: int) -> str:
        """As `nlpsol` names its outputs."""
        return str(ca.nlpsol_out(i))

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """As `nlpsol` sizes its outputs."""
        return ca.Sparsity.dense(self._sizes[ca.nlpsol_out(i)], 1)

    def eval(self, arg: Sequence[ca.DM]) -> list[Any]:
        """0 to go on, 1 to stop."""
        w, f, g = (arg[ca.nlpsol_out().index(name)].full().ravel() for name in ("x", "f", "g"))
        violation = float(np.maximum(np.maximum(self._lower - g, g - self._upper), 0.0).max(initial=0.0))
        # the least violation counts, until it is small; then the objective
        merit = violation if violation > NEAR else NEAR * float(np.arctan(f[0]) / np.pi)
        if np.isfinite(merit) and merit < self._merit:
            self._merit, self.w = merit, w.copy()
        try:
            proceed = self._watch is None or self._watch(Progress(self._count, float(f[0]) * self._objective, violation)) is not False
        except KeyboardInterrupt:
            proceed = False
        except Exception as error:  # noqa: BLE001  # raised again once the solver has stopped, which would make a failure of it
            self.error, proceed = error, False
        self._count += 1
        if not proceed:
            self.status = STOPPED
        return [1 if self.status else 0]


def _check(solver: Ipopt | Fatrop) -> None:
    name = type(solver).__name__
    whole_number(f"{name}.max_iterations", solver.max_iterations, 1)
    positive_number(f"{name}.tolerance", solver.tolerance)
    if not isinstance(solver.verbose, bool):
        raise TypeError(f"{name}.verbose is {solver.verbose!r}: give True or False")
    if not isinstance(solver, Ipopt):
        return
    if solver.seconds is not None:
        positive_number(f"{name}.seconds", solver.seconds)
    if solver.watch is not None and not callable(solver.watch):
        raise TypeError(f"{name}.watch is {solver.watch!r}: give a function of an ocp.Progress, or None")


def _check_library(options: Mapping[str, Any]) -> None:
    """A linear solver whose library is missing would end the process, not raise."""
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
