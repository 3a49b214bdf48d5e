"""Conversion of planes into grounds of the nodes in contact."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from tenscasadi.exchange.mjcf.bodies import Bodies, Shape
from tenscasadi.exchange.mjcf.contact import Weights, ground_numbers
from tenscasadi.exchange.mjcf.elements import Element
from tenscasadi.exchange.mjcf.words import Defaults, check, children
from tenscasadi.scene.ground import Ground
from tenscasadi.util.validate import Array

_SOFT = (0.02, 1.0)  # MuJoCo's default solref
_FRICTION = (1.0, 0.005, 0.0001)
_ALIKE = 1e-4  # relative difference within one ground, for files of six digits
_MOST = 10_000_000  # pairs of geoms


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
    weigh: Callable[[], Weights],
) -> list[Ground]:
    """Read the grounds of a file. Raises SceneFileError.

    Parameters
    ----------
    root, bodies, defaults
        The file.
    node_at : callable
        Returns the node at a point of a piece.
    weigh : callable
        Returns the contact scales.

    Returns
    -------
    list of Ground
        The grounds.
    """
    pairs, apart = _read_contacts(root, bodies, defaults)
    moving = [(k, shape) for k, piece in bodies.moving() for shape in piece.shapes]
    found: list[Ground] = []
    fixed = bodies.pieces[0].shapes
    if len(fixed) * len(moving) > _MOST:
        raise root.error(
            f"has {len(fixed)} geoms in the world and {len(moving)} in bodies, too many to find which touch: give fewer"
        )
    for shape in fixed:
        touches: dict[int, Touch] = {}
        for k, other in moving:
            law = pairs.get(frozenset((shape.element.text("name"), other.element.text("name"))))
            if law is None and (k in apart or not _meet(shape.element, other.element)):
                continue
            if shape.element.text("type", "sphere") != "plane":
                raise shape.element.error(
                    "is touched by bodies: tenscasadi's grounds are planes", "type"
                )
            for touch in _touches(k, other, law or _mixed(shape.element, other.element), node_at):
                if touch.node not in touches or touch.distance > touches[touch.node].distance:
                    touches[touch.node] = touch
        if touches:
            found += _grounds(shape, list(touches.values()), weigh())
    return found


def _read_contacts(
    root: Element, bodies: Bodies, defaults: Defaults
) -> tuple[Mapping[frozenset[str], Element], set[int]]:
    """Read explicit contact pairs, and pieces excluded from world contact."""
    pairs: dict[frozenset[str], Element] = {}
    apart: set[int] = set()
    for section in root.of("contact"):
        for child in children(section):
            if child.tag == "exclude":
                (one, _), (other, _) = (
                    bodies.named(check(child), name) for name in ("body1", "body2")
                )
                apart |= {one, other} if 0 in (one, other) else set()
            else:
                pair = check(defaults.apply(child))
                pairs[frozenset((pair.text("geom1"), pair.text("geom2")))] = pair
    return pairs, apart


def _meet(one: Element, other: Element) -> bool:
    """Return whether two geoms touch by their types and affinities."""
    types, affinities = (
        [geom.whole(name, 1) for geom in (one, other)] for name in ("contype", "conaffinity")
    )
    return bool(types[0] & affinities[1] or types[1] & affinities[0])


def _mixed(one: Element, other: Element) -> Element:
    """Combine the contact attributes of two geoms.

    The geom of higher priority decides. For equal priorities the friction is the maximum, and the
    law the mean.
    """
    priorities = [geom.whole("priority", 0) for geom in (one, other)]
    if priorities[0] != priorities[1]:
        return one if priorities[0] > priorities[1] else other
    friction = max(
        float(geom.numbers("friction", (1, 2, 3), _FRICTION)[0]) for geom in (one, other)
    )
    laws = np.array([geom.numbers("solref", (1, 2), _SOFT) for geom in (one, other)])
    law = laws.mean(axis=0) if (laws[:, 0] > 0).all() else laws.min(axis=0)
    dimensions = max(geom.whole("condim", 3) for geom in (one, other))
    said = {
        "friction": repr(friction),
        "solref": " ".join(repr(float(x)) for x in law),
        "condim": str(dimensions),
    }
    return other.given({**other.attributes, **said})


def _touches(
    k: int, shape: Shape, law: Element, node_at: Callable[[int, Array], int | None]
) -> list[Touch]:
    """Find the contacts of a geom's ends at nodes."""
    if shape.rod is None:
        return []
    nodes = [node_at(k, end) for end in shape.rod.ends[: 1 if shape.rod.kind == "sphere" else 2]]
    return [Touch(node, shape.rod.radius, law) for node in nodes if node is not None]


def _grounds(plane: Shape, touches: list[Touch], weights: Weights) -> list[Ground]:
    """Build the grounds of a plane, one for each law."""
    normal = plane.frame.turn[:, 2]
    touches = sorted(
        (touch for touch in touches if weights.inverse[touch.node] > 0),
        key=lambda touch: touch.node,
    )
    if not touches:
        return []
    mean = float(np.mean([weights.inverse[touch.node] for touch in touches]))
    alike: list[tuple[dict[str, Any], list[int]]] = []
    for touch in touches:
        solref = touch.law.numbers("solref", 2, _SOFT)
        if (solref[0] > 0) != (solref[1] > 0) and solref.any() and solref[0] > 0:
            raise touch.law.error(
                "has one number above 0 and one below: give a time constant and a damping ratio, or both negated",
                "solref",
            )
        friction = (
            float(touch.law.numbers("friction", (1, 2, 3, 4, 5), _FRICTION)[0])
            if touch.law.whole("condim", 3) > 1
            else 0.0
        )
        inverse = (
            float(weights.inverse[touch.node]) if solref[0] <= 0 else mean
        )  # a time constant gives a stiffness proportional to mass
        slow = touch.law.numbers("solreffriction", 2, (0, 0))
        numbers = ground_numbers(solref, slow, friction or None, inverse, weights.standing)
        law = {**numbers, "height": float(normal @ plane.frame.place) + touch.distance}
        nodes = next((nodes for known, nodes in alike if _same(known, law)), None)
        if nodes is None:
            alike.append((law, [touch.node]))
        else:
            nodes.append(touch.node)
    everywhere = len(alike) == 1 and len(touches) == int(np.count_nonzero(weights.inverse))
    try:
        return [
            Ground(**law, normal=tuple(normal.tolist()), nodes=None if everywhere else nodes)
            for law, nodes in alike
        ]
    except ValueError as error:
        raise plane.element.error(str(error)) from None


def _same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Return whether two laws agree to file precision."""
    if one.keys() != other.keys() or (one["friction"] is None) != (other["friction"] is None):
        return False
    return all(
        abs(one[name] - other[name]) <= _ALIKE * max(abs(one[name]), 1e-3 * (name == "height"))
        for name in one
        if one[name] is not None
    )
