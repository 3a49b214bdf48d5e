"""Elements and attributes of MJCF that are read, with default classes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from tenscasadi.exchange.mjcf.elements import Element

_ORIENTATION = "pos quat axisangle euler xyaxes zaxis"
_DRAWN = "name class group rgba material user"
_CONTACT = "condim friction solref solimp margin gap"
_ACTUATOR = "tendon joint jointinparent site ctrllimited ctrlrange forcelimited forcerange"

# Attributes of each element that are read, or do not affect the dynamics. Other elements and those
# without an entry are checked by NEUTRAL alone.
_READ = {
    tag: set(names.split())
    for tag, names in {
        "mujoco": "model",
        "worldbody": "name",
        "body": f"name childclass mocap user {_ORIENTATION}",
        "inertial": f"mass diaginertia fullinertia {_ORIENTATION}",
        "freejoint": "name group align",
        "joint": f"{_DRAWN} type pos axis limited actuatorfrclimited range solreflimit solimplimit "
        "solreffriction solimpfriction margin ref springref",
        "geom": f"{_DRAWN} {_CONTACT} {_ORIENTATION} type size fromto mass density contype mesh "
        "conaffinity priority solmix fluidcoef fitscale hfield",
        "site": f"{_DRAWN} {_ORIENTATION} type size fromto",
        "spatial": f"{_DRAWN} stiffness damping springlength limited actuatorfrclimited range "
        "solreflimit solimplimit margin solreffriction solimpfriction width",
        "connect": "name class body1 body2 anchor site1 site2 solref solimp active",
        "weld": "name class body1 body2 anchor site1 site2 solref solimp active torquescale",
        "pair": f"{_CONTACT} name class geom1 geom2 solreffriction",
        "exclude": "name body1 body2",
        "position": f"{_DRAWN} {_ACTUATOR} kp kv inheritrange",
        "motor": f"{_DRAWN} {_ACTUATOR} gear",
        "intvelocity": f"{_DRAWN} {_ACTUATOR} kp kv actrange inheritrange",
        "general": f"{_DRAWN} {_ACTUATOR} gear gaintype gainprm biastype biasprm dyntype "
        "actlimited actrange",
    }.items()
}

# Attributes without a counterpart, with the values that have no effect.
_NEUTRAL: dict[str, dict[str, str]] = {
    "compiler": {"boundmass": "0", "boundinertia": "0", "settotalmass": "-1"}
    | {"balanceinertia": "false", "inertiagrouprange": "0 5"},
    "option": {"wind": "0 0 0", "density": "0", "viscosity": "0"},
    "flag": dict.fromkeys(("passive", "spring", "damper", "actuation"), "enable")
    | {"override": "disable"},
    "body": {"gravcomp": "0", "sleep": "auto"},
    "joint": dict.fromkeys(("stiffness", "damping", "frictionloss", "armature"), "0")
    | {"springdamper": "0 0"},
    "geom": {"shellinertia": "false", "fluidshape": "none"},
    "spatial": {"frictionloss": "0", "armature": "0"},
    "weld": {"relpose": "0 0 0 0 0 0 0"},
    "position": {"gear": "1", "timeconst": "0", "dampratio": "0"},
    "intvelocity": {"gear": "1", "dampratio": "0"},
    "general": {"input": "pos", "dynprm": "1"},
}
_CHILDREN = {
    tag: set(names.split())
    for tag, names in {
        "mujoco": "compiler option default worldbody tendon equality contact actuator",
        "option": "flag",
        "worldbody": "body geom site",
        "body": "body geom site joint freejoint inertial",
        "tendon": "spatial",
        "spatial": "site",
        "equality": "connect weld",
        "contact": "pair exclude",
        "actuator": "position intvelocity general motor",
    }.items()
}
# Elements for drawing, sensors and saved states: ignored.
_IGNORED = {
    *("visual", "asset", "statistic", "size", "custom"),
    *("sensor", "keyframe", "light", "camera", "lengthrange"),
}
_CURES = {
    "fixed": "strings are spatial tendons",
    "geom": "strings are straight, they do not wrap",
    "pulley": "strings run from one node to another: write one for each part",
}


class Defaults:
    """Default attributes of an MJCF file by class and element kind."""

    def __init__(self, root: Element) -> None:
        self._classes: dict[str, dict[str, dict[str, str]]] = {}
        self._main = "main"
        for k, element in enumerate(root.find("default")):
            if k == 0:
                self._main = element.text("class", "main")
            self._read(element, element.text("class", self._main))

    def _read(self, element: Element, name: str) -> None:
        waiting: list[tuple[Element, str, Mapping[str, dict[str, str]]]] = [(element, name, {})]
        while waiting:
            inner, name, above = waiting.pop()
            known = {**above, **self._classes.get(name, {})}
            own = {tag: dict(attributes) for tag, attributes in known.items()}
            for child in inner:
                if child.tag != "default":
                    own.setdefault(child.tag, {}).update(child.attributes)
            self._classes[name] = own
            for child in inner.find("default"):
                if "class" not in child.attributes:
                    raise child.error("has no class: give class, by which elements name it")
                waiting.append((child, child.text("class"), own))

    def apply(self, element: Element, childclass: str = "") -> Element:
        """Add default attributes to an element, and check all attributes.

        The class of defaults is the element's own, else `childclass` of the enclosing bodies, else
        the main one. Raises SceneFileError.
        """
        name = element.text("class") or childclass or self._main
        if name not in self._classes and name != self._main:
            raise element.error(
                f"names the class {name!r}, which no <default> has: give one of {sorted(self._classes)}"
            )
        known = self._classes.get(name, {})
        # MuJoCo treats all actuators as general ones, and all equalities alike
        parent = {"spatial": "tendon", "connect": "equality", "weld": "equality"}
        parent |= dict.fromkeys(("position", "intvelocity", "motor"), "general")
        tags = [parent[element.tag]] if element.tag in parent else []
        defaults: dict[str, str] = {}
        for tag in (*tags, element.tag):
            defaults.update(known.get(tag, {}))
        return check(element.replace({**defaults, **element.attributes}))


def check(element: Element) -> Element:
    """Check an element for attributes that affect the dynamics and have no counterpart.

    They are recorded as omitted from the scene. If the import is strict, SceneFileError is raised
    instead. Returns the element.
    """
    read, neutral = _READ.get(element.tag), _NEUTRAL.get(element.tag, {})
    for name, value in element.attributes.items():
        if name in neutral:
            if not _equal(value, neutral[name]):
                element.leave_out(
                    f"is {value!r}, which has no counterpart in a scene: leave it out", name
                )
        elif read is not None and name not in read:
            element.leave_out("has no counterpart in a scene: leave it out", name)
    return element


def children(element: Element) -> Iterator[Element]:
    """Yield the children that have a counterpart in a scene.

    Others that affect the dynamics are omitted, or rejected if the import is strict.
    """
    known = _CHILDREN.get(element.tag, set())
    for child in element:
        if child.tag in known:
            yield child
        elif child.tag not in _IGNORED:
            cure = _CURES.get(child.tag, "leave it out")
            child.leave_out(f"has no counterpart in a scene: {cure}")


def _equal(value: str, neutral: str) -> bool:
    """Return whether an attribute has its neutral value.

    Zeros may follow the neutral value.
    """
    if value.split() == neutral.split():
        return True
    try:
        given, wanted = ([float(word) for word in text.split()] for text in (value, neutral))
    except ValueError:
        return False
    return len(given) > 0 and given == [*wanted, *[0.0] * len(given)][: len(given)]
