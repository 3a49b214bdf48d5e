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
from tenscasadi.structure.names import add_names
from tenscasadi.structure.structure import Structure
from tenscasadi.util.immutable import ReadOnlyArrays
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

    def __repr__(self) -> str:
        return f"Sized({self.mass:.6g} kg, {self.message})"

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
    """Build an unsuccessful result without sections, with a message.

    `loads` (cases, n, 3) are the load cases [N].
    """
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
    """Build the result from a design: areas, forces and prestress.

    The areas and the prestress are (members,), and the forces (cases, members). `loads` (cases, n,
    3) are the load cases [N].
    """
    sections, strings = program.sections, len(structure.strings)
    unit = sections.unit
    reasons = _find_reasons(sections, design[0], np.vstack([design[1], design[2]]))
    area, force, own = design[0][unit], design[1][:, unit], design[2][unit]
    lengths = np.concatenate([structure.string_lengths, structure.bar_lengths])
    masses = sections.density[unit] * lengths * area
    largest = float(np.abs(force).max(initial=0.0))
    slack = np.flatnonzero(force[:, :strings].min(axis=0, initial=0.0) < -TOLERANCE * largest)
    if len(slack):
        fault = f"string {slack[0]} would be compressed under a load: raise the prestress"
        message = add_names(fault, structure)
    return Sized(
        not len(slack),
        message,
        float(masses.sum()),
        masses,
        area,
        sections.outer_radius(design[0])[unit],
        force,
        own,
        tuple(reasons[k] for k in unit),
        _build_structure(structure, program, area, own),
        loads,
        program.nodal_weight(design[0]),
    )


def _find_reasons(sections: Sections, area: Array, states: Array) -> tuple[str, ...]:
    """Find the governing limit of each area (members,) [m²].

    It is "yield", "buckling", "minimum" or "none". `states` (·, members) are the forces to carry
    [N].
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

    The areas are in m², and the prestress `own` in N. Bars without force get a billionth of the
    largest area, because each bar must have a mass.
    """
    sections, strings = program.sections, len(structure.strings)
    kept = np.maximum(area, NEGLIGIBLE * (area.max(initial=0.0) or 1.0))
    lengths = np.concatenate([structure.string_lengths, structure.bar_lengths])
    stiffness = sections.modulus[sections.unit] / lengths
    mass = sections.density[sections.unit] * lengths
    outer = np.sqrt(kept / (np.pi * sections.solidity[sections.unit]))
    sized = structure.replace(
        stiffness=(stiffness * area)[:strings],
        string_mass=(mass * area)[:strings],
        bar_mass=(mass * kept)[strings:],
        bar_radius=outer[strings:],
        bar_stiffness=(stiffness * kept)[strings:],
        rest_length=structure.string_lengths,
        bar_rest_length=structure.bar_lengths,
    )
    q = own / lengths
    return set_prestress(sized, q[:strings], -q[strings:])
