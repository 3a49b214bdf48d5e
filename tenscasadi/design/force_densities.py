"""Given and unknown force densities, and groups of members that share one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from tenscasadi.schema.reading import Names
from tenscasadi.structure.cables import density_basis
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array, Indices, as_tuple, real_array

Groups = Iterable[Sequence[int | str]]  # members that share a value: strings first, then bars


class ForceDensities(NamedTuple):
    """Given and unknown force densities of all members.

    They are q = given + basis · p, strings first, then bars. Tension is positive.

    Attributes
    ----------
    given : ndarray (α + β,)
        Given force densities [N/m]; 0 where unknown.
    basis : csc_array (α + β, u)
        One column for each unknown force density.
    lower : ndarray (u,)
        Lower limits of p [N/m]: 0 for strings, −inf for bars.
    """

    given: Array
    basis: Any
    lower: Array

    def of(self, p: Array) -> Array:
        """Compute the force densities of all members [N/m].

        `p` (u,) are the unknown ones, one for each column of the basis.
        """
        return np.asarray(self.given + self.basis @ p)

    @property
    def has_scale(self) -> bool:
        """Whether given force densities determine the scale of all."""
        return bool(self.given.any())

    @property
    def scale(self) -> float:
        """Typical force density [N/m]: the mean of those given, or 1."""
        given = np.abs(self.given[self.given != 0.0])
        return float(given.mean()) if self.has_scale else 1.0


def read_force_densities(structure: Structure, given: Any, groups: Groups | None) -> ForceDensities:
    """Read the given force densities of strings (α,) [N/m].

    NaN marks an unknown force density. Those of bars are always unknown. Members in one of the
    `groups` have equal force densities. Raises TypeError, ValueError.
    """
    strings = len(structure.strings)
    members = strings + len(structure.bars)
    values = np.full(members, np.nan)
    if given is not None:
        values[:strings] = _read_values(given, strings)
    label = read_groups(groups, structure.names)
    values = _share_values(label, values)
    unknown = np.flatnonzero(np.isnan(values))
    columns = np.unique(label[unknown], return_inverse=True)[1]
    count = int(columns.max(initial=-1)) + 1
    basis = sp.csc_array((np.ones(len(unknown)), (unknown, columns)), shape=(members, count))
    lower = np.full(count, -np.inf)
    lower[columns[unknown < strings]] = 0.0
    return ForceDensities(np.where(np.isnan(values), 0.0, values), basis, lower)


def read_basis(structure: Structure, groups: Groups | None) -> Any:
    """Build the matrix from unknowns to force densities of all members.

    There is an unknown for each cable, and for each group of other members.

    Returns
    -------
    csc_array, shape (α + β, u)
        One column for each unknown. A cable has one tension, so that the force densities of its
        strings are inverse to their lengths.

    Raises
    ------
    TypeError, ValueError
        If a group is wrong, or has strings of a cable.
    """
    basis = read_force_densities(structure, None, groups).basis
    if not structure.cables:
        return basis
    own = np.unique(np.concatenate(structure.cables)).astype(np.intp)
    columns = np.unique(basis[own].indices)
    if len(shared := np.flatnonzero(np.asarray(basis[:, columns].sum(axis=0)).ravel() > 1.0)):
        string = basis[:, columns[shared[:1]]].indices[0]
        raise ValueError(
            f"groups has string {string}, and strings of a cable: leave these out, as a cable has one tension"
        )
    cables = structure.cable_of[[cable[0] for cable in structure.cables]]
    others = np.setdiff1d(np.arange(basis.shape[1]), columns)
    return sp.hstack([basis[:, others], density_basis(structure)[:, cables]], format="csc")


def _share_values(label: Indices, values: Array) -> Array:
    """Assign the known value of a group to all its members.

    `label` (members,) is the group of each member. NaN in `values` (members,) marks an unknown
    value. Raises ValueError.
    """
    known = np.flatnonzero(~np.isnan(values))
    least, most = np.full((2, label.max(initial=-1) + 1), np.nan)
    np.fmin.at(least, label[known], values[known])
    np.fmax.at(most, label[known], values[known])
    for group in np.flatnonzero(least < most)[:1]:
        member = np.flatnonzero(label == group)[0]
        raise ValueError(
            f"force_density: the group of member {member} has {least[group]:g} and {most[group]:g} N/m: give its members one value"
        )
    return np.asarray(least[label])


def read_groups(groups: Groups | None, names: Names) -> Indices:
    """Read groups of members as labels (members,).

    `names` resolve members that are given by name. Members without a group have labels of their
    own. Raises TypeError, ValueError.
    """
    strings = names.counts["string"]
    label = np.full(names.counts["member"], -1)
    entries = [] if groups is None else as_tuple("groups", groups, "[[0, 1, 2], [3, 4, 5]]")
    for k, group in enumerate(entries):
        given = names.resolve_all(f"groups[{k}]", "member", group)
        for i, entry in enumerate(as_tuple(f"groups[{k}]", given, "[0, 1, 2]")):
            member = names.index(f"groups[{k}][{i}]", "member", entry)
            if label[member] >= 0:
                raise ValueError(f"groups: member {member} is named twice: leave one out")
            label[member] = k
        own = np.flatnonzero(label == k)
        if np.any(own < strings) and np.any(own >= strings):
            raise ValueError(
                f"groups[{k}] has strings and bars: give groups of one kind; bars count from {strings}"
            )
    alone = np.flatnonzero(label < 0)
    label[alone] = len(entries) + np.arange(len(alone))
    return label


def _read_values(given: Any, count: int) -> Array:
    """Read force densities (count,), or one for all; NaN is allowed."""
    values = real_array("force_density", given, f"an array of shape ({count},)")
    if values.ndim and values.shape != (count,):
        raise ValueError(
            f"force_density has shape {values.shape}: give ({count},), NaN where unknown"
        )
    values = np.broadcast_to(values, (count,))
    for i in np.flatnonzero(np.isinf(values)):
        raise ValueError(
            f"force_density of string {i} is {values[i]:g}: give N/m, or NaN where unknown"
        )
    return values


def set_prestress(structure: Structure, gamma: Array, lam: Array) -> Structure:
    """Set rest lengths so that members have given force densities.

    They are γ (α,) of strings (`gamma`) and λ (β,) of bars (`lam`), positive in compression [N/m].
    Members whose stiffness does not exceed their force density remain unstressed.
    """
    strings = (gamma > 0.0) & (gamma < structure.stiffness)
    stretch = np.divide(gamma, structure.stiffness, out=np.zeros_like(gamma), where=strings)
    bars = structure.elastic & (lam > -structure.bar_stiffness)
    shortening = np.divide(lam, structure.bar_stiffness, out=np.zeros_like(lam), where=bars)
    return structure.replace(
        rest_length=structure.string_lengths * (1.0 - stretch),
        bar_rest_length=structure.bar_lengths * (1.0 + shortening),
    )
