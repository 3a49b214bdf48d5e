"""Base class of `Model`, for modules that must not import it."""

from __future__ import annotations

from typing import Any

from tenscasadi.util.validate import instance


class BaseModel:
    """Base class of `Model`, for type checks."""


def check_model(model: Any, field: str = "model") -> None:
    """Raise TypeError unless a value is a `Model`.

    The message names `field`, the argument that has the value.
    """
    instance(field, model, BaseModel, "a tenscasadi.Model")
