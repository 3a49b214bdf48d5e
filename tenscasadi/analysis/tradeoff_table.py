"""Measured runs as a table: what each costs, how wrong it is, and which are worth their time."""

from __future__ import annotations

import ast
import os
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tenscasadi import integrators
from tenscasadi.integrators.scheme import Scheme
from tenscasadi.integrators.stabilization import Correction
from tenscasadi.util import archive
from tenscasadi.util.validate import positive_number

_FORMAT = "tenscasadi tradeoff 2"
Cost = Literal["seconds", "work"]


@dataclass(frozen=True)
class Row:
    """One run of a trade-off.

    step: s, NaN for a scheme that chooses its own; fidelity: the name of the model; compiled: as machine code or in the virtual machine;
    single: in single precision.
    seconds: wall time of the time loop per simulated second, the median of repeats; setup: wall time of equations and compilation, s.
    position: largest distance of a node from the reference at the end, m; bar, joint (m), energy (J): largest over the run, as in `Trajectory`.
    instructions: of one step with its correction, 0 where they are not known; steps: of the run, with those tried in vain; errors are NaN where
    it failed.
    """

    scheme: Scheme
    step: float
    correction: Correction | None
    fidelity: str
    compiled: bool
    single: bool
    seconds: float = np.nan
    setup: float = np.nan
    position: float = np.nan
    bar: float = np.nan
    joint: float = np.nan
    energy: float = np.nan
    instructions: int = 0
    steps: int = 0
    success: bool = False
    message: str = ""

    @property
    def work(self) -> float:
        """Instructions of the whole run: a cost that no other load of the machine changes; NaN for implicit schemes, where it is not known."""
        return float(self.instructions) * self.steps if self.instructions else float("nan")

    @property
    def name(self) -> str:
        """All but the step in words."""
        return ", ".join([short(self.scheme), *self._variant()])

    @property
    def curve(self) -> str:
        """What rows that differ in step or tolerance only have in common."""
        swept = "rtol" if np.isnan(self.step) else ""
        return ", ".join([short(self.scheme, swept) + (f" with {swept}" if swept else ""), *self._variant()])

    def _variant(self) -> list[str]:
        named = [] if self.correction is None else [short(self.correction)]
        way = ["single precision"] if self.single else [] if self.compiled else ["virtual machine"]
        return [*named, *([self.fidelity] if self.fidelity else []), *way]


