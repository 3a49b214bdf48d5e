"""Command `analyze`: report on a scene at rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from tenscasadi.analysis.statics_report import SOFTEST, StaticsReport, report_statics
from tenscasadi.cli.loading import load_plots
from tenscasadi.cli.report import FAILED, CommandReport
from tenscasadi.cli.source import FILE, find_source
from tenscasadi.design.find_prestress import find_prestress
from tenscasadi.design.prestress_goals import Even
from tenscasadi.design.sizing.material import Material
from tenscasadi.exchange.readers import READERS
from tenscasadi.io.document import Change
from tenscasadi.scene.loads import Gravity
from tenscasadi.scene.scene import Scene
from tenscasadi.util.validate import positive_number


def analyze_scene(
    source: Annotated[str, FILE],
    report: CommandReport,
    changes: Sequence[Change],
    gravity: float | None = None,
    prestress: float | None = None,
    modulus: float | None = None,
    strength: float | None = None,
) -> int:
    """Analyze a scene at rest: forces, stability, soft motions.

    The report lists members, equilibrium under the loads of the scene, self-stresses, mechanisms,
    stability, the softest motions with stiffness and frequency, and the largest utilization.
    Pictures show forces by color and width with reactions, and the softest motions. Files of other
    programs (.mat, .xml, .yaml) are imported; parts without a counterpart are omitted.

    Parameters
    ----------
    source : str
        Template, scene file (.toml, .json) or file of another program.
    report : CommandReport
        Text and files.
    changes : sequence of Change
        Changes of the scene file.
    gravity : float
        Gravity downwards, m/s² (default: that of the scene).
    prestress : float
        Least tension of an even prestress, N (default: the rest lengths of the scene).
    modulus : float
        Young's modulus of all members, Pa, for their utilization.
    strength : float
        Allowable stress of all members, Pa, for their utilization.
    """
    material = _read_material(modulus, strength)
    scene, stem = _load_scene(source, changes)
    if gravity is not None:
        down = positive_number("gravity", gravity, zero=True)
        scene = replace(scene, gravity=Gravity((0.0, 0.0, -down)) if down else None)
    if prestress is not None:
        scene = _prestress(scene, positive_number("prestress", prestress))
    found = report_statics(scene, material)
    report.say(f"{source}: {scene.structure!r}", "", found.summary())
    report.write(f"{stem}-analysis", {}, _find_pictures(found, stem))
    eq, st = found.equilibrium, found.stability
    return report.finish(
        0 if eq.success else FAILED,
        message=eq.message,
        tension=eq.tension,
        bar_force=eq.bar_force,
        reactions=eq.reactions,
        self_stresses=found.self_stresses,
        mechanisms=found.mechanisms,
        stable=st.stable,
        super_stable=st.super_stable,
        stiffness=st.eigenvalues[:SOFTEST],
        frequency=found.modes.frequency,
        utilization=found.utilization,
    )


def _read_material(modulus: float | None, strength: float | None) -> Material | None:
    """Read the material of all members.

    `modulus` and `strength` are in Pa. Returns None if both are missing. Raises ValueError.
    """
    if modulus is None and strength is None:
        return None
    if modulus is None or strength is None:
        name = "modulus" if modulus is None else "strength"
        raise ValueError(f"{name} is missing: give modulus and strength, or neither")
    return Material(modulus, density=1.0, strength=strength)  # no mass enters utilization


def _load_scene(source: str, changes: Sequence[Change]) -> tuple[Scene, str]:
    """Load a scene and the first part of its output file names.

    The source is a template, a scene file, or a file of another program. `changes` replace values
    of the former two.
    """
    read = READERS.get(Path(source).suffix.lower())
    if read is None:
        found = find_source(source, changes)
        return found.scene(), found.stem
    if changes:
        raise ValueError(f"{changes[0].option} changes scene files: import {source} before")
    return read(source, length_unit=1.0, ball_joints=True, strict=False), Path(source).stem


def _prestress(scene: Scene, least: float) -> Scene:
    """Prestress a scene as evenly as possible.

    Tensions are at least `least` [N]. Raises ValueError.
    """
    found = find_prestress(scene.structure, Even(), minimum=least)
    if not found.success:
        raise ValueError(f"prestress is {least:g} N: {found.message}")
    return replace(scene, structure=found.structure)


def _find_pictures(found: StaticsReport, stem: str) -> dict[str, Callable[[Path], Any]]:
    """Build functions that draw the forces and the softest modes.

    They are stored by the endings of their file names. `found` contains the results, and `stem` is
    used in titles.
    """
    eq, st = found.equilibrium, found.stability
    pictures: dict[str, Callable[[Path], Any]] = {}
    if eq.success:
        pictures["-forces.png"] = lambda path: load_plots().forces(
            eq.structure,
            eq.tension,
            eq.bar_force,
            reactions=eq.reactions,
            title=f"{stem}: forces",
            path=path,
        )
    if len(st.eigenvalues):
        labels = [f"{value:.4g} N/m" for value in np.asarray(st.eigenvalues[:SOFTEST])]
        pictures["-modes.png"] = lambda path: load_plots().mode_shapes(
            st.structure, st.modes[:SOFTEST], labels, title=f"{stem}: softest motions", path=path
        )
    return pictures
