"""Between the multipliers of a scaled program and those of limits and goals, in physical units."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ocp.boundary.target import Target
from ocp.solvers.duals import Duals
from ocp.transcription.variables import Program
from tenscasadi.util.validate import Array


def duals_of(program: Program, target: Target, w: Array, rows: Array, limits: Array) -> Duals:
    """The multipliers of an optimum w by name, from the scaled ones of rows and of w's limits; `target` is what is imposed."""
    names, values = [], []
    for part in _parts(program, target):
        combinations, own, sizes = part.target.combined
        names += [f"{part.label}{name}" for name in own]
        values.append(combinations.T @ rows[part.rows] * program.objective / sizes)
    rest = _rest(program)
    return Duals(
        (*(program.names[k] for k in rest), *names, *program.w_names),
        np.concatenate([(rows * program.objective / program.scale)[rest], *values, limits * program.objective / program.w_scale]),
        w * program.w_scale,
    )


def started(program: Program, target: Target, duals: Duals) -> Program:
    """The program that starts where another of the same unknowns and constraints ended; as it is where they are others."""
    rest, parts = _rest(program), _parts(program, target)
    goals = [f"{part.label}{name}" for part in parts for name in part.target.combined.names]
    if duals.names != (*(program.names[k] for k in rest), *goals, *program.w_names):
        return program
    values, count = duals.values / program.objective, len(program.w_names)
    rows = np.zeros(len(program.names))
    rows[rest] = values[: len(rest)] * program.scale[rest]
    place = len(rest)
    for part in parts:
        combinations, _, sizes = part.target.combined
        own = values[place : place + len(sizes)] * sizes
        rows[part.rows] = np.linalg.lstsq(combinations.T, own)[0]
        place += len(sizes)
    return replace(program, first=duals.point / program.w_scale, multipliers=(rows, values[len(values) - count :] * program.w_scale))


class _Part(NamedTuple):
    target: Target
    label: str
    rows: Array


def _parts(program: Program, target: Target) -> list[_Part]:
    """The targets of waypoints and of the end, and where their rows stand."""
    found = [(stop.target, stop.label, f"goal of waypoint {k},") for k, stop in enumerate(target.stops)]
    return [
        _Part(part, label, np.array([k for k, name in enumerate(program.names) if name.startswith(prefix)], dtype=np.intp))
        for part, label, prefix in [*found, (target, "", "goal,")]
        if part.count
    ]


def _rest(program: Program) -> list[int]:
    return [k for k, name in enumerate(program.names) if not name.startswith(("goal,", "goal of waypoint"))]
