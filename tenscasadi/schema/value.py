"""Value classes that register themselves: `class Smooth(StringLaw, kind="Smooth")`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any, ClassVar, TypeVar

T = TypeVar("T", bound=Callable[..., Any])


class Value:
    """Base of values that files hold.

    A direct subclass begins a family. A class with a `kind` is a member of its family. Files, their
    JSON Schema and their reference page include all members.

    Attributes
    ----------
    kind : str
        Name of the class in files; empty for classes that files do not hold.
    short : str
        Field that stands for the whole value where no other is given.
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

    @classmethod
    def maker(cls, function: T) -> T:
        """Register a function that builds values of this family.

        The name of the function is its ``kind`` in scene files.
        """
        _add(cls, function.__name__, function)
        return function

    @classmethod
    def from_fields(cls, **given: Any) -> Any:
        """Build a value from its fields by name."""
        return cls(**given)

    def to_fields(self) -> Mapping[str, Any]:
        """Return the fields by name, as `from_fields` takes them."""
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]


def _add(family: type[Value], kind: str, member: Callable[..., Any]) -> None:
    """Enter a member into its family.

    Raises TypeError if another one has its kind.
    """
    other = family.members.setdefault(kind, member)
    if other.__qualname__ != member.__qualname__ or other.__module__ != member.__module__:
        raise TypeError(
            f"kind {kind!r} is {other.__module__}.{other.__qualname__} already: give {member.__qualname__} another kind"
        )
    family.members[kind] = member
