"""File formats of classes, derived from annotations, defaults and docstrings."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import cache
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    NamedTuple,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from tenscasadi.schema.field_types import (
    NUMBER,
    SPAN,
    WHOLE,
    WHOLES,
    ElsewhereInFile,
    FieldType,
    Flag,
    InPython,
    ListOf,
    Numbers,
    Schema,
    Schemas,
    Word,
)
from tenscasadi.schema.reading import Item, Names, NotWritten, call, nearest
from tenscasadi.schema.value import Value
from tenscasadi.util.validate import format_value


class Field(NamedTuple):
    """Field of a class: type, default and description in files.

    `default` is MISSING for required fields, and `text` is the description.
    """

    type: FieldType
    default: Any = MISSING
    text: str = ""

    def write_default(self) -> list[Any]:
        """Convert the default value to its form in files.

        The result is a list with this entry, empty if there is no default.
        """
        none = self.default is None or self.default is MISSING
        return [] if none else [self.type.write(self.default)]


@dataclass(frozen=True)
class Definition:
    """File format of a class: its fields and their types.

    Parameters
    ----------
    build : callable
        Class or function that builds a value.
    fields : mapping of str to Field
        Fields by name.
    kind : str
        Name in files.
    tag : str
        Key of the kind in tables; empty for tables that have none.
    """

    build: Callable[..., Any]
    fields: Mapping[str, Field]
    kind: str
    tag: str = ""

    @property
    def short(self) -> str:
        """Field that stands for the whole object if given alone."""
        return str(getattr(self.build, "short", ""))

    @property
    def needed(self) -> list[str]:
        """Names of the required fields."""
        return [name for name, field in self._in_files() if field.default is MISSING]

    def _in_files(self) -> list[tuple[str, Field]]:
        own = self.fields.items()
        return [(name, field) for name, field in own if not isinstance(field.type, InPython)]

    def read(self, item: Item, **more: Any) -> Any:
        """Read an object from a table of a file, `item`.

        `more` are fields from other tables. Raises SceneFileError.
        """
        if self.short and not isinstance(item.value, dict):
            table = {self.short: item}
        else:
            table = item.table(f"a table with {', '.join(self.fields) or self.tag}")
            table.pop(self.tag, None)
        given = self.read_fields(table) | more
        for name in self.needed:
            if name not in given:
                text = self.fields[name].text or "which it needs"
                raise item.error(f"{self.kind} has no {name}: give {name}, {text}")
        return call(getattr(self.build, "from_fields", self.build), item, table, given)

    def read_fields(self, table: Mapping[str, Item]) -> dict[str, Any]:
        """Read the fields of a table by name.

        `table` has the entries of a file by name. Raises SceneFileError.
        """
        known, earlier = dict(self._in_files()), getattr(self.build, "earlier_names", {})
        named = {earlier.get(name, name): item for name, item in table.items()}
        for name, item in named.items():
            if name not in known:
                raise item.error(f"is no field of {self.kind}: {nearest(name, known)}")
        return {name: known[name].type.read(item) for name, item in named.items()}

    def write(self, value: Any) -> dict[str, Any]:
        """Convert an object to a table without its default values.

        Raises NotWritten.
        """
        written: dict[str, Any] = {self.tag: self.kind} if self.tag else {}
        own = value.to_fields() if isinstance(value, Value) else value
        for name, field in self.fields.items():
            content = own.get(name)
            if content is None or isinstance(field.type, ElsewhereInFile):
                continue
            try:
                text, usual = field.type.write(content), field.write_default()
            except NotWritten as error:
                raise NotWritten(f"{self.kind}.{name}: {error}") from None
            # by repr: −0.0 is not 0.0
            if name == self.short or repr([text]) != repr(usual):
                written[name] = text
        return written

    def schema(self, kinds: Schemas, tagged: bool = False) -> Schema:
        """Add the JSON Schema to `kinds`, and return a reference to it.

        `kinds` are the definitions of the schema by name. Tables that are `tagged` have to name
        their kind.
        """
        name = _schema_name(self.build, self.kind)
        if name not in kinds:
            kinds[name] = {}  # a kind may hold its like
            own = {field: _field_schema(known, kinds) for field, known in self._in_files()}
            needed = [*([self.tag] if tagged else []), *self.needed]
            table: Schema = {
                "type": "object",
                "properties": {**({self.tag: {"const": self.kind}} if self.tag else {}), **own},
                "additionalProperties": False,
                **({"required": needed} if needed else {}),
            }
            short = [self.fields[self.short].type.schema(kinds)] if self.short else []
            text = _summary(self.build)
            kinds[name] = {"description": text, **({"anyOf": [table, *short]} if short else table)}
        return {"$ref": f"#/$defs/{name}"}


def _schema_name(build: Callable[..., Any], kind: str) -> str:
    package = build.__module__.partition(".")[0]
    return kind if package == __package__.partition(".")[0] else f"{package}.{kind}"


def _summary(build: Callable[..., Any]) -> str:
    return (inspect.getdoc(build) or "").partition("\n")[0]


def _field_schema(field: Field, kinds: Schemas) -> Schema:
    text = {"description": field.text} if field.text else {}
    usual = [{"default": default} for default in field.write_default()]
    return {**field.type.schema(kinds), **text, **(usual[0] if usual else {})}


@cache
def definition(
    build: Callable[..., Any],
    kind: str = "",
    tag: str = "",
    types: tuple[tuple[str, FieldType], ...] = (),
) -> Definition:
    """Derive the file format of a class or function.

    `build` is this class or function. Its tables in files have the key `tag` with the value `kind`;
    no such key if `tag` is "". `kind` is by default the attribute of this name, or else the name of
    the class. `types` are the field types by name, which replace the annotations.
    """
    known, texts = dict(types), parameter_texts(build)
    hints = {} if known else get_type_hints(build, include_extras=True)
    own = {
        name: Field(
            known.get(name) or field_type(hints[name], f"{build.__name__}.{name}"),
            default,
            texts.get(name, ""),
        )
        for name, default in _defaults(build)
    }
    return Definition(build, own, kind or getattr(build, "kind", "") or build.__name__, tag)


def _defaults(build: Callable[..., Any]) -> Iterator[tuple[str, Any]]:
    if is_dataclass(build):
        for field in fields(build):
            made = field.default_factory
            yield field.name, field.default if made is MISSING else made()
        return
    for name, parameter in inspect.signature(build).parameters.items():
        if parameter.kind is not parameter.VAR_KEYWORD:
            yield name, MISSING if parameter.default is parameter.empty else parameter.default


_TYPES: Mapping[Any, FieldType] = {
    **{float: NUMBER, int: WHOLE, bool: Flag(), str: Word()},
    **{float | tuple[float, float]: SPAN, int | Sequence[int]: WHOLES},
}
_LISTS = (Sequence, Iterable, list, tuple)


def field_type(hint: Any, name: str) -> FieldType:
    """Derive the type of the field `name` from its annotation `hint`.

    Raises TypeError if that is impossible.
    """
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        given = [entry for entry in inner[1:] if isinstance(entry, FieldType)]
        return given[0] if given else field_type(inner[0], name)
    if hint in _TYPES:
        return _TYPES[hint]
    if isinstance(hint, type) and issubclass(hint, Value):
        return OneOf(hint)
    if origin is Literal:
        return Word(inner)
    if origin in (Union, UnionType):
        own = [each for each in inner if each is not NoneType]
        if len(own) < len(inner):
            return field_type(Union[tuple(own)], name)  # noqa: UP007  of any number of types
        if len(own) == 2 and get_origin(own[1]) in _LISTS and get_args(own[1]) == (own[0],):
            return ListOf(field_type(own[0], name), single=True)
    elif origin is tuple and set(inner) == {float}:
        return Numbers(((len(inner),),))
    elif origin in _LISTS and len([each for each in inner if each is not ...]) == 1:
        return Numbers(((None,),)) if inner[0] is float else ListOf(field_type(inner[0], name))
    cure = "annotate it with a field type, such as Annotated[Any, Numbers(((3,),))]"
    raise TypeError(f"{name} is of type {format_value(hint)}: {cure}")


@dataclass(frozen=True)
class OneOf(FieldType):
    """Field type of an object of any class of a family.

    In files it is a table with the key ``kind``, or the kind alone. A table without the key is of
    the only kind, or of the implied one.
    """

    family: type[Value]

    @property
    def definitions(self) -> Mapping[str, Definition]:
        """File formats of the classes of the family, by kind."""
        return {
            kind: definition(own, kind, "kind")  # type: ignore[arg-type]  # functions and classes hash
            for kind, own in sorted(self.family.members.items())
            if not isinstance(own, type) or issubclass(own, self.family)
        }

    def read(self, item: Item) -> Any:
        """Read an object of any class of the family.

        `item` is its entry in a file.
        """
        known, value = self.definitions, item.value
        alone = next(iter(known.values())) if len(known) == 1 else known.get(self.family.implied)
        short = alone is not None and alone.short
        if isinstance(value, dict) and "kind" in value:
            word, rest = item.child("kind"), item
        elif isinstance(value, str) and (value in known or not short):
            word, rest = item, item._replace(value={})
        elif alone and (len(known) == 1 or isinstance(value, dict)):
            return alone.read(item)
        else:
            state = "has no kind" if isinstance(value, dict) else f"is {format_value(value)}"
            raise item.error(f"{state}: give a table with kind = one of {', '.join(known)}")
        given = word.text("the name of a kind")
        kind = self.family.earlier_kinds.get(given, given)
        if kind not in known:
            raise word.error(f"is {format_value(kind)}: {nearest(kind, known)}")
        return known[kind].read(rest)

    def write(self, value: Any) -> Any:
        """Convert an object to a table for a file.

        It becomes its kind alone if that is sufficient.
        """
        known = self.definitions
        own = known.get(getattr(type(value), "kind", ""))
        if own is None or own.build is not type(value):
            raise NotWritten(
                f"{format_value(value)} is none of {', '.join(known)}: files hold these only"
            )
        table = own.write(value)
        if len(known) == 1:
            del table["kind"]
            if own.short and set(table) == {own.short}:
                return table[own.short]
        return table if set(table) - {"kind"} else own.kind

    def schema(self, kinds: Schemas) -> Schema:
        """Add the JSON Schemas of all classes of the family to `kinds`."""
        known, name = (
            self.definitions,
            _schema_name(self.family, self.family.__name__.removeprefix("Named")),
        )
        words = [kind for kind, own in known.items() if not own.needed]
        if len(known) == 1:
            table = next(iter(known.values())).schema(kinds)
            return {"anyOf": [table, {"enum": words}]} if words else table
        if name not in kinds:
            kinds[name] = {}  # a kind may hold its like
            tables = [own.schema(kinds, kind != self.family.implied) for kind, own in known.items()]
            many = {"type": "object", "discriminator": {"propertyName": "kind"}, "oneOf": tables}
            options = [many, *([{"enum": words}] if words else [])]
            kinds[name] = {"description": _summary(self.family), "anyOf": options}
        return {"$ref": f"#/$defs/{name}"}

    def resolve(self, field: str, value: Any, names: Names) -> Any:
        """Replace names by indices in the fields of an object.

        See `FieldType.resolve`.
        """
        return resolve_names(value, names)


T = TypeVar("T")


def resolve_names(value: T, names: Names) -> T:
    """Replace names by indices in the fields of an object, `value`.

    They are `names` of nodes, bars and strings of a structure. Objects without names are returned
    unchanged. Raises TypeError, ValueError.
    """
    kinds = [own for own in type(value).__mro__ if issubclass(own, Value) and own.kind]
    if not isinstance(value, Value) or not kinds:
        return value
    given = value.to_fields()
    own = definition(kinds[0], kinds[0].kind, "kind")  # type: ignore[arg-type]  # classes hash
    changed = resolve_fields(own, given, names)
    return value.from_fields(**{**given, **changed}) if changed else value


def resolve_fields(own: Definition, given: Mapping[str, Any], names: Names) -> dict[str, Any]:
    """Replace names of items by indices in field values.

    `own` is the format of the object, `given` are its field values by name, and `names` those of
    nodes, bars and strings. Returns the fields that change.
    """
    found = {
        name: field.type.resolve(f"{own.kind}.{name}", given[name], names)
        for name, field in own.fields.items()
        if name in given
    }
    return {name: value for name, value in found.items() if value is not given[name]}


def parameter_texts(build: Callable[..., Any]) -> dict[str, str]:
    """Extract the parameter descriptions from a numpydoc docstring.

    The docstring is that of `build`. Returns the descriptions by parameter.
    """
    section = re.search(
        r"^Parameters\n-+\n(.*?)(?=^\S[^\n]*\n---|\Z)",
        inspect.getdoc(build) or "",
        re.MULTILINE | re.DOTALL,
    )
    texts: dict[str, str] = {}
    names: list[str] = []
    for line in section[1].splitlines() if section else []:
        if line and not line.startswith(" "):
            names = [name.strip(" *") for name in line.partition(" : ")[0].split(",")]
        elif line.strip():
            texts |= {name: f"{texts.get(name, '')} {line.strip()}".strip() for name in names}
    return texts
