"""MuJoCo's body tree of a structure: parents, joints, loop closures."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from tenscasadi.exchange.source import DEEPEST
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import MAX_BYTES, Array

# bars of one tree, whose mass matrix has three rows and columns per bar
_MOST = int((MAX_BYTES / 8) ** 0.5 / 3)
NO_DIRECTION = np.zeros((0, 3))


class Link(NamedTuple):
    """Bar in MuJoCo's body tree, with the joint to its parent.

    Attributes
    ----------
    bar : int
        Index of the bar.
    parent : int or None
        Bar that it is attached to; None for the world.
    node : int or None
        Node of the ball joint; None for a free body.
    slides : ndarray, shape (k, 3)
        Directions in which that node can slide.
    still : bool
        Whether both ends are pinned.
    """

    bar: int
    parent: int | None
    node: int | None
    slides: Array = NO_DIRECTION
    still: bool = False  # both ends are pinned


class Tie(NamedTuple):
    """Loop-closing constraint of a node in MuJoCo.

    Attributes
    ----------
    node : int
        Index of the node.
    bar : int
        Bar that ends at the node.
    other : int or None
        Bar whose body contains the node; None for the world.
    """

    node: int
    bar: int
    other: int | None


class BodyTree(NamedTuple):
    """MuJoCo's body tree of a structure.

    Attributes
    ----------
    links : list of Link
        All bars, parents before children.
    owner : dict of int to int
        Bar whose body contains a node, for nodes of bars that are not pinned.
    ties : list of Tie
        Loop-closing constraints.
    """

    links: list[Link]
    owner: dict[int, int]
    ties: list[Tie]


def find_held_directions(s: Structure) -> dict[int, Array]:
    """Find the constrained directions (k, 3) of each supported node.

    They are orthonormal.
    """
    axes = {
        node: np.eye(3)[["xyz".index(axis) for axis in names]] for node, names in s.pinned.items()
    }
    return axes | {node: np.array(normals) for node, normals in s.rollers.items()}


def find_free_directions(held: Array) -> Array:
    """Compute orthonormal directions perpendicular to given ones.

    The result is (3 − k, 3). The given directions `held` (k, 3) are orthonormal.
    """
    if np.count_nonzero(held) == len(held):  # coordinate axes: keep the others exact
        return np.eye(3)[~held.any(axis=0)]
    return np.asarray(np.linalg.svd(held)[2][len(held) :])


def build_tree(s: Structure, balls: bool) -> BodyTree:
    """Build MuJoCo's body tree of a structure.

    With `balls`, bars that share a node are connected there by a ball joint. Otherwise each bar is
    a body by itself. Raises ValueError.
    """
    return _TreeBuilder(s, balls).grow()


class _TreeBuilder:
    """Builder of MuJoCo's body tree.

    Bars with pinned nodes come first.
    """

    def __init__(self, s: Structure, balls: bool) -> None:
        self.bars: list[list[int]] = s.bars.tolist()
        self.balls = balls
        self.held = find_held_directions(s)
        self.pinned = {node for node, directions in self.held.items() if len(directions) == 3}
        self.at: dict[int, list[int]] = {}
        for bar, ends in enumerate(self.bars):
            for node in ends:
                self.at.setdefault(node, []).append(bar)
        self.found = BodyTree([], {}, [])
        self.depth: dict[int, int] = {}  # number of ancestors of each bar

    def grow(self) -> BodyTree:
        placed = set[int]()
        for root in sorted(
            range(len(self.bars)),
            key=lambda bar: -max(len(self.held.get(node, ())) for node in self.bars[bar]),
        ):
            self.depth.setdefault(root, 0)
            waiting = deque([self._root(root)])
            while waiting:
                link = waiting.popleft()
                if link.bar not in placed:
                    placed.add(link.bar)
                    waiting.extend(self._take(link))
        return self.found

    def _root(self, bar: int) -> Link:
        """Find the joint between a bar and the world."""
        ends = self.bars[bar]
        if self.pinned.issuperset(ends):
            return Link(bar, None, ends[0], still=True)
        node = max(ends, key=lambda end: len(self.held.get(end, ())))
        if node not in self.held or (node in self.pinned and not self.balls):
            return Link(bar, None, None)
        return Link(bar, None, node, find_free_directions(self.held[node]))

    def _take(self, link: Link) -> Iterator[Link]:
        """Add a bar to the tree, and yield attached ones.

        Each is yielded as its link. `link` is the bar with its connection to the tree.
        """
        self.found.links.append(link)
        for node in self.bars[link.bar]:
            joint = node == link.node
            if node in self.pinned:
                if not joint and not link.still:
                    self.found.ties.append(Tie(node, link.bar, None))
            elif node in self.found.owner:
                if not joint or link.parent is None:
                    self.found.ties.append(Tie(node, link.bar, self.found.owner[node]))
            else:
                if node in self.held and not joint:
                    raise ValueError(
                        f"pinned or rollers of node {node}: it is fixed along {len(self.held[node])} of three directions, and bar {link.bar} "
                        f"is joined to {'the world' if link.node is None else f'node {link.node}'}: MuJoCo supports one such node in a group of "
                        "joined bars, and none if one of their nodes is pinned: pin the node, or free it"
                    )
                self.found.owner[node] = link.bar
                if self.balls and self.depth[link.bar] < DEEPEST:
                    for bar in self.at[node]:
                        self.depth.setdefault(bar, self.depth[link.bar] + 1)
                        yield Link(bar, link.bar, node)


def inverse_weights(s: Structure, tree: BodyTree) -> Array:
    """Compute the inverse effective mass of each bar (β,) [1/kg].

    It is the acceleration of the midpoint per unit force, averaged over all directions: 1/m for a
    single bar. As in MuJoCo, loop-closing constraints are ignored. `tree` is MuJoCo's tree of the
    bars. Raises ValueError if a tree has too many bars.
    """
    found = np.zeros(len(s.bars))
    roots = [k for k, link in enumerate(tree.links) if link.parent is None]
    for first, end in zip(roots, [*roots[1:], len(tree.links)], strict=True):
        links = tree.links[first:end]
        if len(links) > _MOST:
            raise ValueError(
                f"bars: {len(links)} of them are connected, too many to scale contacts: {_MOST} at most"
            )
        found[[link.bar for link in links]] = _weigh(s, tree, links)
    return found


def _weigh(s: Structure, tree: BodyTree, links: list[Link]) -> list[float]:
    """Compute the inverse effective masses of one tree's bars [1/kg].

    `links` are these bars with their connections, the root first.
    """
    slides = np.eye(3) if links[0].node is None else links[0].slides
    size = len(slides) + 3 * len(links)  # root velocities along its slides, then angular velocities
    M, middles = np.zeros((size, size)), []
    points: dict[tuple[int, int | None], Array] = {}
    for k, link in enumerate(links):
        middle, turning = (
            s.nodes[s.bars[link.bar]].mean(axis=0),
            slice(len(slides) + 3 * k, len(slides) + 3 * k + 3),
        )
        place = middle if link.node is None else s.nodes[link.node]
        base = (
            np.pad(slides.T, ((0, 0), (0, 3 * len(links))))
            if link.parent is None
            else points[link.parent, link.node]
        )

        def velocity(
            x: Array,
            base: Array = base,
            place: Array = place,
            turning: slice = turning,
            still: bool = link.still,
        ) -> Array:
            found = base.copy()
            found[:, turning] = 0.0 if still else -np.cross(x - place, np.eye(3)).T  # ω × r
            return found

        for node in s.bars[link.bar].tolist():
            points[link.bar, node] = own = velocity(s.nodes[node])
            if tree.owner.get(node) == link.bar and s.node_mass[node] > 0:
                M += s.node_mass[node] * own.T @ own
        middles.append(velocity(middle))
        M += s.bar_mass[link.bar] * middles[-1].T @ middles[-1]
        across = s.bar_inertia[link.bar] * s.bar_lengths[link.bar] ** 2
        M[turning, turning] += across * np.eye(3)  # also about the axis, about which no bar rotates
    inverse = np.linalg.inv(M)
    return [float(np.sum((J @ inverse) * J)) / 3 for J in middles]
