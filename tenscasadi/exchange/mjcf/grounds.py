"""Conversion of MuJoCo's contacts to grounds and bar contact."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np

from tenscasadi.exchange.mjcf.bodies import Bodies
from tenscasadi.exchange.mjcf.contact import ContactWeights, ground_numbers
from tenscasadi.exchange.mjcf.elements import Element
from tenscasadi.exchange.mjcf.geoms import Geom, RodGeom
from tenscasadi.exchange.mjcf.words import Defaults, check, children
from tenscasadi.scene.bar_contact import BarContact
from tenscasadi.scene.ground import Ground
from tenscasadi.util.validate import MAX_COUNT, Array

_DEFAULTS = {"solref": (0.02, 1.0), "friction": (1.0, 0.005, 0.0001)}  # of MuJoCo


class PlaneTouch(NamedTuple):
    """Possible contact of a node or bar with a plane in MuJoCo.

    Attributes
    ----------
    nodes : tuple of int
        Index of the node, or of both ends of the bar.
    bar : int or None
        Index of the bar.
    distance : float
        Height of the nodes above the plane at contact [m].
    law : Element
        Element with the contact attributes.
    """

    nodes: tuple[int, ...]
    bar: int | None
    distance: float
    law: Element


class Locator(Protocol):
    """Interface that finds nodes and bars of the imported scene."""

    def find_node(self, piece: int, point: Array) -> int | None:
        """Find the node at a point of a rigid piece.

        The point is (3,) [m]. Returns None if there is none.
        """

    def find_bar(self, piece: int, rod: RodGeom) -> int | None:
        """Find the bar that a geom covers with its radius.

        `piece` is the index of the geom's rigid piece, and `rod` its shape. Returns None without
        such a bar.
        """

    def weigh(self) -> ContactWeights:
        """Compute inverse masses and loads for contact parameters."""


def read_contacts(
    root: Element, bodies: Bodies, defaults: Defaults, locator: Locator
) -> tuple[list[Ground], BarContact | None]:
    """Read the grounds and the bar contact of a file.

    `root` is its root element, and `defaults` are its default attributes. The bar contact is None
    if there is none. Raises SceneFileError.
    """
    pairs, apart = _read_pairs(root, bodies, defaults)
    return (
        _read_grounds(root, bodies, pairs, apart, locator),
        _read_bar_contact(bodies, pairs, locator),
    )


def _read_grounds(
    root: Element,
    bodies: Bodies,
    pairs: Mapping[frozenset[str], Element],
    apart: set[int],
    locator: Locator,
) -> list[Ground]:
    moving = [(k, geom) for k, piece in bodies.moving() for geom in piece.geoms]
    found: list[Ground] = []
    fixed = bodies.pieces[0].geoms
    if len(fixed) * len(moving) > 100 * MAX_COUNT:
        raise root.error(
            f"has {len(fixed)} geoms in the world and {len(moving)} in bodies, too many to find which touch: give fewer"
        )
    for plane in fixed:
        touches: dict[tuple[int | None, int], PlaneTouch] = {}
        for k, geom in moving:
            law = pairs.get(frozenset((plane.element.text("name"), geom.element.text("name"))))
            if law is None and (k in apart or not _can_touch(plane.element, geom.element)):
                continue
            if plane.element.text("type", "sphere") != "plane":
                message = "is touched by bodies: tenscasadi's grounds are planes"
                plane.element.leave_out(message, "type")
                break
            law = law or _mix(plane.element, geom.element)
            for touch in _find_touches(k, geom, law, locator):
                key = touch.bar, touch.nodes[0]
                if key not in touches or touch.distance > touches[key].distance:
                    touches[key] = touch
        if touches:
            found += _build_grounds(plane, list(touches.values()), locator.weigh())
    return found


def _read_bar_contact(
    bodies: Bodies, pairs: Mapping[frozenset[str], Element], locator: Locator
) -> BarContact | None:
    """Read the explicit contact pairs of capsules that cover bars.

    `pairs` are the `pair` elements by the names of their two geoms. The result is None without such
    pairs.
    """
    bars = {}
    for k, geom in ((k, geom) for k, piece in bodies.moving() for geom in piece.geoms):
        name, bar = geom.element.text("name"), geom.rod and locator.find_bar(k, geom.rod)
        if name and bar is not None:
            bars[name] = bar
    chosen = [
        (names, law) for names, law in pairs.items() if len(names) == 2 and names <= bars.keys()
    ]
    if not chosen:
        return None
    weights, laws = locator.weigh(), []
    for names, law in chosen:
        inverse = float(sum(weights.bars[bars[name]] for name in names))
        laws.append(_read_law(law, inverse, inverse, weights.standing))
        if not _is_equal(laws[0], laws[-1]):
            law.leave_out("has another law than the first pair of bars: tenscasadi has one for all")
    found = sorted(tuple(sorted(bars[name] for name in names)) for names, _ in chosen)
    try:
        return BarContact(found, **laws[0])
    except ValueError as error:
        raise chosen[0][1].error(str(error)) from None


def _read_pairs(
    root: Element, bodies: Bodies, defaults: Defaults
) -> tuple[Mapping[frozenset[str], Element], set[int]]:
    """Read explicit contact pairs, and pieces excluded from world contact.

    The pairs are XML elements by the names of their two geoms. Pieces are indices.
    """
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
    """Return whether MuJoCo lets two geoms collide.

    Their contact types and affinities decide.
    """
    types, affinities = (
        [geom.whole(name, 1) for geom in (one, other)] for name in ("contype", "conaffinity")
    )
    return bool(types[0] & affinities[1] or types[1] & affinities[0])


def _mix(one: Element, other: Element) -> Element:
    """Combine the contact attributes of two geoms, `one` and `other`.

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


