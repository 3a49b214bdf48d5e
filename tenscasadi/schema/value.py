"""Base class of objects that scene files hold, with registration by kind.

An example is `class Smooth(StringLaw, kind="Smooth")`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import fields
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, TypeVar, Union, get_args, get_origin

T = TypeVar("T", bound=Callable[..., Any])


class Value:
    """Base class of immutable objects that scene files hold.

    A direct subclass begins a family. A class with a `kind` is a member of its family. Files, their
    JSON Schema and their reference page include all members.

    Attributes
    ----------
    kind : str
        Name of the class in files; empty for classes that files do not hold.
    short : str
        Field that stands for the whole object if no other is given.
    implied : str
        Kind of a table that does not name one.
    earlier_names : mapping of str to str
        Earlier names of fields, which files may still use, and their present names.
    members : dict
        Members of the family by kind: classes, and functions that build values.
    earlier_kinds : dict
        Earlier names of kinds, which files may still use, and their present names.
    """

    kind: ClassVar[str] = ""
    short: ClassVar[str] = ""
    implied: ClassVar[str] = ""
    earlier_names: ClassVar[Mapping[str, str]] = {}
    members: ClassVar[dict[str, Callable[..., Any]]] = {}
    earlier_kinds: ClassVar[dict[str, str]] = {}

    def __init_subclass__(
        cls, *, kind: str = "", short: str = "", implied: str = "", earlier: str = "", **more: Any
    ) -> None:
        super().__init_subclass__(**more)
        if Value in cls.__bases__:
            cls.members, cls.earlier_kinds, cls.short, cls.implied = {}, {}, short, implied
        cls.kind, cls.short = kind, short or cls.short
        if kind:
            _add(cls, kind, cls)
        if earlier:
            cls.earlier_kinds[earlier] = kind

    def __post_init__(self) -> None:
        """Check the fields by their annotations."""
        check_fields(self)

    @classmethod
    def maker(cls, function: T) -> T:
        """Register a function that builds objects of this family.

        The name of the function is its ``kind`` in scene files.
        """
        _add(cls, function.__name__, function)
        return function

    @classmethod
    def from_fields(cls, **given: Any) -> Any:
        """Build an object from its fields by name."""
        return cls(**given)

    def to_fields(self) -> Mapping[str, Any]:
        """Return the fields by name, as `from_fields` takes them."""
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]


def _add(family: type[Value], kind: str, member: Callable[..., Any]) -> None:
    """Add a class or function to a family.

    `member` is this class or function, and `kind` its name in files. Raises TypeError if another
    one has its kind.
    """
    other = family.members.setdefault(kind, member)
    if other.__qualname__ != member.__qualname__ or other.__module__ != member.__module__:
        raise TypeError(
            f"kind {kind!r} is {other.__module__}.{other.__qualname__} already: give {member.__qualname__} another kind"
        )
    family.members[kind] = member


def check_fields(value: Any, public: bool = True) -> None:
    """Check and convert the fields of a dataclass by its annotations.

    Entries of an annotation that have a method `check`, such as `Check` and `FieldType`, are
    applied in their order. None is not checked where it is the default, or in the annotation.
    Messages name the class only if it is `public`. `value` is the object, whose fields are replaced
    by converted values.
    """
    owner = f"{type(value).__name__}." if public else ""
    for name, (optional, checks) in _find_checks(type(value)).items():  # type: ignore[arg-type]  # classes hash
        given = getattr(value, name)
        if given is not None or not optional:
            for check in checks:
                given = check(f"{owner}{name}", given)
            object.__setattr__(value, name, given)


@cache
def _find_checks(kind: type) -> dict[str, tuple[bool, list[Callable[[str, Any], Any]]]]:
    """Find the checks of each field of a class, `kind`.

    Returns for each field whether it may be None, and its checks.
    """
    hints: dict[str, Any] = {}
    for base in reversed(kind.__mro__):
        with suppress(NameError):  # a user's class may name types of type checkers alone
            hints |= inspect.get_annotations(base, eval_str=True)
    found = {}
    for field in fields(kind):
        entries = list(_list_entries(hints.get(field.name)))
        own = [e.check for e in entries if hasattr(e, "check") and not isinstance(e, type)]
        if own:
            found[field.name] = NoneType in entries or field.default is None, own
    return found


def _list_entries(hint: Any) -> Iterator[Any]:
    """Yield the types and metadata of an annotation, `hint`.

    Unions and ``Annotated`` are divided into their parts.
    """
    if get_origin(hint) is Annotated:
        kind, *entries = get_args(hint)
        yield from (*_list_entries(kind), *entries)
    elif get_origin(hint) in (Union, UnionType):
        for kind in get_args(hint):
            yield from _list_entries(kind)
    else:
        yield hint
