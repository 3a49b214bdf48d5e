"""IPOPT as a value."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from ocp.solvers.base import Solution, check_options
from ocp.solvers.best import Best, Watcher
from ocp.transcription.sparse_nlp import Program
from tenscasadi.util.validate import positive_number

HSL = ("ma27", "ma57", "ma77", "ma86", "ma97")  # linear solvers that CasADi does not bring along
PUSHES = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")
WARM = {"warm_start_init_point": "yes", **{f"warm_start_{push}": 1e-8 for push in PUSHES}}
BARRIER = 1e-4  # to start with: with IPOPT's own, 0.1, iterates leave the guess
CONTACT = 1e-3  # the same, for motions with contact, which take several times as many iterations with less
KNOWN = 1e-9  # the same where multipliers are known; where they are not, a small one keeps iterates at limits that they should leave


@dataclass(frozen=True)
class Ipopt:
    """IPOPT with exact derivatives.

    max_iterations; tolerance: of scaled optimality and constraints; verbose: prints a line for each iteration; options: further IPOPT
    options, such as {"linear_solver": "spral"}, which override those chosen here. MUMPS runs without its own scaling, which triples its
    speed on these problems. seconds: wall time after which it stops, None: no limit. watch: called with a `Progress` after each iteration, such
    as a `tenscasadi.convergence.Convergence`, which draws them; when it returns False the solver stops. warm: the guess is nearly a solution,
    such as another plan: keep to it, and to its multipliers, if grid and constraints are the same. However it is stopped, also from the
    keyboard, what is returned is the best iterate. Raises TypeError, ValueError.
    """

    max_iterations: int = 300
    tolerance: float = 1e-8
    verbose: bool = False
    options: Mapping[str, Any] = field(default_factory=dict)
    seconds: float | None = None
    watch: Watcher | None = None
    warm: bool = False

    def __post_init__(self) -> None:
        check_options("Ipopt", self.max_iterations, self.tolerance, self.verbose, self.options, "{'mu_strategy': 'adaptive'}")
        if self.seconds is not None:
            positive_number("Ipopt.seconds", self.seconds)
        if self.watch is not None and not callable(self.watch):
            raise TypeError(f"Ipopt.watch is {self.watch!r}: give a function of an ocp.Progress, or None")
        if not isinstance(self.warm, bool):
            raise TypeError(f"Ipopt.warm is {self.warm!r}: give True or False")
        _check_library(self.options)

    def solve(self, program: Program) -> Solution:
        """The solution, or the best iterate with IPOPT's word for what went wrong. Raises ValueError for an option IPOPT refuses."""
        return self.prepared(program)(program)

    def prepared(self, program: Program) -> Callable[[Program], Solution]:
        """Solves this program, and others that differ from it in limits, start and multipliers alone. Raises ValueError as `solve`."""
        best = Best(program.problem["x"].shape[0], len(program.lower), program.objective, self.watch)
        return partial(_run, self._built(program, best), best)

    def _built(self, program: Program, best: Best) -> ca.Function:
        ipopt = {
            "max_iter": self.max_iterations,
            "tol": self.tolerance,
            "print_level": 5 if self.verbose else 0,
            "sb": "yes",
            "mumps_scaling": 0,
            "mumps_permuting_scaling": 0,
            "mumps_pivot_order": 0,  # AMD; what MUMPS chooses fills factors where collocation or a free duration couples much: 10 to 80 times slower
            "nlp_scaling_method": "none",  # programs are scaled
            "mu_init": CONTACT if program.contact else BARRIER,
            "min_refinement_steps": 0,  # solutions of linear systems are refined where their residuals ask for it
            "constr_mult_init_max": 0,  # multipliers of a guess by least squares cost a factorisation, and save no iteration
            **({} if self.seconds is None else {"max_wall_time": self.seconds}),
            **(WARM if self.warm else {}),
            **({"mu_init": KNOWN} if self.warm and program.multipliers is not None else {}),
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
            raise ValueError(f"Ipopt.options is {dict(self.options)}, and IPOPT says: {reason}. Give options that IPOPT has") from None


def _run(solver: ca.Function, best: Best, program: Program) -> Solution:
    known = {} if program.multipliers is None else dict(zip(("lam_g0", "lam_x0"), program.multipliers, strict=True))
    with best.following(program.lower, program.upper):
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
    return Solution(w, success, status, int(stats["iter_count"]), multipliers, last)


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
