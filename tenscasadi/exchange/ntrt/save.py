"""Export of structures to NTRT's YAML files."""

from __future__ import annotations

import warnings
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from tenscasadi.exchange.ntrt.body_rods import Rod, find_body_rods
from tenscasadi.exchange.ntrt.yaml_tree import LARGEST_ENTRY
from tenscasadi.structure.class_one import measure_diagonal, measure_extent
from tenscasadi.structure.names import name_errors
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import NEGLIGIBLE, FilePath, file_path, instance, positive_number
from tenscasadi.util.whole_file import whole_file

_ROD, _BOX, _STRING = "tgRodInfo", "tgBoxInfo", "tgBasicActuatorInfo"


def save_ntrt(structure: Structure, path: FilePath, *, length_unit: float = 1.0) -> Path:
    """Write a structure for NASA's Tensegrity Robotics Toolkit (NTRT).

    The file contains nodes, pair_groups and builders. Bars become rods (tgRodInfo), and strings
    become actuators (tgBasicActuatorInfo) with stiffness, damping and pretension. Members with the
    same properties share a builder. A rigid body becomes rods with its mass, center and inertia,
    which NTRT welds to each other. Rods and boxes of density 0 hold pinned nodes. The z axis
    becomes NTRT's y axis, which points up.

    Parameters
    ----------
    structure : Structure
        The structure.
    path : str or PathLike
        File to write, such as ``"prism.yaml"``; no suffix is added.
    length_unit : float
        Unit of length in the file [m]. NTRT's gravity is then 9.81/length_unit.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong, or strings end at a node that neither bars, bodies nor pins hold.
    OSError
        The file cannot be written.

    Warns
    -----
    UserWarning
        NTRT lacks a feature of the structure, such as ball joints, rollers or cables; it is listed
        with its counterpart in the file.

    See Also
    --------
    load_ntrt : Read such a file: with ``ball_joints=False`` if it contains bodies.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> prism = tc.shapes.prism(bar_radius=0.01, prestress=10.0)
    >>> again = tc.load_ntrt(tc.save_ntrt(prism, "prism.yaml"))
    >>> bool(abs(again.rest_length - prism.rest_length).max() < 1e-12)
    True
    """
    instance("structure", structure, Structure, "a tenscasadi.Structure")
    unit = positive_number("length_unit", length_unit)
    target = file_path("path", path)
    writer = _NtrtWriter(structure, unit)
    text = writer.write()
    with whole_file(target) as file:
        file.write(text.encode())
    if writer.changes:
        told = "; ".join(writer.changes)
        warnings.warn(f"{target.name} differs from the structure: {told}", stacklevel=2)
    return target


