"""Supported elements and attributes of MJCF, and its default classes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from tenscasadi.exchange.mjcf.elements import Element

# Elements for drawing, sensors and saved states: ignored.
SILENT = {
    "visual",
    "asset",
    "statistic",
    "size",
    "custom",
    "sensor",
    "keyframe",
    "light",
    "camera",
    "lengthrange",
}
_FLAT = (
    "joint",
    "geom",
    "site",
    "tendon",
    "equality",
    "pair",
    "general",
    "position",
    "motor",
    "velocity",
    "mesh",
    "material",
    "camera",
    "light",
)
_DRAWN = {"name", "class", "group", "rgba", "material", "user"}
_CONTACT = {"condim", "friction", "solref", "solimp", "margin", "gap"}

# Attributes of each element that are read, or do not affect the dynamics.
READ: dict[str, set[str]] = {
    "mujoco": {"model"},
    "compiler": {
        "angle",
        "eulerseq",
        "inertiafromgeom",
        "autolimits",
        "coordinate",
        "discardvisual",
        "fusestatic",
        "alignfree",
    }
    | {
        "strippath",
        "meshdir",
        "texturedir",
        "assetdir",
        "usethread",
        "convexhull",
        "exactmeshinertia",
        "fitaabb",
        "saveinertial",
    },
    "option": {
        "gravity",
        "timestep",
        "integrator",
        "cone",
        "jacobian",
        "solver",
        "iterations",
        "tolerance",
        "impratio",
        "apirate",
        "ls_iterations",
    }
    | {
        "ls_tolerance",
        "noslip_iterations",
        "noslip_tolerance",
        "ccd_iterations",
        "ccd_tolerance",
        "mpr_iterations",
        "mpr_tolerance",
        "magnetic",
    }
    | {"sdf_iterations", "sdf_initpoints", "actuatorgroupdisable"},
    "flag": {
        "gravity",
        "contact",
        "constraint",
        "equality",
        "warmstart",
        "energy",
        "fwdinv",
        "eulerdamp",
        "multiccd",
        "autoreset",
        "island",
    }
    | {
        "refsafe",
        "sensor",
        "filterparent",
        "clampctrl",
        "nativeccd",
        "frictionloss",
        "limit",
        "midphase",
        "sensornoise",
        "invdiscrete",
        "invdisc",
    },
    "worldbody": {"name"},
    "body": {
        "name",
        "childclass",
        "pos",
        "quat",
        "axisangle",
        "euler",
        "xyaxes",
        "zaxis",
        "mocap",
        "user",
    },
    "inertial": {
        "pos",
        "quat",
        "axisangle",
        "euler",
        "xyaxes",
        "zaxis",
        "mass",
        "diaginertia",
        "fullinertia",
    },
    "freejoint": {"name", "group", "align"},
    "joint": _DRAWN
    | {
        "type",
        "pos",
        "axis",
        "limited",
        "actuatorfrclimited",
        "range",
        "solreflimit",
        "solimplimit",
        "solreffriction",
        "solimpfriction",
    }
    | {"margin", "ref", "springref"},
    "geom": _DRAWN
    | _CONTACT
    | {
        "type",
        "size",
        "fromto",
        "pos",
        "quat",
        "axisangle",
        "euler",
        "xyaxes",
        "zaxis",
        "mass",
        "density",
        "contype",
    }
    | {"conaffinity", "priority", "solmix", "fluidcoef", "fitscale"},
    "site": _DRAWN
    | {"type", "size", "pos", "fromto", "quat", "axisangle", "euler", "xyaxes", "zaxis"},
    "tendon": set(),
    "spatial": _DRAWN
    | {
        "stiffness",
        "damping",
        "springlength",
        "limited",
        "actuatorfrclimited",
        "range",
        "solreflimit",
        "solimplimit",
        "margin",
    }
    | {"solreffriction", "solimpfriction", "width"},
    "equality": set(),
    "connect": {
        "name",
        "class",
        "body1",
        "body2",
        "anchor",
        "site1",
        "site2",
        "solref",
        "solimp",
        "active",
    },
    "contact": set(),
    "pair": _CONTACT | {"name", "class", "geom1", "geom2", "solreffriction"},
    "exclude": {"name", "body1", "body2"},
    "actuator": set(),
    "position": _DRAWN
    | {
        "tendon",
        "kp",
        "kv",
        "ctrllimited",
        "ctrlrange",
        "forcelimited",
        "forcerange",
        "inheritrange",
    },
    "general": _DRAWN
    | {
        "tendon",
        "gaintype",
        "gainprm",
        "biastype",
        "biasprm",
        "dyntype",
        "ctrllimited",
        "ctrlrange",
    }
    | {"forcelimited", "forcerange"},
}

# Attributes without a counterpart, with the values that have no effect.
NEUTRAL: dict[str, dict[str, str]] = {
    "compiler": {
        "inertiagrouprange": "0 5",
        "boundmass": "0",
        "boundinertia": "0",
        "settotalmass": "-1",
        "balanceinertia": "false",
    },
    "option": {"wind": "0 0 0", "density": "0", "viscosity": "0"},
    "flag": {
        "passive": "enable",
        "spring": "enable",
        "damper": "enable",
        "actuation": "enable",
        "override": "disable",
    },
    "body": {"gravcomp": "0", "sleep": "auto"},
    "joint": {
        "stiffness": "0",
        "damping": "0",
        "frictionloss": "0",
        "armature": "0",
        "springdamper": "0 0",
    },
    "geom": {"shellinertia": "false", "fluidshape": "none"},
    "spatial": {"frictionloss": "0", "armature": "0"},
    "position": {"gear": "1", "timeconst": "0", "dampratio": "0"},
    "general": {"gear": "1", "input": "pos"},  # MuJoCo writes these for position actuators
}
_CHILDREN: dict[str, set[str]] = {
    "mujoco": {
        "compiler",
        "option",
        "default",
        "worldbody",
        "tendon",
        "equality",
        "contact",
        "actuator",
    },
    "compiler": set(),
    "option": {"flag"},
    "worldbody": {"body", "geom", "site"},
    "body": {"body", "geom", "site", "joint", "freejoint", "inertial"},
    "tendon": {"spatial"},
    "spatial": {"site"},
    "equality": {"connect"},
    "contact": {"pair", "exclude"},
    "actuator": {"position", "general"},
}
_CURES = {
    "include": "put all into one file, as mujoco.mj_saveLastXML writes it",
    "hinge": "bars turn freely about their nodes: give balls",
    "weld": "put the bodies into each other",
    "motor": "give a position actuator, whose control is the rest length, or a general one with gain −length, whose control is the force density",
    "fixed": "strings are spatial tendons",
    "geom": "strings are straight, they do not wrap",
    "pulley": "strings run from one node to another: write one for each part",
}


class Defaults:
    """Default attributes of a file by class and element kind."""

    def __init__(self, root: Element) -> None:
        self._classes: dict[str, dict[str, dict[str, str]]] = {}
        self._main = "main"
        for k, element in enumerate(root.of("default")):
            if k == 0:
                self._main = element.text("class", "main")
            self._read(element, element.text("class", self._main))

    def _read(self, element: Element, name: str) -> None:
        waiting: list[tuple[Element, str, Mapping[str, dict[str, str]]]] = [(element, name, {})]
        while waiting:
            inner, name, above = waiting.pop()
            own = {
                tag: dict(attributes)
                for tag, attributes in {**above, **self._classes.get(name, {})}.items()
            }
            for child in inner:
                if child.tag in _FLAT:  # others are rejected or ignored where they are used
                    own.setdefault(child.tag, {}).update(child.attributes)
            self._classes[name] = own
            for child in inner.of("default"):
                if "class" not in child.attributes:
                    raise child.error("has no class: give class, by which elements name it")
                waiting.append((child, child.text("class"), own))

    def apply(self, element: Element, childclass: str = "") -> Element:
        """Add default attributes to an element. Raises SceneFileError.

        The class is its own, that of the enclosing bodies, or the main one.
        """
        name = element.text("class") or childclass or self._main
        if name not in self._classes and name != self._main:
            raise element.error(
                f"names the class {name!r}, which no <default> has: give one of {sorted(self._classes)}"
            )
        tag = {"spatial": "tendon", "connect": "equality"}.get(element.tag, element.tag)
        known = self._classes.get(name, {})
        general = (
            known.get("general", {}) if tag == "position" else {}
        )  # MuJoCo treats all actuators as general ones
        return element.given({**general, **known.get(tag, {}), **element.attributes})


def check(element: Element) -> Element:
    """Reject attributes that affect the dynamics without a counterpart.

    Returns the element. Raises SceneFileError.
    """
    for name, value in element.attributes.items():
        if name in READ.get(element.tag, ()):
            continue
        neutral = NEUTRAL.get(element.tag, {}).get(name)
        if neutral is None:
            raise element.error("has no counterpart in a scene: leave it out", name)
        if not _same(value, neutral):
            raise element.error(
                f"is {value!r}, which has no counterpart in a scene: leave it out", name
            )
    return element


def children(element: Element) -> Iterator[Element]:
    """Yield the children that affect the dynamics.

    Raises SceneFileError at a child without a counterpart.
    """
    known = _CHILDREN.get(element.tag, set())
    for child in element:
        if child.tag in known:
            yield child
        elif child.tag not in SILENT:
            raise child.error(
                f"has no counterpart in a scene: {_CURES.get(child.tag, 'leave it out')}"
            )


def _same(value: str, neutral: str) -> bool:
    if value.split() == neutral.split():
        return True
    try:
        given, wanted = ([float(word) for word in text.split()] for text in (value, neutral))
    except ValueError:
        return False
    return len(given) > 0 and all(
        number == (wanted[k] if k < len(wanted) else 0.0) for k, number in enumerate(given)
    )
