"""Comparison with rockit: times and replay errors of the same problem by IPOPT.

Both packages use the same model expression, mesh and initial guess, each with IPOPT's default
options and with those that this package selects. rockit receives the initial guess and the goal
constraints without the redundant ones, which follow from bars and momenta; with all of them no
solver converges. (Its DirectCollocation cannot take a guess in version 0.6.7.) Install it by `pip
install rockit-meco`; without it the example reports that it is missing.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable
from functools import partial
from statistics import median
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

import ocp
import tenscasadi as tc
from ocp.guess.path import make_guess
from ocp.problem.scaling import Scales
from ocp.targets.find_target import find_target
from ocp.transcription.base import Transcription

BAR = 1.4  # m
LEAST, MOST = 5.0, 100.0  # N/m
# What `ocp.Ipopt` chooses for a program without contact, and what IPOPT and MUMPS do where nothing
# is chosen.
TUNED = {
    **{"mumps_scaling": 0, "mumps_permuting_scaling": 0, "mumps_pivot_order": 0, "mu_init": 1e-4},
    **{"nlp_scaling_method": "none", "min_refinement_steps": 0, "constr_mult_init_max": 0.0},
}
AS_IT_COMES = {
    **{"mumps_scaling": 77, "mumps_permuting_scaling": 7, "mumps_pivot_order": 7, "mu_init": 0.1},
    **{
        "nlp_scaling_method": "gradient-based",
        "min_refinement_steps": 1,
        "constr_mult_init_max": 1000.0,
    },
}


class Row(NamedTuple):
    """Time of a plan, including building, and its replay error.

    The error is the largest distance from the goal [m] after steps ten times finer than the
    intervals.
    """

    name: str
    options: str
    seconds: float
    iterations: int
    replay_error: float
    objective: float


def problem() -> ocp.Problem:
    """Height change of a prism from 1 m to 1.1 m in a second, at minimum effort."""

    def prism(height: float) -> tc.Structure:
        return tc.shapes.prism(
            bars=3, radius=np.sqrt(BAR**2 - height**2) / (2 * np.sin(np.radians(75))), height=height
        )

    goals = [ocp.StringLengths(prism(1.1).string_lengths), ocp.AtRest()]
    model = tc.Model(tc.Scene(prism(1.0), control=tc.ForceDensity()))
    return ocp.Problem(
        model, goals=goals, bounds=[ocp.ForceDensityLimits(LEAST, MOST)], costs=[ocp.Effort()]
    )


def ours(name: str, transcription: Transcription, options: dict[str, Any] | None = None) -> Row:
    """Solve the problem by this package, with default or given options."""
    plan = ocp.solve(problem(), transcription, ocp.Ipopt(options=options or {}))
    return Row(
        name,
        "as they come" if options else "ours",
        plan.seconds,
        plan.iterations,
        plan.replay_error,
        plan.objective,
    )


def theirs(rockit: Any, name: str, method: Any, options: dict[str, Any] | None = None) -> Row:
    """Solve the problem by rockit, and replay the plan."""
    asked = problem()
    model, count = asked.model, method.N
    began = time.perf_counter()
    target = find_target(asked, Scales.of(asked))
    guess = make_guess(asked, target, count)
    stage = rockit.Ocp(T=1.0)
    x, u = stage.state(model.nx), stage.control(model.nu)
    stage.set_der(x, model.ode(x, u))
    stage.subject_to(stage.at_t0(x) == target.start)
    stage.subject_to(target.rows(stage.at_tf(x)) == 0)
    stage.subject_to(u >= LEAST)
    stage.subject_to(u <= MOST)
    stage.add_objective(stage.integral(ca.sumsqr(u)))
    chosen = {f"ipopt.{key}": value for key, value in (options or {}).items()}
    stage.solver(
        "ipopt", {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False, **chosen}
    )
    stage.method(method)
    stage.set_initial(x, guess.states.T)
    stage.set_initial(u, guess.force_density.T)
    solution = stage.solve()
    seconds = time.perf_counter() - began
    gamma = np.clip(np.asarray(solution.sample(u, grid="control")[1])[:count], LEAST, MOST)
    replay = tc.simulate(model, 1.0, 0.1 / count, state=target.start, control=gamma, compiled=False)
    meters = np.abs(np.asarray(target.misfit(replay.states[-1])[0].full())).max()
    return Row(
        name,
        "ours" if options else "as they come",
        seconds,
        int(solution.stats["iter_count"]),
        float(meters),
        float(np.sum(gamma**2) / count),
    )


def repeated(make: Callable[[], Row], repeats: int) -> Row:
    """Select the row with the median time of several runs."""
    rows = [make() for _ in range(repeats)]
    return rows[0]._replace(seconds=median(row.seconds for row in rows))


def main(quick: bool = False) -> list[Row]:
    """Print the table and return its rows; those of rockit are omitted without it."""
    count, repeats = (8, 1) if quick else (60, 3)
    ours("warm-up", ocp.Variational(5))
    transcriptions = {
        "Variational": ocp.Variational(count),
        "Variational, corrected": ocp.Variational(count, accuracy=1e-9 if count > 20 else 1e-4),
        "MultipleShooting, 2 substeps": ocp.MultipleShooting(count, substeps=2),
        "Collocation, degree 2": ocp.DirectCollocation(count, degree=2),
        "Collocation, degree 3, a third of the intervals": ocp.DirectCollocation(
            max(5, count // 3), degree=3
        ),
    }
    rows = [
        repeated(partial(ours, name, t, o), repeats)
        for name, t in transcriptions.items()
        for o in (None, AS_IT_COMES)
    ]
    own = len(rows)
    try:
        rockit: Any = importlib.import_module("rockit")
    except ImportError:
        print(
            "rockit is not installed (pip install rockit-meco): only this package's plans are shown, nothing is compared"
        )
    else:
        for substeps in (2, 1):
            name, method = (
                f"rockit, MultipleShooting, M={substeps}",
                rockit.MultipleShooting(N=count, M=substeps, intg="rk"),
            )
            rows += [
                repeated(partial(theirs, rockit, name, method, o), repeats) for o in (None, TUNED)
            ]
    print(
        f"{'':<50}{'options':>14}{'seconds':>10}{'iterations':>12}{'replay error (m)':>18}{'objective':>12}"
    )
    for row in rows:
        print(
            f"{row.name:<50}{row.options:>14}{row.seconds:>10.3f}{row.iterations:>12}{row.replay_error:>18.1e}{row.objective:>12.4f}"
        )
    for peer in rows[own:]:
        better = [
            row
            for row in rows[:own]
            if row.replay_error <= peer.replay_error and row.options == peer.options
        ]
        if better:
            best = min(better, key=lambda row: row.seconds)
            print(
                f"{peer.name}, options {peer.options}: {best.name} is as exact and {peer.seconds / best.seconds:.1f} times as fast"
            )
    return rows


if __name__ == "__main__":
    main()
