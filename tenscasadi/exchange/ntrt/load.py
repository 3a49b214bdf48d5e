"""Import of structures from NTRT's YAML files."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tenscasadi.exchange.ntrt.assembly import Assembly, Node, Pair, bond_edges, place_children
from tenscasadi.exchange.ntrt.yaml_tree import Entry, read_tree
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array, Indices, file_path, flag, positive_number

_ROD = {"radius": 0.5, "density": 1.0}  # NTRT's defaults, in its units
_STRING = {"stiffness": 1000.0, "damping": 10.0, "pretension": 0.0}
_LEFT_OUT = {  # used by ground, motors and logs only
    "tgRodInfo": ("friction", "roll_friction", "restitution"),
    "tgBasicActuatorInfo": (
        "history",
        "max_tension",
        "target_velocity",
        "min_actual_length",
        "min_rest_length",
        "rotation",
    )
    + (
        "moveCablePointAToEdge",
        "moveCablePointBToEdge",
        "radius",
        "motor_friction",
        "motor_inertia",
        "back_drivable",
    ),
}
_CLASSES = {
    "tgRodInfo": "tgRodInfo",
    **dict.fromkeys(("tgBasicActuatorInfo", "tgKinematicActuatorInfo"), "tgBasicActuatorInfo"),
}
_CLASSES |= dict.fromkeys(
    ("tgBasicContactCableInfo", "tgKinematicContactCableInfo"), "tgBasicActuatorInfo"
)
_MOST = 20_000  # nodes, pairs and substructures
_DEEPEST = 20  # nesting depth of substructures
_SAME = 1e-9  # relative to the largest extent: closer nodes are merged, as in NTRT


def load_ntrt(
    path: str | os.PathLike[str],
    *,
    length_unit: float = 1.0,
    ball_joints: bool = False,
    folder: str | os.PathLike[str] | None = None,
) -> Structure:
    """Read a structure from NASA's Tensegrity Robotics Toolkit (NTRT).

    Its YAML files contain nodes, pair_groups, builders, substructures and bond_groups (node_node
    and node_edge). Rods become bars of mass π r² l ρ. Strings of every class become elastic strings
    with the rest length l − pretension/stiffness. The y axis points up in NTRT and the z axis here:
    (x, y, z) becomes (x, −z, y). Strings end at nodes, whereas NTRT moves their ends to the
    surfaces of rods. Motors, contact and friction are ignored. It requires ``pip install
    'tenscasadi[exchange]'``.

    Parameters
    ----------
    path : str or PathLike
        The file.
    length_unit : float
        NTRT's unit of length [m], which its files do not state. It is 0.1 if the gravity is 98.1,
        and 0.01 if the gravity is 981. Mass is in kg.
    ball_joints : bool
        Whether rods that share a node are connected there by a ball joint. NTRT welds them into one
        rigid body, so they are rejected by default.
    folder : str or PathLike, optional
        Folder that must contain the files of substructures. Default: that of the file.

    Returns
    -------
    Structure
        The structure; its nodes are those that rods and strings use, in the order of the file,
        before those of substructures.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    ImportError
        If PyYAML is not installed.
    TypeError, ValueError
        An argument is wrong, or an entry of the file cannot be read or modeled; the message names
        file, line, key and value.

    Examples
    --------
    >>> from pathlib import Path
    >>> import tenscasadi as tc
    >>> text = "nodes: {a: [0, 0, 0], b: [0, 10, 0], c: [5, 0, 0], d: [5, 10, 0]}"
    >>> pairs = "pair_groups: {rod: [[a, b], [c, d]], string: [[a, c], [b, d]]}"
    >>> _ = Path("two.yaml").write_text(f"{text}{chr(10)}{pairs}")
    >>> tc.load_ntrt("two.yaml", length_unit=0.1).bar_lengths.tolist()
    [1.0, 1.0]
    """
    unit = positive_number("length_unit", length_unit)
    flag("ball_joints", ball_joints)
    place = file_path("path", path)
    if not place.exists():
        raise FileNotFoundError(2, "No such file", os.fspath(path))
    reader = _Reader((place.parent if folder is None else file_path("folder", folder)).resolve())
    whole = reader.read(place, "", ())
    return _structure(place, whole, reader.builders, unit, ball_joints)


@dataclass(frozen=True)
class _Builder:
    """Properties of tagged rods or strings, in NTRT's units."""

    tags: frozenset[str]
    values: dict[str, float]

    @property
    def is_rod(self) -> bool:
        return "density" in self.values


