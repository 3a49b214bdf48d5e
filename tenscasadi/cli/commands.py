"""The commands of scenes, which load matplotlib once they draw: each prints a summary, writes a .npz and pictures, and returns an exit code."""

from __future__ import annotations

import argparse
import sys
import time
from typing import Any

import numpy as np

from tenscasadi.analysis.tradeoff import tradeoff
from tenscasadi.cli.demos import demo
from tenscasadi.cli.output import Writers, write_files
from tenscasadi.design.statics import EquilibriumError, equilibrium_force_density
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.rattle import Rattle
from tenscasadi.integrators.runge_kutta import DormandPrince54, DormandPrince853, RungeKutta4
from tenscasadi.integrators.scheme import Scheme
from tenscasadi.integrators.stability import fastest_rate, stable_step
from tenscasadi.integrators.stabilization import Projection
from tenscasadi.simulation.simulate import simulate
from tenscasadi.structure.structure import Structure
from tenscasadi.util.compile import Single, find_compiler
from tenscasadi.util.validate import positive_number

FAILED, INTERRUPTED = 1, 130


def run_simulate(arguments: argparse.Namespace) -> int:
    """Simulate a shape; write trajectory and pictures."""
    from tenscasadi import plots
    from tenscasadi.plots.animation import animate

    chosen = demo(arguments.source)
    began = time.perf_counter()
    model = Model(chosen.scene(arguments.gravity), coordinates=arguments.coordinates or "reduced")
    state = chosen.start(model)
    t_end = chosen.t_end if arguments.t_end is None else arguments.t_end
    trajectory = simulate(
        model,
        t_end,
        1e-3 if arguments.step is None else arguments.step,
        state=state,
        correction=None if arguments.projection is None else Projection(arguments.projection),
        save_every=arguments.save_every,
        compiled=False if arguments.uncompiled else None,
        progress=sys.stderr.isatty(),
    )
    set_up = time.perf_counter() - began - trajectory.seconds
    print(f"{arguments.source}: {model.structure!r}, {model.nx} states, {model.coordinates} coordinates")
    print(trajectory.summary())
    print(f"set-up        {set_up:.2f} s: equations and their compilation")
    writers: Writers = {
        ".npz": trajectory.save,
        ".png": lambda path: plots.time_lapse(trajectory, title=arguments.source, path=path),
        "-errors.png": lambda path: plots.errors(trajectory, title=f"{arguments.source}: errors", path=path),
    }
    if arguments.gif:
        writers[".gif"] = lambda path: animate(trajectory, path, title=arguments.source)
    write_files(arguments.output, f"{arguments.source}-simulation", writers)
    return 0 if trajectory.success else FAILED


def run_tradeoff(arguments: argparse.Namespace) -> int:
    """Measure what schemes and steps cost and are worth on a shape; write table and picture."""
    chosen = demo(arguments.source)
    if arguments.tolerance is not None:
        positive_number("tolerance", arguments.tolerance)
    model = Model(chosen.scene())
    schemes: list[Scheme] = [RungeKutta4(), DormandPrince54(), DormandPrince853(), Rattle(), *map(DormandPrince853, arguments.rtol)]
    table = tradeoff(
        model,
        chosen.t_end if arguments.t_end is None else arguments.t_end,
        schemes,
        arguments.steps,
        state=chosen.start,
        corrections=(None, Projection()),
        compiled=(False if arguments.uncompiled else None, *([Single()] if arguments.single else [])),
        progress=sys.stderr.isatty(),
    )
    print(f"{arguments.source}: {model.structure!r}, {table.t_end:g} s")
    print(table.summary())
    if not table.rows:  # interrupted before the first
        return INTERRUPTED
    served = True
    if arguments.tolerance is not None:
        try:
            row = table.cheapest(arguments.tolerance)
            print(f"fastest within {arguments.tolerance:g} m: {row.name}" + ("" if np.isnan(row.step) else f", step {row.step:g} s"))
        except ValueError as error:  # what was measured is kept all the same
            print(error)
            served = False
    title = f"{arguments.source}: cost and error of schemes"
    write_files(arguments.output, f"{arguments.source}-tradeoff", {".npz": table.save, ".png": lambda path: table.plot(path, title=title)})
    return INTERRUPTED if not table.complete else 0 if served else FAILED


def run_info(arguments: argparse.Namespace) -> int:
    """Describe a shape; write it and its picture."""
    from tenscasadi import plots

    chosen = demo(arguments.source)
    scene = chosen.scene()
    model, s = Model(scene), scene.structure
    print(f"{arguments.source}: {chosen.text}")
    print(f"nodes         {len(s.nodes)}, pinned: {', '.join(map(str, sorted({*s.pinned, *s.rollers}))) or 'none'}")
    print(f"bars          {len(s.bars)}, lengths {_range(s.bar_lengths)} m, mass {s.bar_mass.sum():g} kg in all")
    print(
        f"strings       {len(s.strings)}" + (f", lengths {_range(s.string_lengths)} m, stiffness {_range(s.stiffness)} N/m" if len(s.strings) else "")
    )
    gamma = _equilibrium(s)
    print("\nterm: instructions of the right-hand side")
    print(model.describe())
    print(f"\nfastest rate  {fastest_rate(model):.4g} rad/s, largest stable step of RungeKutta4 {stable_step(model, safety=1.0):.3g} s")
    compiler = find_compiler()
    print(f"C compiler    {' '.join(compiler) if compiler else 'none found: simulations run uncompiled'}")
    fields = ("nodes", "bars", "strings", "bar_mass", "bar_radius", "node_mass", "fixed", "stiffness", "damping", "rest_length", "string_mass")
    content: dict[str, Any] = {name: getattr(s, name) for name in fields}
    writers: Writers = {
        ".npz": lambda path: np.savez_compressed(path, **content, equilibrium_force_density=gamma),
        ".png": lambda path: plots.structure(s, labels=True, title=arguments.source, path=path),
    }
    write_files(arguments.output, f"{arguments.source}-structure", writers)
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
    print(f"equilibrium   without loads, force densities in the ratio {' : '.join(f'{value:.4g}' for value in np.unique(gamma.round(9)))}")
    return gamma


def _range(values: Any) -> str:
    low, high = float(np.min(values)), float(np.max(values))
    return f"{low:g}" if np.isclose(low, high) else f"{low:g} … {high:g}"
