"""Physical quantities that can be parameters."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import numpy as np

from tenscasadi.util.validate import Array


class ParameterQuantity(NamedTuple):
    """Physical quantity that can be a parameter.

    `unit` is its unit, `item` the kind of object that has it, `least` the lower limit of its
    values, and `part` the field of the scene that has it.
    """

    unit: str
    item: str  # kind of object that has it
    least: Literal["any", "zero", "positive"]  # lower limit of its values
    part: str = "structure"  # field of the scene that has it


QUANTITIES = {
    "stiffness": ParameterQuantity("N/m", "string", "zero"),
    "damping": ParameterQuantity("N·s/m", "string", "zero"),
    "rest_length": ParameterQuantity("m", "string", "positive"),
    "string_mass": ParameterQuantity("kg", "string", "zero"),
    "bar_mass": ParameterQuantity("kg", "bar", "positive"),
    "bar_stiffness": ParameterQuantity("N/m", "bar", "positive"),
    "bar_rest_length": ParameterQuantity("m", "bar", "positive"),
    "node_mass": ParameterQuantity("kg", "node", "zero"),
    "body_mass": ParameterQuantity("kg", "body", "positive"),
    "body_inertia": ParameterQuantity("kg·m²", "moment", "any"),
    "gravity": ParameterQuantity("m/s²", "axis", "any", "gravity"),
    "ground_stiffness": ParameterQuantity("N/m", "ground", "positive", "ground"),
    "ground_damping": ParameterQuantity("N·s/m", "ground", "zero", "ground"),
    "ground_friction": ParameterQuantity("1", "ground", "zero", "ground"),
    "bar_contact_stiffness": ParameterQuantity("N/m", "bar contact", "positive", "bar_contact"),
    "bar_contact_damping": ParameterQuantity("N·s/m", "bar contact", "zero", "bar_contact"),
    "bar_contact_friction": ParameterQuantity("1", "bar contact", "zero", "bar_contact"),
    "pressure": ParameterQuantity("Pa", "pressure", "any", "pressure"),
    "forces": ParameterQuantity("N", "force", "any", "forces"),
}
GROUPED = "string", "bar", "node", "body", "ground"
BODIES = "body_mass", "body_inertia"
MASSES = "bar_mass", "node_mass", "string_mass", *BODIES
ELASTIC_BARS = "bar_stiffness", "bar_rest_length"  # rigid bars have none
MOMENTS = "xx", "yy", "zz", "xy", "xz", "yz"  # entries of body_inertia, six for each body
_ROWS, _COLUMNS = (
    np.array(["xyz".index(axis) for name in MOMENTS for axis in name]).reshape(-1, 2).T
)


def read_values(structure: Any, name: str) -> Array:
    """Read the values of a quantity of a structure.

    There is one for each item. `name` is that of the quantity in `QUANTITIES`.
    """
    if name == "body_mass":
        return np.array([body.mass for body in structure.bodies])
    if name == "body_inertia":
        moments = [
            body.mass_properties(structure.nodes[list(body.nodes)]).moments
            for body in structure.bodies
        ]
        inertia = [np.trace(S) * np.eye(3) - S for S in moments]
        return np.array([each[_ROWS, _COLUMNS] for each in inertia]).reshape(-1)
    return np.asarray(getattr(structure, name))


def build_inertia(moments: Array) -> Array:
    """Build inertia matrices (…, 3, 3) from their six entries.

    `moments` (…, 6) are in the order xx, yy, zz, xy, xz, yz.
    """
    inertia = np.zeros((*moments.shape[:-1], 3, 3))
    inertia[..., _ROWS, _COLUMNS] = moments
    inertia[..., _COLUMNS, _ROWS] = moments
    return inertia
