"""Parameters: quantities of a scene that stay open in its equations, as a vector p that a run is given."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, NamedTuple, cast

from tenscasadi.schema.containers import Either, ListOf, TableOf
from tenscasadi.schema.field_types import WHOLE, Members, Word
from tenscasadi.schema.reading import ItemKind
from tenscasadi.schema.value import Value
from tenscasadi.util.validate import as_tuple, format_value, whole_number


class Quantity(NamedTuple):
    """A kind of parameter: its unit, what it belongs to, whether 0 or less is refused, and the part of the scene that has it."""

    unit: str
    item: str
    least: Literal["any", "zero", "positive"]
    part: str = "structure"


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

_GROUPS = TableOf(
    {
        name: Either(
            (str,),
            Word(("all",)),
            ListOf(ListOf(WHOLE) if own.item == "ground" else Members(cast("ItemKind", own.item))),
        )
        for name, own in QUANTITIES.items()
        if own.item in GROUPED
    }
)

Groups = tuple[tuple[str, tuple[tuple[int, ...], ...]], ...]


@dataclass(frozen=True, init=False)
class Parameters(Value, kind="Parameters"):
    """Quantities of a scene that stay open in its equations: a run is given their values, and one compiled code serves all of them.

    What is not named stays constant and costs nothing. Strings and their masses are those of the
    structure, before they are cut into segments.

    Parameters
    ----------
    *names : str
        Quantities, in SI units, with an entry of p for each of their items: ``"stiffness"``,
        ``"damping"``, ``"rest_length"`` and ``"string_mass"`` of strings, ``"bar_mass"``,
        ``"bar_stiffness"`` and ``"bar_rest_length"`` of bars,
        ``"node_mass"`` of nodes, ``"gravity"`` (x, y, z), ``"ground_stiffness"``,
        ``"ground_damping"`` and ``"ground_friction"``, ``"pressure"``, and constant nodal
        ``"forces"`` (x, y, z of each node).
    scale : iterable of str
        Quantities that are multiplied by an entry of p: a factor without dimension, 1 for the
        scene's own values.
    groups : mapping of str to sequence of sequence of int, or to "all", optional
        For named quantities of strings, bars, nodes and grounds the groups of items that share an
        entry; items in no group stay constant. "all": all items share one. A scale is shared by all
        unless there are groups.

    Attributes
    ----------
    names, scale : tuple of str
        The quantities as they are given.
    groups : tuple of (str, tuple of tuples of int)
        The groups of each quantity that has some; "all" is no group at all: ``((),)``.

    Raises
    ------
    TypeError, ValueError
        Where a name is none, given twice, or a group is wrong.

    See Also
    --------
    ParameterLayout : The vector p of a model: `Model.parameters`.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> scene = tc.Scene(tc.shapes.prism(), parameters=tc.Parameters("stiffness", "bar_mass", groups={"bar_mass": "all"}))
    >>> model = tc.Model(scene)
    >>> model.np, model.parameters.names[-1], model.parameters.units[-1]
    (10, 'bar_mass', 'kg')
    >>> run = tc.simulate(model, 0.1, step=0.01, parameters={"stiffness": 120.0}, compiled=False)
    >>> run.parameters.tolist()
    [120.0, 120.0, 120.0, 120.0, 120.0, 120.0, 120.0, 120.0, 120.0, 1.0]
    """

    names: Annotated[tuple[str, ...], ListOf(Word(tuple(QUANTITIES)))] = ()
    scale: Annotated[tuple[str, ...], ListOf(Word(tuple(QUANTITIES)))] = ()
    groups: Annotated[Groups, _GROUPS] = field(default=())

    @classmethod
    def from_fields(  # type: ignore[override]
        cls,
        names: Iterable[str] = (),
        scale: Iterable[str] = (),
        groups: Mapping[str, Any] | None = None,
    ) -> Parameters:
        """Build parameters from their fields by name."""
        return cls(*names, scale=scale, groups=groups)

    def __init__(
        self, *names: str, scale: Iterable[str] = (), groups: Mapping[str, Any] | None = None
    ) -> None:
        example = '("stiffness", "damping")'
        scaled = tuple(as_tuple("Parameters.scale", scale, example))
        given = [*names, *scaled]
        for k, name in enumerate(given):
            if not isinstance(name, str):
                raise TypeError(
                    f"Parameters got {format_value(name)}: give names of quantities, such as {example}"
                )
            if name not in QUANTITIES:
                raise ValueError(
                    f"Parameters got {format_value(name)}: give some of {', '.join(QUANTITIES)}"
                )
            if name in given[:k]:
                raise ValueError(
                    f"Parameters got {format_value(name)} twice: name a quantity once, in SI units or under scale="
                )
        if not given:
            raise ValueError(
                f"Parameters is empty: name quantities, such as {example}, or give no Parameters"
            )
        if groups is not None and not isinstance(groups, Mapping):
            raise TypeError(
                f"Parameters.groups is {format_value(groups)}: give a mapping such as {{'stiffness': [[0, 1, 2], [3, 4, 5]]}}"
            )
        for name in groups or {}:
            if name not in given:
                raise ValueError(
                    f"Parameters.groups has {format_value(name)}, which is no parameter: name it, too, or leave its groups out"
                )
            if QUANTITIES[name].item not in GROUPED:
                raise ValueError(
                    f"Parameters.groups has {format_value(name)}: groups are of strings, bars, nodes and grounds, leave them out"
                )
        read = tuple((name, _read_groups(name, value)) for name, value in (groups or {}).items())
        for attribute, value in {"names": tuple(names), "scale": scaled, "groups": read}.items():
            object.__setattr__(self, attribute, value)

    def to_fields(self) -> dict[str, Any]:
        """Return the fields as `from_fields` takes them."""
        groups = {name: "all" if own == ((),) else own for name, own in self.groups}
        return {"names": self.names, "scale": self.scale, "groups": groups or None}

    def __contains__(self, name: str) -> bool:
        return name in self.names or name in self.scale


def _read_groups(name: str, value: Any) -> tuple[tuple[int, ...], ...]:
    where = f"Parameters.groups[{format_value(name)}]"
    if isinstance(value, str):
        if value != "all":
            raise ValueError(
                f'{where} is {format_value(value)}: give "all", or groups of indices such as [[0, 1], [2, 3]]'
            )
        return ((),)
    groups = tuple(
        tuple(as_tuple(f"{where}[{g}]", group, "[0, 1, 2]"))
        for g, group in enumerate(as_tuple(where, value, "[[0, 1], [2, 3]]"))
    )
    if not groups or not all(groups):
        raise ValueError(
            f"{where} is {format_value(value)}: give at least one group, each with at least one index"
        )
    seen: set[int] = set()
    for g, group in enumerate(groups):
        for index in group:
            whole_number(f"{where}[{g}]", index, 0)
            if index in seen:
                raise ValueError(
                    f"{where}[{g}] has index {index}, which is in a group already: leave one out"
                )
            seen.add(int(index))
    return tuple(tuple(int(index) for index in group) for group in groups)
