"""The [scene] of scene files: all that a `Scene` has beside its structure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tenscasadi.files.containers import ListOf, MapOf
from tenscasadi.files.definitions import Kind, define
from tenscasadi.files.document import Item, nearest
from tenscasadi.files.forms import (
    NUMBER,
    VECTOR,
    Form,
    Index,
    Indices,
    Names,
    Numbers,
    Schema,
    Schemas,
    Wholes,
    Word,
)
from tenscasadi.files.time_formula import OverTime, TimeFormula
from tenscasadi.scene.ground import Ground, Terrain
from tenscasadi.scene.loads import Gravity, NodalForce, Pressure
from tenscasadi.scene.parameters import GROUPED, QUANTITIES, Parameters
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import Clip, ForceDensity, Linear, RestLength, Smooth
from tenscasadi.scene.supports import SupportMotion

_TIMES = Numbers(((None,),))
_OVER_TIME: Mapping[str, Form] = {"times": _TIMES, "breaks": _TIMES}
_SURFACE: Mapping[str, Form] = {
    **dict.fromkeys(("stiffness", "damping", "friction", "slip_speed"), NUMBER),
    "nodes": Indices("node"),
}


@dataclass(frozen=True)
class NodalForces(Form):
    """Forces on all nodes, or a table from some nodes to theirs: constant, at times, or formulas of the time."""

    def read(self, item: Item, names: Names) -> Any:
        """Return forces of all nodes, (n, 3), (K, n, 3) or a function of time."""
        if not isinstance(item.value, dict):
            return OverTime((None, 3)).read(item, names)
        rows: dict[int, Any] = MapOf("node", OverTime((3,))).read(item, names)
        count = names.counts["node"]
        if any(isinstance(row, TimeFormula) for row in rows.values()):
            entries = tuple(
                rows[node].entries
                if isinstance(rows.get(node), TimeFormula)
                else tuple(rows.get(node, (0.0,) * 3))
                for node in range(count)
            )
            if any(
                len(row) != 3 or any(isinstance(entry, list) for entry in row) for row in entries
            ):
                raise item.error("has tables beside formulas of t: give one of them")
            return TimeFormula(entries, tuple(item.document.numbers.items()))
        shapes = {np.shape(row) for row in rows.values()} or {(3,)}
        if len(shapes) > 1:
            raise item.error("has tables of several lengths: give each node as many rows")
        shape = shapes.pop()
        values = np.zeros((*shape[:-1], count, 3))
        for node, row in rows.items():
            values[..., node, :] = row
        return values.tolist()

    def write(self, value: Any) -> Any:
        """Return a table of the nodes that have forces."""
        written = OverTime((None, 3)).write(value)
        if callable(value):
            return written
        array = np.asarray(value)
        some = [
            node
            for node in range(array.shape[-2])
            if array[..., node, :].any() or np.signbit(array[..., node, :]).any()
        ]
        return {str(node): array[..., node, :].tolist() for node in some}

    def schema(self, kinds: Schemas) -> Schema:
        """Return rows or a table."""
        return {
            "anyOf": [
                OverTime((None, 3)).schema(kinds),
                MapOf("node", OverTime((3,))).schema(kinds),
            ]
        }


@dataclass(frozen=True)
class Motion(Form):
    """Formulas of the time for three coordinates."""

    def read(self, item: Item, names: Names) -> TimeFormula:
        """Return a function of time."""
        found = OverTime((3,)).read(item, names)
        if isinstance(found, TimeFormula):
            return found
        if np.shape(found) != (3,):
            raise item.error("is a table: give three formulas of the time t")
        return TimeFormula(tuple(found), ())

    def write(self, value: Any) -> Any:
        """Return the formulas."""
        return OverTime((3,)).write(value)

    def schema(self, kinds: Schemas) -> Schema:
        """Return three formulas."""
        return VECTOR.schema(kinds)


@dataclass(frozen=True)
class StringLaws(Form):
    """A law for all strings, a list with one for each, or a table from some strings to theirs."""

    law: Kind

    def read(self, item: Item, names: Names) -> Any:
        """Return a law, a list or a mapping."""
        if isinstance(item.value, list):
            return ListOf(self.law).read(item, names)
        if isinstance(item.value, dict) and "kind" not in item.value:
            return MapOf("string", self.law).read(item, names)
        return self.law.read(item, names)

    def write(self, value: Any) -> Any:
        """Return a law, or a table of the strings that have another than `Clip()`."""
        if not isinstance(value, tuple):
            return self.law.write(value)
        return {
            str(string): self.law.write(law) for string, law in enumerate(value) if law != Clip()
        }

    def schema(self, kinds: Schemas) -> Schema:
        """Return all three."""
        return {
            "anyOf": [
                self.law.schema(kinds),
                ListOf(self.law).schema(kinds),
                MapOf("string", self.law).schema(kinds),
            ]
        }


@dataclass(frozen=True)
class ParameterGroups(Form):
    """For quantities the groups of items that share a value, by name or index, or "all"."""

    def read(self, item: Item, names: Names) -> dict[str, Any]:
        """Return groups of indices by quantity."""
        found: dict[str, Any] = {}
        for name, entry in item.table().items():
            which: Any = QUANTITIES[name].item if name in QUANTITIES else None
            if which not in GROUPED:
                raise entry.error(
                    f"has no groups: {nearest(name, [known for known, quantity in QUANTITIES.items() if quantity.item in GROUPED])}"
                )
            if entry.value == "all":
                found[name] = "all"
            elif which == "ground":
                found[name] = ListOf(ListOf(Wholes())).read(entry, names)
            else:
                found[name] = ListOf(Indices(which)).read(entry, names)
        return found

    def write(self, value: Any) -> dict[str, Any]:
        """Return groups of indices by quantity."""
        return {
            name: "all" if groups == ((),) else [list(group) for group in groups]
            for name, groups in value
        }

    def schema(self, kinds: Schemas) -> Schema:
        """Return a table of the quantities that have groups."""
        groups = {"anyOf": [{"const": "all"}, ListOf(Indices("node")).schema(kinds)]}
        return {
            "type": "object",
            "properties": {n: groups for n, q in QUANTITIES.items() if q.item in GROUPED},
            "additionalProperties": False,
        }


def _parameters(
    names: Iterable[str] = (), scale: Iterable[str] = (), groups: Mapping[str, Any] | None = None
) -> Parameters:
    """Quantities of a scene that stay open in its equations: a run is given their values.

    Parameters
    ----------
    names : sequence of str
        Quantities, in SI units, with an entry of p for each of their items.
    scale : sequence of str
        Quantities that are multiplied by an entry of p.
    groups : mapping of str to sequence of sequence of int, or to "all"
        The groups of items that share an entry; items in no group stay constant.
    """
    return Parameters(*names, scale=scale, groups=groups)


_QUANTITIES = ListOf(Word(tuple(QUANTITIES)))
LAW = Kind(
    (
        define(Clip, {"damping": Word(("clamped", "unclamped"))}),
        define(Smooth, {"width": NUMBER}),
        define(Linear),
    )
)
CONTROL = Kind((define(ForceDensity), define(RestLength)))
GRAVITY = Kind(
    (define(Gravity, {"acceleration": OverTime((3,)), **_OVER_TIME}, short="acceleration"),)
)
SURFACE = Kind(
    (
        define(Ground, {**_SURFACE, "height": NUMBER, "normal": VECTOR}),
        define(
            Terrain,
            {
                "heights": Numbers(((None, None),)),
                "lower": Numbers(((2,),)),
                "upper": Numbers(((2,),)),
                **_SURFACE,
            },
        ),
    ),
    implied=True,
)
PRESSURE = Kind(
    (
        define(
            Pressure, {"faces": ListOf(Indices("node")), "difference": OverTime(()), **_OVER_TIME}
        ),
    )
)
FORCES = Kind(
    (
        define(
            NodalForce, {"values": NodalForces(), **_OVER_TIME, "bars": MapOf("node", Index("bar"))}
        ),
    )
)
SUPPORTS = Kind((define(SupportMotion, {"positions": MapOf("node", Motion()), "breaks": _TIMES}),))
PARAMETERS = Kind(
    (
        define(
            _parameters,
            {"names": _QUANTITIES, "scale": _QUANTITIES, "groups": ParameterGroups()},
            kind="Parameters",
            made=Parameters,
        ),
    )
)
SCENE = define(
    Scene,
    {
        "control": CONTROL,
        "segments": Wholes(lists=True),
        "ends": Word(("interior", "lumped")),
        "fractions": _TIMES,
        "gravity": GRAVITY,
        "ground": ListOf(SURFACE, single=True),
        "pressure": PRESSURE,
        "forces": FORCES,
        "slack": StringLaws(LAW),
        "supports": SUPPORTS,
        "parameters": PARAMETERS,
    },
)
