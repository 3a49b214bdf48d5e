"""Import of structures from NTRT's YAML files."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from tenscasadi.exchange.ntrt.assembly import (
    Assembly,
    NtrtNode,
    NtrtPair,
    bond_edges,
    place_children,
)
from tenscasadi.exchange.ntrt.members import (
    DEFAULT_BUILDERS,
    StructureBuilder,
    TagBuilder,
    read_builder,
)
from tenscasadi.exchange.ntrt.yaml_tree import YamlEntry, read_tree
from tenscasadi.exchange.source import Source
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import MAX_COUNT, FilePath, file_path, flag, positive_number


def load_ntrt(
    path: FilePath,
    *,
    length_unit: float = 1.0,
    ball_joints: bool = True,
    folder: FilePath | None = None,
    strict: bool = True,
) -> Structure:
    """Read a structure from NASA's Tensegrity Robotics Toolkit (NTRT).

    Its YAML files contain nodes, pair_groups, builders, substructures and bond_groups (node_node
    and node_edge). Rods become bars of mass π r² l ρ, boxes become rigid bodies with their corners
    as additional nodes. Rods and boxes of density 0 are pinned. Strings of every class become
    elastic strings with the rest length l − pretension/stiffness. The y axis points up in NTRT and
    the z axis here: (x, y, z) becomes (x, −z, y). Strings end at nodes, whereas NTRT moves their
    ends to the surfaces of rods. Motors, contact and friction are ignored. It requires
    ``pip install 'tenscasadi[exchange]'``.

    Parameters
    ----------
    path : str or PathLike
        The file.
    length_unit : float
        NTRT's unit of length [m], which its files do not state. It is 0.1 if the gravity is 98.1,
        and 0.01 if the gravity is 981. Mass is in kg.
    ball_joints : bool
        Whether a ball joint connects rods that share a node, with a warning. If False, they form
        one `RigidBody` without bars, as in NTRT.
    folder : str or PathLike, optional
        Folder that must contain the files of substructures. Default: that above the file.
    strict : bool
        Whether entries without a counterpart are errors. Otherwise they are left out, and a warning
        lists them.

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
        PyYAML is not installed.
    TypeError, ValueError
        An argument is wrong, or an entry of the file cannot be read or modeled; the message names
        file, line, key and value.

    Warns
    -----
    InexactImportWarning
        Entries were left out or changed, which it lists.

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
    source = Source(path, strict)
    above = source.path.absolute().parent.parent if folder is None else file_path("folder", folder)
    reader = _NtrtReader(source, above.resolve())
    whole = reader.read(source.path, "", ())
    structure = StructureBuilder(source, whole, reader.builders, ball_joints).build(unit)
    source.report()
    return structure


