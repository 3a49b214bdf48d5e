"""Results that contain their scene."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from tenscasadi.io.document import format_tables, read_tables
from tenscasadi.io.scene_files import read_scene, write_scene
from tenscasadi.scene.samples import sample_functions
from tenscasadi.scene.scene import Scene
from tenscasadi.schema.reading import Document, NotWritten
from tenscasadi.schema.stored import Stored
from tenscasadi.util.archive import Fields
from tenscasadi.util.validate import Array

Own = TypeVar("Own", bound="SceneResult")


class SceneResult(Stored):
    """Base class of results that contain their scene.

    Files contain its functions of time as samples.

    Attributes
    ----------
    states : ndarray, shape (..., nx)
        States of the model; the last entry is the clock, if there is one.
    scene : Scene or None
        The scene; None if a file does not contain it.
    sampled : tuple of str
        Fields of the scene that were functions of time before they were saved.
    """

    states: Array
    scene: Scene | None
    sampled: tuple[str, ...]

    def _write_values(self) -> dict[str, str]:
        own = self._sample()
        with suppress(NotWritten):  # classes of users
            if own.scene is not None:
                more = {"sampled": list(own.sampled)} if own.sampled else {}
                return {"scene": format_tables(more | write_scene(own.scene))}
        return {}

    @classmethod
    def _read_values(cls, content: Fields, given: Mapping[str, Any]) -> dict[str, Any]:
        if "scene" not in content:
            return {}
        return read_tables("scene", content["scene"], _read_scene)

    def __getstate__(self) -> dict[str, Any]:
        return vars(self._sample())  # other processes cannot get functions of Python

    def _sample(self: Own) -> Own:
        """Replace functions of time in the scene by their samples."""
        if self.scene is None or not self.scene.has_clock:
            return self
        clock = self.states[..., -1].ravel()
        try:
            scene, sampled = sample_functions(self.scene, np.unique(clock[np.isfinite(clock)]))
        except (TypeError, ValueError):  # a function that cannot be sampled
            return replace(self, scene=None)  # type: ignore[type-var]  # results are dataclasses
        return replace(self, scene=scene, sampled=sampled or self.sampled) if sampled else self  # type: ignore[type-var]


def _read_scene(document: Document) -> dict[str, Any]:
    sampled = document.root.table().get("sampled")
    names = tuple(item.text() for item in sampled.entries()) if sampled else ()
    return {"scene": read_scene(document), "sampled": names}


def format_largest(errors: Array, unit: str = "") -> str:
    """Format the largest known error for a summary.

    `unit` follows the number. NaN and inf are ignored. Without another error the text is "not
    computed".
    """
    known = np.abs(errors[np.isfinite(errors)])
    return f"{known.max():.2g} {unit}".strip() if known.size else "not computed"
