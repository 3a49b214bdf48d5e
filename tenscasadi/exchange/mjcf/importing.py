"""Import of scenes from MuJoCo."""

from __future__ import annotations

import os
from typing import Any, NamedTuple

import numpy as np

from tenscasadi.exchange.mjcf.bodies import Bodies, Site
from tenscasadi.exchange.mjcf.contact import Weights, contact_weights
from tenscasadi.exchange.mjcf.elements import Element, read_elements
from tenscasadi.exchange.mjcf.frames import Units
from tenscasadi.exchange.mjcf.grounds import read_grounds
from tenscasadi.exchange.mjcf.hanging import hang
from tenscasadi.exchange.mjcf.members import Members, Place, by_number, unique
from tenscasadi.exchange.mjcf.words import Defaults, check, children
from tenscasadi.scene.loads import Gravity
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import Clip, Control, ForceDensity, Linear, RestLength
from tenscasadi.schema.reading import SceneFileError
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array

_ENDLESS = 1e9  # N: larger force limits count as none


class String(NamedTuple):
    """Spatial tendon of a file.

    Attributes
    ----------
    element : Element
        XML element.
    ends : (Site, Site)
        Sites of its ends.
    stiffness : float
        Stiffness [N/m].
    damping : float
        Damping [N s/m].
    rest : float or None
        Rest length [m]; None for the length in the file.
    pushes : bool
        Whether it carries compression.
    """

    element: Element
    ends: tuple[Site, Site]
    stiffness: float
    damping: float
    rest: float | None
    pushes: bool


def import_mjcf(path: str | os.PathLike[str]) -> Scene:
    """Read a tensegrity from MuJoCo's XML, MJCF.

    Bodies with two ends become bars, bodies with one end become point masses, spatial tendons
    between two sites become strings. Ball joints and ``connect`` become nodes that bars share.
    Features without a counterpart in a scene are rejected by name.

    Parameters
    ----------
    path : str or path
        The file. Nothing in it is executed and no other file is opened: ``include`` is rejected.

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

    Notes
    -----
    - The ends of a bar are the points of its strings and joints, or the ends of its longest geom.
      Masses at the ends become node masses. The radius follows from the transverse inertia of all
      its geoms. An inertia below that of a thin rod is rejected.
    - A tendon with two spring lengths, the first of them 0, becomes a string with `Clip`. A tendon
      with one spring length has the law `Linear`. Damped tendons also damp while they are slack in
      MuJoCo; here only strings with `Linear` do.
    - Position actuators on all tendons become control by rest lengths. Its initial value is that of
      the first key. Control ranges are ignored, because they are bounds of a plan.
    - Only nodes touch the ground. Spheres, capsules and cylinders that end at a node give its
      distance. A contact time constant becomes the stiffness for the mean mass. Contacts between
      bodies, velocities of keys, step and solver are ignored.

    Nodes, bars and strings keep the numbers in the names of `export_mjcf`. Others are numbered in
    the order of the file.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> path = tc.export_mjcf(tc.Scene(tc.shapes.prism(), gravity=tc.Gravity()), "prism.xml")
    >>> tc.import_mjcf(path).structure
    Structure(6 nodes, 3 bars, 9 strings, 0 pinned)
    """
    root = read_elements(path)
    if root.tag != "mujoco":
        raise root.error("is no MJCF: give a file whose first element is <mujoco>")
    check(root)
    sections = list(children(root))
    compiler, option = _settings(root, sections)
    defaults = Defaults(root)
    sequence = compiler.text("eulerseq", "xyz")
    if len(sequence) != 3 or not set(sequence.lower()) <= set("xyz"):
        raise compiler.error(f"is {sequence!r}: give three of x, y, z", "eulerseq")
    units = Units(compiler.word("angle", "degree", "degree", "radian") == "degree", sequence)
    bodies = Bodies(root, defaults, units, compiler.flag("inertiafromgeom"))
    strings = [
        _read_string(defaults.apply(child), bodies)
        for section in root.of("tendon")
        for child in children(section)
    ]
    strings = [
        strings[k]
        for k in by_number([[string.element.text("name")] for string in strings], "string")
        or range(len(strings))
    ]
    control, strings = _read_control(root, defaults, strings)
    try:
        return _Reader(root, defaults, bodies, option, strings).scene(control)
    except SceneFileError:
        raise
    except (TypeError, ValueError) as error:
        raise SceneFileError(str(error), root.file, root.line, "<mujoco>") from error