@dataclass
class _NtrtReader:
    """State of an NTRT import.

    `builders` define the properties of members, and later ones take precedence. `folder` contains
    all files, `trees` the parsed ones, and `count` is the number of items.
    """

    source: Source
    folder: Path
    builders: list[TagBuilder] = field(default_factory=lambda: list(DEFAULT_BUILDERS))
    trees: dict[Path, YamlEntry] = field(default_factory=dict)
    count: int = 0

    def read(self, path: Path, name: str, above: tuple[Path, ...]) -> Assembly:
        """Read an NTRT file `path` and its substructures.

        `name` is that of the structure. The files `above` include this one, directly or indirectly.
        Raises SceneFileError.
        """
        if path not in self.trees:
            self.trees[path] = read_tree(self.source, path)
        root = self.trees[path]
        parts = dict(root.items("nodes", "pair_groups", "builders", "substructures", "bond_groups"))
        whole = Assembly(name)
        if "substructures" in parts:
            self._read_substructures(whole, parts["substructures"], (*above, path))
        if "builders" in parts:
            self.builders += [
                read_builder(tags, entry) for tags, entry in parts["builders"].items()
            ]
        for key, entry in parts["nodes"].items() if "nodes" in parts else ():
            whole.nodes.append(NtrtNode(key, entry.vector()))
        self._add_count(len(whole.nodes) + 1, root)
        for tags, pairs in parts["pair_groups"].items() if "pair_groups" in parts else ():
            self._add_count(len(pairs.parts()), pairs)
            own = frozenset(tags.split())
            whole.pairs += [_read_pair(row, (whole, whole), own) for row in pairs.parts()]
        if "bond_groups" in parts:
            self._read_bonds(whole, parts["bond_groups"])
        return whole

    def _add_count(self, more: int, entry: YamlEntry) -> None:
        self.count += more
        if self.count > MAX_COUNT:
            raise entry.error(f"makes more than {MAX_COUNT} nodes, pairs and substructures")

    def _read_substructures(
        self, whole: Assembly, entry: YamlEntry, above: tuple[Path, ...]
    ) -> None:
        """Read the substructures of the structure `whole` from their entry.

        Keys without a path change the substructures of other keys. The files `above` include this
        one, directly or indirectly.
        """
        groups = [
            (
                key.split("/"),
                dict(given.items("path", "rotation", "translation", "scale", "offset")),
            )
            for key, given in entry.items()
        ]
        for names, attributes in groups:
            if "path" in attributes:
                path = self._resolve(attributes["path"], above)
                whole.children += [self.read(path, name, above) for name in names]
        known = {child.name for child in whole.children}
        for key, given in entry.items():
            if not known.issuperset(key.split("/")):
                raise given.error("has no path: give that of its file")
        place_children(whole, groups)

    def _resolve(self, entry: YamlEntry, above: tuple[Path, ...]) -> Path:
        """Resolve the path of a substructure's file.

        `entry` has this path as text. The file must lie in the folder. It must be none of the files
        `above`, which include it.
        """
        path = entry.path.parent / entry.word()
        whole = path.resolve()
        if not whole.is_relative_to(self.folder) or whole.suffix.lower() not in (".yaml", ".yml"):
            raise entry.error(
                f"is {entry.format()}: give a .yaml file in {self.folder}, or another folder by load_ntrt(..., folder=...)"
            )
        if not whole.is_file():
            raise entry.error(f"is {entry.format()}: there is no such file")
        if whole in {file.resolve() for file in above} or len(above) > 20:
            raise entry.error(
                f"is {entry.format()}, which contains itself, or more than 20 levels of substructures"
            )
        return path

    def _read_bonds(self, whole: Assembly, entry: YamlEntry) -> None:
        """Read the bonds between substructures of `whole` from their entry.

        Bonds are nested in tags, or tags in bonds. A key with a slash is a bond, such as
        "leg/foot/node_node".
        """
        for outer, inside in entry.items():
            for inner, pairs in inside.items():
                if ("/" in outer) == ("/" in inner):
                    raise pairs.error(
                        f"stands in {outer}: give tags and a bond, such as leg/foot/node_node, one in the other"
                    )
                bond, tags = (outer, inner) if "/" in outer else (inner, outer)
                *names, kind = bond.split("/")
                if len(names) < 2 or kind not in ("node_node", "node_edge"):
                    raise pairs.error(
                        f"is of the bond {bond}: give two substructures or more and node_node or node_edge, such as leg/foot/node_node"
                    )
                own = frozenset(tags.split())
                for first, second in pairwise(names):
                    self._add_count(2 * len(pairs.parts()), pairs)
                    if kind == "node_edge":
                        bond_edges(whole, (first, second), pairs, own, self._is_rod)
                    else:
                        parts = whole.child(first, pairs), whole.child(second, pairs)
                        more = own | {first, second, f"{first}/{second}"}  # as in NTRT
                        whole.pairs += [_read_pair(row, parts, more) for row in pairs.parts()]

    def _is_rod(self, pair: NtrtPair) -> bool:
        return any(builder.is_rigid and builder.tags <= pair.tags for builder in self.builders)


def _read_pair(row: YamlEntry, parts: tuple[Assembly, Assembly], tags: frozenset[str]) -> NtrtPair:
    first, second = (
        part.node(word.word(), word) for part, word in zip(parts, row.parts(2), strict=True)
    )
    return NtrtPair((first, second), tags, row)
