"""Quantities of scene files that change over time: tables, and arrays of formulas of t."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from tenscasadi.schema.containers import MapOf
from tenscasadi.schema.forms import FREE, VECTOR, Coordinates, Form, Numbers, Schema, Schemas
from tenscasadi.schema.formulas import RESERVED, Formula, FormulaError
from tenscasadi.schema.reading import Item, Names, NotWritten, nearest
from tenscasadi.util.validate import shown


@dataclass(frozen=True)
class TimeFormula:
    """Formulas of the time ``t``, s, in nested tuples, with the numbers that they name: a function of time that can be written to a file."""

    KNOWN: ClassVar[frozenset[str]] = RESERVED
    entries: Any
    numbers: tuple[tuple[str, float], ...]

    def __post_init__(self) -> None:
        used = _names(self.entries)
        object.__setattr__(
            self, "numbers", tuple((name, value) for name, value in self.numbers if name in used)
        )

    def __call__(self, time: Any) -> Any:
        """Return the values at a time: nested lists of numbers, or of CasADi expressions where the time is one."""
        return _value(self.entries, time, dict(self.numbers))

    def plain(self) -> Any:
        """Return nested lists of formulas and numbers that need no declared ones."""
        return _plain(self.entries, dict(self.numbers))


def _names(entries: Any) -> frozenset[str]:
    if isinstance(entries, tuple):
        return frozenset().union(*map(_names, entries))
    return Formula(entries).names if isinstance(entries, str) else frozenset()


def _value(entries: Any, time: Any, numbers: dict[str, float]) -> Any:
    if isinstance(entries, tuple):
        return [_value(entry, time, numbers) for entry in entries]
    return Formula(entries).at(time, numbers) if isinstance(entries, str) else entries


def _plain(entries: Any, numbers: dict[str, float]) -> Any:
    if isinstance(entries, tuple):
        return [_plain(entry, numbers) for entry in entries]
    return Formula(entries).with_numbers(numbers) if isinstance(entries, str) else entries


@dataclass(frozen=True)
class Varying(Form):
    """Numbers, a table of them over time, or formulas of the time ``t``."""

    shape: tuple[int | None, ...]

    def read(self, item: Item, names: Names) -> Any:
        """Return a float, nested lists, or a function of time."""
        constant, table = Numbers((self.shape,)), Numbers((self.shape, (None, *self.shape)))
        if not _varies(item):
            return table.read(item, names)
        sizes, value = [], item.value
        while isinstance(value, list):
            sizes.append(len(value))
            value = value[0] if value else None
        if len(sizes) != len(self.shape) or any(
            want is not None and want != got for want, got in zip(self.shape, sizes, strict=True)
        ):
            raise item.error(
                f"is {shown(item.value)}: give {constant.wanted}, also formulas of the time t"
            )
        return TimeFormula(_texts(item, sizes), tuple(item.document.numbers.items()))

    def write(self, value: Any) -> Any:
        """Return numbers, or the formulas that were read."""
        if isinstance(value, TimeFormula):
            return _checked(value.plain())
        if callable(value):
            raise NotWritten(
                "a function of time in Python: give a table at times, or keep the scene in Python"
            )
        return Numbers().write(value)

    def schema(self, kinds: Schemas) -> Schema:
        """Return the shapes."""
        return Numbers((self.shape, (None, *self.shape))).schema(kinds)


def _checked(entries: Any) -> Any:
    for entry in entries if isinstance(entries, list) else [entries]:
        if isinstance(entry, list):
            _checked(entry)
        elif isinstance(entry, str):
            try:
                Formula(entry)  # with the numbers in their parentheses it is longer, and deeper
            except FormulaError as error:
                raise NotWritten(f"with its numbers {error}") from None
    return entries


def _varies(item: Item) -> bool:
    if isinstance(item.value, list):
        return any(_varies(entry) for entry in item.entries())
    return isinstance(item.value, str) and item.formula().varies


def _texts(item: Item, sizes: list[int]) -> Any:
    """Return nested tuples of formulas and numbers."""
    if sizes:
        if len(item.entries()) != sizes[0]:
            raise item.error(
                f"has {len(item.value)} entries: give {sizes[0]}, as the first row has"
            )
        return tuple(_texts(entry, sizes[1:]) for entry in item.entries())
    if isinstance(item.value, str) and item.formula().varies:
        unknown = item.formula().names - item.document.numbers.keys() - TimeFormula.KNOWN
        if unknown:
            word = min(unknown)
            raise item.error(
                f"{word!r} is not declared: {nearest(word, item.document.numbers)} in [numbers]"
            )
        return item.value
    return item.number()


@dataclass(frozen=True)
class NodalForces(Form):
    """Forces on all nodes, or a table from some nodes to theirs: constant, at times, or formulas of the time."""

    def read(self, item: Item, names: Names) -> Any:
        """Return forces of all nodes, (n, 3), (K, n, 3) or a function of time."""
        if not isinstance(item.value, dict):
            return Varying((None, 3)).read(item, names)
        rows: dict[int, Any] = MapOf("node", Varying((3,))).read(item, names)
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
        written = Varying((None, 3)).write(value)
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
                Varying((None, 3)).schema(kinds),
                MapOf("node", Varying((3,))).schema(kinds),
            ]
        }


@dataclass(frozen=True)
class MovingPoint(Form):
    """Formulas of the time for three coordinates."""

    def read(self, item: Item, names: Names) -> TimeFormula:
        """Return a function of time."""
        found = Varying((3,)).read(item, names)
        if isinstance(found, TimeFormula):
            return found
        if np.shape(found) != (3,):
            raise item.error("is a table: give three formulas of the time t")
        return TimeFormula(tuple(found), ())

    def write(self, value: Any) -> Any:
        """Return the formulas."""
        return Varying((3,)).write(value)

    def schema(self, kinds: Schemas) -> Schema:
        """Return three formulas."""
        return VECTOR.schema(kinds)


@dataclass(frozen=True)
class MovingPlace(Form):
    """Three coordinates, each a number, a formula of the time t, or ``"free"``, None in Python."""

    def read(self, item: Item, names: Names) -> Any:
        """Return three numbers or None, or a function of time."""
        wanted = (
            f'three coordinates, "{FREE}" where one is free; formulas of the time t where it moves'
        )
        entries = item.entries(wanted)
        if len(entries) != 3:
            raise item.error(f"is {shown(item.value)}: give {wanted}")
        found = [
            None if entry.value == FREE else Varying(()).read(entry, names) for entry in entries
        ]
        moving = [entry for entry in found if isinstance(entry, TimeFormula)]
        if not moving:
            return tuple(found)
        numbers = {name: value for entry in moving for name, value in entry.numbers}
        return TimeFormula(
            tuple(entry.entries if isinstance(entry, TimeFormula) else entry for entry in found),
            tuple(numbers.items()),
        )

    def write(self, value: Any) -> list[Any]:
        """Return three numbers, formulas or "free"."""
        if callable(value) and not isinstance(value, TimeFormula):
            raise NotWritten(
                "a function of time in Python: give a place, or keep the problem in Python"
            )
        return [
            FREE if entry is None else entry
            for entry in (value.plain() if isinstance(value, TimeFormula) else value)
        ]

    def schema(self, kinds: Schemas) -> Schema:
        """Return three entries."""
        return Coordinates().schema(kinds)
