"""Reader of XML elements with line numbers.

Only elements and attributes are read. No other file is opened.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any
from xml.parsers import expat

import numpy as np

from tenscasadi.schema.reading import SceneFileError
from tenscasadi.util.validate import LARGEST, Array, file_path, shown

LARGEST_FILE = 16_000_000  # bytes
MOST_ELEMENTS = 100_000
DEEPEST = 500  # nesting depth


@dataclass(frozen=True)
class Element:
    """XML element with its attributes, children and line."""

    tag: str
    attributes: Mapping[str, str]
    file: str
    line: int
    children: list[Element] = field(default_factory=list)

    def __iter__(self) -> Iterator[Element]:
        return iter(self.children)

    def of(self, *tags: str) -> list[Element]:
        """Return the children with these tags."""
        return [child for child in self.children if child.tag in tags]

    def given(self, attributes: Mapping[str, str]) -> Element:
        """Copy the element with other attributes."""
        return replace(self, attributes=attributes)

    def error(self, message: str, attribute: str = "") -> SceneFileError:
        """Build the error that names this element or an attribute."""
        name = self.attributes.get("name")
        said = f"<{self.tag}>" if name is None else f'<{self.tag} name="{shown(name)[1:-1]}">'
        return SceneFileError(message, self.file, self.line, f"{said} {attribute}".strip())

    def text(self, attribute: str, default: str = "") -> str:
        """Return an attribute as text."""
        return self.attributes.get(attribute, default)

    def word(self, attribute: str, default: str, *words: str) -> str:
        """Read an attribute with given alternatives. Raises SceneFileError."""
        found = self.text(attribute, default)
        if found not in words:
            raise self.error(f"is {shown(found)}: tenscasadi reads {' or '.join(words)}", attribute)
        return found

    def flag(self, attribute: str, default: bool | None = None) -> bool | None:
        """Read a Boolean attribute. Raises SceneFileError.

        Returns None for "auto", and the default if it is missing.
        """
        if attribute not in self.attributes:
            return default
        return {"true": True, "false": False, "auto": None}[
            self.word(attribute, "", "true", "false", "auto")
        ]

    def numbers(
        self, attribute: str, count: int | Sequence[int], default: Sequence[float] | None = None
    ) -> Array:
        """Read an attribute of finite numbers. Raises SceneFileError.

        `count` is their number, or the allowed numbers.
        """
        counts = [count] if isinstance(count, int) else list(count)
        if attribute not in self.attributes:
            if default is None:
                raise self.error(
                    f"is not given: give {' or '.join(map(str, counts))} number{'s' * (counts != [1])}",
                    attribute,
                )
            return np.array(default, dtype=float)
        given = self.attributes[attribute]
        try:
            found = np.array([float(word) for word in given.split()])
        except ValueError:
            found = np.full(1, np.nan)
        if len(found) not in counts or not np.all(np.abs(found) <= LARGEST):
            raise self.error(
                f"is {shown(given)}: give {' or '.join(map(str, counts))} finite number{'s' * (counts != [1])}",
                attribute,
            )
        return found

    def number(self, attribute: str, default: float | None = None) -> float:
        """Read an attribute of one number. Raises SceneFileError."""
        return float(self.numbers(attribute, 1, None if default is None else [default])[0])

    def whole(self, attribute: str, default: int) -> int:
        """Read an attribute of one integer. Raises SceneFileError."""
        found = self.number(attribute, default)
        if found != round(found) or abs(found) > 2**31:
            raise self.error(f"is {shown(self.text(attribute))}: give a whole number", attribute)
        return int(found)


def read_elements(path: str | os.PathLike[str]) -> Element:
    """Read the root element of a file. Raises SceneFileError, OSError."""
    source = file_path("path", path)
    if not source.exists():
        raise FileNotFoundError(2, "No such file", os.fspath(path))
    name = source.name or str(source)
    if not source.is_file():  # opening a FIFO would wait for another process
        raise SceneFileError("it is no regular file: give the path of one in MuJoCo's XML", name)
    try:
        with open(source, "rb") as file:
            content = file.read(LARGEST_FILE + 1)
    except OSError as error:
        raise SceneFileError(
            f"it cannot be read ({error.strerror}): give a file that can", name
        ) from None
    if len(content) > LARGEST_FILE:
        raise SceneFileError(
            f"it has more than {LARGEST_FILE / 1e6:g} MB: give a smaller file", name
        )
    return _Reader(name).read(content)


class _Reader:
    """Handler of expat's events."""

    def __init__(self, name: str) -> None:
        self._name, self._count = name, 0
        self._open: list[Element] = [Element("", {}, name, 1)]
        self._parser = parser = expat.ParserCreate()
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.StartDoctypeDeclHandler = self._refuse(
            "a document type, which MJCF has not: remove <!DOCTYPE ...>"
        )
        parser.EntityDeclHandler = self._refuse("an entity, which MJCF has not: remove it")
        parser.ExternalEntityRefHandler = self._refuse(
            "a reference to another file, which is not read: put all into one file"
        )
        parser.SetParamEntityParsing(expat.XML_PARAM_ENTITY_PARSING_NEVER)

    def read(self, content: bytes) -> Element:
        """Parse the root element. Raises SceneFileError."""
        try:
            self._parser.Parse(content, True)
        except expat.ExpatError as error:
            reason = expat.ErrorString(error.code)
            raise SceneFileError(
                f"it is no XML, {reason}: correct it there", self._name, error.lineno
            ) from None
        except (ValueError, LookupError) as error:  # an unknown encoding
            if isinstance(error, SceneFileError):
                raise
            raise SceneFileError(
                "its encoding is not known: write it in UTF-8", self._name, 1
            ) from None
        return self._open[0].children[0]

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._count += 1
        line = self._parser.CurrentLineNumber
        if self._count > MOST_ELEMENTS:
            raise SceneFileError(
                f"it has more than {MOST_ELEMENTS} elements: give a smaller file", self._name, line
            )
        if len(self._open) > DEEPEST:
            raise SceneFileError(
                f"its elements are nested more than {DEEPEST} deep: write it flatter",
                self._name,
                line,
            )
        element = Element(shown(tag)[1:-1], attributes, self._name, line)
        self._open[-1].children.append(element)
        self._open.append(element)

    def _end(self, _: str) -> None:
        self._open.pop()

    def _refuse(self, what: str) -> Callable[..., Any]:
        def refuse(*_: Any) -> None:
            raise SceneFileError(f"it has {what}", self._name, self._parser.CurrentLineNumber)

        return refuse
