"""Bounds on the positions of nodes and bars.

Nodes stay inside a box or above the ground. Bars stay clear of each other and of obstacles.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import casadi as ca
import numpy as np

from ocp.problem.bounds.axis_limits import AxisLimits
from ocp.problem.bounds.bound import Bound, Limit, PathBound
from tenscasadi.schema.field_types import VECTOR, ListOf, Members
from tenscasadi.structure.structure import Structure
from tenscasadi.util.casadi_tools import column_norms
from tenscasadi.util.renamed import rename_fields
from tenscasadi.util.validate import (
    IndexOrName,
    Positive,
    as_tuple,
    check_indices,
    format_value,
    node_index,
    number,
)

if TYPE_CHECKING:
    from ocp.problem.instant import Instant

# fraction of a bar's length over which clipping to its ends is rounded off, for continuous
# derivatives
ROUNDING = 0.02


@dataclass(frozen=True, eq=False)
class InsideBox(AxisLimits, kind="InsideBox"):
    """Nodes inside an axis-aligned box.

    The limits hold at the end of every interval, and not for pinned coordinates. The start has to
    be inside, too. A free start (`FreeStart`) is constrained to the box.

    Parameters
    ----------
    lower : sequence of float or None, length 3, optional
        Corner (x, y, z) with the smallest coordinates [m]; None for an open side.
    upper : sequence of float or None, length 3, optional
        Corner (x, y, z) with the largest coordinates [m]; None for an open side.
    nodes : iterable of int or str, optional
        Nodes that stay inside; None for all.

    Raises
    ------
    TypeError, ValueError
        If all sides are open, if a corner is not three numbers or None, or if ``lower`` is not
        below ``upper``. In a `Problem`: if a node does not exist or is pinned outside, or if the
        start is outside.

    See Also
    --------
    AboveGround : A box with a floor only.

    Examples
    --------
    >>> import ocp
    >>> ocp.InsideBox(upper=(None, None, 1.2), nodes=[3, 4, 5]).upper
    (None, None, 1.2)
    """

    nodes: Annotated[Iterable[IndexOrName] | None, Members("node")] = None

    def check(self, structure: Structure) -> None:
        """Check that the bound can apply to a structure.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If a node does not exist or is pinned outside.
        """
        lower, upper = self.corners()
        chosen = self._chosen(structure)
        check_indices(f"{type(self).__name__}.nodes", chosen, len(structure.nodes))
        for node in chosen:
            for axis in np.flatnonzero(structure.fixed[node]):
                place = structure.nodes[node, axis]
                if not lower[axis] <= place <= upper[axis]:
                    raise ValueError(
                        f"{type(self).__name__} leaves out node {node}, pinned at {'xyz'[axis]} = {place:g} m: widen it or name nodes"
                    )

    def limit(self, now: Instant) -> Limit:
        """Build the constrained quantities.

        Parameters
        ----------
        now : Instant
            Symbolic instant.

        Returns
        -------
        Limit
            Coordinates that are limited and not pinned [m].
        """
        structure = now.model.scene.structure
        lower, upper = self.corners()
        sides = np.flatnonzero(np.isfinite(lower) | np.isfinite(upper))
        entries = [
            (node, int(axis))
            for node in self._chosen(structure)
            for axis in sides
            if not structure.fixed[node, axis]
        ]
        axes = [axis for _, axis in entries]
        value = ca.vertcat(*(now.nodes[axis, node] for node, axis in entries))
        names = tuple(f"{'xyz'[axis]} of node {node}" for node, axis in entries)
        return Limit(value, lower[axes], upper[axes], names, "m")

    def _chosen(self, structure: Structure) -> list[int]:
        """List the nodes that must stay inside the box."""
        return list(range(len(structure.nodes)) if self.nodes is None else self.nodes)


@Bound.maker
def AboveGround(
    height: float = 0.0, nodes: Annotated[Iterable[IndexOrName] | None, Members("node")] = None
) -> InsideBox:
    """Build the bound z ≥ height on nodes.

    It holds at the end of every interval.

    Parameters
    ----------
    height : float, optional
        Height of the ground [m].
    nodes : iterable of int or str, optional
        Nodes that stay above; None for all.

    Returns
    -------
    InsideBox
        A box with a floor only.

    Raises
    ------
    TypeError, ValueError
        If the height is not a number, or for the reasons of `InsideBox`.

    See Also
    --------
    AboveSurface : The same for slopes and height fields.

    Examples
    --------
    >>> import ocp
    >>> ocp.AboveGround(0.1).lower
    (None, None, 0.1)
    """
    return InsideBox((None, None, number("AboveGround.height", height)), nodes=nodes)


@dataclass(frozen=True, eq=False)
class BarClearance(PathBound, kind="BarClearance"):
    """Smallest permitted distance between the axes of bars.

    It holds at the end of every interval.

    Parameters
    ----------
    distance : float
        Least distance between the axes [m], > 0. For bars with radii, give at least the sum of both
        radii.
    pairs : iterable of (int, int), optional
        Pairs of bars that stay apart; None for all pairs without a common node.

    Raises
    ------
    TypeError, ValueError
        If the distance is not a positive number, or if a pair is not two bars. In a `Problem`: if a
        bar does not exist, if two bars of a pair share a node, if there is no pair, or if two bars
        are closer at the start.

    Notes
    -----
    The distance is that of the segments between the bars' ends. At the ends, the clipping of the
    nearest points is rounded off over 2 % of a bar, which keeps derivatives continuous.

    Examples
    --------
    >>> import ocp
    >>> ocp.BarClearance(0.05, pairs=[(0, 1)]).pairs
    ((0, 1),)
    """

    distance: Positive
    pairs: Annotated[Iterable[tuple[IndexOrName, IndexOrName]] | None, ListOf(Members("bar"))] = (
        None
    )

    ends: ClassVar[tuple[str, ...]] = ("end",)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.pairs is not None:
            found = [
                as_tuple(f"BarClearance.pairs[{k}]", pair, "(0, 1)")
                for k, pair in enumerate(as_tuple("BarClearance.pairs", self.pairs, "[(0, 1)]"))
            ]
            for k, pair in enumerate(found):
                if len(pair) != 2:
                    raise ValueError(
                        f"BarClearance.pairs[{k}] is {format_value(pair)}: give two bars, such as (0, 1)"
                    )
            object.__setattr__(self, "pairs", tuple(found))

    def check(self, structure: Structure) -> None:
        """Check that the bound can apply to a structure.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If a bar does not exist, if two bars of a pair share a node, or if there is no pair.
        """
        for pair in self._bar_pairs(structure):
            for bar in pair:
                node_index("BarClearance.pairs: bar", bar, len(structure.bars), "bar")
            if set(structure.bars[pair[0]]) & set(structure.bars[pair[1]]):
                raise ValueError(
                    f"BarClearance.pairs: bars {pair[0]} and {pair[1]} share a node: leave that pair out"
                )
        if not self._bar_pairs(structure):
            raise ValueError("BarClearance: all bars share nodes: leave it out")

    def _bar_pairs(self, structure: Structure) -> list[tuple[int, int]]:
        """List the pairs of bars whose distance is limited."""
        if self.pairs is not None:
            return [(pair[0], pair[1]) for pair in self.pairs]
        ends = [set(bar) for bar in structure.bars.tolist()]
        return [(i, j) for i, j in combinations(range(len(ends)), 2) if not ends[i] & ends[j]]

    def limit(self, now: Instant) -> Limit:
        """Build the constrained quantities.

        Parameters
        ----------
        now : Instant
            Symbolic instant.

        Returns
        -------
        Limit
            Distance of each pair of bars [m].
        """
        structure = now.model.scene.structure
        pairs = np.array(self._bar_pairs(structure))
        sides = [
            [now.nodes[:, structure.bars[pairs[:, k], end].tolist()] for end in (0, 1)]
            for k in (0, 1)
        ]
        value = segment_distance(*sides[0], *sides[1])
        names = tuple(f"clearance of bars {i} and {j}" for i, j in pairs)
        lower = np.full(len(pairs), self.distance)
        return Limit(value, lower, np.full(len(pairs), np.inf), names, "m")


@rename_fields(centre="center")
@dataclass(frozen=True, eq=False)
class Obstacle(PathBound, kind="Obstacle"):
    """Ball that nodes and the axes of bars must avoid.

    The limits hold at the end of every interval.

    Parameters
    ----------
    center : array_like, shape (3,)
        Center (x, y, z) [m].
    radius : float
        Radius [m], > 0.
    bars : iterable of int or str, optional
        Bars that stay outside; None for all.
    nodes : iterable of int or str, optional
        Nodes that stay outside, in addition to the ends of those bars; None for all.

    Raises
    ------
    TypeError, ValueError
        If the center is not three numbers, or the radius not a positive number. In a `Problem`: if
        a bar or node does not exist, or if one is inside at the start.

    Examples
    --------
    >>> import ocp
    >>> ocp.Obstacle((0.0, 0.0, 2.0), 0.3).radius
    0.3
    """

    center: Annotated[Sequence[float], VECTOR]
    radius: Positive
    bars: Annotated[Iterable[IndexOrName] | None, Members("bar")] = None
    nodes: Annotated[Iterable[IndexOrName] | None, Members("node")] = None

    ends: ClassVar[tuple[str, ...]] = ("end",)

    def check(self, structure: Structure) -> None:
        """Check that the bound can apply to a structure.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If a bar or node does not exist.
        """
        for item, all_items in (("bar", structure.bars), ("node", structure.nodes)):
            own = getattr(self, f"{item}s") or ()
            check_indices(f"Obstacle.{item}s", own, len(all_items), item)

    def limit(self, now: Instant) -> Limit:
        """Build the constrained quantities.

        Parameters
        ----------
        now : Instant
            Symbolic instant.

        Returns
        -------
        Limit
            Distance of each bar and node from the center [m].
        """
        structure = now.model.scene.structure
        bars = list(range(len(structure.bars)) if self.bars is None else self.bars)
        on_bars = set(structure.bars[bars].ravel().tolist())
        given = range(len(structure.nodes)) if self.nodes is None else self.nodes
        nodes = [node for node in given if node not in on_bars and not structure.fixed[node].all()]
        values, names = [type(now.state)(0, 1)], []
        if bars:
            a, b = (now.nodes[:, structure.bars[bars, end].tolist()] for end in (0, 1))
            center = ca.repmat(ca.DM(self.center), 1, len(bars))
            along = b - a
            share = _within_segment(ca.sum1((center - a) * along) / ca.sum1(along * along))
            values.append(column_norms(a + ca.repmat(share, 3, 1) * along - center))
            names += [f"obstacle clear of bar {k}" for k in bars]
        if nodes:
            center = ca.repmat(ca.DM(self.center), 1, len(nodes))
            values.append(column_norms(now.nodes[:, nodes] - center))
            names += [f"obstacle clear of node {k}" for k in nodes]
        lower, upper = np.full(len(names), self.radius), np.full(len(names), np.inf)
        return Limit(ca.vertcat(*values), lower, upper, tuple(names), "m")

    def imply(self, structure: Structure) -> Obstacle:
        """Build the weaker bound on nodes only.

        If a bar is outside the ball, so are its ends.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Returns
        -------
        Obstacle
            The same ball, for nodes.
        """
        ends = structure.bars if self.bars is None else structure.bars[list(self.bars)]
        nodes = None if self.nodes is None else sorted({*self.nodes, *ends.ravel().tolist()})
        return replace(self, bars=[], nodes=nodes)


def segment_distance(a: Any, b: Any, c: Any, d: Any) -> Any:
    """Compute distances (m,) between segments a–b and c–d.

    The ends are 3×m [m]. The nearest points are clipped to the segments, with rounding
    (`ROUNDING`), so that derivatives are continuous.
    """
    u, v, w = b - a, d - c, a - c
    uu, vv, uv, uw, vw = (
        ca.sum1(u * u),
        ca.sum1(v * v),
        ca.sum1(u * v),
        ca.sum1(u * w),
        ca.sum1(v * w),
    )
    s = _within_segment(
        (uv * vw - vv * uw) / (uu * vv - uv * uv + 1e-6 * uu * vv)
    )  # the last term is for parallel segments, where any point is nearest
    t = _within_segment((uv * s + vw) / vv)
    s = _within_segment((uv * t - uw) / uu)
    gap = w + ca.repmat(s, 3, 1) * u - ca.repmat(t, 3, 1) * v
    return column_norms(gap)


def _within_segment(share: Any) -> Any:
    """Clip ``share`` to [0, 1], smoothed at both ends."""
    return (ca.sqrt(share**2 + ROUNDING**2) - ca.sqrt((share - 1) ** 2 + ROUNDING**2) + 1) / 2