@dataclass
class _Reader:
    """State of the import: builders, parsed files, number of items.

    Later builders take precedence.
    """

    folder: Path
    builders: list[_Builder] = field(
        default_factory=lambda: [
            _Builder(frozenset({"rod"}), _ROD),
            _Builder(frozenset({"string"}), _STRING),
        ]
    )
    trees: dict[Path, Entry] = field(default_factory=dict)
    count: int = 0

    def read(self, path: Path, name: str, above: tuple[Path, ...]) -> Assembly:
        """Read a file and its substructures. Raises ValueError."""
        if path not in self.trees:
            self.trees[path] = read_tree(path, "load_ntrt")
        root = self.trees[path]
        parts = dict(root.items("nodes", "pair_groups", "builders", "substructures", "bond_groups"))
        whole = Assembly(name)
        if "substructures" in parts:
            self._read_substructures(whole, parts["substructures"], (*above, path))
        if "builders" in parts:
            self.builders += [
                _read_builder(tags, entry) for tags, entry in parts["builders"].items()
            ]
        for key, entry in parts["nodes"].items() if "nodes" in parts else ():
            whole.nodes.append(Node(key, entry.vector()))
        self._counted(len(whole.nodes) + 1, root)
        for tags, pairs in parts["pair_groups"].items() if "pair_groups" in parts else ():
            self._counted(len(pairs.parts()), pairs)
            whole.pairs += [
                _read_pair(row, (whole, whole), frozenset(tags.split())) for row in pairs.parts()
            ]
        if "bond_groups" in parts:
            self._read_bonds(whole, parts["bond_groups"])
        return whole

    def _counted(self, more: int, entry: Entry) -> None:
        self.count += more
        if self.count > _MOST:
            raise entry.refusal(f"makes more than {_MOST} nodes, pairs and substructures")

    def _read_substructures(self, whole: Assembly, entry: Entry, above: tuple[Path, ...]) -> None:
        groups = []
        for names, given in entry.items():
            attributes = dict(given.items("path", "rotation", "translation", "scale", "offset"))
            if "path" not in attributes:
                raise given.refusal("has no path: give that of its file")
            for name in names.split("/"):
                whole.children.append(
                    self.read(self._below(attributes["path"], above), name, above)
                )
            groups.append((names.split("/"), attributes))
        place_children(whole, groups)

    def _below(self, entry: Entry, above: tuple[Path, ...]) -> Path:
        """Resolve the path of a substructure's file.

        It must lie in the folder and must not contain itself.
        """
        path = entry.path.parent / entry.word()
        whole = path.resolve()
        if not whole.is_relative_to(self.folder) or whole.suffix.lower() not in (".yaml", ".yml"):
            raise entry.refusal(
                f"is {entry.shown()}: give a .yaml file in {self.folder}, or another folder by load_ntrt(..., folder=...)"
            )
        if not whole.is_file():
            raise entry.refusal(f"is {entry.shown()}: there is no such file")
        if whole in {file.resolve() for file in above} or len(above) > _DEEPEST:
            raise entry.refusal(
                f"is {entry.shown()}, which holds itself, or substructures deeper than {_DEEPEST} times"
            )
        return path

    def _read_bonds(self, whole: Assembly, entry: Entry) -> None:
        """Read bonds nested in tags, or tags nested in bonds.

        A key with a slash is a bond, such as "leg/foot/node_node".
        """
        for outer, inside in entry.items():
            for inner, pairs in inside.items():
                if ("/" in outer) == ("/" in inner):
                    raise pairs.refusal(
                        f"stands in {outer}: give tags and a bond, such as leg/foot/node_node, one in the other"
                    )
                bond, tags = (outer, inner) if "/" in outer else (inner, outer)
                *names, kind = bond.split("/")
                if len(names) < 2 or kind not in ("node_node", "node_edge"):
                    raise pairs.refusal(
                        f"is of the bond {bond}: give two substructures or more and node_node or node_edge, such as leg/foot/node_node"
                    )
                for first, second in pairwise(names):
                    self._counted(2 * len(pairs.parts()), pairs)
                    if kind == "node_edge":
                        bond_edges(
                            whole, (first, second), pairs, frozenset(tags.split()), self._is_rod
                        )
                    else:
                        parts = whole.child(first, pairs), whole.child(second, pairs)
                        more = frozenset(
                            {*tags.split(), first, second, f"{first}/{second}"}
                        )  # tags for controllers, as in NTRT
                        whole.pairs += [_read_pair(row, parts, more) for row in pairs.parts()]

    def _is_rod(self, pair: Pair) -> bool:
        return any(builder.is_rod and builder.tags <= pair.tags for builder in self.builders)


