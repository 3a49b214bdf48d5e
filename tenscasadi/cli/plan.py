"""The command that plans: it prints a summary, writes plan and pictures."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from tenscasadi.cli.loading import load_ocp, load_plots
from tenscasadi.cli.output import FAILED, Writers, write_files
from tenscasadi.cli.source import find_source
from tenscasadi.dynamics.model import Model
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import ForceDensity
from tenscasadi.structure import shapes
from tenscasadi.structure.structure import Structure
from tenscasadi.util.compile import find_compiler

PRISM: dict[
    str, tuple[str, float]
] = {  # options of the prism's plan: what they are, and their defaults
    "bars": ("prism: number of bars", 3),
    "radius": ("prism: radius of the polygons at the start, m", 0.5),
    "height": ("prism: height at the start, m", 1.0),
    "duration": ("prism: time from start to end, s", 1.0),
    "lower": ("prism: least force density, N/m", 10.0),
    "upper": ("prism: largest force density, N/m", 100.0),
}


def run_plan(arguments: argparse.Namespace) -> int:
    """Plan what a scene file asks for, or how a prism changes its height; write plan and pictures."""
    if arguments.source == "prism":
        return _plan_prism(arguments)
    ocp = load_ocp()

    source = find_source(arguments.source)
    for name in (*PRISM, "to_height", "intervals"):
        if getattr(arguments, name) is not None:
            raise ValueError(
                f"--{name.replace('_', '-')} is for the shape prism: leave it out, and change [plan] of {source.path.name}"
            )
    asked = ocp.load_arguments(source.path)
    problem = asked["problem"]
    try:
        plan = ocp.solve(**asked)
    except ValueError as error:  # goals that nothing reaches, limits that contradict each other
        raise ValueError(f"{source.path.name}, plan: {error}") from error
    print(f"{source.name}: {problem.model.scene.structure!r}, {_describe(problem)}")
    lower, upper = problem.force_density_limits
    return _finish(arguments, source.stem, plan, {"lower": lower, "upper": upper})


def describe_plan(path: Path) -> str:
    """Return what [plan] of a scene file asks for, in a line. Raises SceneFileError."""
    return _describe(load_ocp().load_problem(path))


def _describe(problem: Any) -> str:
    duration = (
        f"{problem.shortest:g} s"
        if problem.shortest == problem.longest
        else f"{problem.shortest:g} to {problem.longest:g} s"
    )
    parts = {
        name: [type(value).__name__ for value in getattr(problem, name)]
        for name in ("phases", "goals", "bounds", "costs")
    }
    return f"{duration}, " + "; ".join(
        f"{name}: {', '.join(kinds)}" for name, kinds in parts.items() if kinds
    )


def _plan_prism(arguments: argparse.Namespace) -> int:
    ocp = load_ocp()
    for name, (_, default) in PRISM.items():
        if getattr(arguments, name) is None:
            setattr(arguments, name, default)
    start = shapes.prism(arguments.bars, arguments.radius, arguments.height)
    goal = _same_bars(
        arguments, 1.2 * arguments.height if arguments.to_height is None else arguments.to_height
    )
    problem = ocp.Problem(
        Model(Scene(start, control=ForceDensity())),
        duration=arguments.duration,
        goals=[ocp.StringLengths(goal.string_lengths), ocp.AtRest()],
        bounds=[ocp.ForceDensityLimits(arguments.lower, arguments.upper)],
        costs=[ocp.Effort()],
    )
    way = (
        ()
        if arguments.intervals is None
        else (ocp.MultipleShooting(intervals=arguments.intervals), ocp.Ipopt())
    )
    plan = ocp.solve(problem, *way)
    print(
        f"prism: {start!r}, from a height of {arguments.height:g} m to {goal.nodes[:, 2].max():g} m in {arguments.duration:g} s"
    )
    return _finish(arguments, "prism", plan, {"lower": arguments.lower, "upper": arguments.upper})


def _finish(arguments: argparse.Namespace, stem: str, plan: Any, limits: dict[str, Any]) -> int:
    """Print a plan's summary, write its files, and return the exit code."""
    plots = load_plots()

    print(plan.summary())
    if find_compiler() is None:
        print("C compiler    none found: it runs uncompiled")
    writers: Writers = {
        ".npz": plan.save,
        ".png": lambda path: plots.time_lapse(
            plan.replay(), title=f"{stem}: the plan, replayed", path=path
        ),
        "-forces.png": lambda path: plots.force_densities(
            plan, **limits, title=f"{stem}: planned force densities", path=path
        ),
    }
    write_files(arguments.output, f"{stem}-plan", writers)
    return 0 if plan.success else FAILED


def _same_bars(arguments: argparse.Namespace, height: float) -> Structure:
    """Return the equilibrium prism of another height with bars of the same length."""
    bars, radius = arguments.bars, arguments.radius
    chord = 2 * np.sin(np.pi / 4 + np.pi / (2 * bars))  # of the equilibrium twist, for radius 1
    square = (chord * radius) ** 2 + arguments.height**2 - height**2
    if not square > 0:
        longest = np.sqrt((chord * radius) ** 2 + arguments.height**2)
        raise ValueError(
            f"to-height is {height:g}: it must be less than the length of the bars, {longest:g} m"
        )
    return shapes.prism(bars, float(np.sqrt(square)) / chord, height)
