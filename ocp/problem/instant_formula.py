"""User-defined functions of an instant, given by formulas in files."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from tenscasadi.schema.field_types import FieldType
from tenscasadi.schema.formulas import TIME, Formula, FormulaError
from tenscasadi.schema.reading import Item, ItemKind, Names, NotWritten
from tenscasadi.util.validate import format_value, instance, number, text

if TYPE_CHECKING:
    from ocp.problem.instant import Instant


def _component(quantity: str, axis: int) -> Callable[[Instant, int], Any]:
    return lambda now, k: getattr(now, quantity)[axis, k]


def _entry(quantity: str) -> Callable[[Instant, int], Any]:
    return lambda now, k: getattr(now, quantity)[k]


# indexed names in formulas: kind of item, and its value at an instant
QUANTITIES: Mapping[str, tuple[ItemKind, Callable[[Instant, int], Any]]] = {
    **{axis: ("node", _component("nodes", k)) for k, axis in enumerate("xyz")},
    **{f"v{axis}": ("node", _component("velocities", k)) for k, axis in enumerate("xyz")},
    **{f"a{axis}": ("node", _component("accelerations", k)) for k, axis in enumerate("xyz")},
    "length": ("string", _entry("lengths")),
    "tension": ("string", _entry("tension")),
    "force_density": ("string", _entry("force_density")),
}
_INDEXED = re.compile(r"(\w+)\[(.+)\]")


@dataclass(frozen=True)
class InstantFormula:
    """Function of an `ocp.Instant` that is given by a formula.

    Parameters
    ----------
    text : str
        Arithmetic such as ``"z[tip] - 0.5 * z[3]"`` of the quantities x, y, z [m], vx, vy, vz
        [m/s], ax, ay, az [m/s²] of nodes, length [m], tension [N] and force_density [N/m] of
        strings, each with the name or index of its item, and of the time t [s].
    numbers : mapping of str to float, optional
        Numbers by name; those that the formula does not name are dropped.

    Raises
    ------
    TypeError, ValueError
        The text is no formula, or a number is not finite.

    Examples
    --------
    >>> import ocp
    >>> high = ocp.AtEnd("height", ocp.InstantFormula("-(z[3] + z[4] + z[5]) / 3"))
    >>> high.expression.text
    '-(z[3] + z[4] + z[5]) / 3'
    """

    text: str
    numbers: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        given = text("InstantFormula.text", self.text)
        try:
            used = Formula(given).names
        except FormulaError as error:
            raise FormulaError(f"InstantFormula.text: {error}") from None
        example = "numbers by name, such as {'side': 0.4}"
        instance("InstantFormula.numbers", self.numbers, Mapping, example)
        numbers = {
            text("InstantFormula.numbers: a name", name): number(
                f"InstantFormula.numbers[{format_value(name)}]", value
            )
            for name, value in self.numbers.items()
        }
        kept = {name: value for name, value in numbers.items() if name in used}
        object.__setattr__(self, "numbers", kept)

    def __call__(self, now: Instant) -> Any:
        """Build the CasADi expression of the formula at an instant.

        Raises FormulaError.
        """
        formula, values = Formula(self.text), dict[str, Any](self.numbers)
        names = now.model.scene.structure.names
        for name in formula.names - values.keys() - {TIME}:
            value, index = find_quantity(name, names)
            values[name] = value(now, index)
        return formula.at(now.time, values)


def find_quantity(name: str, names: Names) -> tuple[Callable[[Instant, int], Any], int]:
    """Find quantity and index of a name such as "z[tip]".

    The quantity is a function of an instant and the index. Raises FormulaError.
    """
    indexed = _INDEXED.fullmatch(name)
    if indexed is None or indexed[1] not in QUANTITIES:
        known = ", ".join(QUANTITIES)
        raise FormulaError(
            f"{name!r} is not known: give {known} with an index, such as z[0], the time t, or a number of [numbers]"
        )
    which, value = QUANTITIES[indexed[1]]
    try:
        found = names.find(which, indexed[2])
    except ValueError as error:
        raise FormulaError(f"{name!r} {error}") from None
    if len(found) != 1:
        raise FormulaError(f"{name!r} names {len(found)} {which}s: give one, such as {found[0]}")
    return value, found[0]


@dataclass(frozen=True)
class InstantText(FieldType):
    """Field type of a formula of an `ocp.Instant`."""

    def read(self, item: Item) -> InstantFormula:
        """Read a formula from a file, and check the names in it."""
        formula = item.formula()
        numbers = item.document.numbers
        for name in sorted(formula.names - numbers.keys() - {TIME}):
            try:
                find_quantity(name, item.names)
            except FormulaError as error:
                raise item.error(str(error)) from None
        return InstantFormula(formula.text, numbers)

    def write(self, value: Any) -> str:
        """Write a formula with numbers in place of named constants."""
        if not isinstance(value, InstantFormula):
            raise NotWritten("a function in Python: leave it out, or give an ocp.InstantFormula")
        return Formula(value.text).with_numbers(value.numbers)

    def schema(self, kinds: Any) -> dict[str, Any]:
        """Build the JSON Schema of a text."""
        return {"type": "string"}