def _settings(root: Element, sections: list[Element]) -> tuple[Element, Element]:
    """Merge the settings of compiler and solver.

    Raises SceneFileError.
    """
    merged = []
    for tag in ("compiler", "option"):
        found = root.given({})
        for element in (section for section in sections if section.tag == tag):
            flags = {
                f"flag {name}": value
                for child in children(element)
                for name, value in check(child).attributes.items()
            }
            found = check(element).given({**found.attributes, **element.attributes, **flags})
        merged.append(found)
    merged[0].word("coordinate", "local", "local")
    return merged[0], merged[1]


def _read_string(tendon: Element, bodies: Bodies) -> String:
    """Read a spatial tendon between two sites. Raises SceneFileError."""
    check(tendon)
    limited = tendon.flag("limited")
    if limited or (limited is None and "range" in tendon.attributes):
        raise tendon.error(
            "limits the length of a tendon, which has no counterpart in a scene: leave it out",
            "range",
        )
    sites = [bodies.site(child) for child in children(tendon)]
    if len(sites) != 2:
        raise tendon.error(
            f"runs through {len(sites)} sites: strings join two nodes, write one for each part"
        )
    lengths = tendon.numbers("springlength", (1, 2), (-1, -1))
    low, high = lengths[0], lengths[-1]
    pushes = low == high
    if not pushes and low != 0:
        raise tendon.error(
            f"is {tendon.text('springlength')!r}: give one length, for a spring, or 0 and one, for a string that goes slack",
            "springlength",
        )
    if high == 0:
        raise tendon.error(
            "is 0: a string has a length greater than 0, give a small one", "springlength"
        )
    stiffness, damping = (
        tendon.numbers("stiffness", (1, 2, 3), [0])[0],
        tendon.numbers("damping", (1, 2, 3), [0])[0],
    )
    for name in ("stiffness", "damping"):
        if np.any(tendon.numbers(name, (1, 2, 3), [0])[1:]):
            raise tendon.error(
                f"is {tendon.text(name)!r}, a polynomial: strings are linear, give one number", name
            )
    return String(
        tendon,
        (sites[0], sites[1]),
        float(stiffness),
        float(damping),
        None if high < 0 else float(high),
        pushes,
    )


def _read_control(
    root: Element, defaults: Defaults, strings: list[String]
) -> tuple[Control | None, list[String]]:
    """Read the control, and apply its law to strings.

    Raises SceneFileError.
    """
    driving, names = {}, {string.element.text("name") for string in strings}
    actuators = [
        check(defaults.apply(child))
        for section in root.of("actuator")
        for child in children(section)
    ]
    for k, actuator in enumerate(actuators):
        name = actuator.text("tendon")
        if name not in names or name in driving:
            raise actuator.error(
                f"is {name!r}: give each tendon one actuator, and actuators to tendons alone",
                "tendon",
            )
        driving[name] = k, actuator
    if not actuators:
        return None, strings
    if len(driving) < len(strings):
        passive = next(string for string in strings if string.element.text("name") not in driving)
        raise passive.element.error(
            "has no actuator, while others have: a scene drives all strings, or none"
        )
    start = _start(root, len(actuators))
    found, controls = [], set[type[Control]]()
    for string in strings:
        k, actuator = driving[string.element.text("name")]
        if string.stiffness or string.damping:
            raise string.element.error(
                "has stiffness or damping beside an actuator: give them to the actuator, as kp and kv",
                "stiffness",
            )
        servo = _servo(actuator)
        controls.add(ForceDensity if servo is None else RestLength)
        if len(controls) > 1:
            raise actuator.error(
                "drives its string in another way than others: a scene drives all in one way"
            )
        if servo is None:
            found.append(
                string._replace(stiffness=100.0, rest=None)
            )  # the default of `Structure`; force densities ignore it
        else:
            rest = None if start is None else float(start[k])
            found.append(
                String(string.element, string.ends, *servo, rest, not _pulls_alone(actuator))
            )
    return controls.pop()(), found


def _servo(actuator: Element) -> tuple[float, float] | None:
    """Read stiffness and damping of a length actuator.

    Returns None if the actuator controls a force density. Raises SceneFileError.
    """
    if actuator.tag == "position":
        return actuator.number("kp", 1.0), actuator.number("kv", 0.0)
    words = [
        actuator.text(name, default)
        for name, default in (("gaintype", "fixed"), ("biastype", "none"), ("dyntype", "none"))
    ]
    gain, bias = (
        np.pad(actuator.numbers(name, range(1, 11), [first]), (0, 9))[:10]
        for name, first in (("gainprm", 1), ("biasprm", 0))
    )
    if (
        words == ["affine", "none", "none"]
        and gain[1] == -1
        and np.count_nonzero(gain) == 1
        and "input" not in actuator.attributes
    ):
        return None
    if (
        words == ["fixed", "affine", "none"]
        and not any([*gain[1:], bias[0], *bias[3:]])
        and bias[1] == -gain[0]
    ):
        return float(gain[0]), float(0.0 - bias[2])  # MuJoCo's position actuator
    raise actuator.error(
        'pulls by another law than force = −length × control: give gaintype="affine" gainprm="0 -1 0"',
        "gainprm",
    )


