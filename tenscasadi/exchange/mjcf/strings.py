"""Tendons and actuators of MJCF as strings and their control."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from tenscasadi.exchange.mjcf.bodies import Bodies, Site
from tenscasadi.exchange.mjcf.elements import Element
from tenscasadi.exchange.mjcf.members import order_by_number
from tenscasadi.exchange.mjcf.words import Defaults, children
from tenscasadi.scene.control import Control
from tenscasadi.scene.strings import ForceDensity, RestLength
from tenscasadi.util.validate import Array

_UNLIMITED = 1e9  # N: larger force limits count as none


class TendonString(NamedTuple):
    """String of a spatial tendon.

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

    @property
    def name(self) -> str:
        """Name of the tendon."""
        return self.element.text("name")


def read_strings(root: Element, defaults: Defaults, bodies: Bodies) -> list[TendonString]:
    """Read all tendons, in the order of the numbers in their names.

    Raises SceneFileError.
    """
    found = [
        string
        for section in root.find("tendon")
        for child in children(section)
        for string in _read_tendon(defaults.apply(child), bodies)
    ]
    order = order_by_number([[string.name] for string in found], "string")
    return found if order is None else [found[k] for k in order]


def _read_tendon(tendon: Element, bodies: Bodies) -> list[TendonString]:
    """Read a spatial tendon as strings in a row.

    Raises SceneFileError.
    """
    limited = tendon.flag("limited")
    if limited or (limited is None and "range" in tendon.attributes):
        message = "limits the length of a tendon, which has no counterpart in a scene: leave it out"
        tendon.leave_out(message, "range")
    sites = [bodies.find_site(child) for child in children(tendon)]
    if len(sites) != 2:
        tendon.leave_out(
            f"runs through {len(sites)} sites: strings join two nodes, write one for each part"
        )
    low, high = tendon.numbers("springlength", (1, 2), (-1, -1))[[0, -1]]
    if low != high and low != 0:
        tendon.leave_out(
            f"is {tendon.text('springlength')!r}: give one length, for a spring, or 0 and one, for a string that goes slack",
            "springlength",
        )
    parts = list(pairwise(sites))
    lengths = [float(np.linalg.norm(b.place - a.place)) for a, b in parts]
    whole = sum(lengths)
    if high == 0:
        message = "is 0: a string has a length greater than 0, give a small one"
        tendon.leave_out(message, "springlength")
        high = 1e-3 * whole
    stiffness, damping = (_read_linear(tendon, name) for name in ("stiffness", "damping"))
    pushes = bool(low == high)
    if len(parts) == 1:
        rest = None if high < 0 else float(high)
        return [TendonString(tendon, parts[0], stiffness, damping, rest, pushes)]
    found = []
    for ends, length in zip(parts, lengths, strict=True):  # in series, of equal tension
        if length > 0:
            share = length / whole
            rest = None if high < 0 else float(high) * share
            k, c = stiffness / share, damping / share
            found.append(TendonString(tendon, ends, k, c, rest, pushes))
    return found


def _read_linear(tendon: Element, name: str) -> float:
    """Read the linear coefficient of a force law."""
    polynomial = tendon.numbers(name, (1, 2, 3), [0])
    if np.any(polynomial[1:]):
        tendon.leave_out(
            f"is {tendon.text(name)!r}, a polynomial: strings are linear, give one number", name
        )
    return float(polynomial[0])


class Servo(NamedTuple):
    """Actuator of a string.

    Attributes
    ----------
    element : Element
        XML element.
    control : type of Control
        Kind of the control.
    stiffness, damping : float
        Those that it adds to the string [N/m], [N s/m].
    rest : float or None
        Rest length of its stiffness at the initial control [m]; None for the length in the file.
    pushes : bool
        Whether it carries compression.
    """

    element: Element
    control: type[Control]
    stiffness: float = 0.0
    damping: float = 0.0
    rest: float | None = None
    pushes: bool = False


