"""Physical quantities that can be parameters."""

from __future__ import annotations

from typing import Literal, NamedTuple


class ParameterQuantity(NamedTuple):
    """Physical quantity that can be a parameter."""

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
    "gravity": ParameterQuantity("m/s²", "axis", "any", "gravity"),
    "ground_stiffness": ParameterQuantity("N/m", "ground", "positive", "ground"),
    "ground_damping": ParameterQuantity("N·s/m", "ground", "zero", "ground"),
    "ground_friction": ParameterQuantity("1", "ground", "zero", "ground"),
    "pressure": ParameterQuantity("Pa", "pressure", "any", "pressure"),
    "forces": ParameterQuantity("N", "force", "any", "forces"),
}
GROUPED = "string", "bar", "node", "ground"
MASSES = "bar_mass", "node_mass", "string_mass"
ELASTIC_BARS = "bar_stiffness", "bar_rest_length"  # rigid bars have none
