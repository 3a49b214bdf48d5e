"""Conversion of a scene to XML elements of MuJoCo."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET  # to write alone

import numpy as np

from tenscasadi.exchange.mjcf.body_tree import (
    NO_DIRECTION,
    BodyTree,
    Link,
    find_free_directions,
    find_held_directions,
)
from tenscasadi.exchange.mjcf.contact import (
    ContactWeights,
    contact_numbers,
    contact_weights,
    list_touching,
)
from tenscasadi.exchange.mjcf.frames import rotate_z_to
from tenscasadi.scene.cables import CableRows
from tenscasadi.scene.control import Control
from tenscasadi.scene.ground import Ground
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import ForceDensity, RestLength, Tension
from tenscasadi.scene.winches import RestLengthRate, Winch
from tenscasadi.structure.cables import find_directions
from tenscasadi.util.linear_algebra import fit_velocities
from tenscasadi.util.validate import Array

# inertia of a bar about its axis, at least so much of its transverse one: MuJoCo rejects 0
AXIAL = 0.01


class SpatialTendon(NamedTuple):
    """String or cable as a spatial tendon of MuJoCo.

    `pushes` is whether it carries compression.
    """

    name: str
    path: list[int]  # nodes
    length: float  # m, at rest
    rest_length: float  # m
    stiffness: float  # N/m
    damping: float  # N·s/m
    pushes: bool

    def control(self, kind: Control) -> float:
        """Compute the initial control that keeps the rest length.

        Its unit is that of the control `kind`: m, m/s, N/m or N.
        """
        if isinstance(kind, RestLength):
            return self.rest_length
        if isinstance(kind, RestLengthRate):
            return 0.0
        if isinstance(kind, ForceDensity):
            return self.stiffness * max(0.0, 1 - self.rest_length / self.length)  # Eq. 99 at rest
        return self.stiffness * max(0.0, self.length - self.rest_length)


def list_tendons(scene: Scene) -> list[SpatialTendon]:
    """Convert the cables, and strings in no cable, of a scene to tendons.

    They are in the order of the control inputs.
    """
    if scene.strength is not None:
        raise ValueError(
            f"scene.strength is {scene.strength}, which MJCF files cannot hold: "
            "give strict=False to leave it out, or a scene with strength=None"
        )
    if isinstance(scene.control, Winch):
        raise ValueError(
            f"scene.control is {scene.control}, which MJCF files cannot hold: "
            "export a scene with control=RestLengthRate() or RestLength()"
        )
    s, pushing = scene.modelled, scene.compression_strings.tolist()
    paths = {
        int(s.cable_of[k]): (f"string{k}", [int(a), int(b)]) for k, (a, b) in enumerate(s.strings)
    }
    for k, cable in enumerate(s.cables):
        steps = find_directions(s.strings, cable)
        path = [steps[0][0], *(end for _, end in steps)]
        paths[int(s.cable_of[cable[0]])] = f"cable{k}", path
    own = CableRows(s).constants() if s.cables else s
    length = np.bincount(s.cable_of, weights=s.string_lengths)
    first = scene.first_strings.tolist()
    return [
        SpatialTendon(
            *paths[k],
            float(length[k]),
            float(own.rest_length[k]),
            float(own.stiffness[k]),
            float(own.damping[k]),
            first[k] in pushing,
        )
        for k in sorted(paths)
    ]


class MjcfWriter:
    """Builder of MuJoCo's XML elements for a scene."""

    def __init__(self, scene: Scene, tree: BodyTree) -> None:
        self.scene, self.s, self.tree = scene, scene.modelled, tree
        self.grounds = [
            ground for ground in scene.grounds if isinstance(ground, Ground)
        ]  # all others are rejected
        self.tendons = list_tendons(scene)
        s = self.s
        size = (
            float(np.mean(np.concatenate([s.bar_lengths, s.string_lengths])))
            if len(s.bars) + len(s.strings)
            else 1.0
        )
        self.drawn, self.sphere = 0.005 * size, 1e-3 * size  # radii of bars and contact spheres
        self.weights = (
            contact_weights(scene, tree)
            if scene.contact_laws
            else ContactWeights(np.zeros(len(s.nodes)), 0.0, np.zeros(len(s.bars)))
        )
        self.touched = sorted(
            {
                node
                for ground in self.grounds
                for node in list_touching(ground, s, self.weights.inverse)
            }
        )
        self.turns: dict[int | None, Array] = {
            None: np.eye(3)
        }  # columns: axes of a bar's body frame; z is along the bar
        self.along: dict[
            tuple[int | None, int], Array
        ] = {}  # position of a node in the body frame of its bar
        self.rates: dict[ET.Element, list[float]] = {}  # joint velocities of each body
        self.owners = {node: f"bar{bar}" for node, bar in tree.owner.items()}  # bodies of nodes
        self.joined: list[tuple[str, str, Array]] = []  # two bodies, and their node in the first
        pinned = [node for node, axes in s.pinned.items() if axes == "xyz"]
        held = [node for body in s.bodies for node in body.nodes if node not in pinned]
        self.has_ties = bool(tree.ties or len(set(held) - set(self.owners)) < len(held))
        self.root = ET.Element("mujoco", model="tenscasadi")

    def write(self, step: float, velocities: Array | None) -> ET.Element:
        """Build the root XML element.

        `step` is the time step [s], and `velocities` (n, 3) are initial ones of nodes [m/s].
        """
        V = np.zeros(self.s.nodes.shape) if velocities is None else velocities
        self._options(step)
        world = ET.SubElement(self.root, "worldbody")
        for k, ground in enumerate(self.grounds):
            if len(ground.select_nodes(self.s)):
                self._plane(world, f"ground{k}", ground, ground.height - self.sphere)
            if ground.bars is not None:
                self._plane(world, f"ground{k}_bars", ground, ground.height)
        self._bars(world, V)
        self._rigid_bodies(world, V)
        self._points(world, V)
        self._contacts()
        self._strings()
        self._ties(step)
        self._control(velocities is not None)
        return self.root

    def _plane(self, world: ET.Element, name: str, ground: Ground, height: float) -> None:
        _add(
            world,
            "geom",
            name=name,
            type="plane",
            size=[0, 0, 1],
            pos=height * np.array(ground.normal),
            zaxis=ground.normal,
            contype=0,
            conaffinity=0,
        )

    def _options(self, step: float) -> None:
        gravity = (0, 0, 0) if self.scene.gravity is None else self.scene.gravity.acceleration
        option = _add(
            self.root, "option", timestep=step, integrator="RK4", gravity=gravity, cone="elliptic"
        )
        if not self.scene.contact_laws and not self.has_ties:
            _add(option, "flag", contact="disable", constraint="disable")

    def _bars(self, world: ET.Element, V: Array) -> None:
        s = self.s
        bodies: dict[int | None, ET.Element] = {None: world}
        turning: dict[int | None, Array] = {None: np.zeros(3)}
        for link in self.tree.links:
            bar, (a, b) = link.bar, s.bars[link.bar].tolist()
            length, outer = s.bar_lengths[bar], self.turns[link.parent]
            axis = outer.T @ (s.nodes[b] - s.nodes[a]) / length
            self.turns[bar] = outer @ rotate_z_to(axis)
            start = -length / 2 if link.node is None else 0.0 if link.node == a else -length
            self.along[bar, a], self.along[bar, b] = (
                np.array([0, 0, start]),
                np.array([0, 0, start + length]),
            )
            middle, moves = (s.nodes[a] + s.nodes[b]) / 2, (V[a] + V[b]) / 2
            if link.node is not None:
                middle, moves = s.nodes[link.node], V[link.node]
            place = middle if link.parent is None else self.along[link.parent, link.node or 0]
            turning[bar] = np.cross(s.nodes[b] - s.nodes[a], V[b] - V[a]) / length**2
            body = bodies[bar] = _add(
                bodies[link.parent], "body", name=f"bar{bar}", pos=place, zaxis=axis
            )
            self._joints(body, link, moves, turning[bar] - turning[link.parent])
            self._rod(body, bar, [start, start + length])
            for node in (a, b):
                if self.tree.owner.get(node) == bar:
                    self._node(body, node, self.along[bar, node])

    def _joints(self, body: ET.Element, link: Link, velocity: Array, turning: Array) -> None:
        if link.still:
            return
        turn = self.turns[link.bar]
        if link.node is None:
            _add(body, "freejoint")
            self.rates[body] = [*velocity]
        else:
            self._slides(body, link.slides, velocity, turn)
            _add(body, "joint", type="ball")
        self.rates[body] += [
            *(turning @ turn)
        ]  # MuJoCo expects angular velocities in the body frame

    def _slides(self, body: ET.Element, directions: Array, velocity: Array, turn: Array) -> None:
        for direction in directions:
            _add(body, "joint", type="slide", axis=direction @ turn)
        self.rates[body] = [*(directions @ velocity)]

    def _rigid_bodies(self, world: ET.Element, V: Array) -> None:
        """Add rigid bodies, whose axes are those of the world.

        `V` (n, 3) are the velocities of nodes [m/s]. A body rotates about a pinned node, or about
        the line through two of them.
        """
        s = self.s
        for k, body in enumerate(s.bodies):
            own = list(body.nodes)
            given = body.mass_properties(s.nodes[own])
            pins = s.nodes[[node for node in own if s.pinned.get(node) == "xyz"]]
            place = pins[0] if len(pins) else given.center
            name = f"body{k}"
            element = _add(world, "body", name=name, pos=place)
            drift, spin = fit_velocities(s.nodes[own], V[own])
            _, sizes, right = np.linalg.svd(pins - place if len(pins) else np.zeros((1, 3)))
            fixed = int(np.sum(sizes > 1e-9 * np.ptp(s.nodes[own], axis=0).max()))
            if not len(pins):
                _add(element, "freejoint")
                moves = drift + np.cross(spin, place - s.nodes[own].mean(axis=0))
                self.rates[element] = [*moves, *spin]
            elif fixed == 0:
                _add(element, "joint", type="ball")
                self.rates[element] = [*spin]
            elif fixed == 1:
                _add(element, "joint", type="hinge", axis=right[0])
                self.rates[element] = [float(spin @ right[0])]
            _add(
                element,
                "inertial",
                pos=given.center - place,
                mass=given.mass,
                fullinertia=_list_inertia(given.moments),
            )
            for node in own:
                if s.pinned.get(node) == "xyz":
                    continue
                if node in self.owners:
                    self.joined.append((name, self.owners[node], s.nodes[node] - place))
                else:
                    self.owners[node] = name
                    self._node(element, node, s.nodes[node] - place)

    def _rod(self, body: ET.Element, bar: int, ends: list[float]) -> None:
        """Add the mass of a bar, and a visible cylinder, to its body.

        `ends` are the positions of the bar's ends along the z axis of the body [m].
        """
        s = self.s
        radius, mass = s.bar_radius[bar], s.bar_mass[bar]
        across = s.bar_inertia[bar] * s.bar_lengths[bar] ** 2  # J of Eq. 19 times l²
        inertia = [across, across, max(mass * radius**2 / 2, AXIAL * across)]
        _add(body, "inertial", pos=[0, 0, sum(ends) / 2], mass=mass, diaginertia=inertia)
        look = {"size": [radius or self.drawn], "contype": 0, "conaffinity": 0, "mass": 0}
        _add(
            body,
            "geom",
            name=f"bar{bar}",
            type="cylinder",
            fromto=[0, 0, ends[0], 0, 0, ends[1]],
            **look,
        )

    def _node(self, body: ET.Element, node: int, place: Array) -> None:
        """Add a node to the body of its bar.

        `place` (3,) is its position in the body's frame [m]. Its point mass is in a body that is
        fixed to that one.
        """
        if self.s.node_mass[node] > 0:
            mass = _add(body, "body", name=f"n{node}", pos=place)
            _add(
                mass, "inertial", pos=[0, 0, 0], mass=self.s.node_mass[node], diaginertia=[0, 0, 0]
            )
        _add(body, "site", name=f"n{node}", pos=place, size=[self.sphere])
        self._ball(body, node, place)

    def _ball(self, body: ET.Element, node: int, place: Array) -> None:
        if node in self.touched:
            _add(
                body,
                "geom",
                name=f"n{node}",
                type="sphere",
                size=[self.sphere],
                pos=place,
                mass=0,
                contype=0,
                conaffinity=0,
            )

    def _points(self, world: ET.Element, V: Array) -> None:
        """Add pinned nodes and nodes without bars.

        They belong to the `world` element. `V` (n, 3) are the velocities of nodes [m/s].
        """
        s, held, here = self.s, find_held_directions(self.s), np.zeros(3)
        for node in (node for node in range(len(s.nodes)) if node not in self.owners):
            slides = find_free_directions(held.get(node, NO_DIRECTION))
            if not len(slides):
                self._node(world, node, s.nodes[node])
                continue
            body = _add(world, "body", name=f"n{node}", pos=s.nodes[node])
            self._slides(body, slides, V[node], np.eye(3))
            _add(
                body,
                "inertial",
                pos=here,
                mass=s.node_mass[node],
                diaginertia=np.full(3, max(s.node_mass[node], 1.0)),
            )  # any value: the body does not rotate
            _add(body, "site", name=f"n{node}", pos=here, size=[self.sphere])
            self._ball(body, node, here)

    def _contacts(self) -> None:
        law, s, (weights, standing, inverse) = self.scene.bar_contact, self.s, self.weights
        found: list[tuple[str, str, Any, float]] = []  # two geoms, law and inverse mass [1/kg]
        if law is not None:
            for one, other in law.select_pairs(s).tolist():
                weight = float(inverse[one] + inverse[other])
                found.append((f"capsule{one}", f"capsule{other}", law, weight))
        for k, ground in enumerate(self.grounds):
            for bar in np.unique(ground.select_bar_points(s).bars).tolist():
                found.append((f"ground{k}_bars", f"capsule{bar}", ground, float(inverse[bar])))
            for node in list_touching(ground, s, weights):
                found.append((f"ground{k}", f"n{node}", ground, weights[node]))
        self._capsules({name for pair in found for name in pair[:2]})
        contact = ET.SubElement(self.root, "contact") if found else self.root
        for one, other, own, weight in found:
            if weight > 0:
                numbers = contact_numbers(own, weight, standing)
                _add(contact, "pair", geom1=one, geom2=other, **numbers)

    def _capsules(self, names: set[str]) -> None:
        """Add the contact capsules of bars with given names."""
        s, bodies = self.s, {body.get("name"): body for body in self.root.iter("body")}
        for bar in (bar for bar in range(len(s.bars)) if f"capsule{bar}" in names):
            ends = [self.along[bar, node] for node in s.bars[bar].tolist()]
            _add(
                bodies[f"bar{bar}"],
                "geom",
                name=f"capsule{bar}",
                type="capsule",
                fromto=np.concatenate(ends),
                size=[max(s.bar_radius[bar], self.sphere * 1e-3)],
                contype=0,
                conaffinity=0,
                mass=0,
            )

    def _strings(self) -> None:
        if not self.tendons:
            return
        tendon = ET.SubElement(self.root, "tendon")
        for own in self.tendons:
            rest = [own.rest_length] if own.pushes else [0.0, own.rest_length]
            law = (
                {"stiffness": own.stiffness, "damping": own.damping, "springlength": rest}
                if self.scene.control is None
                else {}
            )
            spatial = _add(tendon, "spatial", name=own.name, **law)
            for node in own.path:
                _add(spatial, "site", site=f"n{node}")

    def _ties(self, step: float) -> None:
        if not self.tree.ties and not self.joined:
            return
        equality = ET.SubElement(self.root, "equality")
        hard = {"solref": [2 * step, 1.0], "solimp": [0.9999, 0.9999, 0.001, 0.5, 2.0]}
        for tie in self.tree.ties:
            other = {} if tie.other is None else {"body2": f"bar{tie.other}"}
            place = self.along[tie.bar, tie.node]
            _add(equality, "connect", body1=f"bar{tie.bar}", **other, anchor=place, **hard)
        for one, another, place in self.joined:
            _add(equality, "connect", body1=one, body2=another, anchor=place, **hard)

    def _control(self, moving: bool) -> None:
        scene = self.scene
        start: dict[str, Any] = {}
        if moving:  # MuJoCo's order is that of the file
            start["qvel"] = [
                rate for body in self.root.iter("body") for rate in self.rates.get(body, ())
            ]
        if scene.control is not None and self.tendons:
            actuator = ET.SubElement(self.root, "actuator")
            for own in self.tendons:
                of = {"name": own.name, "tendon": own.name}
                if isinstance(scene.control, ForceDensity):
                    _add(
                        actuator, "general", **of, gaintype="affine", gainprm=[0, -1, 0]
                    )  # force −length × γ
                elif isinstance(scene.control, Tension):
                    _add(actuator, "general", **of, gainprm=[-1, 0, 0])
                else:
                    pulls = (
                        {} if own.pushes else {"forcelimited": "true", "forcerange": [-1e12, 0.0]}
                    )
                    k, c = own.stiffness, own.damping
                    if isinstance(scene.control, RestLengthRate):  # the rest length is a state
                        law = {"dyntype": "integrator", "gainprm": k, "biasprm": [0, -k, -c]}
                        _add(actuator, "general", **of, biastype="affine", **law, **pulls)
                        start.setdefault("act", []).append(own.rest_length)
                    else:
                        _add(actuator, "position", **of, kp=k, kv=c, **pulls)
            start["ctrl"] = [own.control(scene.control) for own in self.tendons]
        if start:
            _add(ET.SubElement(self.root, "keyframe"), "key", name="start", **start)


def _list_inertia(moments: Array) -> list[float]:
    """Compute the six inertia entries of a body from second moments.

    They are xx, yy, zz, xy, xz, yz. Principal moments are at least 0.01 of the largest, and within
    rounding of the triangle inequality, as MuJoCo requires.
    """
    inertia = np.trace(moments) * np.eye(3) - moments
    values, vectors = np.linalg.eigh(inertia)
    values = np.maximum(values, AXIAL * values[-1]) + 1e-10 * values[-1]
    full = vectors * values @ vectors.T
    return [full[a, b] for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]


def _add(parent: ET.Element, tag: str, **attributes: Any) -> ET.Element:
    """Add a child to an XML element.

    The child has the name `tag` and is returned. Numbers become text that is read back exactly.
    """
    return ET.SubElement(parent, tag, {name: _text(value) for name, value in attributes.items()})


def _text(value: Any) -> str:
    if isinstance(value, str):
        return value
    numbers: Iterable[Any] = np.atleast_1d(value).tolist()
    return " ".join(
        repr(number + 0) if isinstance(number, int) else repr(number + 0.0).removesuffix(".0")
        for number in numbers
    )
