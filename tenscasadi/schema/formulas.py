"""Formulas of scene files: arithmetic on numbers and time.

The text is parsed, never run as Python.
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import casadi as ca

LONGEST = 1000  # characters: bounds the time of parsing
TIME = "t"
CONSTANTS = MappingProxyType({"pi": math.pi, "deg": math.pi / 180.0})
# number of arguments; all are functions of CasADi, of numbers as well as symbols
FUNCTIONS: Mapping[str, int] = MappingProxyType(
    dict.fromkeys(
        ["sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "exp", "log", "sinh", "cosh", "tanh"],
        1,
    )
    | dict.fromkeys(["abs", "sign", "floor", "ceil"], 1)
    | dict.fromkeys(["atan2", "hypot", "min", "max"], 2)
)
RESERVED = frozenset({TIME, *CONSTANTS, *FUNCTIONS})

_RENAMED = {"abs": ca.fabs, "min": ca.fmin, "max": ca.fmax}
_OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: ca.power,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
_DEGREES = re.compile(r"(?<![\w.])((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*deg\b")
_NAME = re.compile(r"(?<![\w.\[])[A-Za-z_]\w*", re.ASCII)  # indices of "z[tip]" are none


class FormulaError(ValueError):
    """Raised for an invalid formula, with a cure."""


class Formula:
    """Parsed arithmetic expression.

    Parameters
    ----------
    text : str
        Arithmetic such as ``"height / 2 * cos(30 deg)"``.

    Attributes
    ----------
    names : frozenset of str
        Names in the text, also indexed ones such as ``"z[tip]"`` and ``"length[guys[0]]"``.

    Raises
    ------
    FormulaError
        If the text is no arithmetic.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        self._terms: list[tuple[ast.expr, Any, list[ast.expr]]] = []  # operators before operands
        todo = [_parse(text)]
        while todo:
            node = todo.pop()
            content, operands = _read(node, text)
            self._terms.append((node, content, operands))
            todo += operands
        names = {content for _, content, _ in self._terms if isinstance(content, str)}
        self.names = frozenset(names - set(CONSTANTS))

    @property
    def varies(self) -> bool:
        """Whether the formula depends on the time t."""
        return TIME in self.names

    def value(self, numbers: Mapping[str, float]) -> float:
        """Compute the value for given values of the names.

        `numbers` has these values. Raises FormulaError, also for a formula of the time.
        """
        if self.varies:
            raise FormulaError(f"{self.text!r} changes with the time t: give a constant here")
        found = float(self.at(0.0, numbers))
        if not math.isfinite(found):
            raise FormulaError(f"{self.text!r} is {found}: give a formula of a finite value")
        return found

    def at(self, time: Any, numbers: Mapping[str, Any]) -> Any:
        """Compute the value at a time, also a CasADi symbol.

        `numbers` has the values of the names in the formula. Raises FormulaError.
        """
        known = {**numbers, **CONSTANTS, TIME: time}
        values: dict[ast.expr, Any] = {}
        for node, content, operands in reversed(self._terms):
            if callable(content):
                try:
                    values[node] = content(*(values[operand] for operand in operands))
                except ArithmeticError as error:
                    raise FormulaError(f"{self.text!r}: {error}, change the numbers") from None
            elif isinstance(content, str) and content not in known:
                near = f", where there are {', '.join(list(numbers)[:20])}" if numbers else ""
                raise FormulaError(f"{content!r} is not declared: give it in [numbers]{near}")
            else:
                values[node] = known[content] if isinstance(content, str) else content
        return values[self._terms[0][0]]

    def with_numbers(self, numbers: Mapping[str, float]) -> str:
        """Replace the names of declared numbers in the text by values.

        `numbers` has the values by name. Returns the new text.
        """
        known = {name: f"({value!r})" for name, value in numbers.items() if name not in RESERVED}
        return _NAME.sub(lambda found: known.get(found[0], found[0]), self.text)


def _parse(text: str) -> ast.expr:
    if len(text) > LONGEST:
        raise FormulaError(f"a formula of {len(text)} characters: give at most {LONGEST}")
    try:
        if text.isascii() and "#" not in text:
            expression = _DEGREES.sub(r"(\1*deg)", text.strip())
            return ast.parse(expression, "<formula>", "eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        pass
    raise _error(text, "units are SI and not written" if re.search(r"\d\s*[A-Za-z]", text) else "")


def _read(node: ast.expr, text: str) -> tuple[Any, list[ast.expr]]:
    """Find the value, name or operation of a syntax-tree node.

    Returns it with the operands of an operation. `text` is the formula, for messages. Raises
    FormulaError.
    """
    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            return float(str(value)), []  # of an int that is too large: inf
        case ast.Name(name) if name not in FUNCTIONS:
            return name, []
        case ast.Subscript(ast.Name(name), ast.Name(item) | ast.Constant(item)):
            return f"{name}[{item!s}]", []
        case ast.Subscript(
            ast.Name(name), ast.Subscript(ast.Name(group), ast.Constant(int() as member))
        ):
            return f"{name}[{group}[{member}]]", []
        case ast.BinOp(left, ast.BitXor(), right):
            raise _error(text, "give ** for powers")
        case ast.BinOp(left, operation, right) if type(operation) in _OPERATORS:
            return _OPERATORS[type(operation)], [left, right]
        case ast.UnaryOp(operation, operand) if type(operation) in _OPERATORS:
            return _OPERATORS[type(operation)], [operand]
        case ast.Call(ast.Name(name), arguments, []):
            if FUNCTIONS.get(name) == len(arguments):
                return _RENAMED.get(name) or getattr(ca, name), arguments
            counts = ", ".join(f"{name} of {count}" for name, count in FUNCTIONS.items())
            raise _error(text, f"there are the functions {counts}")
    raise _error(text)


def _error(text: str, cause: str = "") -> FormulaError:
    cause = cause and f" ({cause})"
    example = "give arithmetic such as 'height / 2 * cos(30 deg)'"
    return FormulaError(f"{text!r} is no formula{cause}: {example}")
