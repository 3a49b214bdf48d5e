"""Rods and strings of NTRT: the builders of their tags, and the structure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tenscasadi.exchange.ntrt.assembly import Assembly, NtrtNode, NtrtPair
from tenscasadi.exchange.ntrt.yaml_tree import YamlEntry
from tenscasadi.exchange.source import Source
from tenscasadi.schema.reading import SceneFileError
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import NEGLIGIBLE, Array, Indices

_ROD = {"radius": 0.5, "density": 1.0}  # NTRT's defaults, in its units
_STRING = {"stiffness": 1000.0, "damping": 10.0, "pretension": 0.0}
# classes, with their parameters that only concern contact, motors and records
_ROD_IGNORED = {"tgRodInfo": "friction roll_friction restitution"}
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
_IGNORED = {**_ROD_IGNORED, **_STRING_IGNORED}


@dataclass(frozen=True)
class TagBuilder:
    """Properties of tagged rods or strings, in NTRT's units.

    A class that is left out has none.
    """

    tags: frozenset[str]
    values: dict[str, float]

    @property
    def is_rod(self) -> bool:
        """Whether it builds rods."""
        return "density" in self.values


DEFAULT_BUILDERS = (
    TagBuilder(frozenset({"rod"}), _ROD),
    TagBuilder(frozenset({"string"}), _STRING),
)


def read_builder(tags: str, entry: YamlEntry) -> TagBuilder:
    """Read class and parameters of a builder. Raises SceneFileError."""
    own = frozenset(tags.split())
    given = dict(entry.items("class", "parameters"))
    classes = ", ".join(_IGNORED)
    if "class" not in given:
        raise entry.error(f"has no class: give one of {classes}")
    name = given["class"].word()
    if name not in _IGNORED:
        given["class"].leave_out(f"is {name!r} for {tags}: only {classes} can be modeled")
        return TagBuilder(own, {})
    values = dict(_ROD if name in _ROD_IGNORED else _STRING)
    parameters = given.get("parameters")
    for key, parameter in parameters.items(*values, *_IGNORED[name].split()) if parameters else ():
        if key in values:
            values[key] = parameter.number()
            if values[key] < 0 or (values[key] == 0 and key in ("radius", "stiffness")):
                least = "greater than" if key in ("radius", "stiffness") else "at least"
                raise parameter.error(f"is {values[key]:g} for {tags}: it must be {least} 0")
    return TagBuilder(own, values)


class StructureBuilder:
    """Builder of a structure from the pairs of an assembly."""

    def __init__(
        self, source: Source, whole: Assembly, builders: list[TagBuilder], ball_joints: bool
    ) -> None:
        self.source, self.builders, self.ball_joints = source, builders, ball_joints
        self.rods: list[tuple[NtrtPair, dict[str, float]]] = []
        self.strings: list[tuple[NtrtPair, dict[str, float]]] = []
        for part in whole.whole():
            for pair in part.pairs:
                builder = self._select(pair, part.name)
                if builder.values:
                    (self.rods if builder.is_rod else self.strings).append((pair, builder.values))
        if not self.rods and not self.strings:
            raise SceneFileError("it has no pairs in pair_groups or bond_groups", source.path.name)
        used = {id(node) for pair, _ in self.rods + self.strings for node in pair.ends}
        self.nodes = [node for node in whole.all_nodes() if id(node) in used]
        self.places, self.index = _merge_nodes(self.nodes)

    def _select(self, pair: NtrtPair, name: str) -> TagBuilder:
        """Select the last builder whose tags the pair has.

        Builders of rods take precedence. The name of the structure counts as a tag.
        """
        fitting = [builder for builder in self.builders if builder.tags <= pair.tags | {name}]
        if not fitting:
            tags = ", ".join(sorted(pair.tags))
            pair.entry.leave_out(
                f"has the tags {tags}, which no builder fits: NTRT builds nothing there, give it a builder or leave it out"
            )
            return TagBuilder(frozenset(), {})
        return next((builder for builder in reversed(fitting) if builder.is_rod), fitting[-1])

    def build(self, unit: float) -> Structure:
        """Build the structure."""
        bars, rods = self._read_members(self.rods)
        lines, strings = self._read_members(self.strings)
        self._check_joints(bars, lines)
        lengths, spans = (
            np.linalg.norm(self.places[pairs[:, 1]] - self.places[pairs[:, 0]], axis=1)
            for pairs in (bars, lines)
        )
        fixed = rods["density"] == 0
        density = np.where(fixed, _ROD["density"], rods["density"])
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
        try:
            return Structure(
                unit * np.stack([self.places[:, 0], 0.0 - self.places[:, 2], self.places[:, 1]], 1),
                bars,
                lines,
                # in kg for every unit of length; stiffness is in kg/s², and damping in kg/s
                bar_mass=np.pi * rods["radius"] ** 2 * lengths * density,
                bar_radius=unit * rods["radius"],
                stiffness=strings["stiffness"],
                damping=strings["damping"],
                rest_length=unit * rest,
                pinned=np.unique(bars[fixed]).tolist(),
            )
        except ValueError as error:
            raise SceneFileError(str(error), self.source.path.name) from error

    def _read_members(
        self, members: list[tuple[NtrtPair, dict[str, float]]]
    ) -> tuple[Indices, dict[str, Array]]:
        """Read the nodes of members, and their properties; repeated ones are left out."""
        pairs: list[list[int]] = []
        values: list[dict[str, float]] = []
        is_rod = members is self.rods
        kept = []
        for pair, own in members:
            ends = [self.index[id(end)] for end in pair.ends]
            if ends[0] == ends[1]:
                names = " and ".join(end.name for end in pair.ends)
                pair.entry.leave_out(f"joins {names}, which are at one place")
            elif is_rod and sorted(ends) in map(sorted, pairs):
                pair.entry.leave_out("is a rod that is given twice: leave one out")
            else:
                pairs.append(ends)
                values.append(own)
                kept.append((pair, own))
        members[:] = kept
        columns = {
            key: np.array([own[key] for own in values], dtype=float)
            for key in (_ROD if is_rod else _STRING)
        }
        return np.array(pairs, dtype=np.intp).reshape(-1, 2), columns

    def _check_joints(self, bars: Indices, strings: Indices) -> None:
        """Reject strings without rods, and rods that NTRT welds together."""
        names: dict[int, list[str]] = {}
        for node in self.nodes:
            names.setdefault(self.index[id(node)], []).append(node.name)
        name = self.source.path.name
        ends = np.bincount(bars.ravel(), minlength=len(names))
        for k in np.unique(strings)[ends[np.unique(strings)] == 0][:1].tolist():
            reason = "NTRT has nothing to fix them to"
            raise SceneFileError(
                f"node {names[k][0]} has strings, and no rod ends there: {reason}, give it a rod",
                name,
            )
        for k in np.flatnonzero(ends > 1).tolist():
            where = f"node {' = '.join(dict.fromkeys(names[k]))}"
            message = f"{ends[k]} rods meet at {where}: NTRT welds them into one rigid body"
            if not self.ball_joints:
                cure = "give ball_joints=True to let them turn freely there"
                raise SceneFileError(f"{message}, which cannot be modeled; {cure}", name)
            self.source.note(f"{message}, here they turn freely")


def _merge_nodes(nodes: list[NtrtNode]) -> tuple[Array, dict[int, int]]:
    """Merge coinciding nodes.

    Returns positions (n, 3), and the index of each node by its id.
    """
    from scipy.spatial import cKDTree  # slow import

    places = np.array([node.at for node in nodes])
    near = cKDTree(places).query_pairs(
        NEGLIGIBLE * float(np.ptp(places, axis=0).max()), output_type="ndarray"
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
