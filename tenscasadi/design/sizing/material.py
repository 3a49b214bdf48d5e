"""Materials and cross-sections of members."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tenscasadi.schema.value import Value
from tenscasadi.structure.cables import find_units
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array, Indices, Positive


@dataclass(frozen=True)
class Material(Value, kind="Material"):
    """Elastic material with an allowable stress.

    Parameters
    ----------
    modulus : float
        Young's modulus [Pa].
    density : float
        Mass per volume [kg/m³].
    strength : float
        Allowable stress in tension and compression [Pa].

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.Material(modulus=60e9, density=2700.0, strength=110e6)
    Material(modulus=60000000000.0, density=2700.0, strength=110000000.0)
    """

    modulus: Positive
    density: Positive
    strength: Positive


class Sections(NamedTuple):
    """Material and shape of the cross-sections of all members.

    The members (units) are cables and strings in no cable, then bars. A cable has one section.

    Attributes
    ----------
    unit : ndarray of int (α + β,)
        Member (unit) that each string and bar belongs to.
    lengths : ndarray (units,)
        Lengths [m].
    modulus, density, strength : ndarray (units,)
        Properties of the materials, in SI units.
    buckling : ndarray (units,)
        Coefficient c of the Euler load c · area² [N/m⁴]; inf for strings, which carry no
        compression.
    minimum : ndarray (units,)
        Smallest permitted areas [m²].
    solidity : ndarray (units,)
        Area relative to that of a solid section of the same outer radius.
    """

    unit: Indices
    lengths: Array
    modulus: Array
    density: Array
    strength: Array
    buckling: Array
    minimum: Array
    solidity: Array

    @property
    def mass_per_area(self) -> Array:
        """Mass (members,) of each member divided by its area [kg/m²]."""
        return self.density * self.lengths

    def needed_for_yield(self, force: Array) -> Array:
        """Compute the areas required by the allowable stress [m²].

        They have the shape (..., units) of the forces [N].
        """
        return np.asarray(np.abs(force) / self.strength)

    def needed_for_buckling(self, force: Array) -> Array:
        """Compute the areas required by Euler buckling [m²].

        They have the shape (..., units) of the forces [N].
        """
        return np.asarray(np.sqrt(np.maximum(-force, 0.0) / self.buckling))

    def needed(self, forces: Array) -> Array:
        """Compute the areas required by several load states [m²].

        Forces [N] have the shape (states, units), areas (units,). Areas are not below the minimum.
        """
        both = np.maximum(self.needed_for_yield(forces), self.needed_for_buckling(forces))
        return np.asarray(np.maximum(both.max(axis=0, initial=0.0), self.minimum))

    def outer_radius(self, area: Array) -> Array:
        """Compute the outer radii [m] of sections with given areas [m²]."""
        return np.asarray(np.sqrt(area / (np.pi * self.solidity)))


def build_sections(
    structure: Structure, string: Material | None, bar: Material | None, tube: float, minimum: Array
) -> Sections:
    """Build the cross-sections of all members.

    `minimum` (α + β,) are the smallest permitted areas of strings and bars [m²]. `tube` is the
    ratio of the inner to the outer radius of bars. Their second moment of area is κ area², with κ =
    (1 + tube²) / (4π (1 − tube²)). Their Euler load is π² modulus κ area² / length².
    """
    unit, bars = find_units(structure), len(structure.bars)
    own = np.concatenate([structure.string_lengths, structure.bar_lengths])
    lengths = np.asarray(np.bincount(unit, weights=own), dtype=float)
    strings = len(lengths) - bars
    least = np.zeros(len(lengths))
    np.maximum.at(least, unit, minimum)

    def spread(name: str) -> Array:
        own = [1.0 if each is None else getattr(each, name) for each in (string, bar)]
        return np.repeat(own, [strings, bars])

    modulus = spread("modulus")
    kappa = (1.0 + tube**2) / (4.0 * np.pi * (1.0 - tube**2))
    buckling = np.pi**2 * modulus * kappa / lengths**2
    buckling[:strings] = np.inf
    solidity = np.repeat([1.0, 1.0 - tube**2], [strings, bars])
    return Sections(
        unit, lengths, modulus, spread("density"), spread("strength"), buckling, least, solidity
    )
