"""Import of scenes from MuJoCo."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from tenscasadi.exchange.mjcf.bodies import Bodies, Site
from tenscasadi.exchange.mjcf.body_tree import build_tree
from tenscasadi.exchange.mjcf.contact import ContactWeights, contact_weights
from tenscasadi.exchange.mjcf.elements import Element, read_elements
from tenscasadi.exchange.mjcf.frames import Units
from tenscasadi.exchange.mjcf.geoms import RodGeom
from tenscasadi.exchange.mjcf.grounds import read_contacts
from tenscasadi.exchange.mjcf.members import Endpoint, PieceEnds, drop_duplicates, order_by_number
from tenscasadi.exchange.mjcf.strings import TendonString, read_control, read_strings
from tenscasadi.exchange.mjcf.words import Defaults, check, children
from tenscasadi.exchange.source import Source
from tenscasadi.scene.control import Control
from tenscasadi.scene.loads import Gravity
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import Clip, Linear
from tenscasadi.schema.reading import SceneFileError
from tenscasadi.structure.rigid_body import RigidBody
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import FILE_ROUNDING, Array, FilePath

Side = tuple[int, Array]  # a piece, and a position in it


def import_mjcf(path: FilePath, *, strict: bool = True) -> Scene:
    """Read a tensegrity from MuJoCo's XML, MJCF.

    Bodies with two ends become bars, and bodies with one end point masses. Bodies with three or
    more attached points that are not on a line become rigid bodies. Spatial tendons between two
    sites become strings, and those through more sites cables without friction. Ball joints and
    ``connect`` become nodes that bars share. A hinge becomes two nodes on its axis, which two rigid
    bodies share or which are pinned. Bodies that ``weld`` or nesting fixes to each other are one
    body. Features without a counterpart in a scene are rejected by name, or omitted.

    Parameters
    ----------
    path : str or path
        The file. Nothing in it is executed. Files that ``include`` names must be in its folder.
    strict : bool
        Whether features without a counterpart are errors. Otherwise they are left out or replaced
        by similar ones, and a warning lists them.

    Returns
    -------
    Scene
        The structure in MuJoCo's reference configuration, its gravity, control and grounds.

    Raises
    ------
    SceneFileError
        The file is not MJCF, or has a feature without a counterpart; the message names file, line,
        element, value and cure.
    OSError
        The file does not exist.

    Warns
    -----
    InexactImportWarning
        Features were left out or replaced, which it lists.

    Notes
    -----
    - The ends of a bar are the points of its strings and joints, or the ends of its longest geom.
      Masses at the ends become node masses. The radius follows from the transverse inertia of all
      its geoms. An inertia below that of a thin rod is rejected.
    - A tendon with two spring lengths, the first of them 0, becomes a string with `Clip`. A tendon
      with one spring length has the law `Linear`. Damped tendons also damp while they are slack in
      MuJoCo; here only strings with `Linear` do.
    - Position actuators on all tendons become control by rest lengths, and integrators such as
      ``intvelocity`` control by their rates. Initial rest lengths are those of the first key. Forces
      become control by tensions or force densities, and by rest lengths beside springs. Control
      ranges are ignored, because they are bounds of a plan.
    - Nodes touch the ground. Spheres, capsules and cylinders that end at a node give its distance.
      A capsule with the radius of its bar makes it one of `Ground.bars`. A contact time constant
      becomes the stiffness for the mean mass. A `pair` of two such capsules becomes `BarContact`.
      Other contacts between bodies, velocities of keys, step and solver are ignored.
    - If not `strict`, attached points move to the nearer end of their bar. Hinges that slide become
      balls, and boxes are bars along their longest side. Actuators with affine forces become
      control by rest lengths, and tendons without actuator are controlled, too. Limits, friction of
      joints and activation dynamics are left out.

    Nodes, bars and strings keep the numbers in the names of `export_mjcf`. Others, and strings of
    files with cables, are numbered in the order of the file.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> path = tc.export_mjcf(tc.Scene(tc.shapes.prism(), gravity=tc.Gravity()), "prism.xml")
    >>> tc.import_mjcf(path).structure
    Structure(6 nodes, 3 bars, 9 strings, 0 pinned)
    """
    source = Source(path, strict)
    root = read_elements(source)
    if root.tag != "mujoco":
        raise root.error("is no MJCF: give a file whose first element is <mujoco>")
    compiler, option = _read_settings(check(root))
    defaults = Defaults(root)
    sequence = compiler.text("eulerseq", "xyz")
    if len(sequence) != 3 or not set(sequence.lower()) <= set("xyz"):
        raise compiler.error(f"is {sequence!r}: give three of x, y, z", "eulerseq")
    units = Units(
        compiler.word("angle", "degree", "degree", "radian") == "degree",
        sequence,
        compiler.word("coordinate", "local", "local", "global") == "global",
    )
    bodies = Bodies(root, defaults, units, compiler.flag("inertiafromgeom"))
    ties = _read_ties(root, defaults, bodies, option)
    strings = read_strings(root, defaults, bodies)
    control, tendons = read_control(root, defaults, strings)
    strings = [part for tendon in tendons for part in tendon.divide()]
    try:
        builder = _SceneBuilder(bodies, strings, ties)
        scene = builder.build(root, defaults, option, control)
    except SceneFileError:
        raise
    except (TypeError, ValueError) as error:
        raise SceneFileError(str(error), root.file, root.line, "<mujoco>") from error
    source.report()
    return scene


def _read_settings(root: Element) -> tuple[Element, Element]:
    """Merge the compiler and solver settings of a file.

    Returns one `compiler` and one `option` element. Raises SceneFileError.
    """
    merged = []
    sections = list(children(root))
    for tag in ("compiler", "option"):
        found = root.replace({})
        for element in (section for section in sections if section.tag == tag):
            flags = {
                f"flag {name}": value
                for child in children(element)
                for name, value in check(child).attributes.items()
            }
            found = check(element).replace({**found.attributes, **element.attributes, **flags})
        merged.append(found)
    return merged[0], merged[1]


def _read_ties(
    root: Element, defaults: Defaults, bodies: Bodies, option: Element
) -> list[tuple[Element, Side, Side]]:
    """Read the points that equality constraints join.

    Each entry has the constraint's element and its two points. `option` contains the solver
    settings. Welded pieces are merged. Raises SceneFileError.
    """
    found = [
        defaults.apply(child) for section in root.find("equality") for child in children(section)
    ]
    found = [tie for tie in found if tie.flag("active", True)]
    for name in ("flag constraint", "flag equality"):
        if found and option.text(name, "enable") != "enable":
            message = "switches equalities off, and the file has some: leave one out"
            option.leave_out(message, name)
            return []
    for tie in (tie for tie in found if tie.tag == "weld"):
        one, other = (bodies.find_body(tie, name)[0] for name in ("body1", "body2"))
        bodies.weld(one, other, tie)
    ties = []
    for tie in (tie for tie in found if tie.tag == "connect"):
        if "site1" in tie.attributes:
            first, second = (bodies.find_site(tie, name) for name in ("site1", "site2"))
            apart = np.linalg.norm(first.place - second.place)
            if apart > 1e-5 * max(float(np.linalg.norm(first.place)), 1.0):
                tie.leave_out("joins sites that are apart in the file: put them where they meet")
                continue
            ties.append((tie, (first.piece, first.place), (second.piece, second.place)))
        else:
            (piece, frame), (other_piece, _) = (
                bodies.find_body(tie, name) for name in ("body1", "body2")
            )
            place = frame.at(tie.numbers("anchor", 3))
            ties.append((tie, (piece, place), (other_piece, place)))
    return ties


class _SceneBuilder:
    """Builder of a scene from the pieces of an MJCF file."""

    def __init__(
        self,
        bodies: Bodies,
        strings: list[TendonString],
        ties: list[tuple[Element, Side, Side]],
    ) -> None:
        self.bodies, self.strings = bodies, strings
        attached = [site for string in strings for site in string.sites]
        attached += [Site(*side) for _, *sides in ties for side in sides]
        self.ends = ends = PieceEnds(bodies, attached)
        for tie, one, other in ties:
            ends.join(ends.place(*one, tie), ends.place(*other, tie))
        places = [[ends.place(*site) for site in string.sites] for string in strings]
        for end in (end for both in places for end in both if end.piece == 0):
            ends.pinned.add(ends.node(end))
        pieces = dict(bodies.moving())
        bars = [k for k in pieces if len(ends.points[k]) == 2]
        order = order_by_number([[pieces[k].element.text("name")] for k in bars], "bar")
        self.bars = bars if order is None else [bars[k] for k in order]
        bodies_found = [k for k in pieces if len(ends.points[k]) > 2]
        order = order_by_number([[pieces[k].element.text("name")] for k in bodies_found], "body")
        self.rigid = bodies_found if order is None else [bodies_found[k] for k in order]
        points = [Endpoint(k, 0) for k in pieces if len(ends.points[k]) == 1]
        points += [Endpoint(k, end) for k in self.rigid for end in range(len(ends.points[k]))]
        held = [Endpoint(0, k) for k in range(len(ends.points[0]))]
        all_ends = [*(Endpoint(k, end) for k in self.bars for end in (0, 1)), *points, *held]
        self.nodes = self._number(drop_duplicates([ends.node(end) for end in all_ends]))
        pairs = [[self.nodes[ends.node(end)] for end in both] for both in places]
        for string, pair in zip(strings, pairs, strict=True):
            if pair[0] == pair[1]:
                string.element.leave_out("joins a node to itself: give it two different ends")
        kept = [k for k, pair in enumerate(pairs) if pair[0] != pair[1]]
        self.strings, self.pairs = [strings[k] for k in kept], [pairs[k] for k in kept]

    def _number(self, ends: list[Endpoint]) -> dict[Endpoint, int]:
        """Assign node numbers to endpoints (`ends`).

        They follow from the names of sites if possible. Unattached sites of the world are nodes if
        they continue the numbers.
        """
        own, sites = self.ends, self.bodies.sites
        lone = [
            site.place
            for name, site in sites.items()
            if site.piece == 0 and name[:1] == "n" and own.find(0, site.place) is None
        ]
        for found in ([*ends, *(own.place(0, place) for place in lone)], ends):
            names: dict[Endpoint, list[str]] = {end: [] for end in found}
            for name, site in sites.items():
                end = own.find(site.piece, site.place)
                if end is not None and own.node(end) in names:
                    names[own.node(end)].append(name)
            order = order_by_number(list(names.values()), "n")
            if order is not None:
                own.pinned.update(found[len(ends) :])
                return {found[k]: number for number, k in enumerate(order)}
        return {end: number for number, end in enumerate(ends)}

    def _node(self, piece: int, end: int) -> int:
        return self.nodes[self.ends.node(Endpoint(piece, end))]

    def _build_structure(self) -> Structure:
        """Build the structure from bars, points and strings."""
        ends, pieces = self.ends, self.bodies.pieces
        mass = np.zeros(len(self.nodes))
        weights, radii = [], []
        for k in self.bars:
            weight, radius, on_ends = ends.read_bar(k, pieces[k])
            weights.append(weight)
            radii.append(radius)
            for end in (0, 1):
                mass[self._node(k, end)] += on_ends[end]
        for k, piece in self.bodies.moving():
            if len(ends.points[k]) == 1:
                mass[self._node(k, 0)] += ends.read_point(k, piece)
        rigid = []
        for k in self.rigid:
            own, on_nodes = ends.read_body(k, pieces[k])
            numbers = [self._node(k, end) for end in range(len(ends.points[k]))]
            mass[numbers] += on_nodes
            rigid.append(RigidBody(sorted(numbers), own.mass, own.center, own.inertia))
        for still in pieces[0].masses:
            at = ends.node(ends.place(0, still.center))
            if at in self.nodes and not still.inertia.any():
                mass[self.nodes[at]] += still.mass
        pinned, rollers = self._find_supports()
        order = np.argsort(list(self.nodes.values()))
        places = [ends.points[end.piece][end.end] for end in self.nodes]
        nodes = np.array([places[k] for k in order]).reshape(-1, 3)
        lengths = [float(np.linalg.norm(nodes[a] - nodes[b])) for a, b in self.pairs]
        rests = [string.rest for string in self.strings]
        given = any(rest is not None for rest in rests)
        rest_length = [
            length if rest is None else rest for rest, length in zip(rests, lengths, strict=True)
        ]
        return Structure(
            nodes,
            [[self._node(k, end) for end in (0, 1)] for k in self.bars],
            self.pairs,
            bar_mass=weights,
            bar_radius=radii,
            node_mass=mass,
            pinned=pinned,
            rollers=rollers,
            bodies=rigid,
            cables=self._find_cables(),
            stiffness=[string.stiffness for string in self.strings],
            damping=[string.damping for string in self.strings],
            rest_length=rest_length if given else None,
        )

    def _find_cables(self) -> list[list[int]]:
        """Find the strings of each tendon through several sites."""
        parts: dict[int, list[int]] = {}
        for k, string in enumerate(self.strings):
            parts.setdefault(id(string.element), []).append(k)
        cables = [cable for cable in parts.values() if len(cable) > 1]
        order = order_by_number([[self.strings[cable[0]].name] for cable in cables], "cable")
        return cables if order is None else [cables[k] for k in order]

    def _find_supports(self) -> tuple[dict[int, str], dict[int, Array]]:
        """Find pinned nodes, and the normals of rollers, by node.

        Pins are axes such as "xyz", and normals are (·, 3).
        """
        ends = self.ends
        pinned = {self.nodes[ends.node(end)]: "xyz" for end in ends.pinned}
        rollers: dict[int, Array] = {}
        for end, slides in ends.slides.items():
            node = self.nodes[ends.node(end)]
            if node not in pinned:
                normals = np.linalg.svd(np.array(slides))[2][len(slides) :]
                free = np.abs(normals).max(axis=0) < 1e-12  # axes along which it is free
                along_axes = np.count_nonzero(~free) == len(normals)
                rollers[node] = np.eye(3)[~free] if along_axes else normals
        return pinned, rollers

    def build(
        self, root: Element, defaults: Defaults, option: Element, control: Control | None
    ) -> Scene:
        """Build the scene.

        `root` is the root element of the file, and `option` contains its solver settings. `control`
        is the control of the strings, None if there is no actuator.
        """
        structure = self._build_structure()
        gravity = option.numbers("gravity", 3, (0, 0, -9.81))
        if option.text("flag gravity", "enable") != "enable":
            gravity = np.zeros(3)
        laws: dict[int, Any] = {i: Linear() for i, s in enumerate(self.strings) if s.pushes}
        commanded = control is not None and control.commands_forces
        parts: dict[str, Any] = {
            "control": control,
            "gravity": Gravity(tuple(gravity.tolist())) if gravity.any() else None,
            "slack": laws if laws and not commanded else Clip(),
        }
        bare = Scene(structure, **parts)
        if "disable" in (option.text("flag contact"), option.text("flag constraint")):
            return bare
        balls = any(piece.anchor is not None for _, piece in self.bodies.moving())

        locator = _SceneLocator(self, bare, balls)
        grounds, bar_contact = read_contacts(root, self.bodies, defaults, locator)
        return Scene(structure, **parts, ground=grounds or None, bar_contact=bar_contact)


class _SceneLocator(NamedTuple):
    """Finder of a scene's nodes and bars by pieces of the file.

    `balls` is whether the tree of bars uses ball joints.
    """

    builder: _SceneBuilder
    scene: Scene
    balls: bool

    def weigh(self) -> ContactWeights:
        return contact_weights(self.scene, build_tree(self.scene.structure, self.balls))

    def find_node(self, piece: int, point: Array) -> int | None:
        ends = self.builder.ends
        for end, known in enumerate(ends.points[piece]):
            if np.linalg.norm(known - point) <= 1e3 * ends.close:
                return self.builder.nodes[ends.node(Endpoint(piece, end))]
        return None

    def find_bar(self, piece: int, rod: RodGeom) -> int | None:
        if piece not in self.builder.bars or rod.kind != "capsule":
            return None
        bar, s = self.builder.bars.index(piece), self.scene.structure
        if {self.find_node(piece, end) for end in rod.ends} != set(s.bars[bar].tolist()):
            return None
        apart = abs(rod.radius**2 - s.bar_radius[bar] ** 2)
        return bar if apart <= FILE_ROUNDING * rod.length**2 else None
