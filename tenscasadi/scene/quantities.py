"""Physical quantities that can be parameters."""

from __future__ import annotations

from typing import Literal, NamedTuple


class Quantity(NamedTuple):
    """Physical quantity that can be a parameter."""

    unit: str
    item: str  # kind of object that has it
    least: Literal["any", "zero", "positive"]  # lower limit of its values
    part: str = "structure"  # field of the scene that has it


QUANTITIES = {
    "stiffness": Quantity("N/m", "string", "zero"),
    "damping": Quantity("N·s/m", "string", "zero"),
    "rest_length": Quantity("m", "string", "positive"),
    "string_mass": Quantity("kg", "string", "zero"),
    "bar_mass": Quantity("kg", "bar", "positive"),
    "bar_stiffness": Quantity("N/m", "bar", "positive"),
    "bar_rest_length": Quantity("m", "bar", "positive"),
    "node_mass": Quantity("kg", "node", "zero"),
    "gravity": Quantity("m/s²", "axis", "any", "gravity"),
    "ground_stiffness": Quantity("N/m", "ground", "positive", "ground"),
    "ground_damping": Quantity("N·s/m", "ground", "zero", "ground"),
    "ground_friction": Quantity("1", "ground", "zero", "ground"),
    "pressure": Quantity("Pa", "pressure", "any", "pressure"),
    "forces": Quantity("N", "force", "any", "forces"),
}
GROUPED = "string", "bar", "node", "ground"
MASSES = "bar_mass", "node_mass", "string_mass"
ELASTIC_BARS = "bar_stiffness", "bar_rest_length"  # rigid bars have none
