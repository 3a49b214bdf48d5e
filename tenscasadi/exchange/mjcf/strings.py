"""Conversion of MuJoCo's tendons and actuators to strings and control."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from tenscasadi.exchange.mjcf.bodies import Bodies, Site
from tenscasadi.exchange.mjcf.elements import Element
from tenscasadi.exchange.mjcf.members import order_by_number
from tenscasadi.exchange.mjcf.words import Defaults, children
from tenscasadi.scene.control import Control
from tenscasadi.scene.strings import ForceDensity, RestLength, Tension
from tenscasadi.scene.winches import RestLengthRate

_UNLIMITED = 1e9  # N: larger force limits count as none


class TendonString(NamedTuple):
    """String or cable that was read from a spatial tendon.

    Attributes
    ----------
    element : Element
        XML element.
    sites : tuple of Site
        Sites that it runs through: two of a string, more of a cable.
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
    sites: tuple[Site, ...]
    stiffness: float
    damping: float
    rest: float | None
    pushes: bool

    @property
    def name(self) -> str:
        """Name of the tendon."""
        return self.element.text("name")

    @property
    def length(self) -> float:
        """Length of the tendon in the file [m]."""
        return sum(float(np.linalg.norm(b.place - a.place)) for a, b in pairwise(self.sites))

    def divide(self) -> list[TendonString]:
        """Divide a cable into its strings, in series, of equal tension."""
        if len(self.sites) == 2:
            return [self]
        found, length = [], self.length or 1.0
        for ends in pairwise(self.sites):
            share = float(np.linalg.norm(ends[1].place - ends[0].place)) / length
            if share > 0:
                found.append(
                    self._replace(
                        sites=ends,
                        stiffness=self.stiffness / share,
                        damping=self.damping / share,
                        rest=None if self.rest is None else self.rest * share,
                    )
                )
        return found or [self._replace(sites=self.sites[:2])]  # a string of no length


def read_strings(root: Element, defaults: Defaults, bodies: Bodies) -> list[TendonString]:
    """Read all tendons of a file as strings.

    `root` is its root element. The strings are in the order of the numbers in their names. Raises
    SceneFileError.
    """
    read = [
        _read_tendon(defaults.apply(child), bodies)
        for section in root.find("tendon")
        for child in children(section)
    ]
    found = [string for string in read if string is not None]
    order = order_by_number([[string.name] for string in found], "string")
    return found if order is None else [found[k] for k in order]


def _read_tendon(tendon: Element, bodies: Bodies) -> TendonString | None:
    """Read a spatial tendon; None if it is omitted.

    `bodies` contain the sites that it connects. Raises SceneFileError.
    """
    limited = tendon.flag("limited")
    if limited or (limited is None and "range" in tendon.attributes):
        message = "limits the length of a tendon, which has no counterpart in a scene: leave it out"
        tendon.leave_out(message, "range")
    sites = tuple(bodies.find_site(child) for child in children(tendon))
    if len(sites) < 2:
        tendon.leave_out(f"runs through {len(sites)} sites: give two or more")
        return None
    low, high = tendon.numbers("springlength", (1, 2), (-1, -1))[[0, -1]]
    if low != high and low != 0:
        tendon.leave_out(
            f"is {tendon.text('springlength')!r}: give one length, for a spring, or 0 and one, for a string that goes slack",
            "springlength",
        )
    stiffness, damping = (_read_linear(tendon, name) for name in ("stiffness", "damping"))
    rest = None if high < 0 else float(high)
    found = TendonString(tendon, sites, stiffness, damping, rest, bool(low == high))
    if high == 0:
        message = "is 0: a string has a length greater than 0, give a small one"
        tendon.leave_out(message, "springlength")
        found = found._replace(rest=1e-3 * found.length)
    return found


def _read_linear(tendon: Element, name: str) -> float:
    """Read the linear coefficient of a polynomial force law.

    `name` is the attribute of the tendon, its stiffness or damping.
    """
    polynomial = tendon.numbers(name, (1, 2, 3), [0])
    if np.any(polynomial[1:]):
        tendon.leave_out(
            f"is {tendon.text(name)!r}, a polynomial: strings are linear, give one number", name
        )
    return float(polynomial[0])


