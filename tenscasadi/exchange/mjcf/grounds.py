"""Conversion of planes into grounds of the nodes in contact."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from tenscasadi.exchange.mjcf.bodies import Bodies
from tenscasadi.exchange.mjcf.contact import ContactWeights, ground_numbers
from tenscasadi.exchange.mjcf.elements import Element
from tenscasadi.exchange.mjcf.geoms import Geom
from tenscasadi.exchange.mjcf.words import Defaults, check, children
from tenscasadi.scene.ground import Ground
from tenscasadi.util.validate import MAX_COUNT, Array

_DEFAULTS = {"solref": (0.02, 1.0), "friction": (1.0, 0.005, 0.0001)}  # of MuJoCo


class Touch(NamedTuple):
    """Contact of a node with a plane.

    Attributes
    ----------
    node : int
        Index of the node.
    distance : float
        Height of the node above the plane at contact [m].
    law : Element
        Element with the contact attributes.
    """

    node: int
    distance: float
    law: Element


def read_grounds(
    root: Element,
    bodies: Bodies,
    defaults: Defaults,
    node_at: Callable[[int, Array], int | None],
    weigh: Callable[[], ContactWeights],
) -> list[Ground]:
    """Read the grounds of a file. Raises SceneFileError.

    `node_at` returns the node at a point of a piece, and `weigh` the contact scales.
    """
    pairs, apart = _read_contacts(root, bodies, defaults)
    moving = [(k, geom) for k, piece in bodies.moving() for geom in piece.geoms]
    found: list[Ground] = []
    fixed = bodies.pieces[0].geoms
    if len(fixed) * len(moving) > 100 * MAX_COUNT:
        raise root.error(
            f"has {len(fixed)} geoms in the world and {len(moving)} in bodies, too many to find which touch: give fewer"
        )
    for plane in fixed:
        touches: dict[int, Touch] = {}
        for k, geom in moving:
            law = pairs.get(frozenset((plane.element.text("name"), geom.element.text("name"))))
            if law is None and (k in apart or not _can_touch(plane.element, geom.element)):
                continue
            if plane.element.text("type", "sphere") != "plane":
                message = "is touched by bodies: tenscasadi's grounds are planes"
                plane.element.leave_out(message, "type")
                break
            law = law or _mix(plane.element, geom.element)
            for touch in _find_touches(k, geom, law, node_at):
                if touch.node not in touches or touch.distance > touches[touch.node].distance:
                    touches[touch.node] = touch
        if touches:
            found += _build_grounds(plane, list(touches.values()), weigh())
    return found


def _read_contacts(
    root: Element, bodies: Bodies, defaults: Defaults
) -> tuple[Mapping[frozenset[str], Element], set[int]]:
    """Read explicit contact pairs, and pieces excluded from world contact."""
    pairs: dict[frozenset[str], Element] = {}
    apart: set[int] = set()
    for section in root.find("contact"):
        for child in children(section):
            if child.tag == "exclude":
                one, other = (
                    bodies.find_body(check(child), name)[0] for name in ("body1", "body2")
                )
                apart |= {one, other} if 0 in (one, other) else set()
            else:
                pair = defaults.apply(child)
                pairs[frozenset((pair.text("geom1"), pair.text("geom2")))] = pair
    return pairs, apart


def _can_touch(one: Element, other: Element) -> bool:
    """Return whether two geoms touch by their types and affinities."""
    types, affinities = (
        [geom.whole(name, 1) for geom in (one, other)] for name in ("contype", "conaffinity")
    )
    return bool(types[0] & affinities[1] or types[1] & affinities[0])


def _mix(one: Element, other: Element) -> Element:
    """Combine the contact attributes of two geoms.

    The geom of higher priority decides. For equal priorities the friction is the maximum, and the
    law the mean.
    """
    priorities = [geom.whole("priority", 0) for geom in (one, other)]
    if priorities[0] != priorities[1]:
        return one if priorities[0] > priorities[1] else other
    friction = max(
        float(geom.numbers("friction", (1, 2, 3), _DEFAULTS["friction"])[0])
        for geom in (one, other)
    )
    laws = np.array([geom.numbers("solref", (1, 2), _DEFAULTS["solref"]) for geom in (one, other)])
    law = laws.mean(axis=0) if (laws[:, 0] > 0).all() else laws.min(axis=0)
    mixed = {
        "friction": repr(friction),
        "solref": " ".join(repr(float(x)) for x in law),
        "condim": str(max(geom.whole("condim", 3) for geom in (one, other))),
    }
    return other.replace({**other.attributes, **mixed})


def _find_touches(
    k: int, geom: Geom, law: Element, node_at: Callable[[int, Array], int | None]
) -> list[Touch]:
    """Find the contacts of a geom's ends at nodes."""
    if geom.rod is None:
        return []
    nodes = [node_at(k, end) for end in geom.rod.ends[: 1 if geom.rod.kind == "sphere" else 2]]
    return [Touch(node, geom.rod.radius, law) for node in nodes if node is not None]


def _build_grounds(plane: Geom, touches: list[Touch], weights: ContactWeights) -> list[Ground]:
    """Build the grounds of a plane, one for each law."""
    normal = plane.frame.turn[:, 2]
    height = float(normal @ plane.frame.place)
    touches = sorted(touch for touch in touches if weights.inverse[touch.node] > 0)
    if not touches:
        return []
    mean = float(np.mean([weights.inverse[touch.node] for touch in touches]))
    laws: list[tuple[dict[str, Any], list[int]]] = []
    for touch in touches:
        solref = touch.law.numbers("solref", 2, _DEFAULTS["solref"])
        if solref[0] > 0 >= solref[1]:
            raise touch.law.error(
                "has one number above 0 and one below: give a time constant and a damping ratio, or both negated",
                "solref",
            )
        friction = touch.law.numbers("friction", (1, 2, 3, 4, 5), _DEFAULTS["friction"])[0]
        slides = touch.law.whole("condim", 3) == 1 or friction == 0
        inverse = (
            float(weights.inverse[touch.node]) if solref[0] <= 0 else mean
        )  # a time constant gives a stiffness proportional to mass
        numbers = ground_numbers(
            solref,
            touch.law.numbers("solreffriction", 2, (0, 0)),
            None if slides else float(friction),
            inverse,
            weights.standing,
        )
        law = {**numbers, "height": height + touch.distance}
        nodes = next((nodes for known, nodes in laws if _is_equal(known, law)), None)
        if nodes is None:
            laws.append((law, [touch.node]))
        else:
            nodes.append(touch.node)
    everywhere = len(laws) == 1 and len(touches) == int(np.count_nonzero(weights.inverse))
    try:
        return [
            Ground(**law, normal=tuple(normal.tolist()), nodes=None if everywhere else nodes)
            for law, nodes in laws
        ]
    except ValueError as error:
        raise plane.element.error(str(error)) from None


def _is_equal(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Return whether two laws agree to the six digits of a file."""
    if one.keys() != other.keys() or (one["friction"] is None) != (other["friction"] is None):
        return False
    return all(
        abs(one[name] - other[name]) <= 1e-4 * max(abs(one[name]), 1e-3 * (name == "height"))
        for name in one
        if one[name] is not None
    )
