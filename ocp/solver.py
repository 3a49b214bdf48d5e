"""Solvers of nonlinear programs, as values."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import casadi as ca
import numpy as np

from ocp.program import Program
from tenscasadi.validate import Array, positive_number, whole_number

HSL = ("ma27", "ma57", "ma77", "ma86", "ma97")  # linear solvers that CasADi does not bring along


class Solution(NamedTuple):
    """w and whether it is optimal; status is the solver's own word; iterations and wall time, s."""

    w: Array
    success: bool
    status: str
    iterations: int
    seconds: float


class Solver(Protocol):
    """Anything that solves a program."""

    def solve(self, program: Program) -> Solution:
        """The solution; where there is none, the last iterate with success False."""


@dataclass(frozen=True)
class Ipopt:
    """IPOPT with exact derivatives.

    max_iterations; tolerance: of scaled optimality and constraints; verbose: prints a line for each iteration; options: further IPOPT
    options, such as {"linear_solver": "spral"}, which override those chosen here. MUMPS runs without its own scaling, which triples its
    speed on these problems. Raises TypeError, ValueError.
    """

    max_iterations: int = 300
    tolerance: float = 1e-8
    verbose: bool = False
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        whole_number("Ipopt.max_iterations", self.max_iterations, 1)
        positive_number("Ipopt.tolerance", self.tolerance)
        if not isinstance(self.verbose, bool):
            raise TypeError(f"Ipopt.verbose is {self.verbose!r}: give True or False")
        if not isinstance(self.options, Mapping) or not all(isinstance(name, str) for name in self.options):
            raise TypeError(f"Ipopt.options is {self.options!r}: give a mapping of IPOPT's option names, such as {{'mu_strategy': 'adaptive'}}")
        _check_library(self.options)

    def solve(self, program: Program) -> Solution:
        """The solution, or the last iterate with IPOPT's word for what went wrong. Raises ValueError for an option IPOPT refuses."""
        ipopt = {
            "max_iter": self.max_iterations,
            "tol": self.tolerance,
            "print_level": 5 if self.verbose else 0,
            "sb": "yes",
            "mumps_scaling": 0,
            "mumps_permuting_scaling": 0,
            **self.options,
        }
        # error_on_fail: an iterate that does not converge is a result, which says so.
        exact = program.derivatives()
        options: dict[str, Any] = {
            "grad_f": exact["nlp_grad_f"],
            "jac_g": exact["nlp_jac_g"],
            "hess_lag": exact["nlp_hess_l"],
            "ipopt": ipopt,
            "print_time": False,
            "error_on_fail": False,
            "show_eval_warnings": self.verbose,
        }
        began = time.perf_counter()
        try:
            solver = ca.nlpsol("solver", "ipopt", program.problem, options)
        except RuntimeError as error:
            if "IpoptInterface::finalize" not in str(error):
                raise
            reason = str(error).strip().splitlines()[-1].split(": ", 1)[-1]
            raise ValueError(f"Ipopt.options is {dict(self.options)}, and IPOPT says: {reason}. Give options that IPOPT has") from None
        result = solver(x0=program.first, lbx=program.w_lower, ubx=program.w_upper, lbg=program.lower, ubg=program.upper)
        stats = solver.stats()
        w = np.asarray(result["x"].full()).ravel()
        return Solution(w, bool(stats["success"]), str(stats["return_status"]), int(stats["iter_count"]), time.perf_counter() - began)


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
