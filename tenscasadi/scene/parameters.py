"""Parameters: quantities of a scene that can differ between runs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, Any, cast

from tenscasadi.scene.quantities import GROUPED, QUANTITIES
from tenscasadi.schema.containers import Either, TableOf
from tenscasadi.schema.field_types import WHOLE, ListOf, Members, Word
from tenscasadi.schema.reading import ItemKind
from tenscasadi.schema.value import Value
from tenscasadi.util.validate import as_tuple, format_value, index_or_name

_GROUPS = TableOf(
    {
        name: Either(
            (str,),
            Word(("all",)),
            ListOf(
                ListOf(WHOLE)
                if own.item in ("body", "ground")
                else Members(cast("ItemKind", own.item))
            ),
        )
        for name, own in QUANTITIES.items()
        if own.item in GROUPED
    }
)

Groups = tuple[tuple[str, tuple[tuple[int, ...], ...]], ...]


@dataclass(frozen=True, init=False)
class Parameters(Value, kind="Parameters"):
    """Quantities of a scene whose values can differ between runs.

    They form the parameter vector p of the model. One compiled code is used for all their values.
    Other quantities are constants of the equations. Strings are parent strings, before they are
    divided into segments.

    Parameters
    ----------
    *names : str
        Quantities in SI units, with an entry of p for each item. Strings have ``"stiffness"``,
        ``"damping"``, ``"rest_length"`` and ``"string_mass"``. Bars have ``"bar_mass"``,
        ``"bar_stiffness"`` and ``"bar_rest_length"``. Nodes have ``"node_mass"``. Bodies have
        ``"body_mass"`` and ``"body_inertia"`` (xx, yy, zz, xy, xz, yz of each body). Grounds have
        ``"ground_stiffness"``, ``"ground_damping"`` and ``"ground_friction"``; contact of bars has
        ``"bar_contact_stiffness"``, ``"bar_contact_damping"`` and ``"bar_contact_friction"``.
        Constant loads are ``"gravity"`` (x, y, z), ``"pressure"`` and ``"forces"`` (x, y, z of each
        node).
    scale : iterable of str
        Quantities with a dimensionless factor in p, which is 1 for the values of the scene.
    groups : mapping of str to sequence of sequence of int or str, or to "all", optional
        Groups of strings, bars, nodes, bodies or grounds that share an entry, by quantity. Items in no
        group are constant. "all": all items share one entry, which is the default of a scale.

    Attributes
    ----------
    names, scale : tuple of str
        Quantities as given.
    groups : tuple of (str, tuple of tuples of int)
        Groups by quantity; ``((),)`` for "all".

    Raises
    ------
    TypeError, ValueError
        If a name is unknown or given twice, or a group is wrong.

    See Also
    --------
    ParameterLayout : Vector p of a model, `Model.parameters`.

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
        """Build parameters from names, scale and groups as keywords."""
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
                    f"Parameters got {format_value(name)}: give quantities, such as {example}"
                )
            if name not in QUANTITIES:
                raise ValueError(
                    f"Parameters got {format_value(name)}: give some of {', '.join(QUANTITIES)}"
                )
            if name in given[:k]:
                raise ValueError(
                    f"Parameters got {format_value(name)} twice: "
                    "name a quantity once, in SI units or under scale="
                )
        if not given:
            raise ValueError(
                f"Parameters is empty: name quantities, such as {example}, or give no Parameters"
            )
        if groups is not None and not isinstance(groups, Mapping):
            raise TypeError(
                f"Parameters.groups is {format_value(groups)}: "
                "give a mapping such as {'stiffness': [[0, 1, 2], [3, 4, 5]]}"
            )
        for name in groups or {}:
            if name not in given:
                raise ValueError(
                    f"Parameters.groups has {format_value(name)}, which is no parameter: "
                    "name it, too, or remove its groups"
                )
            if QUANTITIES[name].item not in GROUPED:
                raise ValueError(
                    f"Parameters.groups has {format_value(name)}, which cannot have groups: "
                    "give groups of strings, bars, nodes, bodies or grounds"
                )
        read = tuple((name, _read_groups(name, value)) for name, value in (groups or {}).items())
        for attribute, value in {"names": tuple(names), "scale": scaled, "groups": read}.items():
            object.__setattr__(self, attribute, value)

    def to_fields(self) -> dict[str, Any]:
        """Return names, scale and groups as a dictionary.

        `Parameters.from_fields` builds the parameters from it.
        """
        groups = {name: "all" if own == ((),) else own for name, own in self.groups}
        return {"names": self.names, "scale": self.scale, "groups": groups or None}

    def __contains__(self, name: str) -> bool:
        return name in self.names or name in self.scale


def _read_groups(name: str, value: Any) -> tuple[tuple[int, ...], ...]:
    where = f"Parameters.groups[{format_value(name)}]"
    if isinstance(value, str):
        if value != "all":
            raise ValueError(
                f'{where} is {format_value(value)}: give "all", or groups such as [[0, 1], [2, 3]]'
            )
        return ((),)
    groups = tuple(
        tuple(as_tuple(f"{where}[{g}]", group, "[0, 1, 2]"))
        for g, group in enumerate(as_tuple(where, value, "[[0, 1], [2, 3]]"))
    )
    if not groups or not all(groups):
        raise ValueError(
            f"{where} is {format_value(value)}: give one or more groups of one or more indices"
        )
    seen: set[Any] = set()
    for g, group in enumerate(groups):
        for index in group:
            if index_or_name(f"{where}[{g}]", index) in seen:
                raise ValueError(f"{where}[{g}] has index {index} again: give each index once")
            seen.add(index)
    return tuple(tuple(map(partial(index_or_name, where), group)) for group in groups)