def _start(root: Element, count: int) -> Array | None:
    """Read the controls of the first key that has them."""
    for section in root.of("keyframe"):
        for key in section.of("key"):
            if "ctrl" in key.attributes:
                return key.numbers("ctrl", count)
    return None


def _pulls_alone(actuator: Element) -> bool:
    """Return whether an actuator is limited to tension.

    Other limits are rejected. Raises SceneFileError.
    """
    limited = actuator.flag("forcelimited")
    if limited is False or "forcerange" not in actuator.attributes:
        return False
    low, high = actuator.numbers("forcerange", 2)
    if low > -_ENDLESS or (high != 0 and high < _ENDLESS):
        raise actuator.error(
            f"is {actuator.text('forcerange')!r}: give none, or one of -1e12 and 0 for a string that does not push",
            "forcerange",
        )
    return bool(high == 0)


class _Reader:
    """Builder of a scene: numbers nodes and members."""

    def __init__(
        self,
        root: Element,
        defaults: Defaults,
        bodies: Bodies,
        option: Element,
        strings: list[String],
    ) -> None:
        self.root, self.defaults, self.bodies, self.option, self.strings = (
            root,
            defaults,
            bodies,
            option,
            strings,
        )
        ties = [(*self._tied(tie), tie) for tie in self._ties()]
        attached = [site for string in strings for site in string.ends] + [
            Site(*side) for *sides, _ in ties for side in sides
        ]
        self.members = members = Members(bodies, attached)
        for one, other, tie in ties:
            members.join(*(members.place(*side, tie) for side in (one, other)))
        ends = [(string, [members.place(*site) for site in string.ends]) for string in strings]
        for _, places in ends:
            for place in places:
                if place.piece == 0:
                    members.pinned.add(members.node(place))
        pieces = dict(bodies.moving())
        bars = [k for k in pieces if len(members.ends[k]) == 2]
        names = by_number([[pieces[k].element.text("name")] for k in bars], "bar")
        self.bars = bars if names is None else [bars[k] for k in names]
        points = [Place(k, 0) for k in pieces if k not in set(bars)]
        held = [Place(0, k) for k in range(len(members.ends[0]))]
        places = unique(
            [
                members.node(place)
                for place in [*(Place(k, end) for k in self.bars for end in (0, 1)), *points, *held]
            ]
        )
        self.nodes = self._numbered(places)
        self.pairs = [[self.nodes[members.node(place)] for place in both] for _, both in ends]

    def _ties(self) -> list[Element]:
        flags = {
            name: self.option.text(f"flag {name}", "enable") for name in ("constraint", "equality")
        }
        found = [
            check(self.defaults.apply(child))
            for section in self.root.of("equality")
            for child in children(section)
        ]
        found = [tie for tie in found if tie.flag("active", True)]
        for name, value in flags.items():
            if found and value != "enable":
                raise self.option.error(
                    "switches equalities off, and the file has some: leave one out", f"flag {name}"
                )
        return found

    def _tied(self, tie: Element) -> tuple[tuple[int, Array], tuple[int, Array]]:
        """Read the two points that an equality joins.

        Each is a piece and a position. Raises SceneFileError.
        """
        if "site1" in tie.attributes:
            one, other = self.bodies.site(tie, "site1"), self.bodies.site(tie, "site2")
            if np.linalg.norm(one.place - other.place) > 1e-5 * max(
                float(np.linalg.norm(one.place)), 1.0
            ):
                raise tie.error("joins sites that are apart in the file: put them where they meet")
            return (one.piece, one.place), (other.piece, other.place)
        (piece, frame), (other_piece, _) = (
            self.bodies.named(tie, "body1"),
            self.bodies.named(tie, "body2"),
        )
        place = frame.at(tie.numbers("anchor", 3))
        return (piece, place), (other_piece, place)

    def _numbered(self, places: list[Place]) -> dict[Place, int]:
        """Assign node numbers, by the names of sites if possible.

        Unattached sites of the world are nodes if they continue the numbers.
        """
        members, sites = self.members, self.bodies.sites
        lone = [
            site.place
            for name, site in sites.items()
            if site.piece == 0 and name[:1] == "n" and members.near(0, site.place) is None
        ]
        for found in ([*places, *(members.place(0, place) for place in lone)], places):
            names: dict[Place, list[str]] = {place: [] for place in found}
            for name, site in sites.items():
                place = members.near(site.piece, site.place)
                if place is not None and members.node(place) in names:
                    names[members.node(place)].append(name)
            order = by_number(list(names.values()), "n")
            if order is not None:
                members.pinned.update(found[len(places) :])
                return {found[k]: number for number, k in enumerate(order)}
        return {place: number for number, place in enumerate(places)}

    def structure(self) -> Structure:
        """Build the structure from bars, points and strings."""
        members, pieces = self.members, self.bodies.pieces
        mass = np.zeros(len(self.nodes))
        weights, radii = [], []
        for k in self.bars:
            weight, radius, on_ends = members.read_bar(k, pieces[k])
            weights.append(weight)
            radii.append(radius)
            for end in (0, 1):
                mass[self._node(k, end)] += on_ends[end]
        for k, piece in self.bodies.moving():
            if len(members.ends[k]) == 1:
                mass[self._node(k, 0)] += members.read_point(k, piece)
        for still in pieces[0].masses:
            at = members.place(0, still.centre)
            if members.node(at) in self.nodes and not still.inertia.any():
                mass[self.nodes[members.node(at)]] += still.mass
        pinned, rollers = self._held()
        places = [members.ends[place.piece][place.end] for place in self.nodes]
        nodes = np.array([places[k] for k in np.argsort(list(self.nodes.values()))]).reshape(-1, 3)
        rest = (
            {}
            if any(string.rest is None for string in self.strings)
            else {"rest_length": [string.rest for string in self.strings]}
        )
        found = Structure(
            nodes,
            [[self._node(k, end) for end in (0, 1)] for k in self.bars],
            self.pairs,
            bar_mass=weights,
            bar_radius=radii,
            node_mass=mass,
            pinned=pinned,
            rollers=rollers,
            stiffness=[string.stiffness for string in self.strings],
            damping=[string.damping for string in self.strings],
            **rest,  # type: ignore[arg-type]
        )
        if rest or all(string.rest is None for string in self.strings):
            return found
        lengths = [
            found.string_lengths[i] if string.rest is None else string.rest
            for i, string in enumerate(self.strings)
        ]
        return found.replace(rest_length=lengths)

    def _node(self, piece: int, end: int) -> int:
        return self.nodes[self.members.node(Place(piece, end))]

    def _held(self) -> tuple[dict[int, str], dict[int, Array]]:
        """Find pinned nodes, and the normals of rollers."""
        members = self.members
        pinned = {self.nodes[members.node(place)]: "xyz" for place in members.pinned}
        rollers: dict[int, Array] = {}
        for place, slides in members.slides.items():
            node = self.nodes[members.node(place)]
            if node not in pinned:
                directions = np.linalg.svd(np.array(slides))[2][len(slides) :]
                free = np.abs(directions).max(axis=0) < 1e-12  # axes along which it is free
                rollers[node] = (
                    np.eye(3)[~free] if np.count_nonzero(~free) == len(directions) else directions
                )
        return pinned, rollers

    def scene(self, control: Control | None) -> Scene:
        """Build the scene."""
        structure = self.structure()
        gravity = (
            self.option.numbers("gravity", 3, (0, 0, -9.81))
            if self.option.text("flag gravity", "enable") == "enable"
            else np.zeros(3)
        )
        pushing: dict[int, Any] = {
            i: Linear() for i, string in enumerate(self.strings) if string.pushes
        }
        bare = Scene(
            structure,
            control=control,
            gravity=Gravity(tuple(gravity.tolist())) if gravity.any() else None,
            slack=Clip() if not pushing or isinstance(control, ForceDensity) else pushing,
        )
        if "disable" in (self.option.text("flag contact"), self.option.text("flag constraint")):
            return bare
        balls = any(piece.anchor is not None for _, piece in self.bodies.moving())

        def weigh() -> Weights:
            return contact_weights(bare, hang(structure, balls))

        def node_at(piece: int, point: Array) -> int | None:
            near = [
                end
                for end, known in enumerate(self.members.ends[piece])
                if np.linalg.norm(known - point) <= 1e3 * self.members.close
            ]
            return self._node(piece, near[0]) if near else None

        grounds = read_grounds(self.root, self.bodies, self.defaults, node_at, weigh)
        return Scene(
            structure,
            control=control,
            gravity=bare.gravity,
            slack=bare.slack,
            ground=grounds or None,
        )
