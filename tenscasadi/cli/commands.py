"""Commands `describe`, `simulate` and `compare`."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np

from tenscasadi.analysis.tradeoff import tradeoff
from tenscasadi.cli.loading import load_ocp, load_plots
from tenscasadi.cli.report import FAILED, INTERRUPTED, CommandReport, find_scalars
from tenscasadi.cli.source import SCENE, find_source
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.rattle import Rattle
from tenscasadi.integrators.runge_kutta import DormandPrince54, DormandPrince853, RungeKutta4
from tenscasadi.integrators.scheme import Scheme
from tenscasadi.integrators.stability import fastest_rate, stable_step
from tenscasadi.integrators.stabilization import Projection
from tenscasadi.io.document import Change
from tenscasadi.simulation.simulation_files import SIMULATION
from tenscasadi.statics.force_density import EquilibriumError, equilibrium_force_density
from tenscasadi.structure.names import label
from tenscasadi.structure.structure import Structure
from tenscasadi.util.compile import Single, find_compiler
from tenscasadi.util.validate import positive_number


def find_fields() -> Any:
    """Return the fields of the table [simulation].

    Options of the command follow from these.
    """
    return SIMULATION.fields


def simulate_scene(
    source: Annotated[str, SCENE],
    report: CommandReport,
    changes: Sequence[Change],
    gravity: float | None = None,
    projection: int | None = None,
    uncompiled: bool = False,
    gif: bool = False,
    mp4: bool = False,
) -> int:
    """Simulate a scene from its start.

    Ctrl-C ends the run and keeps the rows so far.

    Parameters
    ----------
    source : str
        Template or scene file (.toml, .json).
    report : CommandReport
        Text and files.
    changes : sequence of Change
        Changes of the scene file.
    gravity : float
        Gravity downwards, m/s².
    projection : int
        Steps between projections onto bars and joints.
    uncompiled : bool
        Use CasADi's virtual machine even if there is a C compiler.
    gif : bool
        Write an animation, too.
    mp4 : bool
        Write a film, too.
    """
    sugar = []
    if gravity is not None:
        down = positive_number("gravity", gravity, zero=True)
        sugar.append(Change(f"--gravity {gravity}", "scene.gravity", f"[0, 0, {-down}]"))
    if projection is not None:
        value = f'{{kind = "Projection", every = {projection}}}'
        sugar.append(Change(f"--projection {projection}", "simulation.correction", value))
    found = find_source(source, [*changes, *sugar])
    began = time.perf_counter()
    simulation = found.simulation()
    trajectory = simulation.run(
        progress=sys.stderr.isatty() and not report.quiet, compiled=False if uncompiled else None
    )
    model = simulation.model
    set_up = time.perf_counter() - began - trajectory.seconds
    report.say(
        f"{source}: {model.structure!r}, {model.nx} states, {model.coordinates} coordinates",
        trajectory.summary(),
        f"set-up        {set_up:.2f} s: equations and their compilation",
    )
    plots, stem = load_plots, found.stem
    films = [ending for ending, wanted in ((".gif", gif), (".mp4", mp4)) if wanted]
    report.write(
        f"{stem}-simulation",
        {".npz": trajectory.save},
        {
            ".png": lambda path: plots().time_lapse(trajectory, title=stem, path=path),
            "-errors.png": lambda path: plots().errors(
                trajectory, title=f"{stem}: errors", path=path
            ),
            **dict.fromkeys(
                films, lambda path: plots().animation.animate(trajectory, path, title=stem)
            ),
        },
    )
    code = INTERRUPTED if trajectory.interrupted else 0 if trajectory.success else FAILED
    return report.finish(code, **find_scalars(trajectory) | {"success": trajectory.success})


def compare_schemes(
    source: Annotated[str, SCENE],
    report: CommandReport,
    changes: Sequence[Change],
    t_end: float | None = None,
    steps: list[float] = [0.02, 0.01, 0.005, 0.002, 0.001],  # noqa: B006  only read
    rtol: list[float] = [1e-4, 1e-7, 1e-10],  # noqa: B006
    tolerance: float | None = None,
    single: bool = False,
    uncompiled: bool = False,
) -> int:
    """Measure how fast and how accurate each scheme is.

    Each scheme runs with each step or --rtol, with and without Projection. The reference is one
    that two schemes agree on. Times exclude the compilation, which is reported separately. Ctrl-C
    ends the study and keeps the rows so far.

    Parameters
    ----------
    source : str
        Template or scene file (.toml, .json).
    report : CommandReport
        Text and files.
    changes : sequence of Change
        Changes of the scene file.
    t_end : float
        End of the simulation, s (default: that of the scene).
    steps : list of float
        Steps, s (default: 0.02 … 0.001).
    rtol : list of float
        Tolerances of adaptive schemes (default: 1e-4 1e-7 1e-10).
    tolerance : float
        Wanted accuracy, m: names the fastest run within it.
    single : bool
        Measure single precision, too.
    uncompiled : bool
        Use CasADi's virtual machine even if there is a C compiler.
    """
    end = [] if t_end is None else [Change(f"--t-end {t_end}", "simulation.t_end", str(t_end))]
    found = find_source(source, [*changes, *end])
    if tolerance is not None:
        positive_number("tolerance", tolerance)
    simulation = found.simulation()
    model = simulation.model
    explicit: list[Scheme] = [RungeKutta4(), DormandPrince54(), DormandPrince853(), Rattle()]
    table = tradeoff(
        model,
        simulation.t_end,
        [*explicit, *map(DormandPrince853, rtol)],
        steps,
        state=simulation.start,
        control=simulation.control,
        parameters=simulation.parameters,
        corrections=(None, Projection()),
        compiled=(False if uncompiled else None, *([Single()] if single else [])),
        progress=sys.stderr.isatty() and not report.quiet,
    )
    report.say(f"{source}: {model.structure!r}, {table.t_end:g} s", table.summary())
    if not table.rows:  # interrupted before the first
        return report.finish(INTERRUPTED)
    code = 0 if table.complete else INTERRUPTED
    if tolerance is not None:
        try:
            row = table.cheapest(tolerance)
            step = "" if np.isnan(row.step) else f", step {row.step:g} s"
            report.say(f"fastest within {tolerance:g} m: {row.name}{step}")
        except ValueError as error:
            report.say(str(error))
            code = code or FAILED
    title = f"{found.stem}: cost and error of schemes"
    picture = {".png": lambda path: table.plot(path, title=title)}
    report.write(f"{found.stem}-tradeoff", {".npz": table.save}, picture)
    rows = [{"name": row.name, **vars(row)} for row in table.rows]
    return report.finish(code, rows=rows)


def describe(
    source: Annotated[str, SCENE], report: CommandReport, changes: Sequence[Change]
) -> int:
    """Check a scene file and describe its model.

    The description has members, masses, equilibrium, equations and the stable step.

    Files are written only if --output is given.

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
    simulation = found.simulation() if found.has("simulation") else None
    model = Model(found.scene()) if simulation is None else simulation.model
    given = None if simulation is None else simulation.parameters
    structure = model.with_parameters(given).scene.structure
    rate = fastest_rate(model, parameters=given)
    stable = stable_step(model, safety=1.0, parameters=given)
    gamma, equilibrium = _find_equilibrium(structure)
    compiler = " ".join(find_compiler() or []) or "none found: simulations run uncompiled"
    report.say(source, *_describe_members(structure), equilibrium)
    report.say("\nterm: instructions of the right-hand side", str(model.describe()))
    limit = f"largest stable step of RungeKutta4 {stable:.3g} s"
    report.say(f"\nfastest rate  {rate:.4g} rad/s, {limit}")
    if simulation is not None:
        step = "" if simulation.step is None else f" in steps of {simulation.step:g} s"
        report.say(f"simulation    {simulation.t_end:g} s{step} by {simulation.scheme}")
    if found.has("plan"):
        files = load_ocp().io.problem_files
        problem = files.read_arguments(found.document)["problem"]
        sections = load_ocp().io.study_sections
        lines = sections.describe_studies(sections.read_studies(found.document))
        report.say("\n".join([f"plan          {files.describe_problem(problem)}", *lines]))
    report.say(f"C compiler    {compiler}")
    if report.output is not None:
        content = {**structure.to_fields(), "equilibrium_force_density": gamma}
        arrays = {name: np.asarray(value) for name, value in content.items()}
        plain: dict[str, Any] = {
            name: array for name, array in arrays.items() if array.dtype.kind != "O"
        }
        report.write(
            f"{found.stem}-structure",
            {".npz": lambda path: np.savez_compressed(path, **plain)},
            {
                ".png": lambda path: load_plots().structure(
                    structure, labels=True, title=found.stem, path=path
                )
            },
        )
    counts = {name: len(getattr(structure, name)) for name in ("nodes", "bars", "strings")}
    rates = {"fastest_rate": rate, "stable_step": stable, "states": model.nx}
    return report.finish(0, **counts, **rates, mass=float(structure.bar_mass.sum()))