class Servo(NamedTuple):
    """Actuator of a string in MuJoCo.

    Attributes
    ----------
    element : Element
        XML element.
    control : type of Control
        Kind of the control.
    stiffness, damping : float
        Those that it adds to the string [N/m], [N s/m].
    rest : float or None
        Rest length of its stiffness, or of the string's, at the initial control [m]; None for the
        length in the file.
    pushes : bool
        Whether it carries compression.
    start : float
        Initial control of a commanded force [N/m] or [N].
    """

    element: Element
    control: type[Control]
    stiffness: float = 0.0
    damping: float = 0.0
    rest: float | None = None
    pushes: bool = False
    start: float = 0.0

    def force_density(self, length: float) -> float:
        """Compute the initial force density [N/m] of a prescribed force.

        `length` is the initial length of the tendon [m].
        """
        return self.start / length if self.control is Tension and length > 0 else self.start


# kinds of control, the preferred one of a file with several first
_KINDS = (RestLength, RestLengthRate, Tension, ForceDensity)


def read_control(
    root: Element, defaults: Defaults, strings: list[TendonString]
) -> tuple[Control | None, list[TendonString]]:
    """Read the control, and apply its law to the strings.

    `root` is the root element of the file. The control is None without actuators. Raises
    SceneFileError.
    """
    names = {string.name: string for string in strings if string.name}
    actuators = [
        defaults.apply(child) for section in root.find("actuator") for child in children(section)
    ]
    start = _read_start(root, actuators)
    servos: dict[str, Servo] = {}
    for k, actuator in enumerate(actuators):
        name = actuator.text("tendon")
        if name not in names or name in servos:
            message = "give each tendon one actuator, and actuators to tendons alone"
            actuator.leave_out(f"is {name!r}: {message}", "tendon")
            continue
        servo = _read_servo(actuator, names[name], start[k])
        if servo.control is ForceDensity and len(names[name].sites) > 2:
            actuator.leave_out(
                f"drives a cable by force density: {_TENSION} for its tension", "gainprm"
            )
            servo = servo._replace(control=Tension, start=servo.start * names[name].length)
        servos[name] = servo
    if not servos:
        return None, strings
    kinds = {servo.control for servo in servos.values()}
    kind = next(kind for kind in _KINDS if kind in kinds)
    found = []
    for string in strings:
        own = servos.get(string.name)
        if own is None:
            message = "has no actuator, while others have: a scene controls all strings, or none"
            string.element.leave_out(message)
        elif own.control is not kind:
            own.element.leave_out(
                "controls its string in another way than others: a scene has one kind of control"
            )
        found.append(_drive(string, own, kind))
    return kind(), found


def _drive(string: TendonString, servo: Servo | None, kind: type[Control]) -> TendonString:
    """Combine the springs of a string and its actuator.

    `servo` is the actuator, None without one. `kind` is the common control of all strings. An
    actuator with another control is ignored.
    """
    commands = kind in (ForceDensity, Tension)
    own = servo
    if servo is not None and servo.control is not kind and (commands or not servo.stiffness):
        own = None
    if own is not None and commands and (string.stiffness or string.damping):
        string.element.leave_out(
            "has stiffness or damping beside an actuator that sets its force: leave them out",
            "stiffness",
        )
    if own is not None and (string.stiffness or string.damping) and own.stiffness:
        if not (string.pushes and own.pushes):
            string.element.leave_out(
                "has stiffness or damping beside an actuator: give them to the actuator, as kp and kv",
                "stiffness",
            )
        rests = [string.length if part.rest is None else part.rest for part in (string, own)]
        total = string.stiffness + own.stiffness
        rest = (string.stiffness * rests[0] + own.stiffness * rests[1]) / total
        return string._replace(
            stiffness=total, damping=string.damping + own.damping, rest=rest, pushes=own.pushes
        )
    if own is not None and own.stiffness:
        return string._replace(**{name: getattr(own, name) for name in _SPRING})
    if own is not None and own.rest is not None:
        return string._replace(rest=own.rest)
    if commands:
        return _hold(string, 0.0 if own is None else own.force_density(string.length))
    return string


def _hold(string: TendonString, density: float) -> TendonString:
    """Choose a spring with a given initial force density [N/m].

    The string has a prescribed force.
    """
    k = max(100.0, 2 * density)  # the default of `Structure`, which commanded forces ignore
    return string._replace(
        stiffness=k, rest=string.length * (1 - density / k) if density > 0 else None
    )


_SPRING = ("stiffness", "damping", "rest", "pushes")
_DENSITY = 'give gaintype="affine" gainprm="0 -1 0"'
_TENSION = 'give gainprm="-1 0 0"'


