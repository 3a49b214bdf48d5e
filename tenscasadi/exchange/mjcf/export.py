"""Export of scenes to MuJoCo.

Bars become bodies, and strings become spatial tendons.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree as ET  # to write alone

import numpy as np
from numpy.typing import ArrayLike

from tenscasadi.exchange.mjcf.contact import Weights, contact_numbers, contact_weights, touching
from tenscasadi.exchange.mjcf.frames import turn_to
from tenscasadi.exchange.mjcf.hanging import (
    NO_DIRECTION,
    Hanging,
    Link,
    free_directions,
    hang,
    held_directions,
)
from tenscasadi.scene.ground import Ground
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import ForceDensity, RestLength, Smooth
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import (
    Array,
    choice,
    file_path,
    finite_array,
    instance,
    positive_number,
)
from tenscasadi.util.whole_file import whole_file

_LEAST = 1e-15  # kg and kg m²: MuJoCo's minimum for a moving body
# axis does not spin it
_AXIAL = 0.01
_DRAWN = 0.005  # relative to the mean member length: radius of bars without one
_SPHERE = 1e-3  # relative to the mean member length: radius of contact spheres
_STRONGEST = 1e12  # N


def export_mjcf(
    scene: Scene,
    path: str | os.PathLike[str],
    velocities: ArrayLike | None = None,
    joints: Literal["ball", "connect"] = "ball",
    step: float = 1e-3,
) -> Path:
    """Write a scene as MuJoCo's XML, MJCF.

    Bars become bodies ``bar0``, ``bar1`` …, nodes become sites ``n0``, ``n1`` …, and strings or
    their segments become spatial tendons ``string0``, ``string1`` … The reference configuration is
    that of the structure.

    Parameters
    ----------
    scene : Scene
        The scene.
    path : str or path
        The file, such as ``"prism.xml"``.
    velocities : array_like, shape (n, 3), optional
        Initial velocities of the modelled nodes [m/s], for the keyframe ``start``; at rest if None.
    joints : {"ball", "connect"}
        "ball" connects bars with shared or pinned nodes by ball joints, which are exact. Loops of
        bars are closed by the equality ``connect``. With "connect" each bar is a free body, and
        ``connect`` holds all shared nodes.
    step : float
        MuJoCo's time step [s]. Equalities have a time constant of two steps, so export again to
        change the step.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong, or a feature of the scene has no counterpart in MJCF; the message
        names it.
    OSError
        The file cannot be written.

    Notes
    -----
    The models differ as follows:

    - A bar has the axial inertia m r²/2, and at least 0.01 of its transverse inertia, because
      MuJoCo rejects 0. No force turns a bar about its axis, so only friction on the contact spheres
      changes the trajectory.
    - A damped string also damps while it is slack in MuJoCo, and may then push. Strings without
      damping follow `Clip` exactly, and strings with the law `Linear` are always exact. `Smooth` is
      rejected.
    - `connect` is soft: two ends separate by about 1e-4 of their free separation in two steps.
    - In contact, nodes are spheres with a radius of 0.001 of the mean member length. The plane is
      lower by this radius. The normal force is that of `Ground`, except for 1e-4 of the other
      forces on the body. Friction is Coulomb friction with a slip speed. In MuJoCo the slip speed
      refers to the weight on each of three supporting nodes, in `Ground` to the current normal
      force.
    - Control by rest lengths becomes a position actuator for each string. Control by force
      densities becomes a general actuator with the gain −length. MuJoCo's ``ctrl`` is the control
      of the model in both cases. Its initial value is in the keyframe ``start``: begin with
      ``mujoco.mj_resetDataKeyframe(model, data, 0)``.

    Pressure, nodal forces, moving supports, height fields, time-varying gravity and parameters are
    rejected. Rollers are rejected if MuJoCo's joints cannot represent them.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> scene = tc.Scene(tc.shapes.prism(stiffness=1000.0, prestress=50.0), gravity=tc.Gravity())
    >>> tc.export_mjcf(scene, "prism.xml").name
    'prism.xml'

    >>> import mujoco  # doctest: +SKIP
    >>> model = mujoco.MjModel.from_xml_path("prism.xml")  # doctest: +SKIP
    """
    instance("scene", scene, Scene, "a tenscasadi.Scene")
    choice("joints", joints, "ball", "connect")
    h = positive_number("step", step)
    target = file_path("path", path)
    _refuse(scene)
    hanging = hang(scene.modelled, joints == "ball")
    root = _Writer(scene, hanging).write(
        h, None if velocities is None else _velocities(scene.modelled, velocities)
    )
    ET.indent(root)
    with whole_file(target) as file:
        ET.ElementTree(root).write(file)
    return target


def _refuse(scene: Scene) -> None:
    """Reject features that MJCF lacks. Raises ValueError."""
    others = {
        "pressure": "leave it out",
        "forces": "leave them out, and give them to MuJoCo through data.xfrc_applied",
        "supports": "leave it out, the nodes are pinned where they are",
        "parameters": "leave it out, the file has the values of the structure",
    }
    for name, cure in others.items():
        if getattr(scene, name) is not None:
            raise ValueError(f"Scene.{name} has no counterpart in MJCF: {cure}")
    if scene.gravity is not None and scene.gravity.varies:
        raise ValueError(
            "Scene.gravity changes over time, in MJCF it is constant: give one acceleration"
        )
    for ground in scene.grounds:
        instance("Scene.ground", ground, Ground, "planes alone, tenscasadi.Ground: MJCF has them")
    for law, strings in scene.string_laws:
        if isinstance(law, Smooth):
            raise ValueError(
                f"Scene.slack of string {strings[0]} is {law}: MuJoCo's tendons are slack or not, give Clip() or Linear()"
            )
    s = scene.modelled
    if scene.control is not None and len(s.strings) > len(scene.structure.strings):
        raise ValueError(
            "Scene.segments: MuJoCo's actuators drive strings in one piece: give segments=1, or control=None"
        )
    for what, values in (
        ("bar_mass", s.bar_mass),
        ("bar_inertia times length²", s.bar_inertia * s.bar_lengths**2),
    ):
        for bar in np.flatnonzero(values < _LEAST / _AXIAL):
            raise ValueError(
                f"{what} of bar {bar} is {values[bar]:g}: MuJoCo needs {_LEAST / _AXIAL:g} or more"
            )
    for node in np.flatnonzero((s.node_mass < _LEAST) & (s.node_mass > 0)):
        raise ValueError(
            f"node_mass of node {node} is {s.node_mass[node]:g} kg: MuJoCo needs {_LEAST:g} or more"
        )


def _velocities(s: Structure, given: ArrayLike) -> Array:
    """Check that velocities satisfy bars and pins. Raises TypeError, ValueError."""
    V = finite_array("velocities", given, (len(s.nodes), 3))
    least = 1e-9 * abs(V).max(initial=0.0)
    for node, directions in held_directions(s).items():
        if abs(directions @ V[node]).max() > least:
            raise ValueError(
                f"velocities[{node}] moves node {node} along a direction in which it is held: give {node} a velocity across it"
            )
    apart = (
        np.einsum(
            "ij,ij->i", np.diff(s.nodes[s.bars], axis=1)[:, 0], np.diff(V[s.bars], axis=1)[:, 0]
        )
        / s.bar_lengths
    )
    for bar in np.flatnonzero(abs(apart) > 1e-6 * abs(V).max(initial=0.0)):
        raise ValueError(
            f"velocities stretch bar {bar} by {apart[bar]:g} m/s: give velocities that keep its length, such as model.velocities(x)"
        )
    return V


class _Writer:
    """Builder of the XML elements of one file."""

    def __init__(self, scene: Scene, hanging: Hanging) -> None:
        self.scene, self.s, self.hanging = scene, scene.modelled, hanging
        self.grounds = [
            ground for ground in scene.grounds if isinstance(ground, Ground)
        ]  # `_refuse` rejects all other kinds
        s = self.s
        size = (
            float(np.mean(np.concatenate([s.bar_lengths, s.string_lengths])))
            if len(s.bars) + len(s.strings)
            else 1.0
        )
        self.drawn, self.sphere = _DRAWN * size, _SPHERE * size
        self.weights = (
            contact_weights(scene, hanging)
            if self.grounds
            else Weights(np.zeros(len(s.nodes)), 0.0)
        )
        self.touched = sorted(
            {node for ground in self.grounds for node in touching(ground, self.weights.inverse)}
        )
        self.turns: dict[int | None, Array] = {
            None: np.eye(3)
        }  # columns: axes of a bar's body frame; z is along the bar
        self.along: dict[
            tuple[int | None, int], Array
        ] = {}  # position of a node in the body frame of its bar
        self.rates: dict[ET.Element, list[float]] = {}  # joint velocities of each body
        self.root = ET.Element("mujoco", model="tenscasadi")

    def write(self, step: float, velocities: Array | None) -> ET.Element:
        """Build the root element."""
        V = np.zeros(self.s.nodes.shape) if velocities is None else velocities
        self._options(step)
        world = ET.SubElement(self.root, "worldbody")
        for k, ground in enumerate(self.grounds):
            place = (ground.height - self.sphere) * np.array(ground.normal)
            _add(
                world,
                "geom",
                name=f"ground{k}",
                type="plane",
                size=[0, 0, 1],
                pos=place,
                zaxis=ground.normal,
                contype=0,
                conaffinity=0,
            )
        self._bars(world, V)
        self._points(world, V)
        self._contacts()
        self._strings()
        self._ties(step)
        self._control(velocities is not None)
        return self.root

    def _options(self, step: float) -> None:
        gravity = (0, 0, 0) if self.scene.gravity is None else self.scene.gravity.acceleration
        option = _add(
            self.root, "option", timestep=step, integrator="RK4", gravity=gravity, cone="elliptic"
        )
        if not self.grounds and not self.hanging.ties:
            _add(option, "flag", contact="disable", constraint="disable")

    def _bars(self, world: ET.Element, V: Array) -> None:
        s = self.s
        bodies: dict[int | None, ET.Element] = {None: world}
        turning: dict[int | None, Array] = {None: np.zeros(3)}
        for link in self.hanging.links:
            bar, (a, b) = link.bar, s.bars[link.bar].tolist()
            length, outer = s.bar_lengths[bar], self.turns[link.parent]
            axis = outer.T @ (s.nodes[b] - s.nodes[a]) / length
            self.turns[bar] = outer @ turn_to(axis)
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
                if self.hanging.owner.get(node) == bar:
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

    def _rod(self, body: ET.Element, bar: int, ends: list[float]) -> None:
        """Add the mass of a bar and a visible cylinder."""
        s = self.s
        radius, mass = s.bar_radius[bar], s.bar_mass[bar]
        across = s.bar_inertia[bar] * s.bar_lengths[bar] ** 2  # J of Eq. 19 times l²
        inertia = [across, across, max(mass * radius**2 / 2, _AXIAL * across)]
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

        Its point mass goes into a body fixed to that one.
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
        """Add pinned nodes and nodes without bars."""
        s, held, here = self.s, held_directions(self.s), np.zeros(3)
        for node in (node for node in range(len(s.nodes)) if node not in self.hanging.owner):
            slides = free_directions(held.get(node, NO_DIRECTION))
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
        if not self.touched:
            return
        contact = ET.SubElement(self.root, "contact")
        for k, ground in enumerate(self.grounds):
            for node in touching(ground, self.weights.inverse):
                numbers = contact_numbers(ground, self.weights.inverse[node], self.weights.standing)
                _add(contact, "pair", geom1=f"ground{k}", geom2=f"n{node}", **numbers)

    def _strings(self) -> None:
        s, pushing, driven = (
            self.s,
            set(self.scene.compression_strings.tolist()),
            self.scene.control is not None,
        )
        if not len(s.strings):
            return
        tendon = ET.SubElement(self.root, "tendon")
        for string, (a, b) in enumerate(s.strings):
            rest = [s.rest_length[string]] if string in pushing else [0.0, s.rest_length[string]]
            law = (
                {}
                if driven
                else {
                    "stiffness": s.stiffness[string],
                    "damping": s.damping[string],
                    "springlength": rest,
                }
            )
            spatial = _add(tendon, "spatial", name=f"string{string}", **law)
            for node in (a, b):
                _add(spatial, "site", site=f"n{node}")

    def _ties(self, step: float) -> None:
        if not self.hanging.ties:
            return
        equality = ET.SubElement(self.root, "equality")
        for tie in self.hanging.ties:
            other = {} if tie.other is None else {"body2": f"bar{tie.other}"}
            hard = {"solref": [2 * step, 1.0], "solimp": [0.9999, 0.9999, 0.001, 0.5, 2.0]}
            _add(
                equality,
                "connect",
                body1=f"bar{tie.bar}",
                **other,
                anchor=self.along[tie.bar, tie.node],
                **hard,
            )

    def _control(self, moving: bool) -> None:
        scene, s = self.scene, self.s
        start: dict[str, Any] = {}
        if moving:  # MuJoCo's order is that of the file
            start["qvel"] = [
                rate for body in self.root.iter("body") for rate in self.rates.get(body, ())
            ]
        if scene.control is not None and len(s.strings):
            actuator = ET.SubElement(self.root, "actuator")
            pushing = set(scene.compression_strings.tolist())
            for string in range(len(s.strings)):
                of = {"name": f"string{string}", "tendon": f"string{string}"}
                if isinstance(scene.control, ForceDensity):
                    _add(
                        actuator, "general", **of, gaintype="affine", gainprm=[0, -1, 0]
                    )  # force −length × γ
                else:
                    pulls = (
                        {}
                        if string in pushing
                        else {"forcelimited": "true", "forcerange": [-_STRONGEST, 0.0]}
                    )
                    _add(
                        actuator,
                        "position",
                        **of,
                        kp=s.stiffness[string],
                        kv=s.damping[string],
                        **pulls,
                    )
            taut = s.stiffness * np.maximum(
                0.0, 1 - s.rest_length / s.string_lengths
            )  # Eq. 99 at rest
            start["ctrl"] = s.rest_length if isinstance(scene.control, RestLength) else taut
        if start:
            _add(ET.SubElement(self.root, "keyframe"), "key", name="start", **start)


def _add(parent: ET.Element, tag: str, **attributes: Any) -> ET.Element:
    """Add an element.

    Numbers become text that is read back exactly.
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
