"""Recommendations for random scenes, tested against tight references.

`python -m tests.support.random_recommendations 60` prints the share that meets its tolerance and
the time limit, and every one that does not.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections import Counter

import numpy as np

import tenscasadi as tc
from tests.support.random_runs import draw_case, solve_tightly

TIME_LIMIT = 60.0  # s


def check_recommendation(seed: int, time_limit: float) -> str | None:
    """Check the recommendation for one scene.

    Returns "met", "missed", "late", or the message without a recommendation; None without a
    reference.
    """
    case = draw_case(seed)
    reference = solve_tightly(case)
    if reference is None:
        return None
    motion = float(np.ptp(reference.nodes, axis=0).max())
    tolerance = motion * 10 ** np.random.default_rng([seed, 2]).uniform(-6, -2)
    began = time.perf_counter()
    try:
        advice = tc.recommend(
            case.model, case.t_end, tolerance, case.state, case.control, compiled=False,
            time_limit=time_limit,
        )  # fmt: skip
    except (tc.NoSchemeError, tc.NoReferenceError) as error:
        return str(error)
    if time.perf_counter() - began > 1.1 * time_limit + 1:
        return "late"
    run = tc.simulate(
        case.model, case.t_end, state=case.state, control=case.control, compiled=False,
        verify=False, **advice.options,
    )  # fmt: skip
    error = np.linalg.norm(run.nodes[-1] - reference.nodes[-1], axis=1).max()
    return "met" if error <= tolerance else "missed"


def main() -> None:
    warnings.simplefilter("ignore")
    given = [*map(int, sys.argv[1:]), *[60, 0][len(sys.argv) - 1 :]]
    count, seed = given[:2]
    found: Counter[str] = Counter()
    while found.total() < count:
        outcome = check_recommendation(seed, TIME_LIMIT)
        seed += 1
        if outcome is None:
            continue
        kind = outcome if outcome in ("met", "missed", "late") else "none"
        found[kind] += 1
        if kind != "met":
            print(f"{seed - 1}: {outcome}", flush=True)
    print(dict(found))


if __name__ == "__main__":
    main()
