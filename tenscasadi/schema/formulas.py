"""Formulas of scene files: arithmetic over declared numbers, and over the time t. Nothing in them is ever run as Python."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, NoReturn

import casadi as ca

LONGEST = 1000  # characters
DEEPEST = 40  # parentheses, signs and powers inside each other
TIME = "t"

CONSTANTS = MappingProxyType({"pi": math.pi, "deg": math.pi / 180.0})

_TOKEN = re.compile(
    r"\s*(?:(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)|([^\W\d]\w*)|(\*\*|[-+*/(),]))",
    re.ASCII,
)

_WORD = re.compile(r"(?<![\w.])[A-Za-z_]\w*", re.ASCII)


class _Function(NamedTuple):
    """A function, of numbers and of CasADi's symbols, and how many arguments it takes."""

    number: Callable[..., float]
    symbol: Callable[..., Any]
    arguments: int = 1


def _sign(value: float) -> float:
    return math.copysign(1.0, value) if value else 0.0


FUNCTIONS = MappingProxyType(
    {
        **{
            name: _Function(getattr(math, name), getattr(ca, name))
            for name in ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "exp", "log")
        },
        **{
            name: _Function(getattr(math, name), getattr(ca, name))
            for name in ("sinh", "cosh", "tanh", "floor", "ceil")
        },
        "abs": _Function(abs, ca.fabs),
        "sign": _Function(_sign, ca.sign),
        "atan2": _Function(math.atan2, ca.atan2, 2),
        "hypot": _Function(math.hypot, ca.hypot, 2),
        "min": _Function(min, ca.fmin, 2),
        "max": _Function(max, ca.fmax, 2),
    }
)
RESERVED = frozenset({TIME, *CONSTANTS, *FUNCTIONS})

_Step = tuple[
    str, Any
]  # ("number", value), ("name", word) or (operator or function, number of operands)


class FormulaError(ValueError):
    """A fault of a formula, and its cure."""


class Formula:
    """A formula, read but not computed.

    Parameters
    ----------
    text : str
        Arithmetic such as ``"height / 2 * cos(30 deg)"``.

    Raises
    ------
    FormulaError
        Where it is none.
    """

    def __init__(self, text: str) -> None:
        if len(text) > LONGEST:
            raise FormulaError(f"a formula of {len(text)} characters: give at most {LONGEST}")
        self.text = text
        self._steps = _Parser(text).steps()
        self.names = frozenset(of for what, of in self._steps if what == "name")

    @property
    def varies(self) -> bool:
        """Whether it is a formula of the time t."""
        return TIME in self.names

    def value(self, numbers: Mapping[str, float]) -> float:
        """Return the number that the formula is, for these declared numbers. Raises FormulaError."""
        if self.varies:
            raise FormulaError(f"{self.text!r} changes with the time t: give a constant here")
        found = float(_run(self._steps, numbers, _of_numbers))
        if not math.isfinite(found):
            raise FormulaError(f"{self.text!r} is {found}: give a formula of a finite value")
        return found

    def at(self, time: Any, numbers: Mapping[str, float]) -> Any:
        """Return the value at a time, a number or one of CasADi's symbols. Raises FormulaError."""
        if isinstance(time, (ca.SX, ca.MX, ca.DM)):
            return _run(self._steps, {**numbers, TIME: time}, _of_symbols)
        return _run(self._steps, {**numbers, TIME: float(time)}, _of_numbers)

    def with_numbers(self, numbers: Mapping[str, float]) -> str:
        """Return the text with declared numbers in place of their names."""
        known = {name: f"({value!r})" for name, value in numbers.items() if name not in RESERVED}
        return _WORD.sub(lambda found: known.get(found[0], found[0]), self.text)


