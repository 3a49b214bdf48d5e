"""A hundred planning problems of the kinds that users bring, each solved by default, with the error of its replay against a stated tolerance.

Run it: python examples/ocp_suite.py, or with the kinds of problems to solve: python
examples/ocp_suite.py tower arm. With "known", "held-out" or "fresh" it solves random problems of
sixteen kinds (`ocp_problems.wide`); only the known ones are looked at while the planner is tuned.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from itertools import chain
from typing import NamedTuple

import contact_problems
import numpy as np
from ocp_problems.case import Case
from ocp_problems.shape_changes import large_cases, small_cases
from ocp_problems.tasks import constrained_cases, reaching_cases
from ocp_problems.wide import FRESH, HELD_OUT, SEEDS, wide_cases

import ocp

RANDOM = {"known": SEEDS, "held-out": HELD_OUT, "fresh": FRESH}  # seeds of random problems
TIME_LIMIT = 60.0  # of a random problem, s


class Row(NamedTuple):
    """Result of the plan of one problem."""

    kind: str
    name: str
    success: bool
    iterations: int
    seconds: float
    objective: float
    error: float
    tolerance: float

    @property
    def met(self) -> bool:
        """Whether a plan was found whose replay error is within the tolerance."""
        return self.success and not self.error > self.tolerance


def cases(kinds: Sequence[str] = (), quick: bool = False) -> Iterator[Case]:
    """Yield the problems, of some kinds if given; with `quick`, a few of them."""
    for name in RANDOM.keys() & kinds:
        yield from wide_cases(RANDOM[name])
    for case in chain(
        small_cases(), large_cases(), reaching_cases(), constrained_cases(), contact_cases()
    ):
        if (not kinds or case.kind in kinds) and (case.quick or not quick):
            yield case


def contact_cases() -> Iterator[Case]:
    """Yield the contact problems of `contact_problems`, by default with 1 cm tolerance."""
    for name, asked in contact_problems.PROBLEMS.items():
        yield Case("contact", name, asked.build, asked.tolerance or 0.01)


def solved(case: Case) -> tuple[Row, str]:
    """Solve a problem; return its row of the table and the message of the plan.

    The time is that of `ocp.solve`: the goals of random problems come from simulations.
    """
    problem = case.problem()
    began = time.perf_counter()
    if np.isnan(case.tolerance):
        plan = ocp.solve(problem, time_limit=TIME_LIMIT)
    else:
        plan = ocp.solve(problem, tolerance=case.tolerance)
    seconds = time.perf_counter() - began
    row = Row(
        case.kind,
        case.name,
        plan.success,
        plan.iterations,
        seconds,
        plan.objective,
        plan.replay_error,
        case.tolerance,
    )
    return row, plan.message


def print_kinds(rows: Sequence[Row]) -> None:
    """Print the number of solved problems of each kind, times and iterations."""
    print(
        f"\n{'kind':16}  problems  solved  seconds: median  ninetieth percentile  iterations: median  ninetieth percentile"
    )
    for kind in [*dict.fromkeys(row.kind for row in rows), "all"]:
        own = [row for row in rows if kind in (row.kind, "all")]
        seconds, iterations = (
            [getattr(row, what) for row in own] for what in ("seconds", "iterations")
        )
        share = sum(row.met for row in own) / len(own)
        print(
            f"{kind:16}  {len(own):8}  {share:6.0%}  {np.median(seconds):15.2f}  {np.percentile(seconds, 90):20.2f}"
            f"  {np.median(iterations):18.0f}  {np.percentile(iterations, 90):20.0f}"
        )


def main(quick: bool = False, kinds: Sequence[str] = ()) -> list[Row]:
    """Solve the problems, print a row for each and for each kind; return the rows.

    With `quick`, a few of them are solved.
    """
    print(f"{'problem':36}  found  iterations  seconds   objective  replay error  tolerance")
    rows = []
    for case in cases(kinds, quick):
        row, said = solved(case)
        found = "yes" if row.success else "no"
        numbers = f"{row.iterations:10}  {row.seconds:7.2f}  {row.objective:10.6g}  {row.error:12.1e}  {row.tolerance:9.0e}"
        print(
            f"{row.name:36}  {found:5}  {numbers}" + ("" if row.met else f"  ← {said[:100]}"),
            flush=True,
        )
        rows.append(row)
    print_kinds(rows)
    return rows


if __name__ == "__main__":
    main(kinds=sys.argv[1:])
