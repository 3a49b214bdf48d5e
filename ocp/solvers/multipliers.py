"""Lagrange multipliers of limits and goals in physical units."""

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
    """Lagrange multipliers of an optimum.

    A dual is positive if an upper limit is active, and negative if a lower limit is active. If a limit or
    the value of a goal rises by δ, the optimal objective J changes by −λ δ to first order.

    Attributes
    ----------
    names : tuple of str
        Names of the m duals: path constraints and the motion, then goals, then the n unknowns of
        the program. Goals that bar lengths or momenta determine near the target are inequalities,
        such as "goal, AtRest: node 1 y".
    values : ndarray, shape (m,)
        Duals λ of J + Σ λ c, in units of J per unit of the constraint c (N/m, N, m, m/s). Duals of
        goals refer to the directions that bar lengths and momenta do not determine. Duals of defect
        constraints have the scale of their rows.
    point : ndarray, shape (n,)
        Unknowns at the optimum.

    Notes
    -----
    Finite differences of plans agree with duals if both plans are on one branch of optima. With a
    symmetry, several limits share one dual: move all images of a limit together, and start from
    `guess=plan` with ``Ipopt(warm_start=True)``. A plan from another guess may be a mirror image.

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
        return f"Duals({len(self.names)} duals, {len(self.point)} unknowns)"

    def __getitem__(self, name: str) -> Array:
        """Return the duals of a named constraint, in the order of time."""
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


def name_duals(program: Program, target: Target, w: Array, rows: Array, limits: Array) -> Duals:
    """Convert scaled duals to physical units, with names.

    `w` is the scaled solution of the program; `rows` are the duals of its constraints, and `limits`
    those of the bounds on variables. `target` converts duals of combined goal rows to those of the
    goals.
    """
    names, values = [], []
    for part in _find_parts(program, target):
        reduction = part.target.reduction
        names += [f"{part.label}{name}" for name in reduction.names]
        values.append(
            reduction.combinations.T @ rows[part.rows] * program.objective / reduction.sizes
        )
    rest = _find_rest(program)
    return Duals(
        (*(program.names[k] for k in rest.tolist()), *names, *program.w_names),
        np.concatenate(
            [
                (rows * program.objective / program.scale)[rest],
                *values,
                limits * program.objective / program.w_scale,
            ]
        ),
        w * program.w_scale,
    )


def warm_start_program(program: Program, target: Target, duals: Duals) -> Program:
    """Warm-start a program from the duals of an equal program.

    `target` combines duals of the goals to those of goal rows. If names differ, the program is
    returned unchanged.
    """
    rest, parts = _find_rest(program), _find_parts(program, target)
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
    """Goal constraints of a waypoint or of the end.

    Attributes
    ----------
    target : Target
        Their goals.
    label : str
        Beginning of their names.
    rows : slice
        Their positions among the constraints of the program.
    """

    target: Target
    label: str
    rows: slice


def _find_parts(program: Program, target: Target) -> list[_Part]:
    """Find the goal constraints of waypoints and end.

    `target` is that of the end, with those of the waypoints. Those of the end are last.
    """
    goals = [(waypoint.target, waypoint.label) for waypoint in target.waypoints] + [(target, "")]
    imposed = [(part, label) for part, label in goals if part.count]
    return [
        _Part(part, label, rows)
        for (part, label), rows in zip(imposed, program.rows("waypoint", "end"), strict=True)
    ]


def _find_rest(program: Program) -> Indices:
    """Find the indices of constraints that do not belong to goals."""
    goals = [np.arange(rows.start, rows.stop) for rows in program.rows("waypoint", "end")]
    return np.setdiff1d(
        np.arange(len(program.names)), np.concatenate([np.zeros(0, dtype=np.intp), *goals])
    )