def _read_servo(actuator: Element, string: TendonString, control: float | None) -> Servo:
    """Read the actuator of a string with its initial control.

    The force is affine in control, length and velocity, or the product of control and length.
    """
    gain, bias = (
        np.pad(actuator.numbers(name, range(1, 11), [first]), (0, 9))[:10]
        for name, first in (("gainprm", 1.0), ("biasprm", 0.0))
    )
    kinds = [
        actuator.text("gaintype", "fixed"),
        actuator.text("biastype", "none"),
        _read_dynamics(actuator),
    ]
    if actuator.tag in ("position", "intvelocity"):
        k = actuator.number("kp", 1.0)
        gain, bias = np.array([k]), np.array([0.0, -k, -actuator.number("kv", 0.0)])
        kinds = ["fixed", "affine", _read_dynamics(actuator)]
    if kinds[2] not in ("none", "integrator"):
        actuator.leave_out(f"is {kinds[2]!r}: strings follow their control at once", "dyntype")
        kinds[2] = "none"
    gear = float(actuator.text("gear", "1").split()[0])
    single = kinds[1:] == ["none", "none"] and np.count_nonzero(gain) == 1
    if single and kinds[0] == "affine" and gain[1] * gear**2 == -1:
        return Servo(actuator, ForceDensity, start=control or 0.0)
    affine = kinds[1] == "affine"
    if kinds[0] == "fixed" and kinds[2] == "none" and not (affine and np.any(bias[1:])):
        return _read_motor(actuator, string, gear * (gain[0] * (control or 0.0) + affine * bias[0]))
    is_spring = kinds[:2] == ["fixed", "affine"] and bias[1] < 0
    exact = gear == 1 and (not is_spring or (not bias[0] and bias[1] == -gain[0]))
    if not is_spring or not exact or np.any(gain[1:]) or np.any(bias[3:]):
        actuator.leave_out(
            f"pulls by another law than force = −length × control: {_DENSITY}", "gainprm"
        )
    if not is_spring:
        return Servo(actuator, RestLength)
    rest = (bias[0] + gear * gain[0] * (control or 0.0)) / -bias[1]
    given = control is not None or bias[0]
    return Servo(
        actuator,
        RestLengthRate if kinds[2] == "integrator" else RestLength,
        float(-bias[1]),
        float(0.0 - bias[2]),
        float(rest) if given and rest > 0 else None,
        not _is_tension_only(actuator),
    )


def _read_motor(actuator: Element, string: TendonString, force: float) -> Servo:
    """Read an actuator whose force does not depend on length.

    It prescribes the tension of a tendon without a spring. Besides a spring, it has the effect of
    another rest length. `force` is its initial force [N], negative in tension.
    """
    if not string.stiffness and not string.damping:
        return Servo(actuator, Tension, start=-force)
    if not (string.pushes and string.stiffness):
        actuator.leave_out(
            "adds a force to a string that goes slack, or has only damping: give the tendon a "
            "stiffness and one springlength"
        )
        return Servo(actuator, RestLength)
    rest = string.length if string.rest is None else string.rest
    return Servo(actuator, RestLength, rest=rest + force / string.stiffness)


def _read_dynamics(actuator: Element) -> str:
    """Read the activation dynamics of an actuator, such as "integrator"."""
    kinds = {"position": "none", "intvelocity": "integrator"}
    return kinds.get(actuator.tag, actuator.text("dyntype", "none"))


def _read_start(root: Element, actuators: list[Element]) -> list[float | None]:
    """Read the initial controls from the first keyframe that has them.

    `root` is the root element of the file. There is one number for each actuator; None where no
    keyframe has one. Controls of actuators with activation are their activation states.
    """
    keys = [key for section in root.find("keyframe") for key in section.find("key")]

    def read(name: str, count: int) -> list[float | None]:
        first = (key for key in keys if name in key.attributes)
        return next((key.numbers(name, count).tolist() for key in first), [])

    kinds = [_read_dynamics(actuator) for actuator in actuators]
    states = [k for k, kind in enumerate(kinds) if kind != "none"]
    controls = read("ctrl", len(kinds)) or [None] * len(kinds)
    found = [
        None if kind == "integrator" else own for kind, own in zip(kinds, controls, strict=True)
    ]
    for k, own in zip(states, read("act", len(states)), strict=False):  # [] without states
        found[k] = own
    return found


def _is_tension_only(actuator: Element) -> bool:
    """Return whether an actuator is limited to tension.

    Raises SceneFileError for other limits.
    """
    if actuator.flag("forcelimited") is False or "forcerange" not in actuator.attributes:
        return False
    low, high = actuator.numbers("forcerange", 2)
    if low > -_UNLIMITED or (high != 0 and high < _UNLIMITED):
        actuator.leave_out(
            f"is {actuator.text('forcerange')!r}: give none, or one of -1e12 and 0 for a string that does not push",
            "forcerange",
        )
    return bool(high == 0)
