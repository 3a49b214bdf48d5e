"""A start that is found with the plan: rows that keep its bars, and rows of a motion that ends as it began.

Bars are kept by the motion once the start keeps them: their rows are imposed there alone. Where both ends keep them, and what strings
cannot change is the same at both, the rows of "end = start" repeat each other: with Z a basis of what bars and momenta leave free,
Zᵀ (x − x₀) is left.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from ocp.boundary.invariants import Invariant, UnreachableGoal, invariants
from ocp.boundary.row_reduction import Combined, RowFunction, reduce_rows
from ocp.problem.goals import Rows, rows_of
from ocp.problem.problem import Problem
from tenscasadi.util.validate import Array

FALLS = 1e-6  # m/s: what momenta change by beyond that is no rounding


@dataclass(frozen=True, eq=False)
class Cycle:
    """Rows of a free start x₀ and of the end x.

    start: Function x₀ → independent rows: bars, and what the start has to meet. repeats: Function (x₀, x) → independent rows, zero where the end
    repeats the start. misfit: Function (x₀, x) → (metres, metres per second) in each of `names`. repeated: rows left out, by what
    repeats them; combined: what `repeats` consists of.
    """

    start: ca.Function
    repeats: ca.Function
    misfit: ca.Function
    names: tuple[str, ...]
    repeated: dict[str, int]
    combined: Combined


def find_cycle(problem: Problem, length: float, time: float, scale: Array) -> Cycle | None:
    """The rows of a free start, None where it is given. length, time, scale (nx,): sizes of rows, m and s, and of the state.

    Raises `UnreachableGoal` where the motion cannot repeat, as all of the structure falls.
    """
    if not problem.free_start:
        return None
    model, near = problem.model, problem.first_state
    structure = model.scene.structure
    first, last = ca.SX.sym("x0", model.nx), ca.SX.sym("x", model.nx)
    sizes = {"m": length, "m/s": length / time, "m²/s": length**2 / time, "s": time}

    def scaled(group: Invariant) -> tuple[Any, RowFunction]:
        units = np.array([sizes[unit] for unit in group.units])
        return group.value / ca.DM(units), RowFunction(first, group.value, units, scale)

    groups = {group.kind: group for group in invariants(model, near, first, ca.SX(problem.shortest))}
    rows, kept = [], []
    if "bar" in groups:
        value, function = scaled(groups["bar"])
        kept.append(("bar", function(near)[1]))
        rows.append(ca.mtimes(ca.DM(reduce_rows(kept[0][1], []).combinations), value))
    N0, V0 = model.nodes(first), model.velocities(first)
    met = _Stack([part for goal in problem.start_goals for part in rows_of(goal, structure, N0, V0)], length, length / time)
    if met.names:
        wanted = reduce_rows(RowFunction(first, met.value, met.sizes, scale)(near)[1], kept)
        rows.append(ca.mtimes(ca.DM(wanted.combinations), met.value / ca.DM(met.sizes)))

    if "momentum" in groups and problem.repeating:
        momentum = groups["momentum"]
        speeds = [k for k, unit in enumerate(momentum.units) if unit != "m"]  # places of the centre of mass follow from its speed at the start
        group = replace(
            momentum, value=momentum.value[speeds], names=tuple(momentum.names[k] for k in speeds), units=tuple(momentum.units[k] for k in speeds)
        )
        value, function = scaled(group)
        change = np.abs(np.asarray(ca.Function("change", [first], [value])(near).full()).ravel())
        if change.max(initial=0.0) > FALLS:
            name = group.names[int(np.argmax(change))]
            raise UnreachableGoal(f"Periodic cannot be met, as {name} whatever the strings do: give a scene with a ground, or pin a node")
        kept.append(("momentum", function(near)[1]))

    before = N0[:, : len(structure.nodes)].T, V0[:, : len(structure.nodes)].T
    N, V = model.nodes(last), model.velocities(last)
    repeats = _Stack([part for goal in problem.repeating for part in rows_of(replace(goal, start=before), structure, N, V)], length, length / time)
    reduction = reduce_rows(RowFunction(last, ca.substitute(repeats.value, first, ca.DM(near)), repeats.sizes, scale)(near)[1], kept)
    combinations = ca.mtimes(ca.DM(reduction.combinations), repeats.value / ca.DM(repeats.sizes))
    return Cycle(
        ca.Function("start", [first], [ca.densify(ca.vertcat(ca.SX(0, 1), *rows))]),
        ca.Function("repeats", [first, last], [ca.densify(combinations)]),
        ca.Function("misfit", [first, last], [repeats.metres, repeats.speeds]),
        repeats.names,
        reduction.repeated,
        Combined(reduction.combinations, repeats.names, repeats.sizes),
    )


class _Stack:
    """Rows of goals, those in m before those in m/s."""

    def __init__(self, rows: list[Rows], metre: float, speed: float) -> None:
        self.metres, self.speeds = (ca.vertcat(ca.SX(0, 1), *(part.value for part in rows if part.speed is kind)) for kind in (False, True))
        self.value = ca.vertcat(self.metres, self.speeds)
        self.names = tuple(name for kind in (False, True) for part in rows if part.speed is kind for name in part.names)
        self.sizes = np.concatenate([np.full(self.metres.shape[0], metre), np.full(self.speeds.shape[0], speed)])
