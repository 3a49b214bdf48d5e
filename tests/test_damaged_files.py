"""Files with bits turned, cut off or numbers changed: each kind is refused with a reason, or loads as something that can be used."""

from __future__ import annotations

import random
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from costly_calls import short_plan
from ensemble_calls import many
from public_calls import table, trajectory

import ocp
import tenscasadi as tc

KINDS: dict[str, tuple[Callable[[], Any], Callable[[Path], Any]]] = {
    "trajectory": (trajectory, tc.Trajectory.load),
    "trade-off": (table, tc.Tradeoff.load),
    "plan": (short_plan, ocp.Plan.load),
    "rollouts": (many, tc.Rollouts.load),
}
NUMBERS = {
    "i": [0, -1, 10**5, 10**9, 2**62],
    "f": [np.nan, np.inf, -1.0, 0.0, 1e300, 1e-300, 1e9],
    "b": [True, False],
}


def use(loaded: Any) -> None:
    """What a user would do with it first."""
    repr(loaded)
    loaded.summary()
    if isinstance(loaded, ocp.Plan) and loaded.success and loaded.model is not None:
        loaded.replay()


def check(path: Path, load: Callable[[Path], Any], what: object) -> None:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            use(load(path))
    except ValueError as error:
        assert f"{path.name} is not a " in str(error), (what, error)  # noqa: PT017  most damages load
    except Exception as error:
        raise AssertionError(what) from error


def damaged(draw: random.Random, whole: bytes) -> bytes:
    """Bits turned anywhere, a byte changed near the end, where an archive has its table of contents, or the end cut off."""
    content = bytearray(whole)
    way = draw.randrange(3)
    if way == 0:
        return bytes(content[: draw.randrange(len(content))])
    for _ in range(draw.choice([1, 3, 20])):
        place = (
            draw.randrange(len(content))
            if way == 1
            else len(content) - draw.randrange(1, min(len(content), 6000))
        )
        content[place] ^= 1 << draw.randrange(8)
    return bytes(content)


def changed(
    draw: random.Random, arrays: dict[str, np.ndarray]
) -> tuple[dict[str, np.ndarray], object]:
    """One field with another number, another shape or other text, or lost."""
    name = draw.choice([name for name in arrays if name != "format"])
    value, way = np.array(arrays[name]), draw.randrange(5)
    if way == 0:
        return {key: entry for key, entry in arrays.items() if key != name}, (name, "lost")
    if way == 1:
        shapes = [value[None], value[..., :-1] if value.ndim else np.zeros(3), np.zeros(0)]
        return arrays | {name: draw.choice(shapes)}, (name, "shape")
    if value.dtype.kind == "U":
        text = str(value) if value.ndim == 0 else ""
        place = draw.randrange(len(text) + 1)
        return arrays | {
            name: np.asarray(text[:place] + draw.choice('0e9"{},:-[]') + text[place + 1 :])
        }, (name, "text", place)
    if value.size and value.dtype.kind in NUMBERS:
        place, number = draw.randrange(value.size), draw.choice(NUMBERS[value.dtype.kind])
        value.flat[place] = (
            np.clip(number, np.iinfo(value.dtype).min, np.iinfo(value.dtype).max)
            if value.dtype.kind == "i"
            else number
        )
        return arrays | {name: value}, (name, place, number)
    return arrays, "nothing"


def damage(kind: str, count: int, tmp_path: Path) -> None:
    make, load = KINDS[kind]
    draw, path = random.Random(1), tmp_path / "file.npz"
    make().save(path)
    whole = path.read_bytes()
    with np.load(path) as archive:
        arrays = dict(archive)
    for _ in range(count):
        path.write_bytes(damaged(draw, whole))
        check(path, load, "bits")
        content, what = changed(draw, arrays)
        np.savez(path, **content)
        check(path, load, what)


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_are_refused_or_of_use(kind: str, tmp_path: Path) -> None:
    damage(kind, 25, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_hundreds_of_damaged_files_are_refused_or_of_use(kind: str, tmp_path: Path) -> None:
    damage(kind, 300, tmp_path)