class _NtrtWriter:
    """State of an NTRT export: points, pairs by builder, and changes."""

    def __init__(self, structure: Structure, unit: float) -> None:
        self.structure, self.unit = structure, unit
        self.points = list(structure.nodes)
        self.pairs: dict[tuple[str, str], list[tuple[int, int]]] = defaultdict(list)
        self.parts: list[list[str]] = [[] for _ in self.points]  # rigid parts of each node
        self.changes: list[str] = []

    def write(self) -> str:
        """Build the text of the NTRT file.

        Raises ValueError.
        """
        self._list_missing()
        pinned = self.structure.fixed.all(axis=1)
        self._add_bars(pinned)
        self._add_bodies()
        self._add_pins(np.flatnonzero(pinned).tolist())
        self._check_nodes()
        self._add_strings()
        return self._format()

    def _list_missing(self) -> None:
        """Report features of the structure that NTRT lacks."""
        s = self.structure
        partly = [node for node, axes in s.pinned.items() if axes != "xyz"]
        self._note("node", [*partly, *s.rollers], "free, as NTRT only fixes whole rods")
        self._note("node", np.flatnonzero(s.node_mass), "without node_mass")
        self._note("bar", np.flatnonzero(s.elastic), "rigid, in place of bar_stiffness")
        self._note("string", np.flatnonzero(s.string_mass + s.coupled_mass), "without mass")
        self._note("cable", range(len(s.cables)), "as single strings that do not slide")
        if s.cable_friction.any():
            self._note("cable", np.flatnonzero(s.cable_friction), "without friction")

    def _note(self, kind: str, items: Iterable[Any], change: str) -> None:
        """Report a change of some nodes or members.

        `kind` is "node", "bar" or the like, and `items` are their numbers. `change` describes the
        change.
        """
        numbers = [str(item) for item in items]
        if numbers:
            more = f" and {len(numbers) - 5} more" * (len(numbers) > 5)
            plural = "s" * (len(numbers) > 1)
            self.changes.append(f"{kind}{plural} {', '.join(numbers[:5])}{more} {change}")

    def _add_rod(self, rod: Rod, fixed: bool = False) -> None:
        a, b = rod.nodes
        length = float(np.linalg.norm(self.points[b] - self.points[a])) / self.unit
        radius = rod.radius / self.unit
        density = 0.0 if fixed else rod.mass / (np.pi * radius**2 * length)
        self._add(_ROD, {"density": density, "radius": radius}, rod.nodes)

    def _add(self, kind: str, values: dict[str, float], nodes: tuple[int, int]) -> None:
        for key, value in values.items():
            if not value < LARGEST_ENTRY:
                raise ValueError(
                    f"length_unit is {self.unit:g}: with it a {key} is {value:g}, give another unit"
                )
        parameters = ", ".join(f"{key}: {value:.14g}" for key, value in values.items())
        self.pairs[kind, parameters].append(nodes)

    def _add_bars(self, pinned: Any) -> None:
        s = self.structure
        fixed: Any = pinned[s.bars].all(axis=1)
        for k, (a, b) in enumerate(s.bars.tolist()):
            radius = float(s.bar_radius[k]) or float(s.bar_lengths[k]) / 100
            self._add_rod(Rod((a, b), float(s.bar_mass[k]), radius), bool(fixed[k]))
            for node in (a, b):
                self.parts[node].append("the ground" if fixed[k] else f"bar {k}")
        thin = np.flatnonzero(s.bar_radius == 0)
        self._note("bar", thin, "with the radius length/100, in place of 0")
        self._note("bar", np.flatnonzero(fixed), "without mass, between pinned nodes")

    def _add_bodies(self) -> None:
        for k, body in enumerate(self.structure.bodies):
            own = list(body.nodes)
            wanted = body.mass_properties(self.structure.nodes[own])
            points, rods = find_body_rods(self.structure.nodes[own], wanted)
            for node in own:
                self.parts[node].append(f"body {k}")
            if more := points[len(own) :].tolist():
                own += range(len(self.points), len(self.points) + len(more))
                self.points += map(np.array, more)
                self._note("body", [k], f"with {len(more)} more nodes, for its inertia")
            for rod in rods:
                a, b = rod.nodes
                self._add_rod(Rod((own[a], own[b]), rod.mass, rod.radius))
            if len(rods) == 1:
                self._note("body", [k], "as a single rod, which is read as a bar")

    def _add_pins(self, pinned: list[int]) -> None:
        """Fix pinned nodes by boxes of density 0."""
        loose = [node for node in pinned if "the ground" not in self.parts[node]]
        for node in loose:
            self.parts[node].append("the ground")
        if len(loose) % 2:
            loose.append(len(self.points))
            self.points.append(self.points[loose[0]] - np.array([0.0, 0.0, self._width()]))
            self._note("node", loose[:1], "with one more pinned node below")
        width = self._width() / 100 / self.unit
        for pair in zip(loose[::2], loose[1::2], strict=True):
            self._add(_BOX, {"density": 0.0, "width": width, "height": width}, pair)

    def _width(self) -> float:
        return measure_diagonal(self.structure.nodes) / 100 or 1.0

    @name_errors
    def _check_nodes(self) -> None:
        """Reject strings without rods, and report joints and omitted nodes."""
        s = self.structure
        used = np.unique(s.strings)
        for node in used:
            if not self.parts[node]:
                raise ValueError(
                    f"node {node} has strings, but no bar, body or pin: NTRT ties strings to rods, give it one"
                )
        for a, b in sorted(self._find_coinciding()):
            self.changes.append(f"nodes {a} and {b} at one place are one node")
        alone = [node for node, parts in enumerate(self.parts) if not parts]
        self._note("node", alone, "left out, without members")
        if not self.pairs:
            raise ValueError("structure has no bars, bodies or pins: NTRT needs one of them")
        for node, parts in enumerate(map(dict.fromkeys, self.parts)):
            if len(parts) > 1:
                joined = ", ".join(parts)
                self.changes.append(f"node {node} welds {joined}, in place of a ball joint")

    def _find_coinciding(self) -> set[tuple[int, int]]:
        """Find pairs of nodes that NTRT merges."""
        from scipy.spatial import cKDTree  # slow import

        points = np.array(self.points)
        return cKDTree(points).query_pairs(  # type: ignore[no-any-return]
            NEGLIGIBLE * measure_extent(points)
        )

    def _add_strings(self) -> None:
        s = self.structure
        force = s.stiffness * (s.string_lengths - s.rest_length) / self.unit
        for k, (a, b) in enumerate(s.strings.tolist()):
            if s.stiffness[k] > 0:
                values = {"stiffness": s.stiffness[k], "damping": s.damping[k]}
                self._add(_STRING, {**values, "pretension": max(force[k], 0.0)}, (a, b))
        self._note("string", np.flatnonzero(s.stiffness <= 0), "left out, without stiffness")
        slack = (s.rest_length > (1 + NEGLIGIBLE) * s.string_lengths) & (s.stiffness > 0)
        self._note("string", np.flatnonzero(slack), "without slack, which NTRT lacks")

    def _format(self) -> str:
        used = sorted({node for pairs in self.pairs.values() for pair in pairs for node in pair})
        lines = ["nodes:"]
        for node in used:
            x, y, z = self.points[node] / self.unit
            lines.append(f"  n{node}: [{x:.15g}, {z:.15g}, {0.0 - y:.15g}]")
        names = {_ROD: "rod", _BOX: "box", _STRING: "string"}
        tags = {key: f"{names[key[0]]}_{k}" for k, key in enumerate(self.pairs)}
        lines.append("pair_groups:")
        for key, pairs in self.pairs.items():
            lines += [f"  {tags[key]}:", *(f"    - [n{a}, n{b}]" for a, b in pairs)]
        lines.append("builders:")
        for key, tag in tags.items():
            lines += [f"  {tag}:", f"    class: {key[0]}", f"    parameters: {{{key[1]}}}"]
        return "\n".join([*lines, ""])
