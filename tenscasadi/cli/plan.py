"""Command that plans motions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from tenscasadi.cli.loading import load_ocp, load_plots
from tenscasadi.cli.report import FAILED, CommandReport, find_scalars
from tenscasadi.cli.source import SCENE, find_source
from tenscasadi.io.document import Change
from tenscasadi.util.compile import find_compiler


def find_fields() -> Any:
    """Find the fields of [plan]."""
    return load_ocp().io.plan_section.PLAN.fields


def plan_motion(
    source: Annotated[str, SCENE],
    report: CommandReport,
    changes: Sequence[Change],
    intervals: int | None = None,
) -> int:
    """Solve the optimal control problem [plan] of a scene file.

    Numbers of the file are options: `tenscasadi plan prism --to-height 1.2 --upper 200`. The plan is
    verified by a simulation in finer steps, whose distance from the goal is printed. Limits near the
    force densities of the equilibrium make an easy problem; wide ones may take many iterations.

    Parameters
    ----------
    source : str
        Template or scene file (.toml, .json).
    report : CommandReport
        Text and files.
    changes : sequence of Change
        Changes of the scene file.
    intervals : int
        Intervals of multiple shooting with IPOPT (default: chosen by the problem).
    """
    way = {
        "transcription": f'{{kind = "MultipleShooting", intervals = {intervals}}}',
        "solver": "Ipopt",
    }
    sugar = [
        Change(f"--intervals {intervals}", f"plan.{name}", value) for name, value in way.items()
    ]
    found = find_source(source, [*changes, *(sugar if intervals is not None else [])])
    ocp = load_ocp()
    arguments = ocp.io.problem_files.read_arguments(found.document)
    problem = arguments["problem"]
    try:
        plan = ocp.solve(**arguments)
    except ValueError as error:  # infeasible goals, contradicting limits
        raise ValueError(f"{found.path.name}, plan: {error}") from error
    asked = ocp.io.problem_files.describe_problem(problem)
    report.say(f"{source}: {problem.model.scene.structure!r}, {asked}", plan.summary())
    if find_compiler() is None:
        report.say("C compiler    none found: it runs uncompiled")
    (lower, upper), stem = problem.force_density_limits, found.stem
    report.write(
        f"{stem}-plan",
        {".npz": plan.save},
        {
            ".png": lambda path: load_plots().time_lapse(
                plan.replay(), title=f"{stem}: the plan, replayed", path=path
            ),
            "-forces.png": lambda path: load_plots().force_densities(
                plan, lower=lower, upper=upper, title=f"{stem}: planned force densities", path=path
            ),
        },
    )
    code = 0 if plan.success else FAILED
    return report.finish(code, **find_scalars(plan) | {"success": plan.success})
