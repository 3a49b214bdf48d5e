"""Fields of values are checked by their annotations."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from typing import Annotated, Any

import numpy as np
import pytest

import ocp
import tenscasadi
from tenscasadi.schema.field_types import VECTOR
from tenscasadi.schema.value import Value, check_fields
from tenscasadi.util.validate import Boolean, Count, NonNegative, Positive, positive_each


@dataclasses.dataclass(frozen=True)
class Example(Value):
    """A value of a test."""

    size: Positive = 1.0
    offset: NonNegative | None = None
    count: Count = 1
    flagged: Boolean = False
    place: Annotated[Any, VECTOR] = (0.0, 0.0, 0.0)
    limits: Annotated[Any, positive_each("entry", infinite=True)] = None


@dataclasses.dataclass(frozen=True)
class Other(Example):
    """Its fields are those of its base, and one that is no type."""

    size: Positive | None = 2.0
    more: Unknown = None  # type: ignore[name-defined]  # noqa: F821


def test_clean_values_are_kept():
    value = Example(np.float64(2), None, np.int64(3), np.True_, [1, 2, 3], [np.inf, 1])
    assert (value.size, value.count, value.flagged) == (2.0, 3, True)
    assert type(value.count) is int
    assert isinstance(value.place, np.ndarray)
    assert not value.place.flags.writeable
    assert value.limits == [np.inf, 1]


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ({"size": 0}, ValueError, r"Example\.size is 0: it must be greater than 0"),
        ({"size": None}, TypeError, r"Example\.size"),
        ({"offset": -1}, ValueError, r"Example\.offset is -1: it must be at least 0"),
        ({"count": 1.5}, TypeError, r"Example\.count is 1\.5: give a whole number"),
        ({"flagged": 1}, TypeError, r"Example\.flagged is 1: give True or False"),
        ({"place": (0, 1)}, ValueError, r"Example\.place has shape \(2,\)"),
        ({"limits": [1, -np.inf]}, ValueError, r"Example\.limits\[1\] is -inf"),
    ],
)
def test_bad_values_are_rejected_by_their_field(given, error, message):
    with pytest.raises(error, match=message):
        Example(**given)


def test_a_subclass_with_unknown_types_keeps_the_checks_of_its_base():
    with pytest.raises(ValueError, match=r"Other\.offset is -1"):
        Other(offset=-1)


def modules() -> Iterator[Any]:
    for package in (tenscasadi, ocp):
        for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if not found.name.endswith("__main__"):
                yield importlib.import_module(found.name)


def test_annotations_of_all_checked_classes_are_known():
    # a name that only type checkers know would leave the fields unchecked
    checked = [
        kind
        for module in modules()
        for kind in vars(module).values()
        if isinstance(kind, type)
        and dataclasses.is_dataclass(kind)
        and kind.__module__ == module.__name__
        and (issubclass(kind, Value) or check_fields.__name__ in vars(module))
        and kind is not ocp.Problem  # its own function checks its arguments
    ]
    assert len(checked) > 80
    for kind in checked:
        inspect.get_annotations(kind, eval_str=True)
