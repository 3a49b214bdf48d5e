"""Contact of bars with each other as capsules."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Annotated, Any

import numpy as np

from tenscasadi.schema.field_types import ListOf, Members
from tenscasadi.schema.value import Value
from tenscasadi.util.validate import (
    IndexOrName,
    Indices,
    NonNegative,
    Positive,
    as_tuple,
    format_value,
    index_or_name,
    node_index,
)


@dataclass(frozen=True)
class BarContact(Value, kind="BarContact"):
    """Penalty contact between bars as capsules of radius `bar_radius`.

    Two bars push each other apart at the closest points of their axes with the force k d − c v, at
    least 0. The depth d is the sum of their radii less the distance, and v the rate at which the
    points separate. Friction is that of `Ground`.

    Parameters
    ----------
    pairs : sequence of pairs of int or str, optional
        Pairs of bars that can touch. Default: all that share no node.
    stiffness : float
        Contact stiffness k [N/m].
    damping : float
        Contact damping c [N·s/m].
    friction : float, optional
        Coulomb's friction coefficient μ. Default: no friction.
    slip_speed : float
        Slip velocity v_s over which friction is regularized [m/s], see `Ground`.

    Raises
    ------
    TypeError, ValueError
        If a field is wrong. A scene checks the pairs against its bars.

    See Also
    --------
    Ground : Contact of nodes and bars with a plane.

    Notes
    -----
    The force is the gradient of the energy k d²/2, because the distance does not change to first
    order with the closest points. Parallel bars touch at one point, which jumps as they rotate.
    Keep depths below the sum of the radii: the direction of the force is lost where axes cross.

    Friction acts in the middle of the overlap, and thus has a couple about each bar. A bar of Eq. 19
    does not rotate about its own axis: the part of the couple about it is omitted.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> crossed = tc.Structure([(-1, 0, 0), (1, 0, 0), (0, -1, 0.15), (0, 1, 0.15)], bars=[(0, 1), (2, 3)], bar_radius=0.05)
    >>> scene = tc.Scene(crossed, gravity=tc.Gravity(), bar_contact=tc.BarContact([(0, 1)], stiffness=1e5))
    >>> tc.Model(scene).nx
    24
    """

    pairs: Annotated[Sequence[Sequence[IndexOrName]] | None, ListOf(Members("bar"))] = None
    stiffness: Positive = 1e4
    damping: NonNegative = 0.0
    friction: Positive | None = None
    slip_speed: Positive = 1e-3

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.pairs is not None:
            given = as_tuple("BarContact.pairs", self.pairs, "[(0, 1)]")
            pairs = tuple(_read_pair(k, pair) for k, pair in enumerate(given))
            if not given or len({frozenset(pair) for pair in pairs}) < len(given):
                raise ValueError(
                    f"BarContact.pairs is {format_value(given)}: give each pair once, or None for all"
                )
            object.__setattr__(self, "pairs", pairs)

    @property
    def conservative(self) -> bool:
        """Whether there is neither damping nor friction."""
        return self.damping == 0 and self.friction is None

    def check(self, structure: Any) -> None:
        """Check the pairs against the bars of a structure.

        Parameters
        ----------
        structure : Structure
            Bars and their radii.

        Raises
        ------
        ValueError
            If there is no such pair, its bars share a node, or both have no radius.
        """
        bars, radius = structure.bars, structure.bar_radius
        for k, pair in enumerate(self.pairs or ()):
            where = f"BarContact.pairs[{k}] is {tuple(pair)}"
            for bar in pair:
                node_index(f"BarContact.pairs[{k}]", bar, len(bars), "bar")
            if shared := set(bars[pair[0]].tolist()) & set(bars[pair[1]].tolist()):
                raise ValueError(
                    f"{where}, which share node {min(shared)}: leave the pair out, they meet there"
                )
        chosen = self.select_pairs(structure)
        if not len(chosen):
            raise ValueError(
                "Scene.bar_contact: the structure has no two bars that share no node: leave it out"
            )
        for pair in chosen[radius[chosen].sum(axis=1) <= 0]:
            raise ValueError(
                f"Scene.bar_contact: bars {pair[0]} and {pair[1]} have no bar_radius: "
                "give structure.replace(bar_radius=...)"
            )

    def select_pairs(self, structure: Any) -> Indices:
        """Select the pairs of bars that can touch.

        Parameters
        ----------
        structure : Structure
            Bars.

        Returns
        -------
        ndarray of int, shape (m, 2)
            The given pairs, or all whose bars share no node.
        """
        if self.pairs is not None:
            return np.array(self.pairs, dtype=np.intp)
        ends = [set(bar) for bar in structure.bars.tolist()]
        found = [
            pair for pair in combinations(range(len(ends)), 2) if not ends[pair[0]] & ends[pair[1]]
        ]
        return np.array(found, dtype=np.intp).reshape(-1, 2)


def _read_pair(k: int, given: Any) -> tuple[int, int]:
    pair = as_tuple(f"BarContact.pairs[{k}]", given, "(0, 1)")
    if len(pair) != 2:
        raise ValueError(f"BarContact.pairs[{k}] is {format_value(given)}: give two bars")
    one, other = (index_or_name(f"BarContact.pairs[{k}]", bar) for bar in pair)
    if one == other:
        raise ValueError(f"BarContact.pairs[{k}] is {(one, other)}: give two different bars")
    return one, other
