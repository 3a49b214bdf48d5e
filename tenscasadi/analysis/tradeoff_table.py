"""Table of a trade-off study: cost and errors of measured runs."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from numbers import Integral
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tenscasadi.integrators.scheme import NamedScheme, Scheme, check_scheme
from tenscasadi.integrators.stabilization import Correction
from tenscasadi.util import archive
from tenscasadi.util.validate import (
    FilePath,
    as_tuple,
    format_value,
    instance,
    positive_number,
    real_array,
)

_FORMAT = "tenscasadi tradeoff 2"
Cost = Literal["seconds", "work"]


@dataclass(frozen=True)
class TradeoffRow:
    """Cost and errors of one run of a trade-off study.

    Attributes
    ----------
    scheme : scheme
        The integration scheme.
    step : float
        Largest step [s]; NaN for a scheme with error control.
    correction : Projection, BarLengthCorrection or None
        Correction of bars and joints.
    fidelity : str
        Name of the model.
    compiled : bool
        Whether the run used machine code, not CasADi's virtual machine.
    single : bool
        Whether the run was in single precision.
    seconds : float
        Wall time of the time loop per simulated second [s/s], the median of the repeats.
    setup : float
        Wall time of building and compiling the equations [s].
    position : float
        Largest distance of a node from the reference at the end [m]. All errors are NaN if the run
        failed.
    bar : float
        Largest relative error of a bar's length over the run.
    joint : float
        Largest joint error over the run [m].
    energy : float
        Largest energy error over the run [J].
    instructions : int
        Number of instructions of one step with its correction; 0 if unknown.
    steps : int
        Steps of the run, including rejected trial steps.
    success : bool
        Whether the run reached the end.
    message : str
        Reason for the failure, or a warning.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> row = tc.TradeoffRow(tc.RungeKutta4(), 0.01, tc.Projection(), "", True, False, instructions=1000, steps=100)
    >>> row.name, row.work
    ('RungeKutta4, Projection', 100000.0)
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

    def __post_init__(self) -> None:
        check_scheme(self.scheme, "TradeoffRow.scheme")
        _check_kinds(self)

    @property
    def work(self) -> float:
        """Number of instructions that the whole run executes.

        Unlike the wall time, it does not depend on the machine and its load. It is NaN for implicit
        schemes, whose number of iterations is not known beforehand.
        """
        return float(self.instructions) * self.steps if self.instructions else float("nan")

    @property
    def name(self) -> str:
        """Scheme and options of the run, without its step."""
        return ", ".join([abbreviate(self.scheme), *self._variant()])

    @property
    def curve(self) -> str:
        """Common name of runs that differ only in step or tolerance."""
        swept = "rtol" if np.isnan(self.step) else ""
        return ", ".join(
            [abbreviate(self.scheme, swept) + (f" with {swept}" if swept else ""), *self._variant()]
        )

    def _variant(self) -> list[str]:
        named = [] if self.correction is None else [abbreviate(self.correction)]
        way = ["single precision"] if self.single else [] if self.compiled else ["virtual machine"]
        return [*named, *([self.fidelity] if self.fidelity else []), *way]