def _read_pair(row: Entry, parts: tuple[Assembly, Assembly], tags: frozenset[str]) -> Pair:
    first, second = (
        part.node(word.word(), word) for part, word in zip(parts, row.parts(2), strict=True)
    )
    return Pair((first, second), tags, row)


def _read_builder(tags: str, entry: Entry) -> _Builder:
    given = dict(entry.items("class", "parameters"))
    if "class" not in given:
        raise entry.refusal(f"has no class: give one of {', '.join(_CLASSES)}")
    name = given["class"].word()
    if name not in _CLASSES:
        raise given["class"].refusal(
            f"of {tags} is {name!r}: only {', '.join(_CLASSES)} can be modelled"
        )
    values = dict(_ROD if _CLASSES[name] == "tgRodInfo" else _STRING)
    for key, parameter in (
        given["parameters"].items(*values, *_LEFT_OUT[_CLASSES[name]])
        if "parameters" in given
        else ()
    ):
        if key in values:
            values[key] = parameter.number()
            if values[key] < 0 or (values[key] == 0 and key in ("radius", "density", "stiffness")):
                least = "at least" if key in ("damping", "pretension") else "greater than"
                raise parameter.refusal(f"of {tags} is {values[key]:g}: it must be {least} 0")
    return _Builder(frozenset(tags.split()), values)


