"""Multipliers of constraints by name: between the multipliers of a scaled program and those of limits and goals, in physical units."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import numpy as np

from ocp.targets.target import Target
from ocp.transcription.sparse_nlp import Program
from tenscasadi.schema.stored import Stored
from tenscasadi.util.validate import Array, Indices, instance


@dataclass(frozen=True, eq=False)
class Duals(Stored):
    """Multipliers of an optimum: how much each constraint costs.

    A multiplier is positive where an upper limit holds, negative where a lower one does. Where a
    limit, or the value that a goal wants, rises by δ, the least objective J changes by −λ δ, to
    first order. Finite differences of solved plans agree as long as both solutions lie on one
    branch of optima. Where problem and optimum have a symmetry, several limits share the price:
    moving one of them alone costs the sum of what its images pay, or breaks the symmetry, and a
    plan that is solved anew may come out mirrored, with its multipliers at other strings. Compare
    by moving all images of a limit together, from `guess=plan` with ``Ipopt(warm=True)``.

    Attributes
    ----------
    names : tuple of str
        Names of the m multipliers: path constraints and the motion, then goals, then the n unknowns
        of the program.
    values : ndarray, shape (m,)
        Multipliers λ of J + Σ λ c, with c what is limited: J per unit of what is limited (N/m, N,
        m, m/s), of goals per m or m/s, as far as bars and momenta let them give. Of the motion in
        the scale of its rows.
    point : ndarray, shape (n,)
        The unknowns at the optimum.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> plan = ocp.solve(ocp.Problem(model, goals=goals, costs=[ocp.Effort()]), ocp.Variational(6))
    >>> plan.duals["force density of string 0"].shape
    (6,)
    """

    names: Annotated[tuple[str, ...], "m", "U"]
    values: Annotated[Array, "m", "f"]
    point: Annotated[Array, "u", "f"]

    def __repr__(self) -> str:
        return f"Duals({len(self.names)} multipliers, {len(self.point)} unknowns)"

    def __getitem__(self, name: str) -> Array:
        """Return all multipliers of one name, in the order of time: duals["tension of string 3"]. Raises TypeError, KeyError."""
        instance(
            "Duals[name]", name, str, 'one of Duals.names, such as duals["tension of string 3"]'
        )
        found = [
            k for k, own in enumerate(self.names) if own == name or own.startswith(f"{name}, ")
        ]
        if not found:
            examples = sorted(
                {own.split(",")[0] for own in self.names if own.split(" ")[0] == name.split(" ")[0]}
            )
            raise KeyError(
                f"{name!r} has no multiplier: give "
                + (" or ".join(map(repr, examples[:3])) if examples else "one of Duals.names")
            )
        return np.asarray(self.values[found])


def named_duals(program: Program, target: Target, w: Array, rows: Array, limits: Array) -> Duals:
    """Return the multipliers of an optimum w by name, from the scaled ones of rows and of w's limits; `target` is what is imposed."""
    names, values = [], []
    for part in _parts(program, target):
        reduction = part.target.reduction
        names += [f"{part.label}{name}" for name in reduction.names]
        values.append(
            reduction.combinations.T @ rows[part.rows] * program.objective / reduction.sizes
        )
    rest = _rest(program)
    return Duals(
        (*(program.names[k] for k in rest), *names, *program.w_names),
        np.concatenate(
            [
                (rows * program.objective / program.scale)[rest],
                *values,
                limits * program.objective / program.w_scale,
            ]
        ),
        w * program.w_scale,
    )


def warm_started(program: Program, target: Target, duals: Duals) -> Program:
    """Return the program that starts where another of the same unknowns and constraints ended; as it is where they are others."""
    rest, parts = _rest(program), _parts(program, target)
    goals = [f"{part.label}{name}" for part in parts for name in part.target.reduction.names]
    if duals.names != (*(program.names[k] for k in rest), *goals, *program.w_names):
        return program
    values, count = duals.values / program.objective, len(program.w_names)
    rows = np.zeros(len(program.names))
    rows[rest] = values[: len(rest)] * program.scale[rest]
    place = len(rest)
    for part in parts:
        reduction = part.target.reduction
        own = values[place : place + len(reduction.sizes)] * reduction.sizes
        rows[part.rows] = np.linalg.lstsq(reduction.combinations.T, own)[0]
        place += len(own)
    return replace(
        program,
        first=duals.point / program.w_scale,
        multipliers=(rows, values[len(values) - count :] * program.w_scale),
    )


class _Part(NamedTuple):
    target: Target
    label: str
    rows: slice


def _parts(program: Program, target: Target) -> list[_Part]:
    """Return the targets of waypoints and of the end, and where their rows stand."""
    goals = [(waypoint.target, waypoint.label) for waypoint in target.waypoints] + [(target, "")]
    imposed = [(part, label) for part, label in goals if part.count]
    return [
        _Part(part, label, rows)
        for (part, label), rows in zip(imposed, program.rows("waypoint", "end"), strict=True)
    ]


def _rest(program: Program) -> Indices:
    """Return the rows that are not of goals."""
    goals = [np.arange(rows.start, rows.stop) for rows in program.rows("waypoint", "end")]
    return np.setdiff1d(
        np.arange(len(program.names)), np.concatenate([np.zeros(0, dtype=np.intp), *goals])
    )
