"""Which body of MuJoCo's tree each bar and each node belongs to, and the joints that a tree cannot hold."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array

# bars that hang from each other: files that are nested deeper are hard to read, for MuJoCo too
DEEPEST = 100
# bars of a tree whose weights are computed: with a matrix of three rows and columns for each
MOST = 1000
NO_DIRECTION = np.zeros((0, 3))


class Link(NamedTuple):
    """A bar, the bar that it hangs from (None: the world), the node that it turns about (None: it is free) and along which that slides (k, 3)."""

    bar: int
    parent: int | None
    node: int | None
    slides: Array = NO_DIRECTION
    still: bool = False  # both ends are pinned


class Tie(NamedTuple):
    """A node that an equation holds: its bar, and the bar that has the node (None: the world)."""

    node: int
    bar: int
    other: int | None


class Hanging(NamedTuple):
    """All bars, each after the one that it hangs from; which bar has a node, of nodes of bars that are not pinned; and the ties."""

    links: list[Link]
    owner: dict[int, int]
    ties: list[Tie]


def held_directions(s: Structure) -> dict[int, Array]:
    """Return the orthonormal directions (k, 3) along which nodes are held, of those that are."""
    axes = {
        node: np.eye(3)[["xyz".index(axis) for axis in names]] for node, names in s.pinned.items()
    }
    return axes | {node: np.array(normals) for node, normals in s.rollers.items()}


def free_directions(held: Array) -> Array:
    """Return orthonormal directions (3 − k, 3) across those held (k, 3)."""
    if np.count_nonzero(held) == len(held):  # along axes: the others, as they are
        return np.eye(3)[~held.any(axis=0)]
    return np.asarray(np.linalg.svd(held)[2][len(held) :])


def hang(s: Structure, balls: bool) -> Hanging:
    """Return the tree of the bars of `s`: bars that share a node turn about it where `balls`, else each is by itself. Raises ValueError."""
    return _Tree(s, balls).grow()


class _Tree:
    """A tree that grows from bars which hang from the world, those with pinned nodes first."""

    def __init__(self, s: Structure, balls: bool) -> None:
        self.bars: list[list[int]] = s.bars.tolist()
        self.balls = balls
        self.held = held_directions(s)
        self.pinned = {node for node, directions in self.held.items() if len(directions) == 3}
        self.at: dict[int, list[int]] = {}
        for bar, ends in enumerate(self.bars):
            for node in ends:
                self.at.setdefault(node, []).append(bar)
        self.found = Hanging([], {}, [])
        self.depth: dict[int, int] = {}  # how many bars hang above each other

    def grow(self) -> Hanging:
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
        """Return how a bar hangs from the world: about a pinned node, about one that slides, or not at all."""
        ends = self.bars[bar]
        if self.pinned.issuperset(ends):
            return Link(bar, None, ends[0], still=True)
        node = max(ends, key=lambda end: len(self.held.get(end, ())))
        if node not in self.held or (node in self.pinned and not self.balls):
            return Link(bar, None, None)
        return Link(bar, None, node, free_directions(self.held[node]))

    def _take(self, link: Link) -> Iterator[Link]:
        """Put a bar into the tree, and tell which ones may hang from it."""
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
                        f"pinned or rollers of node {node}: it is held along {len(self.held[node])} of three directions, and bar {link.bar} "
                        f"hangs from {'the world' if link.node is None else f'node {link.node}'}: MuJoCo lets one such node of bars that hang "
                        "together slide, and none where one of their nodes is pinned: pin the node, or let it go"
                    )
                self.found.owner[node] = link.bar
                if self.balls and self.depth[link.bar] < DEEPEST:
                    for bar in self.at[node]:
                        self.depth.setdefault(bar, self.depth[link.bar] + 1)
                        yield Link(bar, link.bar, node)


def inverse_weights(s: Structure, hanging: Hanging) -> Array:
    """Return how much a force on the middle of each bar accelerates it, the mean over all directions, 1/kg: 1/m for a bar by itself.

    Of the trees without their ties, as MuJoCo computes it. Raises ValueError where too many bars
    hang together.
    """
    found = np.zeros(len(s.bars))
    roots = [k for k, link in enumerate(hanging.links) if link.parent is None]
    for first, end in zip(roots, [*roots[1:], len(hanging.links)], strict=True):
        tree = hanging.links[first:end]
        if len(tree) > MOST:
            raise ValueError(
                f"bars: {len(tree)} of them hang together, too many to weigh what they press on the ground with: {MOST} at most"
            )
        found[[link.bar for link in tree]] = _weigh(s, hanging, tree)
    return found


def _weigh(s: Structure, hanging: Hanging, tree: list[Link]) -> list[float]:
    """Return the inverse weights of the bars of one tree."""
    slides = np.eye(3) if tree[0].node is None else tree[0].slides
    size = len(slides) + 3 * len(
        tree
    )  # velocities of the root along its slides, then rates of turning
    M, middles = np.zeros((size, size)), []
    points: dict[tuple[int, int | None], Array] = {}
    for k, link in enumerate(tree):
        middle, turning = (
            s.nodes[s.bars[link.bar]].mean(axis=0),
            slice(len(slides) + 3 * k, len(slides) + 3 * k + 3),
        )
        place = middle if link.node is None else s.nodes[link.node]
        base = (
            np.pad(slides.T, ((0, 0), (0, 3 * len(tree))))
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
            if hanging.owner.get(node) == link.bar and s.node_mass[node] > 0:
                M += s.node_mass[node] * own.T @ own
        middles.append(velocity(middle))
        M += s.bar_mass[link.bar] * middles[-1].T @ middles[-1]
        across = s.bar_inertia[link.bar] * s.bar_lengths[link.bar] ** 2
        M[turning, turning] += across * np.eye(3)  # about the axis, too: nothing turns about it
    inverse = np.linalg.inv(M)
    return [float(np.sum((J @ inverse) * J)) / 3 for J in middles]
