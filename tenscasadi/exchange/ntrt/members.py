"""Conversion of NTRT's rods, boxes and strings to a structure."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tenscasadi.exchange.ntrt.assembly import Assembly, NtrtNode, NtrtPair
from tenscasadi.exchange.ntrt.rigid_groups import RigidPart, combine_mass, group_parts
from tenscasadi.exchange.ntrt.yaml_tree import YamlEntry
from tenscasadi.exchange.source import Source
from tenscasadi.schema.reading import SceneFileError
from tenscasadi.structure.class_one import distances, measure_extent
from tenscasadi.structure.rigid_body import RigidBody
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import NEGLIGIBLE, Array, Indices

_ROD = {"radius": 0.5, "density": 1.0}  # NTRT's defaults, in its units
_BOX = {"width": 1.0, "height": 1.0, "density": 1.0}  # half the width, and half the height
_STRING = {"stiffness": 1000.0, "damping": 10.0, "pretension": 0.0}
# classes, with their parameters that only concern contact, motors and records
_RIGID_IGNORED = dict.fromkeys(["tgRodInfo", "tgBoxInfo"], "friction roll_friction restitution")
_STRING_IGNORED = dict.fromkeys(
    [
        "tgBasicActuatorInfo",
        "tgKinematicActuatorInfo",
        "tgBasicContactCableInfo",
        "tgKinematicContactCableInfo",
    ],
    "history max_tension target_velocity min_actual_length min_rest_length rotation radius "
    "moveCablePointAToEdge moveCablePointBToEdge motor_friction motor_inertia back_drivable",
)
_IGNORED = {**_RIGID_IGNORED, **_STRING_IGNORED}
_DEFAULTS = {"tgRodInfo": _ROD, "tgBoxInfo": _BOX}  # strings have _STRING
_POSITIVE = ("radius", "stiffness", "width", "height")


@dataclass(frozen=True)
class TagBuilder:
    """Properties of tagged rods, boxes or strings, in NTRT's units.

    `tags` select the members, and `values` are the properties by NTRT's names. A class that is not
    imported has no values.
    """

    tags: frozenset[str]
    values: dict[str, float]

    @property
    def is_rigid(self) -> bool:
        """Whether it describes rods or boxes."""
        return "density" in self.values


DEFAULT_BUILDERS = (
    TagBuilder(frozenset({"rod"}), _ROD),
    TagBuilder(frozenset({"box"}), _BOX),
    TagBuilder(frozenset({"string"}), _STRING),
)


def read_builder(tags: str, entry: YamlEntry) -> TagBuilder:
    """Read class and parameters of an NTRT builder.

    `tags`, separated by spaces, select its members. Raises SceneFileError.
    """
    own = frozenset(tags.split())
    given = dict(entry.items("class", "parameters"))
    classes = ", ".join(_IGNORED)
    if "class" not in given:
        raise entry.error(f"has no class: give one of {classes}")
    name = given["class"].word()
    if name not in _IGNORED:
        given["class"].leave_out(f"is {name!r} for {tags}: only {classes} can be modeled")
        return TagBuilder(own, {})
    values = dict(_DEFAULTS.get(name, _STRING))
    parameters = given.get("parameters")
    for key, parameter in parameters.items(*values, *_IGNORED[name].split()) if parameters else ():
        if key in values:
            values[key] = parameter.number()
            if values[key] < 0 or (values[key] == 0 and key in _POSITIVE):
                least = "greater than" if key in _POSITIVE else "at least"
                raise parameter.error(f"is {values[key]:g} for {tags}: it must be {least} 0")
    return TagBuilder(own, values)


class StructureBuilder:
    """Builder of a structure from NTRT's pairs of nodes."""

    def __init__(
        self, source: Source, whole: Assembly, builders: list[TagBuilder], ball_joints: bool
    ) -> None:
        self.source, self.builders, self.ball_joints = source, builders, ball_joints
        self.rigid: list[tuple[NtrtPair, dict[str, float]]] = []  # rods and boxes
        self.strings: list[tuple[NtrtPair, dict[str, float]]] = []
        for part in whole.whole():
            for pair in part.pairs:
                builder = self._select(pair, part.name)
                if builder.values:
                    members = self.rigid if builder.is_rigid else self.strings
                    members.append((pair, builder.values))
        if not self.rigid and not self.strings:
            raise SceneFileError("it has no pairs in pair_groups or bond_groups", source.path.name)
        used = {id(node) for pair, _ in self.rigid + self.strings for node in pair.ends}
        self.nodes = [node for node in whole.all_nodes() if id(node) in used]
        self.places, self.index = _merge_nodes(self.nodes)

    def _select(self, pair: NtrtPair, name: str) -> TagBuilder:
        """Select the last builder whose tags a pair has.

        Builders of rods and boxes take precedence. The name of the structure counts as a tag.
        """
        fitting = [builder for builder in self.builders if builder.tags <= pair.tags | {name}]
        if not fitting:
            tags = ", ".join(sorted(pair.tags))
            pair.entry.leave_out(
                f"has the tags {tags}, which no builder fits: NTRT builds nothing there, give it a builder or leave it out"
            )
            return TagBuilder(frozenset(), {})
        return next((builder for builder in reversed(fitting) if builder.is_rigid), fitting[-1])

    def build(self, unit: float) -> Structure:
        """Build the structure.

        Lengths of the file are in units of `unit` m.
        """
        nodes = unit * np.stack(
            [self.places[:, 0], 0.0 - self.places[:, 2], self.places[:, 1]], axis=1
        )
        parts = self._read_parts(nodes, unit)
        lines, strings = self._read_strings()
        self._check_joints(parts, lines)
        rest = self._rest_lengths(lines, strings)
        bars, pinned, bodies = [], set[int](), []
        for group in group_parts(parts, not self.ball_joints):
            rods = [part for part in group if part.sides is None]
            if not any(part.density for part in group):  # NTRT holds them in place
                pinned.update(node for part in group for node in part.nodes)
                bars += rods
            elif len(group) == len(rods) == 1:
                bars += rods
            else:
                own = list(dict.fromkeys(node for part in group for node in part.nodes))
                corners = np.concatenate([part.corners() for part in group])
                own += range(len(nodes), len(nodes) + len(corners))
                nodes = np.concatenate([nodes, corners])
                mass = combine_mass(group)
                inertia = np.trace(mass.moments) * np.eye(3) - mass.moments
                bodies.append((own, mass.mass, mass.center, inertia))
        masses = [(part if part.density else replace(part, density=unit**-3)) for part in bars]
        try:
            return Structure(
                nodes,
                [part.nodes for part in bars],
                lines,
                bar_mass=[part.mass_properties().mass for part in masses],
                bar_radius=[part.radius for part in bars],
                stiffness=strings["stiffness"],  # kg/s²; damping is in kg/s
                damping=strings["damping"],
                rest_length=unit * rest,
                pinned=sorted(pinned),
                bodies=[RigidBody(*body) for body in bodies],
            )
        except ValueError as error:
            raise SceneFileError(str(error), self.source.path.name) from error

    def _read_parts(self, nodes: Array, unit: float) -> list[RigidPart]:
        """Read rods and boxes.

        `nodes` (n, 3) are in m, and `unit` is NTRT's unit of length in m. Repeated ones that are
        not welded are omitted.
        """
        found: list[RigidPart] = []
        known = set[frozenset[int]]()
        for pair, own in self.rigid:
            ends = self._find_ends(pair)
            if ends is None:
                continue
            if self.ball_joints and frozenset(ends) in known:
                pair.entry.leave_out("is a rod or box that is given twice: leave one out")
                continue
            known.add(frozenset(ends))
            box = (unit * own["width"], unit * own["height"]) if "width" in own else None
            density = own["density"] / unit**3  # masses are in kg for every unit of length
            radius = unit * own.get("radius", 0.0)
            found.append(RigidPart(ends, nodes[list(ends)], density, radius, box))
        return found

    def _read_strings(self) -> tuple[Indices, dict[str, Array]]:
        """Read the nodes of strings, and their properties.

        Nodes are (k, 2), and properties (k,) by name.
        """
        members = [(pair, self._find_ends(pair), own) for pair, own in self.strings]
        kept = [(pair, ends, own) for pair, ends, own in members if ends is not None]
        self.strings = [(pair, own) for pair, _, own in kept]
        columns = {key: np.array([own[key] for *_, own in kept], dtype=float) for key in _STRING}
        return np.array([ends for _, ends, _ in kept], dtype=np.intp).reshape(-1, 2), columns

    def _find_ends(self, pair: NtrtPair) -> tuple[int, int] | None:
        """Find the two nodes of a pair.

        Returns None if they coincide; the pair is then omitted.
        """
        a, b = (self.index[id(end)] for end in pair.ends)
        if a == b:
            names = " and ".join(end.name for end in pair.ends)
            pair.entry.leave_out(f"joins {names}, which are at one place")
            return None
        return a, b

    def _rest_lengths(self, lines: Indices, strings: dict[str, Array]) -> Array:
        """Compute rest lengths, in the unit of the file, from pretensions.

        `lines` (k, 2) are the strings' nodes, and `strings` their properties (k,) by name.
        """
        spans = distances(self.places, lines)
        rest = spans - strings["pretension"] / strings["stiffness"]
        for k in np.flatnonzero(rest <= 0):
            pretension = (
                f"has the pretension {strings['pretension'][k]:g} on a length of {spans[k]:g}"
            )
            most = strings["stiffness"][k] * spans[k]
            self.strings[k][0].entry.leave_out(
                f"{pretension}: it must be less than {most:g}, stiffness times length"
            )
            rest[k] = 0.01 * spans[k]
        return np.asarray(rest)

    def _check_joints(self, parts: list[RigidPart], strings: Indices) -> None:
        """Reject strings without rods, and report joints that NTRT welds.

        `parts` are the rods and boxes, and `strings` (k, 2) the strings' nodes.
        """
        names: dict[int, list[str]] = {}
        for node in self.nodes:
            names.setdefault(self.index[id(node)], []).append(node.name)
        held = np.array([part.nodes for part in parts], dtype=np.intp).ravel()
        ends = np.bincount(held, minlength=len(names))
        for k in np.unique(strings)[ends[np.unique(strings)] == 0][:1].tolist():
            reason = "NTRT has nothing to fix them to"
            raise SceneFileError(
                f"node {names[k][0]} has strings, and no rod ends there: {reason}, give it a rod",
                self.source.path.name,
            )
        for k in np.flatnonzero(ends > 1).tolist() if self.ball_joints else ():
            where = f"node {' = '.join(dict.fromkeys(names[k]))}"
            message = f"{ends[k]} rods meet at {where}: NTRT welds them into one rigid body"
            self.source.note(f"{message}, as ball_joints=False does; here they turn freely")


def _merge_nodes(nodes: list[NtrtNode]) -> tuple[Array, dict[int, int]]:
    """Merge coinciding nodes.

    Returns positions (n, 3), and the index of each node by its Python id.
    """
    from scipy.spatial import cKDTree  # slow import

    places = np.array([node.at for node in nodes])
    near = cKDTree(places).query_pairs(NEGLIGIBLE * measure_extent(places), output_type="ndarray")
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
