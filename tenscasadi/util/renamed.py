"""Lazy imports, and deprecated names with a warning."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterable, Mapping
from functools import wraps
from importlib import import_module
from importlib.util import LazyLoader, find_spec, module_from_spec
from typing import Any, TypeVar

_Function = TypeVar("_Function", bound=Callable[..., Any])


def find_attribute(
    package: str, modules: Mapping[str, Iterable[str]], renamed: Mapping[str, str]
) -> Callable[[str], Any]:
    """Build a package's `__getattr__` for lazy imports.

    Deprecated names warn.

    Parameters
    ----------
    package : str
        Name of the package.
    modules : mapping of str to iterable of str
        Names by module. A module is imported at the first use of one of its names.
    renamed : mapping of str to str
        New names by deprecated name.
    """
    places = {name: module for module, names in modules.items() for name in names}

    def find(name: str) -> Any:
        if name in renamed:
            message = f"{package}.{name} is deprecated: use {package}.{renamed[name]}"
            warnings.warn(message, DeprecationWarning, stacklevel=2)
            return getattr(import_module(package), renamed[name])
        if name not in places:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(places[name]), name)
        setattr(import_module(package), name, value)
        return value

    return find


def lazy_module(name: str) -> Any:
    """Import a module whose code runs only at its first use.

    `name` is its full name. Raises ModuleNotFoundError.
    """
    if name in sys.modules:
        return sys.modules[name]
    spec = find_spec(name)
    if spec is None or spec.loader is None:
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)
    spec.loader = LazyLoader(spec.loader)
    module = sys.modules[name] = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class RenamedAttribute:
    """Deprecated name of an attribute or method, which warns.

    It returns the attribute `new` of the same object.
    """

    def __init__(self, new: str) -> None:
        self.new = new

    def __set_name__(self, owner: type, name: str) -> None:
        self.message = f"{owner.__name__}.{name} is deprecated: use {self.new}"

    def __get__(self, instance: Any, owner: type | None = None) -> Any:
        if instance is None:
            return self
        warnings.warn(self.message, DeprecationWarning, stacklevel=2)
        return getattr(instance, self.new)


def rename_keywords(**names: str) -> Callable[[_Function], _Function]:
    """Decorate a function to accept deprecated keywords.

    `names` are pairs old="new". A deprecated keyword causes a warning.
    """

    def decorate(function: _Function) -> _Function:
        @wraps(function)
        def call(*arguments: Any, **keywords: Any) -> Any:
            for old, new in names.items():
                if old in keywords:
                    name = function.__qualname__.removesuffix(".__init__")
                    message = f"{name}({old}=) is deprecated: use {new}="
                    if new in keywords:
                        raise TypeError(f"{message}, and leave {old} out")
                    warnings.warn(message, DeprecationWarning, stacklevel=2)
                    keywords[new] = keywords.pop(old)
            return function(*arguments, **keywords)

        return call  # type: ignore[return-value]

    return decorate


_Class = TypeVar("_Class", bound=type)


def rename_fields(**names: str) -> Callable[[_Class], _Class]:
    """Decorate a dataclass to accept deprecated field names.

    `names` are pairs old="new". A deprecated name causes a warning. Files may use both; see
    `tenscasadi.schema.value.Value.earlier_names`.
    """

    def decorate(kind: _Class) -> _Class:
        made: Any = kind
        made.earlier_names = names
        made.__init__ = rename_keywords(**names)(made.__init__)
        for old, new in names.items():
            attribute = RenamedAttribute(new)
            attribute.__set_name__(made, old)
            setattr(made, old, attribute)
        return kind

    return decorate
