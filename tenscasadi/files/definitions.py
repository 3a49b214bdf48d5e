"""The mechanism of the table of definitions: which values files hold, by kind and field. Reading, writing and the JSON Schema come from it."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any

from tenscasadi.files.document import Item, SceneFileError, nearest
from tenscasadi.files.forms import Form, Names, NotWritten, Schema, Schemas
from tenscasadi.util.validate import shown

_NOTHING = inspect.Parameter.empty


@dataclass(frozen=True)
class Definition:
    """A kind of value: what makes it, from which fields of which forms.

    Defaults, and which fields are needed, are those of the call; what fields mean is told by its
    docstring.
    """

    build: Callable[..., Any]
    fields: Mapping[str, Form]
    kind: str
    made: type | None  # type of the values that are written as this kind; None: never written
    short: str  # field that stands for the whole table where it is no table
    take: Callable[[Any], Mapping[str, Any]]  # fields of a value
    more: tuple[Callable[..., Any], ...]  # whose docstrings explain fields that `build` passes on

    def read(self, item: Item, names: Names, tag: str | None = None) -> Any:
        """Return the value that a table tells; `tag`: its key that tells the kind, if any. Raises SceneFileError."""
        if self.short and not isinstance(item.value, dict):
            return self.make(
                item, {self.short: item}, {self.short: self.fields[self.short].read(item, names)}
            )
        table = item.table(f"a table with {', '.join(self.fields) or tag}")
        if tag is not None:
            table.pop(tag, None)
        return self.make(item, table, self.read_fields(table, names))

    def read_fields(self, table: Mapping[str, Item], names: Names) -> dict[str, Any]:
        """Return the fields that a table tells, by name. Raises SceneFileError."""
        for name, item in table.items():
            if name not in self.fields:
                raise item.error(f"is no field of {self.kind}: {nearest(name, self.fields)}")
        return {name: self.fields[name].read(item, names) for name, item in table.items()}

    def make(self, item: Item, table: Mapping[str, Item], given: Mapping[str, Any]) -> Any:
        """Return what the call makes of fields; what it refuses is told with the place of the field. Raises SceneFileError."""
        for name in self.needed:
            if name not in given:
                raise item.error(
                    f"{self.kind} has no {name}: give {name}, {self.texts.get(name, 'which it needs')}"
                )
        return call(self.build, item, table, given)

    def write(self, value: Any, tag: str = "") -> dict[str, Any]:
        """Return the table of a value; `tag`: key that tells its kind, if any. Raises NotWritten, naming the field."""
        written: dict[str, Any] = {tag: self.kind} if tag else {}
        for name, content in self.take(value).items():
            if content is None:
                continue
            try:
                told = self.fields[name].write(content)
            except NotWritten as error:
                raise NotWritten(f"{self.kind}.{name}: {error}") from None
            default = self.defaults.get(name)
            if (
                name == self.short
                or default is None
                or repr(self.fields[name].write(default)) != repr(told)
            ):  # −0.0 is not 0.0
                written[name] = told
        return written

    def schema(self, kinds: Schemas, tag: str = "kind", tagged: bool = False) -> Schema:
        """Return a reference to the schema of this kind, which is put into `kinds`; `tagged`: its kind has to be told."""
        package = self.build.__module__.partition(".")[0]
        name = self.kind if package == __package__.partition(".")[0] else f"{package}.{self.kind}"
        if name not in kinds:
            kinds[name] = {}  # a kind may hold its like
            fields = {
                field: {**form.schema(kinds), **self._notes(field)}
                for field, form in self.fields.items()
            }
            needed = [*([tag] if tagged else []), *self.needed]
            table: Schema = {
                "type": "object",
                "properties": {**({tag: {"const": self.kind}} if tag else {}), **fields},
            }
            table |= {"additionalProperties": False, **({"required": needed} if needed else {})}
            text = {"description": summary(self.build)} if summary(self.build) else {}
            kinds[name] = text | (
                {"anyOf": [table, self.fields[self.short].schema(kinds)]} if self.short else table
            )
        return {"$ref": f"#/$defs/{name}"}

    def _notes(self, field: str) -> Schema:
        """Return the meaning and the default of a field, as a schema tells them."""
        default = self.defaults.get(field)
        text = {"description": self.texts[field]} if field in self.texts else {}
        return text if default is None else {**text, "default": self.fields[field].write(default)}

    @cached_property
    def defaults(self) -> Mapping[str, Any]:
        """Defaults of the fields that need not be given."""
        parameters = inspect.signature(self.build).parameters
        made = {
            own.name: own.default_factory()
            for own in dataclass_fields(self.build)
            if callable(own.default_factory)
        }
        found = {
            name: made.get(name, parameters[name].default)
            for name in self.fields
            if name in parameters
        }
        return MappingProxyType(
            {name: default for name, default in found.items() if default is not _NOTHING}
        )

    @cached_property
    def needed(self) -> tuple[str, ...]:
        """Fields without a default."""
        parameters = inspect.signature(self.build).parameters
        return tuple(
            name
            for name in self.fields
            if name in parameters and parameters[name].default is _NOTHING
        )

    @cached_property
    def texts(self) -> Mapping[str, str]:
        """The meaning of each field, from the docstring."""
        told = [parameter_texts(source) for source in (*self.more, self.build)]
        return MappingProxyType(
            {name: text for texts in told for name, text in texts.items() if name in self.fields}
        )


def define(
    build: Callable[..., Any],
    fields: Mapping[str, Form] = MappingProxyType({}),
    *,
    kind: str = "",
    made: type | None = None,
    short: str = "",
    take: Callable[[Any], Mapping[str, Any]] | None = None,
    more: tuple[Callable[..., Any], ...] = (),
) -> Definition:
    """Define a kind of value: by default `build` is its class, whose name is the kind, and its attributes are the fields."""
    own = made or (build if isinstance(build, type) else None)
    attributes = take or (lambda value: {name: getattr(value, name) for name in fields})
    return Definition(
        build,
        MappingProxyType(dict(fields)),
        kind or getattr(build, "__name__", ""),
        own,
        short,
        attributes,
        more,
    )


@dataclass(frozen=True)
class Kind(Form):
    """A value of one of some kinds: a table whose key ``kind`` tells which, a word for a kind without more.

    Where there is only one, or `implied`, a table without the key is of the first.
    """

    definitions: tuple[Definition, ...]
    tag: str = "kind"
    implied: bool = False

    def read(self, item: Item, names: Names) -> Any:
        """Return the value."""
        if isinstance(item.value, str) and (item.value in self._kinds or not self._short):
            return self._find(item, item.value).read(Item({}, item.key, item.document), names)
        if isinstance(item.value, dict) and self.tag in item.value:
            tag = item.child(self.tag)
            return self._find(tag, tag.text("the name of a kind")).read(item, names, self.tag)
        if len(self.definitions) > 1 and not (self.implied and isinstance(item.value, dict)):
            wanted = f"a table with {self.tag} = one of {', '.join(self._kinds)}"
            raise item.error(
                f"has no {self.tag}: give {wanted}"
                if isinstance(item.value, dict)
                else f"is {shown(item.value)}: give {wanted}"
            )
        return self.definitions[0].read(item, names, self.tag)

    def write(self, value: Any) -> Any:
        """Return a table, or the word of a kind that needs no more."""
        for definition in self.definitions:
            if definition.made is not None and type(value) is definition.made:
                tagged = definition.write(value, self.tag if len(self.definitions) > 1 else "")
                if self._short and set(tagged) == {self._short}:
                    return tagged[self._short]
                return definition.kind if set(tagged) <= {self.tag} else tagged
        raise NotWritten(
            f"{shown(value)} is none of {', '.join(self._kinds)}: files hold these only"
        )

    def schema(self, kinds: Schemas) -> Schema:
        """Return all kinds, and their words."""
        several = len(self.definitions) > 1
        options = [
            definition.schema(kinds, self.tag, several and not (self.implied and k == 0))
            for k, definition in enumerate(self.definitions)
        ]
        words = [definition.kind for definition in self.definitions if not definition.needed]
        return {"anyOf": [*options, *([{"enum": words}] if words else [])]}

    @property
    def _kinds(self) -> list[str]:
        return [definition.kind for definition in self.definitions]

    @property
    def _short(self) -> str:
        return self.definitions[0].short if len(self.definitions) == 1 else ""

    def _find(self, item: Item, name: str) -> Definition:
        for definition in self.definitions:
            if definition.kind == name:
                return definition
        raise item.error(f"is {shown(name)}: {nearest(name, self._kinds)}")


def call(
    build: Callable[..., Any], item: Item, table: Mapping[str, Item], given: Mapping[str, Any]
) -> Any:
    """Return build(**given); a TypeError or ValueError becomes the error of the field that it names first. Raises SceneFileError."""
    try:
        return build(**given)
    except SceneFileError:
        raise
    except (TypeError, ValueError) as error:
        text = str(error)
        places = {
            name: found.start()
            for name in table
            if (found := re.search(rf"(?<!\w){re.escape(name)}(?!\w)", text))
        }
        where = table[min(places, key=lambda name: places[name])] if places else item
        raise where.error(text) from error


def dataclass_fields(build: Callable[..., Any]) -> tuple[Any, ...]:
    """Return the fields of a dataclass; none of any other call."""
    return fields(build) if is_dataclass(build) else ()


def summary(build: Callable[..., Any]) -> str:
    """Return the first line of a docstring."""
    return (inspect.getdoc(build) or "").partition("\n")[0]


def parameter_texts(build: Callable[..., Any]) -> dict[str, str]:
    """Return what a numpydoc docstring says of each parameter, in one line each."""
    section = re.search(
        r"^Parameters\n-+\n(.*?)(?=^\S[^\n]*\n---|\Z)",
        inspect.getdoc(build) or "",
        re.MULTILINE | re.DOTALL,
    )
    texts: dict[str, str] = {}
    names: list[str] = []
    for line in section[1].splitlines() if section else []:
        if line and not line.startswith(" "):
            names = [name.strip() for name in line.partition(" : ")[0].split(",")]
        elif line.strip():
            texts |= {name: f"{texts.get(name, '')} {line.strip()}".strip() for name in names}
    return texts
