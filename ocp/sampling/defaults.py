"""Defaults of sampling: groups of strings, force densities to begin with, intervals, knots, steps."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from ocp.problem.costs import Prestress
from ocp.problem.problem import Problem
from tenscasadi.integrators.stability import lightest_mass
from tenscasadi.statics.force_density import EquilibriumError, equilibrium_force_density
from tenscasadi.util.validate import Array, per_item

ALIKE = 1e-3  # of the structure's size: lengths and heights that differ by less are the same
HOLDING = (
    2.0  # times the weight per length of a bar: the mean of force densities that hold a structure
)
RANGE, TIMES = (
    0.2,
    5.0,
)  # of the limits' range, and of the mean to begin with: the spread is the smaller
SWING = 0.6  # radians in an interval of what force densities to begin with let a node swing by
KNOTS = 3.0  # of splines in the time √(size/g) of a fall
LEAST_INTERVALS, MOST_INTERVALS, LEAST_KNOTS, MOST_KNOTS = 20, 400, 6, 24


class Usual(NamedTuple):
    """Beginnings of a motion: γ (α,) and how far it is changed (α,), N/m, the mass, kg, that a node moves with, and the time of a fall, s."""

    force_density: Array
    spread: Array
    mass: float
    fall: float

    @property
    def strength(self) -> float:
        """A typical γ, N/m."""
        return float(self.force_density.mean())

    def intervals(self, problem: Problem) -> int:
        """Return how many intervals resolve the swinging of nodes."""
        structure = problem.model.scene.structure
        ends = max(1.0, 2 * len(structure.strings) / len(structure.nodes))
        rate = np.sqrt(ends * self.strength / self.mass)
        return int(
            np.clip(np.ceil(problem.longest * rate / SWING), LEAST_INTERVALS, MOST_INTERVALS)
        )

    def knots(self, seconds: float) -> int:
        """Return how many knots a spline of this duration gets."""
        return int(np.clip(np.ceil(KNOTS * seconds / self.fall), LEAST_KNOTS, MOST_KNOTS))


def usual(problem: Problem) -> Usual:
    """Return the beginnings of the motions of a problem."""
    model, (lower, upper) = problem.model, problem.force_density_limits
    structure = model.scene.structure
    size = (
        float(structure.bar_lengths.mean())
        if len(structure.bars)
        else float(np.linalg.norm(np.ptp(structure.nodes, axis=0)))
    )
    weight = 0.0 if model.scene.gravity is None else float(ca.norm_2(model.scene.gravity.at(0.0)))
    pull = weight or size / problem.longest**2
    level = [cost.level for cost in problem.costs if isinstance(cost, Prestress)]
    if level:
        gamma = per_item("Prestress.level", level[0], model.nu)
    else:
        gamma = _self_stress(problem) * HOLDING * float(model.mechanism.M.sum()) * pull / size
    gamma = np.clip(gamma, lower, upper)
    mean = float(gamma.mean()) or 1.0
    room = np.where(np.isfinite(upper), RANGE * (upper - lower), np.inf)
    return Usual(
        gamma, np.minimum(room, TIMES * mean), lightest_mass(model), float(np.sqrt(size / pull))
    )


def _self_stress(problem: Problem) -> Array:
    """Return force densities (α,) of mean 1 that hold the start's shape by themselves; equal ones where none do."""
    structure = problem.model.scene.structure
    nodes = problem.model.nodes(problem.first_state)[: len(structure.nodes)]
    try:
        gamma = equilibrium_force_density(structure.replace(nodes=nodes), minimum=1.0)
    except (EquilibriumError, ValueError):
        return np.ones(problem.model.nu)
    return np.asarray(gamma / gamma.mean())


def alike(problem: Problem) -> tuple[tuple[int, ...], ...]:
    """Return the strings in groups: those of one length whose ends are equally high at the start, as symmetry about the vertical has it."""
    model, structure = problem.model, problem.model.scene.structure
    nodes = model.nodes(problem.first_state)[: len(structure.nodes)]
    down = (
        np.array([0.0, 0.0, -1.0])
        if model.scene.gravity is None
        else np.asarray(ca.DM(model.scene.gravity.at(0.0)).full()).ravel()
    )
    height = -nodes @ down / (np.linalg.norm(down) or 1.0)
    ends = np.sort(height[structure.strings], axis=1)
    length = np.linalg.norm(nodes[structure.strings[:, 1]] - nodes[structure.strings[:, 0]], axis=1)
    near = ALIKE * float(np.linalg.norm(np.ptp(nodes, axis=0)))
    found: list[tuple[Array, list[int]]] = []
    for string, values in enumerate(np.column_stack([length, ends])):
        for first, members in found:
            if np.abs(first - values).max() <= near:
                members.append(string)
                break
        else:
            found.append((values, [string]))
    return tuple(tuple(members) for _, members in found)
