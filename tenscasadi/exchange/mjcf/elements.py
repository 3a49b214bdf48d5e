"""XML elements of MJCF files, with line numbers.

Only elements and attributes are read, and files that `include` names in the folder of the file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np

from tenscasadi.exchange.source import DEEPEST, Source
from tenscasadi.schema.reading import SceneFileError
from tenscasadi.util.validate import LARGEST, MAX_COUNT, Array, format_value


@dataclass(frozen=True)
class Element:
    """XML element with its tag, attributes, children and line number.

    `source` is the import that it belongs to, and `file` the name of its file.
    """

    tag: str
    attributes: Mapping[str, str]
    source: Source
    file: str
    line: int
    children: list[Element] = field(default_factory=list)

    def __iter__(self) -> Iterator[Element]:
        return iter(self.children)

    def find(self, *tags: str) -> list[Element]:
        """Return the children with given tags."""
        return [child for child in self.children if child.tag in tags]

    def replace(self, attributes: Mapping[str, str]) -> Element:
        """Copy the element with other attributes."""
        return replace(self, attributes=attributes)

    def error(self, message: str, attribute: str = "") -> SceneFileError:
        """Build an error that names this element or an attribute.

        `message` is its text.
        """
        name = self.attributes.get("name")
        tag = f"<{self.tag}>" if name is None else f'<{self.tag} name="{format_value(name)[1:-1]}">'
        return SceneFileError(message, self.file, self.line, f"{tag} {attribute}".strip())

    def leave_out(self, message: str, attribute: str = "") -> None:
        """Omit the element or an attribute from the import.

        Raises SceneFileError if strict. `message` is the reason.
        """
        self.source.leave_out(self.error(message, attribute))

    def text(self, attribute: str, default: str = "") -> str:
        """Return an attribute as text.

        It is `default` if the attribute is missing.
        """
        return self.attributes.get(attribute, default)

    def word(self, attribute: str, default: str, *words: str) -> str:
        """Read an attribute that must be one of `words`.

        `default` replaces a missing attribute. Raises SceneFileError.
        """
        found = self.text(attribute, default)
        if found not in words:
            raise self.error(
                f"is {format_value(found)}: tenscasadi reads {' or '.join(words)}", attribute
            )
        return found

    def flag(self, attribute: str, default: bool | None = None) -> bool | None:
        """Read a Boolean attribute.

        Returns None for "auto", and the default if it is missing. Raises SceneFileError.
        """
        if attribute not in self.attributes:
            return default
        return {"true": True, "false": False, "auto": None}[
            self.word(attribute, "", "true", "false", "auto")
        ]

    def numbers(
        self, attribute: str, count: int | Sequence[int], default: Sequence[float] | None = None
    ) -> Array:
        """Read an attribute of finite numbers.

        `count` is their number, or the allowed numbers. `default` replaces a missing attribute;
        with None it raises SceneFileError.
        """
        counts = [count] if isinstance(count, int) else list(count)
        expected = f"{' or '.join(map(str, counts))} number{'s' * (counts != [1])}"
        if attribute not in self.attributes:
            if default is None:
                raise self.error(f"is not given: give {expected}", attribute)
            return np.array(default, dtype=float)
        given = self.attributes[attribute]
        try:
            found = np.array([float(word) for word in given.split()])
        except ValueError:
            found = np.full(1, np.nan)
        if len(found) not in counts or not np.all(np.abs(found) <= LARGEST):
            expected = expected.replace(" number", " finite number")
            raise self.error(f"is {format_value(given)}: give {expected}", attribute)
        return found

    def number(self, attribute: str, default: float | None = None) -> float:
        """Read an attribute of one number.

        `default` replaces a missing attribute; with None it raises SceneFileError.
        """
        return float(self.numbers(attribute, 1, None if default is None else [default])[0])

    def whole(self, attribute: str, default: int) -> int:
        """Read an attribute of one integer.

        `default` replaces a missing attribute. Raises SceneFileError.
        """
        found = self.number(attribute, default)
        if found != round(found) or abs(found) > 2**31:
            raise self.error(
                f"is {format_value(self.text(attribute))}: give a whole number", attribute
            )
        return int(found)


def read_elements(source: Source) -> Element:
    """Read the root element of a file with its includes.

    Raises SceneFileError, OSError.
    """
    return _XmlReader(source, source.path, [0], ()).read()


class _XmlReader:
    """XML parser of one file, with includes."""

    def __init__(
        self, source: Source, path: Path, count: list[int], above: tuple[Path, ...]
    ) -> None:
        self._source, self._path, self._count, self._above = source, path, count, above
        self._name = path.name or str(path)
        self._open: list[Element] = [Element("", {}, source, self._name, 1)]
        self._parser = parser = expat.ParserCreate()
        parser.StartElementHandler = self._start
        parser.EndElementHandler = lambda _: self._open.pop()
        parser.StartDoctypeDeclHandler = self._reject("a document type, which MJCF has not")
        parser.EntityDeclHandler = self._reject("an entity, which MJCF has not")
        parser.ExternalEntityRefHandler = self._reject("a reference to another file")
        parser.SetParamEntityParsing(expat.XML_PARAM_ENTITY_PARSING_NEVER)

    def read(self) -> Element:
        """Parse the root element.

        Raises SceneFileError.
        """
        content = self._source.read(self._path)
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
        self._count[0] += 1
        line = self._parser.CurrentLineNumber
        if self._count[0] > MAX_COUNT:
            message = f"it has more than {MAX_COUNT} elements: give a smaller file"
            raise SceneFileError(message, self._name, line)
        if len(self._open) > DEEPEST:
            message = f"its elements are nested more than {DEEPEST} deep: write it flatter"
            raise SceneFileError(message, self._name, line)
        element = Element(format_value(tag)[1:-1], attributes, self._source, self._name, line)
        if tag == "include":
            self._open[-1].children.extend(self._include(element))
        else:
            self._open[-1].children.append(element)
        self._open.append(element)

    def _include(self, element: Element) -> list[Element]:
        """Read the elements of an included file.

        Raises SceneFileError.
        """
        path = self._source.path.parent / element.text("file")
        folder = self._source.path.parent.resolve()
        if not path.resolve().is_relative_to(folder) or path.resolve() in self._above:
            raise element.error(
                f"is {element.text('file')!r}: give a file in {folder}, which does not include itself",
                "file",
            )
        if not path.is_file():
            element.leave_out(f"is {element.text('file')!r}: there is no such file", "file")
            return []
        above = (*self._above, self._path.resolve(), path.resolve())
        return _XmlReader(self._source, path, self._count, above).read().children

    def _reject(self, content: str) -> Callable[..., Any]:
        def reject(*_: Any) -> None:
            line = self._parser.CurrentLineNumber
            raise SceneFileError(f"it has {content}: remove it", self._name, line)

        return reject