def read_control(
    root: Element, defaults: Defaults, strings: list[TendonString]
) -> tuple[Control | None, list[TendonString]]:
    """Read the control, and apply its law to the strings.

    Raises SceneFileError.
    """
    names = {string.name for string in strings}
    actuators = [
        defaults.apply(child) for section in root.find("actuator") for child in children(section)
    ]
    start = _read_start(root, len(actuators))
    servos: dict[str, Servo] = {}
    for k, actuator in enumerate(actuators):
        name = actuator.text("tendon")
        if name not in names or name in servos:
            message = "give each tendon one actuator, and actuators to tendons alone"
            actuator.leave_out(f"is {name!r}: {message}", "tendon")
            continue
        servo = _read_servo(actuator, None if start is None else float(start[k]))
        if servo is not None:
            servos[name] = servo
    if not servos:
        return None, strings
    kinds = {servo.control for servo in servos.values()}
    kind = RestLength if RestLength in kinds else ForceDensity
    found = []
    for string in strings:
        servo = servos.get(string.name)
        if servo is None:
            message = "has no actuator, while others have: a scene drives all strings, or none"
            string.element.leave_out(message)
        elif servo.control is not kind:
            servo.element.leave_out(
                "drives its string in another way than others: a scene drives all in one way"
            )
        found.append(_drive(string, servo, kind))
    return kind(), found


def _drive(string: TendonString, servo: Servo | None, kind: type[Control]) -> TendonString:
    """Combine the springs of a string and its actuator."""
    own = servo if servo is not None and servo.control is kind else None
    if own is not None and (string.stiffness or string.damping) and own.stiffness:
        string.element.leave_out(
            "has stiffness or damping beside an actuator: give them to the actuator, as kp and kv",
            "stiffness",
        )
        length = float(np.linalg.norm(string.ends[1].place - string.ends[0].place))
        rests = [length if part.rest is None else part.rest for part in (string, own)]
        total = string.stiffness + own.stiffness
        rest = (string.stiffness * rests[0] + own.stiffness * rests[1]) / total
        return string._replace(
            stiffness=total, damping=string.damping + own.damping, rest=rest, pushes=own.pushes
        )
    if own is not None and kind is RestLength and own.stiffness:
        return string._replace(**{name: getattr(own, name) for name in _SPRING})
    if kind is ForceDensity:  # the default of `Structure`, which force densities ignore
        return string._replace(stiffness=100.0, rest=None)
    return string


_SPRING = ("stiffness", "damping", "rest", "pushes")


def _read_servo(actuator: Element, control: float | None) -> Servo | None:
    """Read an actuator with its initial control; None if it is left out.

    The force is affine in control, length and velocity, or the product of control and length.
    """
    gain, bias = (
        np.pad(actuator.numbers(name, range(1, 11), [first]), (0, 9))[:10]
        for name, first in (("gainprm", 1.0), ("biasprm", 0.0))
    )
    kinds = [actuator.text(f"{name}type", "fixed" if name == "gain" else "none") for name in _TYPES]
    if actuator.tag == "position":
        k = actuator.number("kp", 1.0)
        gain, bias = np.array([k]), np.array([0.0, -k, -actuator.number("kv", 0.0)])
        kinds = ["fixed", "affine", "none"]
    if kinds[2] != "none":
        actuator.leave_out(f"is {kinds[2]!r}: strings follow their control at once", "dyntype")
    gear = float(actuator.text("gear", "1").split()[0])
    if kinds[:2] == ["affine", "none"] and gain[1] == -1 and np.count_nonzero(gain) == 1:
        return Servo(actuator, ForceDensity)
    is_spring = kinds[:2] == ["fixed", "affine"] and bias[1] < 0
    exact = gear == 1 and (not is_spring or (not bias[0] and bias[1] == -gain[0]))
    if not is_spring or not exact or np.any(gain[1:]) or np.any(bias[3:]):
        cure = 'give gaintype="affine" gainprm="0 -1 0"'
        actuator.leave_out(
            f"pulls by another law than force = −length × control: {cure}", "gainprm"
        )
    if not is_spring:  # a force beside that of the string's own spring
        return Servo(actuator, RestLength)
    rest = (bias[0] + gear * gain[0] * (control or 0.0)) / -bias[1]
    given = control is not None or bias[0]
    return Servo(
        actuator,
        RestLength,
        float(-bias[1]),
        float(0.0 - bias[2]),
        float(rest) if given and rest > 0 else None,
        not _is_tension_only(actuator),
    )


_TYPES = ("gain", "bias", "dyn")


def _read_start(root: Element, count: int) -> Array | None:
    """Read the controls of the first key that has them."""
    keys = [key for section in root.find("keyframe") for key in section.find("key")]
    return next((key.numbers("ctrl", count) for key in keys if "ctrl" in key.attributes), None)


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