def _structure(
    path: Path, whole: Assembly, builders: list[_Builder], unit: float, ball_joints: bool
) -> Structure:
    rods: list[tuple[Pair, dict[str, float]]] = []
    strings: list[tuple[Pair, dict[str, float]]] = []
    for part in whole.whole():
        for pair in part.pairs:
            builder = _builder_of(pair, part.name, builders)
            (rods if builder.is_rod else strings).append((pair, builder.values))
    if not rods and not strings:
        raise ValueError(f"{path}: it has no pairs in pair_groups or bond_groups")
    used = {id(node) for pair, _ in rods + strings for node in pair.ends}
    nodes = [node for part in whole.whole() for node in part.nodes if id(node) in used]
    places, index = _merged(nodes)
    bars, lines = (_pairs([pair for pair, _ in members], index) for members in (rods, strings))
    _check_joints(path, nodes, index, bars, lines, ball_joints)
    lengths = [
        np.linalg.norm(places[pairs[:, 1]] - places[pairs[:, 0]], axis=1) for pairs in (bars, lines)
    ]
    radius, density = (
        np.array([values[key] for _, values in rods]) for key in ("radius", "density")
    )
    stiffness, damping, pretension = (
        np.array([values[key] for _, values in strings])
        for key in ("stiffness", "damping", "pretension")
    )
    rest = lengths[1] - pretension / stiffness
    for k in np.flatnonzero(rest <= 0):
        length, most = lengths[1][k], stiffness[k] * lengths[1][k]
        told = f"has the pretension {pretension[k]:g} on a length of {length:g}"
        raise strings[k][0].entry.refusal(
            f"{told}: it must be less than {most:g}, stiffness times length"
        )
    try:
        return Structure(
            unit * np.column_stack([places[:, 0], 0.0 - places[:, 2], places[:, 1]]),
            bars,
            lines,
            bar_mass=np.pi * radius**2 * lengths[0] * density,  # in kg for every unit of length
            bar_radius=unit * radius,
            stiffness=stiffness,  # kg/s², and damping kg/s
            damping=damping,
            rest_length=unit * rest,
        )
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _builder_of(pair: Pair, name: str, builders: list[_Builder]) -> _Builder:
    """Select the last builder whose tags the pair has.

    Builders of rods take precedence. The name of the structure counts as a tag.
    """
    fitting = [builder for builder in builders if builder.tags <= pair.tags | {name}]
    if not fitting:
        told = f"has the tags {', '.join(sorted(pair.tags))}, which no builder fits"
        raise pair.entry.refusal(
            f"{told}: NTRT builds nothing there, give it a builder or leave it out"
        )
    return next((builder for builder in reversed(fitting) if builder.is_rod), fitting[-1])


def _merged(nodes: list[Node]) -> tuple[Array, dict[int, int]]:
    """Merge coinciding nodes.

    Returns positions (n, 3), and the index of each node by its id.
    """
    from scipy.spatial import cKDTree  # slow import

    places = np.array([node.at for node in nodes])
    near = cKDTree(places).query_pairs(
        _SAME * float(np.ptp(places, axis=0).max()), output_type="ndarray"
    )
    links = coo_array(
        (np.ones(len(near)), (near[:, 0], near[:, 1])), shape=(len(nodes), len(nodes))
    )
    groups = connected_components(links, directed=False)[1]
    first, index = np.unique(groups, return_index=True)[1], np.empty(groups.max() + 1, dtype=int)
    order = np.sort(first)
    index[groups[order]] = np.arange(len(order))
    return places[order], {
        id(node): int(index[group]) for node, group in zip(nodes, groups, strict=True)
    }


def _pairs(pairs: list[Pair], index: dict[int, int]) -> Indices:
    found = np.array(
        [[index[id(end)] for end in pair.ends] for pair in pairs], dtype=np.intp
    ).reshape(-1, 2)
    for k in np.flatnonzero(found[:, 0] == found[:, 1]):
        raise pairs[k].entry.refusal(
            f"joins {pairs[k].ends[0].name} and {pairs[k].ends[1].name}, which are at one place"
        )
    return found


def _check_joints(
    path: Path,
    nodes: list[Node],
    index: dict[int, int],
    bars: Indices,
    strings: Indices,
    ball_joints: bool,
) -> None:
    """Reject strings without rods, and rods that NTRT welds together."""
    names: dict[int, list[str]] = {}
    for node in nodes:
        names.setdefault(index[id(node)], []).append(node.name)
    ends = np.bincount(bars.ravel(), minlength=len(names))
    for k in np.unique(strings)[ends[np.unique(strings)] == 0][:1].tolist():
        raise ValueError(
            f"{path}: node {names[k][0]} has strings, and no rod ends there, where NTRT has nothing to fix them to: give it a rod"
        )
    for k in np.flatnonzero(ends > 1)[: 0 if ball_joints else 1].tolist():
        where = f"node {' = '.join(dict.fromkeys(names[k]))}"
        cure = "give ball_joints=True to let them turn freely there"
        raise ValueError(
            f"{path}: {ends[k]} rods meet at {where}: NTRT welds them into one rigid body, which cannot be modelled; {cure}"
        )
