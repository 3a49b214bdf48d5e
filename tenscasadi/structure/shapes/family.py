"""Base class and common functions of shapes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from tenscasadi.schema.value import Value
from tenscasadi.structure.equilibrium_matrix import equilibrium_matrix
from tenscasadi.structure.names import name_members
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import NEGLIGIBLE, Array, Indices, positive_number

Groups = Mapping[str, Indices]  # pairs of nodes (members, 2) by the name of their group


class ShapeFamily(Value):
    """Set of functions that build structures.

    The name of each function is its kind in files.
    """


shape = ShapeFamily.maker


def build_structure(
    nodes: ArrayLike,
    bars: Groups,
    strings: Groups,
    options: Mapping[str, Any],
    stress: Array | None = None,
    prestress: float | None = None,
    node_groups: Iterable[tuple[str, int]] = (),
) -> Structure:
    """Build a structure from named groups of members.

    `nodes` are (n, 3) [m]. `bars` and `strings` have the node pairs (members, 2) of each group by
    name, `node_groups` the name and size of each group of nodes. Member k of a group is named
    ``name[k]``; a single member has the name itself, and members of the group "" have no names.
    `options` are other keywords of `Structure`. `prestress` is the smallest force density of the
    self-stress [N/m]; None: no self-stress. The self-stress is proportional to `stress` (α,) if
    that is given, else equal within groups.
    """
    bar_pairs, string_pairs = (
        np.concatenate([*groups.values()] or [np.zeros((0, 2), dtype=int)])
        for groups in (bars, strings)
    )
    names = {
        "node_names": name_members(node_groups),
        "bar_names": name_members((name, len(own)) for name, own in bars.items()),
        "string_names": name_members((name, len(own)) for name, own in strings.items()),
    }
    structure = Structure(nodes, bar_pairs, string_pairs, **{**names, **options})
    if prestress is None:
        return structure
    for name in ("rest_length", "bar_rest_length"):
        if options.get(name) is not None:
            raise ValueError(f"prestress and {name} are both given: leave one of them out")
    if stress is None:
        stress = symmetric_self_stress(structure, [*bars.values()], [*strings.values()])
    return structure.prestressed(stress * (positive_number("prestress", prestress) / stress.min()))


def symmetric_self_stress(
    structure: Structure, bars: Sequence[Indices], strings: Sequence[Indices]
) -> Array:
    """Compute the self-stress γ (α,) that is equal within groups.

    A self-stress of the structure without its supports is preferred to one with them. Its scale is
    arbitrary. Raises ValueError if there is no such self-stress with all strings in tension, or
    more than one. `bars` and `strings` are node pairs (members, 2) of each group.
    """
    sizes = [len(pairs) for pairs in (*strings, *bars)]
    count = sum(sizes)
    members = sp.csc_array(
        (np.ones(count), (np.arange(count), np.repeat(np.arange(len(sizes)), sizes)))
    )
    held = bool(structure.held.any())
    for supported in (
        [structure.replace(pinned=(), node_mass=1.0), structure] if held else [structure]
    ):
        _, values, right = np.linalg.svd((equilibrium_matrix(supported) @ members).toarray())
        rank = int(np.sum(values > NEGLIGIBLE * values.max(initial=0.0)))
        of_groups = right[-1][: len(strings)] * np.sign(right[-1][: len(strings)].sum())
        if rank == len(sizes) - 1 and of_groups.min(initial=np.inf) > 0.0:
            return np.repeat(of_groups, sizes[: len(strings)])
    raise ValueError(
        "prestress: this geometry has no symmetric self-stress with all strings in tension: "
        "leave prestress out or change the dimensions"
    )


def place_ring(count: int, radius: float, start: float, z: float) -> Array:
    """Compute points (count, 3) equally spaced on a circle.

    The circle of this radius surrounds the z axis at height z. The first point is at the angle
    `start` [rad].
    """
    angles = start + 2 * np.pi * np.arange(count) / count
    return np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(count, z)])


def polygon(nodes: Indices) -> Indices:
    """Build the node pairs (sides, 2) of a closed polygon.

    `nodes` are its corners in order.
    """
    return np.column_stack([nodes, np.roll(nodes, -1)])