class _Parser:
    """Turns a text into steps of a stack machine. Precedence as in Python: ** before signs before * and / before + and -."""

    def __init__(self, text: str) -> None:
        self._text, self._depth, self._at = text, 0, 0
        self._tokens = list(self._split())
        self._steps: list[_Step] = []

    def steps(self) -> tuple[_Step, ...]:
        self._sum()
        if self._peek():
            units = ", units are SI and not written" if self._tokens[self._at][0] == "name" else ""
            self._fail(f"{self._peek()!r} is not expected{units}")
        return tuple(self._steps)

    def _split(self) -> Iterator[tuple[str, str]]:
        at, end = 0, len(self._text.rstrip())
        while at < end:
            found = _TOKEN.match(self._text, at)
            if found is None:
                rest = self._text[at:].lstrip()
                cure = ", give ** for powers" if rest[0] == "^" else ""
                raise FormulaError(
                    f"{self._text!r} has {rest[0]!r}, which no formula has{cure}: give arithmetic such as 'height / 2 * cos(30 deg)'"
                )
            at = found.end()
            kind = ("number", "name", "mark")[(found.lastindex or 1) - 1]
            yield kind, found[found.lastindex or 1]

    def _peek(self) -> str:
        return self._tokens[self._at][1] if self._at < len(self._tokens) else ""

    def _take(self, *marks: str) -> str:
        if self._peek() in marks and self._peek():
            self._at += 1
            return self._tokens[self._at - 1][1]
        return ""

    def _fail(self, fault: str) -> NoReturn:
        raise FormulaError(
            f"{self._text!r} is no formula, {fault}: give arithmetic such as 'height / 2 * cos(30 deg)'"
        )

    def _emit(self, what: str, of: Any) -> None:
        self._steps.append((what, of))

    def _sum(self) -> None:
        self._product()
        while mark := self._take("+", "-"):
            self._product()
            self._emit(mark, 2)

    def _product(self) -> None:
        self._signed()
        while mark := self._take("*", "/"):
            self._signed()
            self._emit(mark, 2)

    def _signed(self) -> None:
        self._depth += 1
        if self._depth > DEEPEST:
            self._fail(f"more than {DEEPEST} signs and parentheses lie inside each other")
        if mark := self._take("+", "-"):
            self._signed()
            self._emit("neg" if mark == "-" else "pos", 1)
        else:
            self._item()
            if self._take("**"):
                self._signed()
                self._emit("**", 2)
        self._depth -= 1

    def _item(self) -> None:
        if self._take("("):
            self._sum()
            if not self._take(")"):
                self._fail("a parenthesis is not closed")
            return
        if self._at >= len(self._tokens):
            self._fail("it ends too early")
        kind, word = self._tokens[self._at]
        self._at += 1
        if kind == "mark":
            self._fail(f"{word!r} is not expected")
        if word in FUNCTIONS:
            self._call(word)
        elif kind == "name":
            if self._peek() == "(":
                self._fail(f"{word!r} is no function; there are {', '.join(FUNCTIONS)}")
            self._emit("name", word)
        else:
            self._emit("number", float(word))
            if self._take("deg"):  # 30 deg
                self._emit("name", "deg")
                self._emit("*", 2)

    def _call(self, word: str) -> None:
        wanted, count = FUNCTIONS[word].arguments, 1
        if not self._take("("):
            self._fail(f"{word} is a function and needs parentheses")
        self._sum()
        while self._take(","):
            self._sum()
            count += 1
        if not self._take(")"):
            self._fail("a parenthesis is not closed")
        if count != wanted:
            self._fail(f"{word} takes {wanted} argument{'s' * (wanted > 1)}")
        self._emit(word, count)


def _run(steps: tuple[_Step, ...], names: Mapping[str, Any], apply: Callable[..., Any]) -> Any:
    stack: list[Any] = []
    for what, of in steps:
        if what == "number":
            stack.append(of)
        elif what == "name":
            stack.append(CONSTANTS[of] if of in CONSTANTS else _declared(of, names))
        else:
            operands = stack[-of:]
            stack[-of:] = [apply(what, *operands)]
    return stack[0]


def _declared(word: str, names: Mapping[str, Any]) -> Any:
    if word not in names:
        raise FormulaError(
            f"{word!r} is not declared: give it in [numbers]"
            + (f", where there are {', '.join(list(names)[:20])}" if names else "")
        )
    return names[word]


def _of_numbers(what: str, *values: float) -> float:
    try:
        return float(
            _OPERATORS[what](*values) if what in _OPERATORS else FUNCTIONS[what].number(*values)
        )
    except (ArithmeticError, ValueError) as error:
        shown = (
            f"{what}({', '.join(f'{value:g}' for value in values)})"
            if what not in _OPERATORS
            else f" {what} ".join(f"{v:g}" for v in values)
        )
        raise FormulaError(f"{shown} has no value ({error}): change the numbers") from None


def _of_symbols(what: str, *values: Any) -> Any:
    if not any(isinstance(value, (ca.SX, ca.MX, ca.DM)) for value in values):
        return _of_numbers(what, *values)
    return _SYMBOLIC[what](*values) if what in _SYMBOLIC else FUNCTIONS[what].symbol(*values)


_OPERATORS: dict[str, Callable[..., float]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
    "**": math.pow,  # of numbers with a point: no large powers of whole numbers
    "neg": lambda a: -a,
    "pos": lambda a: a,
}
_SYMBOLIC: dict[str, Callable[..., Any]] = {**_OPERATORS, "**": lambda a, b: a**b}
