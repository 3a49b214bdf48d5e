"""Fatrop as a value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from ocp.solvers.base import Solution, check_options
from ocp.solvers.staged import staged
from ocp.transcription.variables import Program

REFUSED = "option not supported", "generic_type.cpp"  # what CasADi says of options that Fatrop does not have, or of another type
BARRIER = 1e-2  # with Fatrop's own, 0.1, it does not return on more problems


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
        check_options("Fatrop", self.max_iterations, self.tolerance, self.verbose, self.options, "{'mu_init': 0.1}")

    def solve(self, program: Program) -> Solution:
        """The solution, or the last iterate with success False. Raises ValueError for an option Fatrop refuses."""
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
                "mu_init": BARRIER,
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
        except RuntimeError as error:  # Fatrop gives up by raising what CasADi does not pass on
            if any(sign in str(error) for sign in REFUSED):
                raise ValueError(f"Fatrop.options is {dict(self.options)}: give options that Fatrop has, and values of their kind") from None
            return Solution(program.first, False, "Fatrop_Error", 0)
        stats = solver.stats()
        w = np.asarray(result["x"].full()).ravel()
        success = bool(stats["success"]) and bool(np.all(np.isfinite(w)))
        failure = "Maximum_Iterations_Exceeded" if stats["iter_count"] >= self.max_iterations else "Fatrop_Failed"
        status = "Solve_Succeeded" if success else failure
        multipliers = result["lam_g"].full().ravel()[parts.rows], result["lam_x"].full().ravel()[parts.original]
        return Solution(w[parts.original], success, status, int(stats["iter_count"]), multipliers)
