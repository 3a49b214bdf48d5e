"""Assembly of NTRT structures from nodes, pairs, substructures and bonds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from tenscasadi.exchange.ntrt.yaml_tree import YamlEntry
from tenscasadi.util.validate import Array


@dataclass(eq=False)
class NtrtNode:
    """Named node of an NTRT structure.

    `at` (3,) is its position.
    """

    name: str
    at: Array


@dataclass(eq=False)
class NtrtPair:
    """Pair of NTRT nodes with tags that select its properties.

    `ends` are the two nodes. `entry` is its place in the file.
    """

    ends: tuple[NtrtNode, NtrtNode]
    tags: frozenset[str]
    entry: YamlEntry


@dataclass(eq=False)
class Assembly:
    """NTRT structure with its nodes and pairs, and substructures (`children`)."""

    name: str = ""
    nodes: list[NtrtNode] = field(default_factory=list)
    pairs: list[NtrtPair] = field(default_factory=list)
    children: list[Assembly] = field(default_factory=list)

    def whole(self) -> Iterator[Assembly]:
        """Yield this structure and all substructures, level by level."""
        level = [self]
        while level:
            yield from level
            level = [child for part in level for child in part.children]

    def all_nodes(self) -> list[NtrtNode]:
        """Return the nodes of all levels."""
        return [node for part in self.whole() for node in part.nodes]

    def center(self) -> Array:
        """Compute the mean position (3,) of all nodes."""
        return np.asarray(np.mean([node.at for node in self.all_nodes()], axis=0))

    def transform(self, change: Callable[[Array], Array]) -> None:
        """Apply a transformation to the positions of all nodes.

        `change` maps a position (3,) to the new one.
        """
        for node in self.all_nodes():
            node.at = change(node.at)

    def child(self, name: str, entry: YamlEntry) -> Assembly:
        """Find the nearest substructure of this name.

        `entry` is the entry that names it. Raises SceneFileError.
        """
        for part in self.whole():
            if part is not self and part.name == name:
                return part
        raise entry.error(f"names the substructure {name!r}: there is none")

    def node(self, path: str, entry: YamlEntry) -> NtrtNode:
        """Find the nearest node of a dotted name `path`.

        The parts before the last are names of substructures. `entry` is the entry that names it.
        Raises SceneFileError.
        """
        *parents, name = path.split(".")
        part = self
        for parent in parents:
            part = part.child(parent, entry)
        for inner in part.whole():
            for node in inner.nodes:
                if node.name == name:
                    return node
        raise entry.error(f"names the node {path!r}: there is none")


def rotate(axis: Array, angle: float) -> Array:
    """Compute the rotation matrix (3, 3) about an axis.

    The angle is in rad; the axis need not have unit length.
    """
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


def rotate_between(a: Array, b: Array, fallback: Array) -> Array:
    """Compute the smallest rotation from direction a to b.

    The result is the rotation matrix (3, 3). If they are opposite, it is a half turn about
    `fallback`.
    """
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    if np.linalg.norm(a - b) < 1e-5:  # NTRT's tolerance for equal directions
        return np.eye(3)
    if np.linalg.norm(a + b) < 1e-5:
        return rotate(fallback, np.pi)
    return rotate(np.cross(a, b), float(np.arccos(np.clip(a @ b, -1.0, 1.0))))


def place_children(parent: Assembly, groups: list[tuple[list[str], dict[str, YamlEntry]]]) -> None:
    """Rotate, scale and translate substructures of `parent`, in NTRT's order.

    A group is a list of names and the attributes that they share.
    """
    for names, attributes in groups:
        if "rotation" in attributes:
            for name in names:
                _rotate(parent.child(name, attributes["rotation"]), attributes["rotation"])
    for names, attributes in groups:
        for index, name in enumerate(names):
            if "scale" in attributes:
                _scale(parent.child(name, attributes["scale"]), attributes["scale"].number())
            for key, factor in (("offset", index), ("translation", 1)):
                if key in attributes:
                    _move(parent.child(name, attributes[key]), factor * attributes[key].vector())


def _move(child: Assembly, shift: Array) -> None:
    child.transform(lambda at: at + shift)


def _rotate(child: Assembly, rotation: YamlEntry) -> None:
    given = dict(rotation.items("axis", "angle", "reference"))
    if not {"axis", "angle"} <= set(given):
        raise rotation.error("needs an axis and an angle")
    axis = given["axis"].vector()
    if not np.linalg.norm(axis) > 0:
        raise given["axis"].error("is (0, 0, 0): give a direction")
    about = given["reference"].vector() if "reference" in given else child.center()
    matrix = rotate(axis, np.deg2rad(given["angle"].number()))
    child.transform(lambda at: about + matrix @ (at - about))


def _scale(child: Assembly, factor: float) -> None:
    about = child.center()
    child.transform(lambda at: about + factor * (at - about))


def bond_edges(
    parent: Assembly,
    names: tuple[str, str],
    pairs: YamlEntry,
    tags: frozenset[str],
    is_rod: Callable[[NtrtPair], bool],
) -> None:
    """Bond nodes of one substructure to edges of the other.

    `names` are those of the two substructures in `parent`, and `pairs` the entries of a node and an
    edge. The second substructure is moved so that the nodes meet the midpoints of the edges. Each
    string of an edge "a/b" is replaced by two, from a to the node and from the node to b. They have
    the `tags`. Strings between the nodes are removed. `is_rod` tells rods from strings.
    """
    parts = [parent.child(name, pairs) for name in names]
    joints, edges, places = [], [], []
    rows = pairs.parts()
    if len(rows) < 3:
        raise pairs.error("has fewer than 3 pairs of a node and an edge: give at least 3")
    for row in rows:
        words = row.parts(2)
        if sum("/" in word.word() for word in words) != 1:
            raise row.error("does not pair a node with an edge, such as [top1, bottom1/bottom2]")
        place = []
        for part, word in zip(parts, words, strict=True):
            ends = [part.node(path, word) for path in word.word().split("/")]
            if len(ends) > 2:
                raise word.error(f"is {word.format()}: an edge has two ends")
            place.append(np.mean([end.at for end in ends], axis=0))
            (edges.append((ends[0], ends[1])) if len(ends) == 2 else joints.append(ends[0]))
        places.append(place)
    _meet(parts[1], np.array(places).transpose(1, 0, 2), pairs)
    old = {frozenset(edge) for edge in edges} | {
        frozenset((a, b)) for a in joints for b in joints if a is not b
    }
    for part in parts:
        for inner in part.whole():
            for pair in list(inner.pairs):
                if frozenset(pair.ends) in old and (
                    frozenset(pair.ends) in map(frozenset, edges) or not is_rod(pair)
                ):
                    if is_rod(pair):
                        raise pairs.error(
                            f"has the rod {pair.ends[0].name}/{pair.ends[1].name} for an edge: only strings can be edges"
                        )
                    inner.pairs.remove(pair)
    for joint, (first, last) in zip(joints, edges, strict=True):
        parent.pairs += [
            NtrtPair((first, joint), tags, pairs),
            NtrtPair((joint, last), tags, pairs),
        ]


def _meet(moved: Assembly, places: Array, entry: YamlEntry) -> None:
    """Move a substructure so that its points coincide with given ones.

    `places` (2, k, 3) are the given points, then those of the substructure. Their planes are
    aligned first, then the first points about the normal. `entry` is the file's entry of the bond,
    for messages.
    """
    middles = places.mean(axis=1)
    normals = np.cross(places[:, 1] - places[:, 0], places[:, 2] - places[:, 0])
    if not (
        np.linalg.norm(normals, axis=1)
        > 1e-12 * np.linalg.norm(places - middles[:, None], axis=2).max() ** 2
    ).all():
        raise entry.error("pairs places on one line: their first three must span a plane")
    first = rotate_between(normals[1], normals[0], places[1, 1] - places[1, 0])
    arms = [places[0, 0] - middles[0], first @ (places[1, 0] - middles[1])]
    if min(np.linalg.norm(arm) for arm in arms) < 1e-12 * np.linalg.norm(normals[0]) ** 0.5:
        raise entry.error("pairs places whose first is in their middle: give another one first")
    whole = rotate_between(arms[1], arms[0], normals[0]) @ first
    moved.transform(lambda at: middles[0] + whole @ (at - middles[1]))
