"""Result of sizing: sections, forces and structure."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from tenscasadi.design.force_densities import set_prestress
from tenscasadi.design.sizing.material import Sections
from tenscasadi.design.sizing.program import SizingProgram
from tenscasadi.scene.loads import NodalForce
from tenscasadi.scene.scene import Scene
from tenscasadi.statics.buckling import buckling_factor
from tenscasadi.structure.structure import Structure
from tenscasadi.util.read_only import ReadOnlyArrays
from tenscasadi.util.validate import NEGLIGIBLE, TOLERANCE, Array


@dataclass(frozen=True, eq=False)
class Sized(ReadOnlyArrays):
    """Sections and forces of a sized structure.

    Members are strings first, then bars.

    Attributes
    ----------
    success : bool
        Whether the sections carry all load cases.
    message : str
        The mass compared with its lower bound; the reason of a failure.
    mass : float
        Mass of all members [kg]; inf without success.
    member_mass : ndarray (α + β,)
        Masses [kg].
    area : ndarray (α + β,)
        Areas of the sections [m²].
    radius : ndarray (α + β,)
        Outer radii [m].
    force : ndarray (cases, α + β)
        Forces in each load case [N], positive in tension.
    prestress : ndarray (α + β,)
        Forces without loads and weight [N].
    governs : tuple of str (α + β,)
        Governing limit of each area: "yield", "buckling", "minimum", or "none" for members without
        force.
    structure : Structure
        The structure with masses, radii, stiffness and rest lengths. Bars are elastic.
    loads : ndarray (cases, n, 3)
        Load cases [N].
    weight : ndarray (n, 3)
        Weight of the members on the nodes [N].

    Examples
    --------
    >>> import tenscasadi as tc
    >>> steel = tc.Material(modulus=210e9, density=7850.0, strength=235e6)
    >>> rope = tc.Structure([(0, 0, 0), (0, 0, -1)], strings=[(0, 1)], pinned=[0], node_mass=1.0)
    >>> sized = tc.size(rope, [[(0, 0, 0), (0, 0, -2.35e4)]], string=steel)
    >>> sized.area.round(9).tolist(), sized.governs, round(sized.mass, 6)
    ([0.0001], ('yield',), 0.785)
    """

    success: bool
    message: str
    mass: float
    member_mass: Array
    area: Array
    radius: Array
    force: Array
    prestress: Array
    governs: tuple[str, ...]
    structure: Structure
    loads: Array = field(repr=False)
    weight: Array = field(repr=False)

    @cached_property
    def buckling(self) -> Array:
        """Global buckling factors (cases,) of the load cases.

        They are those of `buckling_factor` for `structure`. A factor is inf without buckling or
        load, and 0 if there is no stable equilibrium without the load.
        """
        own = NodalForce(self.weight) if self.weight.any() else None
        scene = Scene(self.structure, forces=own)
        return np.array(
            [buckling_factor(scene, load).factor if load.any() else np.inf for load in self.loads]
        )


def report_failure(structure: Structure, loads: Array, message: str) -> Sized:
    """Build an unsuccessful result without sections."""
    members = len(structure.strings) + len(structure.bars)
    none, forces = np.zeros(members), np.zeros((len(loads), members))
    nothing, weight = ("none",) * members, np.zeros(structure.nodes.shape)
    arrays = (none, none, none, forces, none)
    return Sized(False, message, np.inf, *arrays, nothing, structure, loads, weight)


def report_sections(
    structure: Structure,
    program: SizingProgram,
    loads: Array,
    design: tuple[Array, Array, Array],
    message: str,
) -> Sized:
    """Build the result from areas, forces and prestress."""
    area, force, own = design
    sections, strings = program.sections, program.strings
    masses = sections.mass_per_area * area
    largest = float(np.abs(force).max(initial=0.0))
    slack = np.flatnonzero(force[:, :strings].min(axis=0, initial=0.0) < -TOLERANCE * largest)
    if len(slack):
        message = f"string {slack[0]} would be compressed under a load: raise the prestress"
    return Sized(
        not len(slack),
        message,
        float(masses.sum()),
        masses,
        area,
        sections.outer_radius(area),
        force,
        own,
        _find_reasons(sections, area, np.vstack([force, own])),
        _build_structure(structure, program, area, own),
        loads,
        program.nodal_weight(area),
    )


def _find_reasons(sections: Sections, area: Array, states: Array) -> tuple[str, ...]:
    """Find the governing limit of each area.

    It is "yield", "buckling", "minimum" or "none".
    """
    needs = [
        sections.needed_for_yield(states).max(axis=0, initial=0.0),
        sections.needed_for_buckling(states).max(axis=0, initial=0.0),
        sections.minimum,
    ]
    reasons = np.array(["yield", "buckling", "minimum"])[np.argmax(needs, axis=0)]
    unused = area <= TOLERANCE * area.max(initial=0.0)
    return tuple(np.where(unused, "none", reasons).tolist())


def _build_structure(
    structure: Structure, program: SizingProgram, area: Array, own: Array
) -> Structure:
    """Build the structure with given areas and prestress.

    Bars without force get a billionth of the largest area, because each bar must have a mass.
    """
    sections, strings = program.sections, program.strings
    kept = np.maximum(area, NEGLIGIBLE * (area.max(initial=0.0) or 1.0))
    stiffness = sections.modulus / sections.lengths
    sized = structure.replace(
        stiffness=(stiffness * area)[:strings],
        string_mass=(sections.mass_per_area * area)[:strings],
        bar_mass=(sections.mass_per_area * kept)[strings:],
        bar_radius=sections.outer_radius(kept)[strings:],
        bar_stiffness=(stiffness * kept)[strings:],
        rest_length=structure.string_lengths,
        bar_rest_length=structure.bar_lengths,
    )
    q = own / sections.lengths
    return set_prestress(sized, q[:strings], -q[strings:])
