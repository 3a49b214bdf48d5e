"""Quantities of scene files that change over time: tables, and arrays of formulas of t."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from tenscasadi.files.document import Item, nearest
from tenscasadi.files.forms import Form, Names, NotWritten, Numbers, Schema, Schemas
from tenscasadi.files.formulas import RESERVED, Formula, FormulaError
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
class OverTime(Form):
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