@dataclass(frozen=True)
class Tradeoff:
    """The rows of a trade-off study over [0, t_end].

    reference_error: how far the reference itself may be off, m; reference_message: how it was found. complete: False when the study was
    interrupted; message says so.
    """

    rows: tuple[Row, ...]
    t_end: float
    reference_error: float
    reference_message: str
    complete: bool = True
    message: str = ""

    def pareto(self, cost: Cost = "seconds") -> tuple[Row, ...]:
        """The rows that no other beats in both cost and position error, from the cheapest to the most accurate.

        cost: "seconds", as measured, or "work", instructions times steps. Errors below that of the reference are not told apart.
        """
        front: list[Row] = []
        for *_, row in self._by(cost):
            if not front or row.position < front[-1].position > self.reference_error:
                front.append(row)
        return tuple(front)

    def cheapest(self, tolerance: float, cost: Cost = "seconds") -> Row:
        """The cheapest row whose position error, with that of the reference, is within `tolerance`, m. ValueError when there is none."""
        tolerance = positive_number("tolerance", tolerance)
        for *_, row in self._by(cost):
            if row.position + self.reference_error <= tolerance:
                return row
        if tolerance <= self.reference_error < np.inf:
            raise ValueError(f"tolerance is {tolerance:g} m: the reference itself may be off by {self.reference_error:.2g} m, give more than that")
        if not self._good():
            raise ValueError(f"tolerance is {tolerance:g} m: {f'all {len(self.rows)} runs failed' if self.rows else 'there is no run'}")
        least = min(row.position for row in self._good())
        raise ValueError(f"tolerance is {tolerance:g} m: the most accurate of {len(self.rows)} runs is off by {least:.2g} m, add smaller steps")

    def summary(self) -> str:
        """The table as lines of text; rows of the front of cost against error are marked."""
        width = max([len(row.name) for row in self.rows] + [6])
        names = {"step s": 9, "s per s": 9, "position m": 10, "bars": 8, "joints m": 8, "energy J": 9, "instr.": 7, "set-up s": 8}
        head = f"  {'scheme':<{width}} " + " ".join(f"{name:>{size}}" for name, size in names.items())
        front = set(map(id, self.pareto()))
        lines = [head]
        for row in self.rows:
            mark = "*" if id(row) in front else " "
            start = f"{mark} {row.name:<{width}} {_number(row.step, '9.3g')}"
            if row.success:
                position = f"{row.position:.2g}" if row.position > self.reference_error else f"< {self.reference_error:.2g}"
                errors = f"{position:>10} {row.bar:8.1g} {row.joint:8.1g} {_number(row.energy, '9.2g')}"
                lines.append(f"{start} {row.seconds:9.2g} {errors} {row.instructions:7} {row.setup:8.2f}")
            else:
                lines.append(f"{start}   {row.message.split(';')[0]}")
        lines.append(f"reference: {self.reference_message}")
        lines.append("s per s: seconds per simulated second, without set-up; *: no other row is both faster and more accurate")
        return "\n".join([*lines, self.message] if self.message else lines)

    def plot(self, path: str | os.PathLike[str] | None = None, title: str = "") -> Any:
        """A work-precision diagram as a matplotlib Figure, saved where `path` is given: seconds per simulated second over position error."""
        from tenscasadi.plots.diagrams import work_precision  # loads matplotlib

        curves: dict[str, list[tuple[float, float]]] = {}
        for row in self._good():
            curves.setdefault(row.curve, []).append((row.position, row.seconds))
        front = [(row.position, row.seconds) for row in self.pareto()]
        return work_precision(curves, front, self.reference_error, title=title, path=path)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes a compressed .npz file (NumPy arrays only) to exactly `path` and returns it. Raises OSError when it cannot be written."""
        columns = {field.name: [getattr(row, field.name) for row in self.rows] for field in fields(Row)}
        for name in ("scheme", "correction"):
            columns[name] = list(map(repr, columns[name]))
        own = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "rows"}
        content = {f"row_{name}": np.asarray(values) for name, values in columns.items()} | {name: np.asarray(value) for name, value in own.items()}
        return archive.save(path, _FORMAT, content)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Tradeoff:
        """The study saved in `path`. No code in the file is ever run.

        Raises FileNotFoundError, and ValueError naming the file for one that cannot be read or is no study.
        """
        return archive.load(path, _FORMAT, "trade-off", _from_arrays)

    def _good(self) -> list[Row]:
        return [row for row in self.rows if row.success]

    def _by(self, cost: Cost) -> list[tuple[float, float, int, Row]]:
        """(cost, position, place, row) of each good row whose cost is known, from the cheapest."""
        if cost not in ("seconds", "work"):
            raise ValueError(f'cost is {cost!r}: give "seconds" or "work"')
        known = [(float(getattr(row, cost)), row.position, place, row) for place, row in enumerate(self._good())]
        return sorted(entry for entry in known if not np.isnan(entry[0]))


def short(value: Any, without: str = "") -> str:
    """A frozen value as text, with only the options that are not the default, and not that of the name `without`."""
    own = [(field.name, getattr(value, field.name), field.default) for field in fields(value)] if is_dataclass(value) else []
    changed = ", ".join(f"{name}={option!r}" for name, option, default in own if option != default and name != without)
    return type(value).__name__ + (f"({changed})" if changed else "")


def _from_arrays(content: dict[str, Any]) -> Tradeoff:
    columns = {field.name: content.pop(f"row_{field.name}").tolist() for field in fields(Row)}
    for name in ("scheme", "correction"):
        columns[name] = [_value(text) for text in columns[name]]
    rows = tuple(Row(**dict(zip(columns, values, strict=True))) for values in zip(*columns.values(), strict=True))
    return Tradeoff(rows=rows, **{name: value.item() for name, value in content.items()})


def _number(value: float, form: str) -> str:
    return f"{'–':>{form.split('.')[0]}}" if np.isnan(value) else f"{value:{form}}"


def _value(text: str) -> Any:
    """The scheme or correction that `repr` wrote: a class of `integrators.__all__` with plain options."""
    tree = ast.parse(text, mode="eval").body
    if isinstance(tree, ast.Constant) and tree.value is None:
        return None
    if not isinstance(tree, ast.Call) or not isinstance(tree.func, ast.Name) or tree.func.id not in integrators.__all__ or tree.args:
        raise ValueError(f"{text!r} is no scheme or correction")
    return getattr(integrators, tree.func.id)(**{str(option.arg): ast.literal_eval(option.value) for option in tree.keywords})
