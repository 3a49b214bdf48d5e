"""Report of a scene at rest: forces, stability, modes, utilization."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tenscasadi.analysis.modes import Modes, modes
from tenscasadi.design.sizing.material import Material, Sections, build_sections
from tenscasadi.scene.scene import Scene
from tenscasadi.statics.equilibrium import Equilibrium, find_equilibrium
from tenscasadi.statics.self_stress import mechanisms, self_stress
from tenscasadi.statics.stability import Stability, stability
from tenscasadi.structure.mass_checks import total_mass
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import NEGLIGIBLE, Array

SOFTEST = 6  # motions in the report


@dataclass(frozen=True, eq=False)
class StaticsReport:
    """Analysis of a scene at rest under its loads.

    Attributes
    ----------
    equilibrium : Equilibrium
        Nodes, forces and reactions.
    stability : Stability
        Stiffness in equilibrium.
    self_stresses, mechanisms : int
        Numbers of self-stresses and infinitesimal mechanisms in the given nodes.
    modes : Modes
        Natural modes about the equilibrium.
    utilization : ndarray (α + β,) or None
        Force over strength or Euler's load of each member: strings first, then bars; None without
        materials. Members without a section have NaN.
    """

    equilibrium: Equilibrium
    stability: Stability
    self_stresses: int
    mechanisms: int
    modes: Modes
    utilization: Array | None

    def summary(self) -> str:
        """Describe the results in lines of text."""
        eq, st = self.equilibrium, self.stability
        lines = [*_describe_members(eq.structure), "", f"equilibrium   {eq.message}"]
        if eq.success:
            lines += _describe_forces(eq)
        words = {True: "yes", False: "no"}
        lines += [
            "",
            f"self-stresses {self.self_stresses}",
            f"mechanisms    {self.mechanisms} infinitesimal, rigid-body motions left out",
            f"stable        {words[st.stable]}; super-stable: {words[st.super_stable]}",
            *self._describe_modes(),
            *self._describe_use(),
        ]
        return "\n".join(lines)

    def _describe_modes(self) -> list[str]:
        """Describe the softest modes by stiffness and frequency."""
        stiffness, frequency = self.stability.eigenvalues[:SOFTEST], self.modes.frequency[:SOFTEST]
        if not len(stiffness):
            return ["softest       none: bars and supports keep the shape"]
        return [
            f"softest       {', '.join(f'{value:.4g}' for value in stiffness)} N/m",
            f"frequencies   {', '.join(f'{value:.4g}' for value in frequency)} Hz",
        ]

    def _describe_use(self) -> list[str]:
        """Describe the utilization of members."""
        if self.utilization is None:
            return ["utilization   unknown: give a modulus and a strength"]
        known = np.flatnonzero(~np.isnan(self.utilization))
        if not len(known):
            return ["utilization   unknown: no member has a section"]
        worst = int(known[np.argmax(self.utilization[known])])
        strings = len(self.equilibrium.structure.strings)
        name = f"string {worst}" if worst < strings else f"bar {worst - strings}"
        missing = len(self.utilization) - len(known)
        more = f"; {missing} members have no section" if missing else ""
        return [f"utilization   {self.utilization[worst]:.3g} at most, in {name}{more}"]


def report_statics(scene: Scene, material: Material | None = None) -> StaticsReport:
    """Analyze a scene at rest under its loads.

    Parameters
    ----------
    scene : Scene
        The scene.
    material : Material, optional
        Material of all members for their utilization. The section of a string follows from its
        stiffness, that of a bar from its radius, or else its stiffness.

    Returns
    -------
    StaticsReport
        Equilibrium, stability, modes and utilization.
    """
    eq = find_equilibrium(scene)
    given = scene.modelled
    use = None if material is None else find_utilization(eq, material)
    counts = len(self_stress(given)), len(mechanisms(given))
    return StaticsReport(eq, stability(eq), *counts, modes(eq, count=SOFTEST), use)


def find_utilization(eq: Equilibrium, material: Material) -> Array:
    """Compute each member's force relative to its permitted force.

    The forces are those of the equilibrium `eq`. The result (α + β,) is force over strength of the
    material, or over Euler's load for compression; NaN without a section.
    """
    s = eq.structure
    elastic = np.where(s.elastic, s.bar_stiffness * s.bar_rest_length / material.modulus, 0.0)
    bars = np.where(s.bar_radius > 0.0, np.pi * s.bar_radius**2, elastic)
    area = np.concatenate([s.stiffness * s.rest_length / material.modulus, bars])
    sections: Sections = build_sections(s, material, material, 0.0, np.zeros(len(area)))
    force = np.concatenate([eq.tension, eq.bar_force])
    euler = sections.buckling * area**2
    with np.errstate(divide="ignore", invalid="ignore"):
        use = np.maximum(np.abs(force) / (material.strength * area), np.maximum(-force, 0) / euler)
    return np.where(area > 0.0, use, np.nan)


def _describe_members(s: Structure) -> list[str]:
    """Describe the nodes, bars and strings of a structure."""
    supports = sorted({*s.pinned, *s.rollers})
    held = f"{len(supports)} supported" if supports else "none supported"
    joint = int(np.bincount(s.bars.ravel()).max(initial=0)) if len(s.bars) else 0
    kinds = f", {int(s.elastic.sum())} elastic" if s.elastic.any() else ""
    lines = [f"nodes         {len(s.nodes)}, {held}", f"bars          {len(s.bars)}{kinds}"]
    if len(s.bars):
        lines[1] += f", class {joint}, lengths {_range(s.bar_lengths)} m"
    lines.append(f"strings       {len(s.strings)}")
    if len(s.strings):
        lines[2] += f", lengths {_range(s.string_lengths)} m"
    lines += [f"bodies        {len(s.bodies)}"] if s.bodies else []
    return [*lines, f"mass          {total_mass(s):.6g} kg"]


def _describe_forces(eq: Equilibrium) -> list[str]:
    """Describe the tensions, bar forces and reactions of an equilibrium.

    The equilibrium is `eq`.
    """
    lines = []
    if len(eq.tension):
        slack = int(np.sum(eq.tension == 0.0))
        all_slack = ", all slack: give a prestress" if slack == len(eq.tension) else ""
        some = f", {slack} slack" if slack else ""
        lines.append(f"tensions      {_range(eq.tension)} N{all_slack or some}")
    if len(eq.bar_force):
        lines.append(f"bar forces    {_range(eq.bar_force)} N, compression below 0")
    total = eq.reactions.sum(axis=0)
    total[np.abs(total) <= NEGLIGIBLE * np.abs(eq.reactions).max(initial=0.0)] = 0.0
    if eq.reactions.any():
        lines.append(f"reactions     sum ({', '.join(f'{value + 0.0:.6g}' for value in total)}) N")
    return lines


def _range(values: Any) -> str:
    """Format the smallest and the largest value."""
    low, high = float(np.min(values)) + 0.0, float(np.max(values)) + 0.0
    return f"{low:.5g}" if np.isclose(low, high, rtol=1e-5) else f"{low:.5g} … {high:.5g}"