@dataclass(frozen=True)
class Tradeoff:
    """Result of a trade-off study.

    Attributes
    ----------
    rows : tuple of TradeoffRow
        The runs.
    t_end : float
        Duration of each run [s].
    reference_error : float
        Estimated error of the reference [m].
    reference_message : str
        Description of the reference.
    complete : bool
        False if the study was interrupted.
    message : str
        Place at which it was interrupted.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> ways = {"step": 0.01, "correction": None, "fidelity": "", "compiled": True, "single": False, "success": True}
    >>> cheap = tc.TradeoffRow(tc.RungeKutta4(), **ways, seconds=0.1, position=1e-4)
    >>> exact = tc.TradeoffRow(tc.DormandPrince853(), **ways, seconds=0.3, position=1e-9)
    >>> table = tc.Tradeoff((cheap, exact), t_end=1.0, reference_error=1e-12, reference_message="known")
    >>> table.cheapest(1e-6).name
    'DormandPrince853'
    """

    rows: tuple[TradeoffRow, ...]
    t_end: float
    reference_error: float
    reference_message: str
    complete: bool = True
    message: str = ""

    def __post_init__(self) -> None:
        for k, row in enumerate(as_tuple("Tradeoff.rows", self.rows, "(TradeoffRow(...),)")):
            instance(f"Tradeoff.rows[{k}]", row, TradeoffRow, "a tenscasadi.TradeoffRow")
        _check_kinds(self)

    def pareto(self, cost: Cost = "seconds") -> tuple[TradeoffRow, ...]:
        """Select the rows on the Pareto front.

        No other row is better in both cost and position error.

        Errors below that of the reference count as equal.

        Parameters
        ----------
        cost : {"seconds", "work"}
            Wall time as measured, or instructions times steps.

        Returns
        -------
        tuple of TradeoffRow
            From the cheapest to the most accurate.

        Raises
        ------
        ValueError
            If there is no such cost.
        """
        front: list[TradeoffRow] = []
        for row in self._sort_by(cost):
            if not front or row.position < front[-1].position > self.reference_error:
                front.append(row)
        return tuple(front)

    def cheapest(self, tolerance: float, cost: Cost = "seconds") -> TradeoffRow:
        """Find the cheapest row within a position error.

        The error of the reference is included.

        Parameters
        ----------
        tolerance : float
            Largest position error [m].
        cost : {"seconds", "work"}
            Wall time as measured, or instructions times steps.

        Returns
        -------
        TradeoffRow
            The cheapest.

        Raises
        ------
        TypeError, ValueError
            If an argument is wrong, or no row is within the tolerance.
        """
        tolerance = positive_number("tolerance", tolerance)
        for row in self._sort_by(cost):
            if row.position + self.reference_error <= tolerance:
                return row
        if tolerance <= self.reference_error < np.inf:
            raise ValueError(
                f"tolerance is {tolerance:g} m: the reference has an error of up to {self.reference_error:.2g} m, give more than that"
            )
        if not self._successful():
            raise ValueError(
                f"tolerance is {tolerance:g} m: {f'all {len(self.rows)} runs failed' if self.rows else 'there is no run'}"
            )
        least = min(row.position for row in self._successful())
        raise ValueError(
            f"tolerance is {tolerance:g} m: the most accurate of {len(self.rows)} runs has an error of {least:.2g} m, add smaller steps"
        )

    def summary(self) -> str:
        """Format the table as text.

        A mark shows the rows on the Pareto front.

        Returns
        -------
        str
            A line for each row, and a description of the reference.
        """
        width = max([len(row.name) for row in self.rows] + [6])
        names = {
            "step s": 9,
            "s per s": 9,
            "position m": 10,
            "bars": 8,
            "joints m": 8,
            "energy J": 9,
            "instr.": 7,
            "set-up s": 8,
        }
        head = f"  {'scheme':<{width}} " + " ".join(
            f"{name:>{size}}" for name, size in names.items()
        )
        front = set(map(id, self.pareto()))
        lines = [head]
        for row in self.rows:
            mark = "*" if id(row) in front else " "
            start = f"{mark} {row.name:<{width}} {_number(row.step, '9.3g')}"
            if row.success:
                position = (
                    f"{row.position:.2g}"
                    if row.position > self.reference_error
                    else f"< {self.reference_error:.2g}"
                )
                errors = (
                    f"{position:>10} {row.bar:8.1g} {row.joint:8.1g} {_number(row.energy, '9.2g')}"
                )
                lines.append(
                    f"{start} {row.seconds:9.2g} {errors} {row.instructions:7} {row.setup:8.2f}"
                )
            else:
                lines.append(f"{start}   {row.message.split(';')[0]}")
        lines.append(f"reference: {self.reference_message}")
        lines.append(
            "s per s: seconds per simulated second, without set-up; *: no other row is both faster and more accurate"
        )
        return "\n".join([*lines, self.message] if self.message else lines)

    def plot(self, path: FilePath | None = None, title: str = "") -> Any:
        """Draw a work-precision diagram.

        It shows seconds per simulated second over position error.

        Parameters
        ----------
        path : path-like, optional
            File to save the figure to. Its suffix selects the format.
        title : str
            Title of the diagram.

        Returns
        -------
        matplotlib.figure.Figure
            The diagram.
        """
        from tenscasadi.plots.diagrams import work_precision  # loads matplotlib

        curves: dict[str, list[tuple[float, float]]] = {}
        for row in self._successful():
            curves.setdefault(row.curve, []).append((row.position, row.seconds))
        front = [(row.position, row.seconds) for row in self.pareto()]
        return work_precision(curves, front, self.reference_error, title=title, path=path)

    def save(self, path: FilePath) -> Path:
        """Write the study to a compressed .npz file.

        Parameters
        ----------
        path : path-like
            File to write; no suffix is added.

        Returns
        -------
        pathlib.Path
            The file.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        columns = {
            field.name: [getattr(row, field.name) for row in self.rows]
            for field in fields(TradeoffRow)
        }
        for name in ("scheme", "correction"):
            columns[name] = list(map(repr, columns[name]))
        own = {
            field.name: getattr(self, field.name) for field in fields(self) if field.name != "rows"
        }
        content = {f"row_{name}": np.asarray(values) for name, values in columns.items()} | {
            name: np.asarray(value) for name, value in own.items()
        }
        return archive.save(path, _FORMAT, content)

    @staticmethod
    def load(path: FilePath) -> Tradeoff:
        """Read a study that `save` wrote.

        No code in the file is ever run.

        Parameters
        ----------
        path : path-like
            The file.

        Returns
        -------
        Tradeoff
            The study.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If it cannot be read, is no study, or holds numbers that no study can have; the message
            names the file and the field.
        """
        return archive.load(path, _FORMAT, "trade-off", _from_arrays)

    def _successful(self) -> list[TradeoffRow]:
        return [row for row in self.rows if row.success]

    def _sort_by(self, cost: Cost) -> list[TradeoffRow]:
        """Sort the successful rows by a cost, cheapest first.

        Of rows of equal cost the more accurate comes first.
        """
        if not isinstance(cost, str) or cost not in ("seconds", "work"):
            raise ValueError(f'cost is {format_value(cost)}: give "seconds" or "work"')
        known = [row for row in self._successful() if not np.isnan(getattr(row, cost))]
        return sorted(known, key=lambda row: (getattr(row, cost), row.position))


def abbreviate(value: Any, without: str = "") -> str:
    """Format an object (`value`) with its non-default options.

    The option named `without` is omitted.
    """
    own = (
        [(field.name, getattr(value, field.name), field.default) for field in fields(value)]
        if is_dataclass(value)
        else []
    )
    changed = ", ".join(
        f"{name}={option!r}"
        for name, option, default in own
        if option != default and name != without
    )
    return type(value).__name__ + (f"({changed})" if changed else "")


def _check_kinds(value: TradeoffRow | Tradeoff) -> None:
    """Check the types of a row's or table's fields. Raises TypeError, ValueError."""
    for field in fields(value):
        name, given = f"{type(value).__name__}.{field.name}", getattr(value, field.name)
        if field.type == "float" and real_array(name, given, "a number").ndim:
            raise ValueError(f"{name} is {format_value(given)}: give a number")
        if field.type in _WORDS:
            instance(name, given, *_WORDS[field.type])
        if field.type == "int" and not abs(given) < 2**63:
            raise ValueError(f"{name} is {format_value(given)}: it must be less than 2^63 in size")


_WORDS: dict[Any, tuple[Any, str]] = {
    "int": (Integral, "a whole number"),
    "bool": ((bool, np.bool_), "True or False"),
    "str": (str, "text"),
}


def _from_arrays(content: archive.Fields) -> Tradeoff:
    columns: dict[str, Any] = {
        field.name: content.array(f"row_{field.name}", "fibU", 1) for field in fields(TradeoffRow)
    }
    for field in fields(TradeoffRow):
        if columns[field.name].size:  # NumPy takes an empty list for numbers
            content.array(f"row_{field.name}", _kinds(field))
    known = {field.name: field for field in fields(Tradeoff) if field.name != "rows"}
    if unknown := {name for name in content if not name.startswith("row_")} - known.keys():
        raise ValueError(f"it has a field {min(unknown)!r}")
    own = {
        name: content.array(name, _kinds(field), 0).item()
        for name, field in known.items()
        if field.default is MISSING or name in content
    }
    _check_values(columns, own)
    for name in ("scheme", "correction"):
        columns[name] = [_value(text) for text in columns[name].tolist()]
    lists = [values if isinstance(values, list) else values.tolist() for values in columns.values()]
    return Tradeoff(
        tuple(
            TradeoffRow(**dict(zip(columns, values, strict=True)))
            for values in zip(*lists, strict=True)
        ),
        **own,
    )


def _kinds(field: Field[Any]) -> str:
    """Return NumPy's type codes of a field, such as "fi".

    The code of schemes and other objects is that of text.
    """
    return {"float": "fi", "int": "i", "bool": "b"}.get(str(field.type), "U")


def _check_values(columns: Mapping[str, Any], own: Mapping[str, Any]) -> None:
    """Check the values of the fields.

    `columns` are the fields of rows, and `own` those of the table. Raises ValueError with the name
    of the first wrong field. NaN stands for a value that was not measured.
    """
    if not 0 < own["t_end"] < np.inf:
        raise ValueError(f"field 't_end' is {own['t_end']:g}: it must be finite and greater than 0")
    if not own["reference_error"] >= 0:
        raise ValueError(
            f"field 'reference_error' is {own['reference_error']:g}: it must be at least 0"
        )
    success = columns["success"].astype(bool)
    for name in ("step", "seconds", "position", "bar", "joint", "energy", "instructions", "steps"):
        values = columns[name]
        wrong = values <= 0 if name == "step" else values < 0
        wrong = wrong | np.isinf(values) if name in ("step", "seconds") else wrong
        wrong = (
            wrong | (success & ~np.isfinite(values))
            if name in ("position", "bar", "joint")
            else wrong
        )
        for k in np.flatnonzero(wrong)[:1]:
            raise ValueError(f"field 'row_{name}' is {values[k]:g} in row {k}, which no run has")


def _number(value: float, form: str) -> str:
    return f"{'–':>{form.split('.')[0]}}" if np.isnan(value) else f"{value:{form}}"


def _value(text: str) -> Any:
    """Read a scheme or correction from its `repr` (`text`).

    Only registered classes with plain options are read.
    """
    try:
        tree = ast.parse(text, mode="eval").body
    except SyntaxError:
        raise ValueError(f"{text!r} is no scheme or correction") from None
    if isinstance(tree, ast.Constant) and tree.value is None:
        return None
    known = {**NamedScheme.members, **Correction.members}
    if (
        not isinstance(tree, ast.Call)
        or not isinstance(tree.func, ast.Name)
        or tree.func.id not in known
        or tree.args
    ):
        raise ValueError(f"{text!r} is no scheme or correction")
    options = {str(option.arg): ast.literal_eval(option.value) for option in tree.keywords}
    try:
        return known[tree.func.id](**options)
    except TypeError as error:  # of an option that is unknown or of another type
        raise ValueError(f"{text!r} is no scheme or correction: {error}") from None
