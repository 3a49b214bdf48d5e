"""Commands `plan` and `control`."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Annotated, Any

from tenscasadi.cli.loading import load_ocp, load_plots
from tenscasadi.cli.report import FAILED, INTERRUPTED, CommandReport, find_scalars
from tenscasadi.cli.source import SCENE, SceneSource, find_source
from tenscasadi.io.document import Change
from tenscasadi.schema.reading import SceneFileError
from tenscasadi.util.compile import find_compiler


def find_fields() -> Any:
    """Return the fields of the table [plan]."""
    return load_ocp().io.plan_section.PLAN.fields


def find_loop_fields() -> Any:
    """Return the fields of the table [closed_loop]."""
    return load_ocp().io.study_sections.SECTIONS["closed_loop"].fields


def plan_motion(
    source: Annotated[str, SCENE],
    report: CommandReport,
    changes: Sequence[Change],
    intervals: int | None = None,
) -> int:
    """Solve the optimal control problem [plan] of a scene file.

    Numbers of the file are options: `tenscasadi plan prism --to-height 1.2 --upper 200`. The plan is
    verified by a simulation in finer steps, whose distance from the goal is printed. Limits near the
    force densities of the equilibrium make an easy problem; wide ones may take many iterations. With
    [refinement] the plan is refined, with [robustness] it is replayed under random errors.

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
    arguments, studies = _read(found)
    problem = arguments["problem"]
    plan = _find_plan(found, arguments, studies.refinement)
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
    content = find_scalars(plan) | {"success": plan.success}
    if studies.robustness is not None:
        content["robustness"] = _study_robustness(found, plan, studies.robustness, report)
        if content["robustness"]["interrupted"]:
            return report.finish(INTERRUPTED, **content)
    return report.finish(0 if plan.success else FAILED, **content)


def control_motion(
    source: Annotated[str, SCENE], report: CommandReport, changes: Sequence[Change]
) -> int:
    """Simulate a scene under the controller of [closed_loop].

    The controller pursues the goals of [plan]: model predictive control, sampled motions (MPPI), or
    feedback along a plan, which is solved first. The simulated scene may have other parameters than
    the controller's model. Ctrl-C ends the run and keeps the rows so far.

    Parameters
    ----------
    source : str
        Template or scene file (.toml, .json).
    report : CommandReport
        Text and files.
    changes : sequence of Change
        Changes of the scene file.
    """
    found = find_source(source, changes)
    sections = load_ocp().io.study_sections
    arguments, studies = _read(found)
    if studies.closed_loop is None:
        raise found.document.root.error("it has no [closed_loop]: give one with t_end, s")
    problem = arguments["problem"]
    with _named(found, "closed_loop"):
        loop = studies.closed_loop.run(
            problem,
            lambda: _find_plan(found, arguments, studies.refinement),
            progress=sys.stderr.isatty() and not report.quiet,
        )
    trajectory, slowest = loop.trajectory, float(loop.seconds.max(initial=0.0))
    position, velocity = sections.measure_goal_error(problem, trajectory.states[-1])
    report.say(
        f"{source}: {problem.model.scene.structure!r}",
        *sections.describe_studies(studies._replace(refinement=None, robustness=None)),
        trajectory.summary(),
        f"decisions     {len(loop.seconds)} of at most {slowest:.3g} s",
        f"goals         it ends {position:.2g} m and {velocity:.2g} m/s from them",
    )
    title = f"{found.stem}: under feedback"
    report.write(
        f"{found.stem}-control",
        {".npz": trajectory.save},
        {".png": lambda path: load_plots().time_lapse(trajectory, title=title, path=path)},
    )
    errors = {"goal_error": position, "goal_speed_error": velocity}
    content = find_scalars(trajectory) | errors | {"slowest_decision": slowest}
    code = INTERRUPTED if trajectory.interrupted else 0 if trajectory.success else FAILED
    return report.finish(code, **content | {"success": trajectory.success})


def _read(found: SceneSource) -> tuple[dict[str, Any], Any]:
    """Read the arguments of `ocp.solve` and the requested studies.

    They are those of the scene file `found`. This is done before anything is solved, so that errors
    come early.
    """
    ocp = load_ocp()
    arguments = ocp.io.problem_files.read_arguments(found.document)
    return arguments, ocp.io.study_sections.read_studies(found.document)


@contextmanager
def _named(found: SceneSource, section: str) -> Iterator[None]:
    """Add the names of file and table to errors.

    The file is `found`, and the table `section`.
    """
    try:
        yield
    except SceneFileError:
        raise
    except ValueError as error:  # infeasible goals, contradicting limits
        raise ValueError(f"{found.path.name}, {section}: {error}") from error


def _find_plan(found: SceneSource, arguments: dict[str, Any], refinement: Any) -> Any:
    """Solve the problem in [plan], and refine the plan if requested.

    `arguments` are those of `ocp.solve`, and `refinement` is None without a request.
    """
    with _named(found, "plan"):
        plan = load_ocp().solve(**arguments)
    if refinement is None:
        return plan
    with _named(found, "refinement"):
        return refinement.run(plan)


def _study_robustness(
    found: SceneSource, plan: Any, study: Any, report: CommandReport
) -> dict[str, Any]:
    """Replay the plan with random errors, and report the result.

    `study` contains the options. Returns the numbers of the result by name.
    """
    with _named(found, "robustness"):
        result = study.run(plan, progress=sys.stderr.isatty() and not report.quiet)
    report.say("\nrobustness", result.summary())
    title = f"{found.stem}: errors of {len(result.error)} replays"
    draw = {".png": lambda path: load_plots().robustness(result, title=title, path=path)}
    report.write(f"{found.stem}-robustness", {}, draw)
    quantiles = dict(zip(("5 %", "50 %", "95 %"), result.quantiles(), strict=True))
    return {
        **{
            name: getattr(result, name)
            for name in ("success_rate", "tolerance", "tracked", "interrupted")
        },
        **{"error": quantiles, "importance": result.importance},
    }
