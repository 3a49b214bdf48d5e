"""Functions of time that are given by formulas, for files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tenscasadi.schema.formulas import Formula
from tenscasadi.schema.value import Value


@dataclass(frozen=True)
class TimeFormula(Value, kind="TimeFormula"):
    """Function of time, given by formulas of ``t``.

    Parameters
    ----------
    entries : nested tuples
        Formulas, numbers, and None for free coordinates.
    numbers : tuple of (str, float)
        Declared numbers; those that no formula names are dropped.
    """

    entries: Any
    numbers: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        used: set[str] = set()
        _map(self.entries, lambda formula: used.update(formula.names))
        numbers = tuple((name, value) for name, value in self.numbers if name in used)
        object.__setattr__(self, "numbers", numbers)

    def __call__(self, time: Any) -> Any:
        """Compute nested lists of values at a time.

        The time is a number or a CasADi symbol.
        """
        numbers = dict(self.numbers)
        return _map(self.entries, lambda formula: formula.at(time, numbers))

    def plain(self) -> Any:
        """Return the formulas as text, with numbers in place of names."""
        numbers = dict(self.numbers)
        return _map(self.entries, lambda formula: Formula(formula.with_numbers(numbers)).text)


def _map(entries: Any, function: Callable[[Formula], Any]) -> Any:
    """Apply a function to each formula in nested tuples, `entries`.

    Texts are formulas; numbers and None are unchanged. The result is nested lists.
    """
    if isinstance(entries, tuple):
        return [_map(entry, function) for entry in entries]
    return function(Formula(entries)) if isinstance(entries, str) else entries
