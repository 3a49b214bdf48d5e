"""What a simulation returns: motion, forces, energies and errors over time, kept in .npz files."""

from __future__ import annotations

import os
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tenscasadi.util import archive
from tenscasadi.util.validate import Array, Indices

_FORMAT = "tenscasadi trajectory 1"


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A motion of n nodes, β bars and α strings at T saved times. Arrays are read-only; SI units.

    time (T,) s; nodes (T, n, 3) m; velocities (T, n, 3) m/s; force_density (T, α) N/m and tension (T, α) N of the strings;
    energy (T,) J in total and energy_parts (T, 3) kinetic, elastic, gravity;
    energy_error (T,) J: what the total gained beyond the work of all forces and of changes of the control, so an error of the numerics
    (NaN where it was not computed); bar_length_error (T,): the largest |length − l| / l; joint_error (T,) m: the largest gap of a joint;
    correction_shift (T,) m and correction_energy (T,) J: how far the correction after the step that starts here moves a node, and what it adds to
    the energy (0 without correction, NaN for schemes that take their own steps: how long the step before a correction was is not kept);
    states (T, nx) and control (T, nu) of the model: a row's control acts from that row's time on (in the last row: until that time);
    bars (β, 2), strings (α, 2) and pinned (any,): node indices; success and message tell how the run ended, interrupted whether from the
    keyboard; step s, in the mean; attempts: steps computed, with those that error control rejected or took to locate events (0: not
    counted); seconds: wall time of the time loop; compiled: whether it ran as machine code.
    """

    time: Array
    nodes: Array
    velocities: Array
    force_density: Array
    tension: Array
    energy: Array
    energy_parts: Array
    energy_error: Array
    bar_length_error: Array
    joint_error: Array
    correction_shift: Array
    correction_energy: Array
    states: Array
    control: Array
    bars: Indices
    strings: Indices
    pinned: Indices
    success: bool
    message: str
    step: float
    seconds: float
    compiled: bool
    attempts: int = 0
    interrupted: bool = False

    def __post_init__(self) -> None:
        _check({field.name: getattr(self, field.name) for field in fields(self)})
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                view = value.view()
                view.flags.writeable = False
                object.__setattr__(self, field.name, view)

    def __repr__(self) -> str:
        return f"Trajectory({len(self.time)} rows, {self.nodes.shape[1]} nodes, t = {self.time[0]:g} … {self.time[-1]:g} s, success={self.success})"

    def summary(self) -> str:
        """How the run went, its errors and its speed, as a few lines of text."""
        steps = round((self.time[-1] - self.time[0]) / self.step)
        rate = f" ({steps / self.seconds:,.0f} steps/s)" if self.seconds > 0 else ""
        tried = f" by {self.attempts} attempts" if self.attempts > steps else ""
        way = ("compiled" if self.compiled else "not compiled") + (", interrupted" if self.interrupted else "")
        lines = [
            f"{self.message}",
            f"time          {self.time[0]:g} … {self.time[-1]:g} s, {steps} steps of {self.step:g} s{tried}, {len(self.time)} rows kept",
            f"wall time     {self.seconds:.3g} s{rate}, {way}",
            f"energy        {self.energy[0]:.6g} → {self.energy[-1]:.6g} J, largest error {_largest(self.energy_error, 'J')}",
            f"bar lengths   largest relative error {_largest(self.bar_length_error)}",
            f"joints        largest gap {_largest(self.joint_error, 'm')}",
        ]
        if np.any(self.correction_shift > 0):
            lines.append(
                f"correction    moves a node by {_largest(self.correction_shift, 'm')} and adds {_largest(self.correction_energy, 'J')} at most"
            )
        elif np.any(np.isnan(self.correction_shift)):
            lines.append("correction    what it does is not measured for schemes that take their own steps")
        if self.tension.size:
            lines.append(f"tension       {self.tension.min():.4g} … {self.tension.max():.4g} N")
        return "\n".join(lines)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes a compressed .npz file (NumPy arrays only) to exactly `path` and returns it. Raises OSError when it cannot be written."""
        content = {field.name: np.asarray(getattr(self, field.name)) for field in fields(self)}
        return archive.save(path, _FORMAT, content)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Trajectory:
        """The trajectory saved in `path`. No code in the file is ever run.

        Raises FileNotFoundError, and ValueError naming the file and the field for one that cannot be read or is no trajectory.
        """
        return archive.load(path, _FORMAT, "trajectory", Trajectory.from_arrays, Trajectory.__dataclass_fields__)

    @staticmethod
    def from_arrays(content: dict[str, Any]) -> Trajectory:
        """The trajectory whose fields are these arrays, by name; those with a default may be missing. ValueError naming what is wrong."""
        given = {}
        for field in fields(Trajectory):
            if field.name in content:
                given[field.name] = content[field.name]
            elif field.default is MISSING:
                raise ValueError(f"it has no field {field.name!r}")
            else:
                given[field.name] = np.asarray(field.default)
        _check(given)
        return Trajectory(**{name: value.item() if value.ndim == 0 else value for name, value in given.items()})


# The shape of each field by the letters of the class's description, and the kind of its numbers (NumPy's letters; i: also small integers).
_SHAPES: dict[str, tuple[str, str]] = {
    "time": ("T", "f"),
    "nodes": ("Tn3", "f"),
    "velocities": ("Tn3", "f"),
    "force_density": ("Tα", "f"),
    "tension": ("Tα", "f"),
    "energy": ("T", "f"),
    "energy_parts": ("T3", "f"),
    "energy_error": ("T", "f"),
    "bar_length_error": ("T", "f"),
    "joint_error": ("T", "f"),
    "correction_shift": ("T", "f"),
    "correction_energy": ("T", "f"),
    "states": ("Tx", "f"),
    "control": ("Tu", "f"),
    "bars": ("β2", "i"),
    "strings": ("α2", "i"),
    "pinned": ("p", "i"),
    "success": ("", "b"),
    "message": ("", "U"),
    "step": ("", "f"),
    "seconds": ("", "f"),
    "compiled": ("", "b"),
    "attempts": ("", "i"),
    "interrupted": ("", "b"),
}


def _check(content: dict[str, Any]) -> None:
    """ValueError naming the first field whose kind, shape or indices do not fit the others."""
    sizes: dict[str, int] = {"2": 2, "3": 3}
    for name, (letters, kind) in _SHAPES.items():
        value = np.asarray(content[name])
        if value.dtype.kind != kind:
            raise ValueError(f"field {name!r} holds values of type {value.dtype}")
        if value.ndim != len(letters) or any(sizes.setdefault(letter, size) != size for letter, size in zip(letters, value.shape, strict=True)):
            raise ValueError(f"field {name!r} has shape {value.shape}, which does not fit the others")
    if sizes["T"] < 1:
        raise ValueError("field 'time' is empty")
    for name in ("bars", "strings", "pinned"):
        indices: NDArray[Any] = np.asarray(content[name])
        if indices.size and not 0 <= indices.min() <= indices.max() < sizes["n"]:
            raise ValueError(f"field {name!r} holds indices outside 0 … {sizes['n'] - 1}")


def _largest(errors: Array, unit: str = "") -> str:
    known = np.abs(errors[np.isfinite(errors)])
    return f"{known.max():.2g} {unit}".strip() if known.size else "not computed"
