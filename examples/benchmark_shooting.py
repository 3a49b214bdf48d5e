"""Time per iteration of multiple shooting: derivatives put together from stages, against CasADi's of the unrolled steps, by turns in one run.

Both are of the same program and solved by the same IPOPT, so that iterates are equal but for
rounding; an iteration's time is that of the first few. What derivatives do not take is MUMPS (a
factorisation, or several where curvature is negative) and IPOPT itself: the same in both.
"""

from __future__ import annotations

import os

os.environ.setdefault(
    "OMP_NUM_THREADS", "1"
)  # before NumPy is loaded: so that the processor's seconds are those of one thread

import time
from collections.abc import Callable
from dataclasses import replace
from statistics import median
from typing import NamedTuple

import numpy as np
from ocp_problems.shape_changes import ball, free_prism, free_tower

import ocp
from ocp.search.methods import program_of
from ocp.transcription.sparse_nlp import Program

STRUCTURES: dict[str, tuple[Callable[[], ocp.Problem], int]] = {
    "prism": (lambda: free_prism(3, 1.0, 1.1), 40),
    "ball": (lambda: ball(0.95), 30),
    "tower of 6 bars": (lambda: free_tower(2), 60),
    "tower of 12 bars": (lambda: free_tower(4), 60),
}
ITERATIONS = 6


class Row(NamedTuple):
    """Milliseconds of the processor for an iteration, from stages and unrolled. derivatives: Jacobian and Hessian, each once."""

    structure: str
    intervals: int
    derivatives: tuple[float, float]
    iteration: tuple[float, float]
    difference: float  # between the iterates reached


def milliseconds(call: Callable[[], object]) -> float:
    """What a call takes of the processor."""
    began = time.process_time()
    call()
    return 1e3 * (time.process_time() - began)


def measured(name: str, problem: ocp.Problem, intervals: int, iterations: int, repeats: int) -> Row:
    """The medians of one structure."""
    staged = program_of(problem, ocp.MultipleShooting(intervals)).disturbed()
    programs = (staged, replace(staged, parts=staged.parts.unrolled()))
    runs = [ocp.Ipopt(max_iterations=iterations).prepared(program) for program in programs]
    rng = np.random.default_rng(0)
    took: list[list[tuple[float, float]]] = [[], []]
    ends = [staged.first, staged.first]
    for _ in range(repeats):
        w, multipliers = (
            staged.first + 1e-6 * rng.standard_normal(len(staged.first)),
            rng.standard_normal(len(staged.lower)),
        )
        for k, program in enumerate(programs):
            own = derivatives(program, w, multipliers)
            began = time.process_time()
            solution = runs[k](program)
            took[k].append((own, 1e3 * (time.process_time() - began) / solution.iterations))
            ends[k] = solution.w if solution.last is None else solution.last
    (own, whole), (own_unrolled, whole_unrolled) = (
        [median(column) for column in zip(*rows, strict=True)] for rows in took
    )
    return Row(
        name,
        intervals,
        (own, own_unrolled),
        (whole, whole_unrolled),
        float(np.abs(ends[0] - ends[1]).max()),
    )


def derivatives(program: Program, w: np.ndarray, multipliers: np.ndarray) -> float:
    """Milliseconds of a Jacobian and a Hessian at a point."""
    functions = program.derivatives()
    return milliseconds(lambda: functions["nlp_jac_g"](w, [])) + milliseconds(
        lambda: functions["nlp_hess_l"](w, [], 1.0, multipliers)
    )


def main(quick: bool = False) -> list[Row]:
    """Prints the table and returns its rows. `quick`: the prism alone, on few intervals."""
    print(
        f"{'ms of the processor':<20}{'intervals':>10}{'derivatives':>13}{'unrolled':>10}{'ratio':>7}{'iteration':>11}{'unrolled':>10}{'ratio':>7}"
    )
    rows: list[Row] = []
    for name, (make, intervals) in STRUCTURES.items():
        if quick and rows:
            break
        row = measured(
            name, make(), 5 if quick else intervals, 2 if quick else ITERATIONS, 1 if quick else 3
        )
        rows.append(row)
        (own, own_unrolled), (whole, whole_unrolled) = row.derivatives, row.iteration
        print(
            f"{name:<20}{row.intervals:>10}{own:>13.1f}{own_unrolled:>10.1f}{own_unrolled / own:>7.1f}"
            f"{whole:>11.1f}{whole_unrolled:>10.1f}{whole_unrolled / whole:>7.1f}",
            flush=True,
        )
    return rows


if __name__ == "__main__":
    main()
