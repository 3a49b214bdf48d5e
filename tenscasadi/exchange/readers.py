"""Importers of other programs' files, by the ending of the file name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tenscasadi.exchange.matlab.structures import load_mat
from tenscasadi.exchange.mjcf import import_mjcf
from tenscasadi.exchange.ntrt.load import load_ntrt
from tenscasadi.scene.scene import Scene


def _import_mat(path: str, strict: bool, **_: Any) -> Scene:
    structure = load_mat(path, strict=strict)
    # in MATLAB's programs, nodes carry the mass of strings
    return Scene(structure, ends="lumped" if structure.string_mass.any() else "interior")


READERS: dict[str, Callable[..., Scene]] = {
    ".xml": lambda path, strict, **_: import_mjcf(path, strict=strict),
    ".mat": _import_mat,
    **dict.fromkeys((".yaml", ".yml"), lambda path, **own: Scene(load_ntrt(path, **own))),
}