def _describe_members(structure: Structure) -> list[str]:
    pins = sorted({*structure.pinned, *structure.rollers})
    fixed = [label(structure.node_names, k) for k in pins]
    lines = [f"nodes         {len(structure.nodes)}, pinned: {', '.join(fixed) or 'none'}"]
    bars, strings = structure.bar_lengths, structure.string_lengths
    mass, stiffness = structure.bar_mass.sum(), _format_range(structure.stiffness)
    own = f", lengths {_format_range(bars)} m, mass {mass:g} kg in all" if len(bars) else ""
    lines.append(f"bars          {len(bars)}{own}")
    lengths = _format_range(strings)
    own = f", lengths {lengths} m, stiffness {stiffness} N/m" if len(strings) else ""
    bodies = [f"bodies        {len(structure.bodies)}"] if structure.bodies else []
    return [*lines, f"strings       {len(strings)}{own}", *bodies]


def _find_equilibrium(structure: Structure) -> tuple[Any, str]:
    """Compute and describe the force densities (α,) without loads [N/m].

    They are NaN if there is no equilibrium.
    """
    if not len(structure.strings):
        return np.zeros(0), "equilibrium   no strings"
    try:
        gamma = equilibrium_force_density(structure)
    except EquilibriumError as error:
        return np.full(len(structure.strings), np.nan), f"equilibrium   {error}"
    ratio = " : ".join(f"{value:.4g}" for value in np.unique(gamma.round(9)))
    return gamma, f"equilibrium   without loads, force densities in the ratio {ratio}"


def _format_range(values: Any) -> str:
    if not np.size(values):
        return ""
    low, high = float(np.min(values)), float(np.max(values))
    return f"{low:g}" if np.isclose(low, high) else f"{low:g} … {high:g}"
