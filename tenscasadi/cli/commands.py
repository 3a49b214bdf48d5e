"""The commands of scenes, which load matplotlib once they draw: each prints a summary, writes a .npz and pictures, and returns an exit code."""

from __future__ import annotations

import argparse
import sys
import time
from typing import Any

import numpy as np

from tenscasadi.analysis.tradeoff import tradeoff
from tenscasadi.cli.loading import load_plots
from tenscasadi.cli.output import FAILED, INTERRUPTED, Writers, write_files
from tenscasadi.cli.plan import describe_plan
from tenscasadi.cli.source import find_source
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.rattle import Rattle
from tenscasadi.integrators.runge_kutta import DormandPrince54, DormandPrince853, RungeKutta4
from tenscasadi.integrators.scheme import Scheme
from tenscasadi.integrators.stability import fastest_rate, stable_step
from tenscasadi.integrators.stabilization import Projection
from tenscasadi.statics.force_density import EquilibriumError, equilibrium_force_density
from tenscasadi.structure.structure import Structure
from tenscasadi.util.compile import Single, find_compiler
from tenscasadi.util.validate import positive_number


def run_simulate(arguments: argparse.Namespace) -> int:
    """Simulate a shape; write trajectory and pictures."""
    plots = load_plots()

    source = find_source(arguments.source)
    began = time.perf_counter()
    names = ("t_end", "step", "coordinates", "gravity", "save_every", "projection")
    simulation = source.simulation(**{name: getattr(arguments, name) for name in names})
    trajectory = simulation.run(
        progress=sys.stderr.isatty(), compiled=False if arguments.uncompiled else None
    )
    model = simulation.model
    set_up = time.perf_counter() - began - trajectory.seconds
    print(f"{source.name}: {model.structure!r}, {model.nx} states, {model.coordinates} coordinates")
    print(trajectory.summary())
    print(f"set-up        {set_up:.2f} s: equations and their compilation")
    writers: Writers = {
        ".npz": trajectory.save,
        ".png": lambda path: plots.time_lapse(trajectory, title=source.stem, path=path),
        "-errors.png": lambda path: plots.errors(
            trajectory, title=f"{source.stem}: errors", path=path
        ),
    }
    films = [
        ending for ending, wanted in ((".gif", arguments.gif), (".mp4", arguments.mp4)) if wanted
    ]
    writers |= dict.fromkeys(
        films, lambda path: plots.animation.animate(trajectory, path, title=source.stem)
    )
    write_files(arguments.output, f"{source.stem}-simulation", writers)
    return 0 if trajectory.success else FAILED


def run_tradeoff(arguments: argparse.Namespace) -> int:
    """Measure what schemes and steps cost and are worth on a shape; write table and picture."""
    source = find_source(arguments.source)
    if arguments.tolerance is not None:
        positive_number("tolerance", arguments.tolerance)
    simulation = source.simulation(t_end=arguments.t_end)
    model = simulation.model
    schemes: list[Scheme] = [
        RungeKutta4(),
        DormandPrince54(),
        DormandPrince853(),
        Rattle(),
        *map(DormandPrince853, arguments.rtol),
    ]
    table = tradeoff(
        model,
        simulation.t_end,
        schemes,
        arguments.steps,
        state=simulation.start,
        control=simulation.control,
        parameters=simulation.parameters,
        corrections=(None, Projection()),
        compiled=(
            False if arguments.uncompiled else None,
            *([Single()] if arguments.single else []),
        ),
        progress=sys.stderr.isatty(),
    )
    print(f"{source.name}: {model.structure!r}, {table.t_end:g} s")
    print(table.summary())
    if not table.rows:  # interrupted before the first
        return INTERRUPTED
    served = True
    if arguments.tolerance is not None:
        try:
            row = table.cheapest(arguments.tolerance)
            print(
                f"fastest within {arguments.tolerance:g} m: {row.name}"
                + ("" if np.isnan(row.step) else f", step {row.step:g} s")
            )
        except ValueError as error:  # what was measured is kept all the same
            print(error)
            served = False
    title = f"{source.stem}: cost and error of schemes"
    write_files(
        arguments.output,
        f"{source.stem}-tradeoff",
        {".npz": table.save, ".png": lambda path: table.plot(path, title=title)},
    )
    return INTERRUPTED if not table.complete else 0 if served else FAILED


def run_info(arguments: argparse.Namespace) -> int:
    """Describe a shape; write it and its picture."""
    plots = load_plots()

    source = find_source(arguments.source)
    simulation = source.simulation() if source.has("simulation") else None
    scene = source.scene() if simulation is None else simulation.scene
    model, given = (
        (Model(scene), None) if simulation is None else (simulation.model, simulation.parameters)
    )
    s = model.with_parameters(given).scene.structure
    print(f"{source.name}: {source.text}")
    print(
        f"nodes         {len(s.nodes)}, pinned: {', '.join(map(str, sorted({*s.pinned, *s.rollers}))) or 'none'}"
    )
    print(
        f"bars          {len(s.bars)}"
        + (
            f", lengths {_range(s.bar_lengths)} m, mass {s.bar_mass.sum():g} kg in all"
            if len(s.bars)
            else ""
        )
    )
    print(
        f"strings       {len(s.strings)}"
        + (
            f", lengths {_range(s.string_lengths)} m, stiffness {_range(s.stiffness)} N/m"
            if len(s.strings)
            else ""
        )
    )
    gamma = _equilibrium(s)
    print("\nterm: instructions of the right-hand side")
    print(model.describe())
    rate, stable = (
        fastest_rate(model, parameters=given),
        stable_step(model, safety=1.0, parameters=given),
    )
    print(f"\nfastest rate  {rate:.4g} rad/s, largest stable step of RungeKutta4 {stable:.3g} s")
    if simulation is not None:
        step = "" if simulation.step is None else f" in steps of {simulation.step:g} s"
        print(f"simulation    {simulation.t_end:g} s{step} by {simulation.scheme}")
    if source.has("plan"):
        print(f"plan          {describe_plan(source.path)}")
    compiler = find_compiler()
    print(
        f"C compiler    {' '.join(compiler) if compiler else 'none found: simulations run uncompiled'}"
    )
    fields = (
        "nodes",
        "bars",
        "strings",
        "bar_mass",
        "bar_radius",
        "node_mass",
        "fixed",
        "stiffness",
        "damping",
        "rest_length",
        "string_mass",
    )
    content: dict[str, Any] = {name: getattr(s, name) for name in fields}
    writers: Writers = {
        ".npz": lambda path: np.savez_compressed(path, **content, equilibrium_force_density=gamma),
        ".png": lambda path: plots.structure(s, labels=True, title=source.stem, path=path),
    }
    write_files(arguments.output, f"{source.stem}-structure", writers)
    return 0


def _equilibrium(structure: Structure) -> Any:
    """Print and return the force densities (α,) of the equilibrium without loads; NaN where there is none."""
    if not len(structure.strings):
        return np.zeros(0)
    try:
        gamma = equilibrium_force_density(structure)
    except EquilibriumError as error:
        print(f"equilibrium   {error}")
        return np.full(len(structure.strings), np.nan)
    print(
        f"equilibrium   without loads, force densities in the ratio {' : '.join(f'{value:.4g}' for value in np.unique(gamma.round(9)))}"
    )
    return gamma


def _range(values: Any) -> str:
    low, high = float(np.min(values)), float(np.max(values))
    return f"{low:g}" if np.isclose(low, high) else f"{low:g} … {high:g}"
