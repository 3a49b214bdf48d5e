"""Definitions of values: fields and their forms from a class or a function, its types and its docstring."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import cache, cached_property
from types import MappingProxyType, NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from tenscasadi.schema.containers import ListOf
from tenscasadi.schema.forms import (
    NUMBER,
    WHOLE,
    Flag,
    Form,
    InPython,
    Numbers,
    Schema,
    Schemas,
    ToldApart,
    Wholes,
    Word,
)
from tenscasadi.schema.reading import Item, Names, NotWritten, call, nearest
from tenscasadi.schema.value import Value
from tenscasadi.util.validate import shown


@dataclass(frozen=True)
class Definition:
    """A kind of value: its class or function, and the form of each field.

    Attributes
    ----------
    build : callable
        Class or function that makes a value.
    fields : mapping of str to Form
        Forms of the fields by name.
    kind : str
        Name in files.
    short : str
        Field that stands for the whole table where it is no table.
    more : tuple of callable
        Further objects whose docstrings explain fields.
    """

    build: Callable[..., Any]
    fields: Mapping[str, Form]
    kind: str
    short: str = ""
    more: tuple[Callable[..., Any], ...] = ()

    def read(self, item: Item, names: Names, tag: str | None = None) -> Any:
        """Read a table; `tag` is the key of its kind, if any. Raises SceneFileError."""
        if self.short and not isinstance(item.value, dict):
            return self.make(
                item, {self.short: item}, {self.short: self.fields[self.short].read(item, names)}
            )
        table = item.table(f"a table with {', '.join(self.fields) or tag}")
        if tag is not None:
            table.pop(tag, None)
        earlier = getattr(self.build, "earlier_names", {})
        table = {earlier.get(name, name): entry for name, entry in table.items()}
        return self.make(item, table, self.read_fields(table, names))

    def read_fields(self, table: Mapping[str, Item], names: Names) -> dict[str, Any]:
        """Read the fields of a table by name. Raises SceneFileError."""
        for name, item in table.items():
            if name not in self.fields:
                raise item.error(f"is no field of {self.kind}: {nearest(name, self.fields)}")
        return {name: self.fields[name].read(item, names) for name, item in table.items()}

    def make(self, item: Item, table: Mapping[str, Item], given: Mapping[str, Any]) -> Any:
        """Build the value from its fields; errors name the place of the field. Raises SceneFileError."""
        for name in self.needed:
            if name not in given:
                raise item.error(
                    f"{self.kind} has no {name}: give {name}, {self.texts.get(name, 'which it needs')}"
                )
        return call(getattr(self.build, "from_fields", self.build), item, table, given)

    def write(self, value: Any, tag: str = "") -> dict[str, Any]:
        """Write a value as a table without its defaults; `tag` is the key of its kind, if any. Raises NotWritten."""
        written: dict[str, Any] = {tag: self.kind} if tag else {}
        own = (
            value.to_fields()
            if isinstance(value, Value)
            else value
            if isinstance(value, Mapping)
            else vars(value)
        )
        for name, form in self.all_fields.items():
            content, default = own.get(name), self.defaults.get(name)
            if content is None or isinstance(form, ToldApart):
                continue
            try:
                told = form.write(content)
                # by repr: −0.0 is not 0.0
                plain = default is None or repr(form.write(default)) != repr(told)
            except NotWritten as error:
                raise NotWritten(f"{self.kind}.{name}: {error}") from None
            if name == self.short or plain:
                written[name] = told
        return written

    def schema(self, kinds: Schemas, tag: str = "kind", tagged: bool = False) -> Schema:
        """Refer to the JSON Schema of this kind, which enters `kinds`; `tagged`: the table has to name its kind."""
        package = self.build.__module__.partition(".")[0]
        name = self.kind if package == __package__.partition(".")[0] else f"{package}.{self.kind}"
        if name not in kinds:
            kinds[name] = {}  # a kind may hold its like
            told = {
                field: {**form.schema(kinds), **self._notes(field)}
                for field, form in self.fields.items()
            }
            needed = [*([tag] if tagged else []), *self.needed]
            table: Schema = {
                "type": "object",
                "properties": {**({tag: {"const": self.kind}} if tag else {}), **told},
            }
            table |= {"additionalProperties": False, **({"required": needed} if needed else {})}
            text = {"description": summary(self.build)} if summary(self.build) else {}
            kinds[name] = text | (
                {"anyOf": [table, self.fields[self.short].schema(kinds)]} if self.short else table
            )
        return {"$ref": f"#/$defs/{name}"}

    def _notes(self, field: str) -> Schema:
        """Return the meaning and the default of a field for its JSON Schema."""
        default = self.defaults.get(field)
        text = {"description": self.texts[field]} if field in self.texts else {}
        return text if default is None else {**text, "default": self.fields[field].write(default)}

    @cached_property
    def all_fields(self) -> Mapping[str, Form]:
        """The fields with those that no file holds."""
        return {
            **(_forms(self.build, apart=True) if is_dataclass(self.build) else {}),
            **self.fields,
        }

    @cached_property
    def defaults(self) -> Mapping[str, Any]:
        """Defaults of the fields."""
        return MappingProxyType(dict(_defaults(self.build)))

    @cached_property
    def needed(self) -> tuple[str, ...]:
        """Fields without a default."""
        known = inspect.signature(self.build).parameters
        return tuple(name for name in self.fields if name in known and name not in self.defaults)

    @cached_property
    def texts(self) -> Mapping[str, str]:
        """The meaning of each field, from the docstrings."""
        told = [parameter_texts(source) for source in (*self.more, self.build)]
        return MappingProxyType(
            {name: text for texts in told for name, text in texts.items() if name in self.fields}
        )


@cache
def definition(build: Callable[..., Any], kind: str = "") -> Definition:
    """Derive the definition of a dataclass or a function; by default its kind is its name."""
    return Definition(
        build,
        MappingProxyType(_forms(build)),
        kind or getattr(build, "kind", "") or build.__name__,
        getattr(build, "short", ""),
    )


def _forms(build: Callable[..., Any], apart: bool = False) -> dict[str, Form]:
    """Return the forms of the fields that files hold, or of those that they do not."""
    names = (
        [field.name for field in fields(build)]
        if is_dataclass(build)
        else [
            name
            for name, parameter in inspect.signature(build).parameters.items()
            if parameter.kind is not parameter.VAR_KEYWORD
        ]
    )
    hints = get_type_hints(build, include_extras=True)
    forms = {name: form_of(hints[name], f"{build.__name__}.{name}") for name in names}
    return {
        name: form
        for name, form in forms.items()
        if isinstance(form, (InPython, ToldApart)) is apart
    }


def _defaults(build: Callable[..., Any]) -> Iterable[tuple[str, Any]]:
    if not is_dataclass(build):
        for name, parameter in inspect.signature(build).parameters.items():
            if parameter.default is not parameter.empty:
                yield name, parameter.default
        return
    for field in fields(build):
        if field.default is not MISSING:
            yield field.name, field.default
        elif field.default_factory is not MISSING:
            yield field.name, field.default_factory()


_PLAIN: Mapping[Any, Form] = {float: NUMBER, int: WHOLE, bool: Flag(), str: Word()}
_LISTS = (Sequence, Iterable, list, tuple)


def form_of(hint: Any, name: str) -> Form:
    """Derive the form of a field from its type. Raises TypeError naming the field where a form has to be given."""
    given = [entry for entry in get_args(hint)[1:] if isinstance(entry, Form)]
    if get_origin(hint) is Annotated:
        return given[0] if given else form_of(get_args(hint)[0], name)
    if hint in _PLAIN:
        return _PLAIN[hint]
    if isinstance(hint, type) and issubclass(hint, Value):
        return OneOf(hint)
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Literal:
        return Word(inner)
    if origin in (Union, UnionType):
        own = [each for each in inner if each is not NoneType]
        if len(own) == 1:
            return form_of(own[0], name)
        if own == [float, tuple[float, float]]:
            return Numbers(((), (2,)))
        if len(own) == 2 and get_origin(own[1]) in _LISTS and get_args(own[1]) == (own[0],):
            return (
                Wholes(lists=True) if own[0] is int else ListOf(form_of(own[0], name), single=True)
            )
    elif origin is tuple and set(inner) == {float}:
        return Numbers(((len(inner),),))
    elif origin in _LISTS and len([each for each in inner if each is not ...]) == 1:
        return Numbers(((None,),)) if inner[0] is float else ListOf(form_of(inner[0], name))
    raise TypeError(
        f"{name} is of type {shown(hint)}: annotate it with a form, such as Annotated[Any, Numbers(((3,),))]"
    )


@dataclass(frozen=True)
class OneOf(Form):
    """A value of a family: a table whose key ``kind`` names the class, a word for a kind without more.

    Where there is only one, or the family has an implied kind, a table without the key is of that.
    """

    base: type[Value]
    tag: str = "kind"

    @property
    def definitions(self) -> Mapping[str, Definition]:
        """Definitions of the members of the family, by kind."""
        return {
            kind: definition(member, kind)  # type: ignore[arg-type]  # functions and classes hash
            for kind, member in sorted(self.base.members.items())
            if not isinstance(member, type) or issubclass(member, self.base)
        }

    def read(self, item: Item, names: Names) -> Any:
        """Read the value."""
        known, short = self.definitions, self._short
        if isinstance(item.value, str) and (item.value in known or not short):
            return self._find(item, item.value).read(Item({}, item.key, item.document), names)
        if isinstance(item.value, dict) and self.tag in item.value:
            tag = item.child(self.tag)
            return self._find(tag, tag.text("the name of a kind")).read(item, names, self.tag)
        if len(known) == 1:
            return next(iter(known.values())).read(item, names, self.tag)
        if isinstance(item.value, dict) and self.base.implied:
            return known[self.base.implied].read(item, names, self.tag)
        wanted = f"a table with {self.tag} = one of {', '.join(known)}"
        raise item.error(
            f"has no {self.tag}: give {wanted}"
            if isinstance(item.value, dict)
            else f"is {shown(item.value)}: give {wanted}"
        )

    def write(self, value: Any) -> Any:
        """Write a table, or the word of a kind that needs no more."""
        known = self.definitions
        own = known.get(getattr(type(value), "kind", ""))
        if own is None or own.build is not type(value):
            raise NotWritten(f"{shown(value)} is none of {', '.join(known)}: files hold these only")
        tagged = own.write(value, self.tag if len(known) > 1 else "")
        if self._short and set(tagged) == {self._short}:
            return tagged[self._short]
        return own.kind if set(tagged) <= {self.tag} else tagged

    def schema(self, kinds: Schemas) -> Schema:
        """Return all kinds, told apart by their key, and their words."""
        known = self.definitions
        words = [kind for kind, own in known.items() if not own.needed]
        if len(known) == 1:
            (own,) = known.values()
            return {"anyOf": [own.schema(kinds, self.tag), *([{"enum": words}] if words else [])]}
        several: Schema = {
            "type": "object",
            "discriminator": {"propertyName": self.tag},
            "oneOf": [
                own.schema(kinds, self.tag, kind != self.base.implied)
                for kind, own in known.items()
            ],
        }
        return {"anyOf": [several, {"enum": words}]} if words else several

    @property
    def _short(self) -> str:
        known = self.definitions
        return next(iter(known.values())).short if len(known) == 1 else ""

    def _find(self, item: Item, name: str) -> Definition:
        known = self.definitions
        if name not in known:
            raise item.error(f"is {shown(name)}: {nearest(name, known)}")
        return known[name]


def summary(build: Callable[..., Any]) -> str:
    """Return the first line of a docstring."""
    return (inspect.getdoc(build) or "").partition("\n")[0]


def parameter_texts(build: Callable[..., Any]) -> dict[str, str]:
    """Read the text of each parameter in a numpydoc docstring, in one line each."""
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