def _find_touches(k: int, geom: Geom, law: Element, locator: Locator) -> list[PlaneTouch]:
    """Find the possible plane contacts of a geom.

    The geom belongs to piece k and has the contact attributes `law`. It covers a bar, or its ends
    are nodes. `locator` finds these.
    """
    if geom.rod is None:
        return []
    ends = geom.rod.ends[: 1 if geom.rod.kind == "sphere" else 2]
    nodes = [node for end in ends if (node := locator.find_node(k, end)) is not None]
    bar = locator.find_bar(k, geom.rod)
    if bar is not None:
        return [PlaneTouch(tuple(nodes), bar, geom.rod.radius, law)]
    return [PlaneTouch((node,), None, geom.rod.radius, law) for node in nodes]


def _build_grounds(plane: Geom, touches: list[PlaneTouch], weights: ContactWeights) -> list[Ground]:
    """Build the grounds of a plane, one for each contact law.

    `touches` are the contacts with the plane, and `weights` the inverse masses and loads of nodes.
    """
    normal = plane.frame.turn[:, 2]
    height = float(normal @ plane.frame.place)
    covered = {
        node: touch.distance for touch in touches if touch.bar is not None for node in touch.nodes
    }

    def weigh(touch: PlaneTouch) -> float:
        inverse = weights.inverse[touch.nodes[0]] if touch.bar is None else weights.bars[touch.bar]
        return float(inverse)

    touches = [
        touch
        for touch in sorted(touches, key=lambda touch: touch.nodes)
        if weigh(touch) > 0
        and (touch.bar is not None or touch.distance > covered.get(touch.nodes[0], 0.0))
    ]
    if not touches:
        return []
    mean = float(np.mean([weigh(touch) for touch in touches]))
    laws: list[tuple[dict[str, Any], list[int], list[int]]] = []
    for touch in touches:
        law = _read_law(touch.law, weigh(touch), mean, weights.standing)
        law["height"] = height + (touch.distance if touch.bar is None else 0.0)
        same = next((kept for kept in laws if _is_equal(kept[0], law)), None)
        if same is None:
            same = law, [], []
            laws.append(same)
        if touch.bar is None:
            same[1].append(touch.nodes[0])
        else:
            same[2].append(touch.bar)
    everywhere = len(laws) == 1 and len(touches) == int(np.count_nonzero(weights.inverse))
    try:
        return [
            Ground(
                **law,
                normal=tuple(normal.tolist()),
                nodes=None if everywhere and not bars else nodes,
                bars=bars or None,
            )
            for law, nodes, bars in laws
        ]
    except ValueError as error:
        raise plane.element.error(str(error)) from None


def _read_law(law: Element, inverse: float, mean: float, standing: float) -> dict[str, Any]:
    """Read the contact law for an inverse mass [1/kg].

    The result are keywords of `Ground`. `standing` is the load on one supporting node [N]. A time
    constant gives a stiffness proportional to the mass, for the `mean` of inverse masses. Raises
    SceneFileError.
    """
    solref = law.numbers("solref", 2, _DEFAULTS["solref"])
    if solref[0] > 0 >= solref[1]:
        raise law.error(
            "has one number above 0 and one below: give a time constant and a damping ratio, or both negated",
            "solref",
        )
    friction = law.numbers("friction", (1, 2, 3, 4, 5), _DEFAULTS["friction"])[0]
    slides = law.whole("condim", 3) == 1 or friction == 0
    return ground_numbers(
        solref,
        law.numbers("solreffriction", 2, (0, 0)),
        None if slides else float(friction),
        inverse if solref[0] <= 0 else mean,
        standing,
    )


def _is_equal(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Return whether two contact laws agree within 0.01 %.

    Laws are keywords of `Ground`.
    """
    if one.keys() != other.keys() or (one["friction"] is None) != (other["friction"] is None):
        return False
    return all(
        abs(one[name] - other[name]) <= 1e-4 * max(abs(one[name]), 1e-3 * (name == "height"))
        for name in one
        if one[name] is not None
    )
