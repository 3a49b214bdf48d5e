"""Value classes that register themselves: `class Smooth(StringLaw, kind="Smooth")`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any, ClassVar, TypeVar

T = TypeVar("T", bound=Callable[..., Any])


class Value:
    """Base of values that files hold.

    A class right below this one begins a family. Every class that names its `kind` becomes a member
    of its family, and files, their JSON Schema and their reference page know it.

    Attributes
    ----------
    kind : str
        Name of the class in files; empty for classes that files do not hold.
    short : str
        Field that stands for the whole value where no other is given.
    implied : str
        Kind of a table that does not name one.
    earlier_names : mapping of str to str
        Names of fields in earlier versions, which files may still use, and those of today.
    members : dict
        Members of the family by kind: classes, and functions that make values.
    """

    kind: ClassVar[str] = ""
    short: ClassVar[str] = ""
    implied: ClassVar[str] = ""
    earlier_names: ClassVar[Mapping[str, str]] = {}
    members: ClassVar[dict[str, Callable[..., Any]]] = {}

    def __init_subclass__(
        cls, *, kind: str = "", short: str = "", implied: str = "", **more: Any
    ) -> None:
        super().__init_subclass__(**more)
        if Value in cls.__bases__:
            cls.members, cls.short, cls.implied = {}, short, implied
        cls.kind, cls.short = kind, short or cls.short
        if kind:
            _add(cls, kind, cls)

    @classmethod
    def maker(cls, function: T) -> T:
        """Register a function that makes values of this family; its name is the kind."""
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
    """Enter a member into its family. Raises TypeError where another one has its kind."""
    other = family.members.setdefault(kind, member)
    if other.__qualname__ != member.__qualname__ or other.__module__ != member.__module__:
        raise TypeError(
            f"kind {kind!r} is {other.__module__}.{other.__qualname__} already: give {member.__qualname__} another kind"
        )
    family.members[kind] = member
