"""Default parameters of the random search."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from ocp.problem.costs import Prestress
from ocp.problem.problem import Problem
from ocp.problem.rows import RESOLUTION
from tenscasadi.integrators.stability import lightest_mass
from tenscasadi.statics.force_density import EquilibriumError, equilibrium_force_density
from tenscasadi.structure.class_one import distances, measure_diagonal
from tenscasadi.util.validate import Array, per_item


class SamplingDefaults(NamedTuple):
    """Default parameters of the random search.

    Attributes
    ----------
    force_density : ndarray, shape (α,)
        Initial force densities [N/m].
    spread : ndarray, shape (α,)
        Standard deviations of the random changes [N/m].
    mass : float
        Effective mass of a node [kg].
    fall : float
        Free-fall time over the structure's size [s].
    """

    force_density: Array
    spread: Array
    mass: float
    fall: float

    @property
    def strength(self) -> float:
        """Mean initial force density [N/m]."""
        return float(self.force_density.mean())

    def intervals(self, problem: Problem) -> int:
        """Choose the number of intervals.

        The fastest vibration has a phase of 0.6 rad in each.
        """
        rate = np.sqrt(count_strings_per_node(problem) * self.strength / self.mass)
        return int(np.clip(np.ceil(problem.longest * rate / 0.6), 20, 400))

    def knots(self, seconds: float) -> int:
        """Choose the number of spline knots, three per free-fall time.

        `seconds` is the duration of the spline.
        """
        return int(np.clip(np.ceil(3 * seconds / self.fall), 6, 24))


def count_strings_per_node(problem: Problem) -> float:
    """Compute the mean number of strings at a node, at least 1."""
    structure = problem.model.scene.structure
    return max(1.0, 2 * len(structure.strings) / len(structure.nodes))


def choose_defaults(problem: Problem) -> SamplingDefaults:
    """Choose the parameters of the random search for a problem."""
    model, (lower, upper) = problem.model, problem.force_density_limits
    structure = model.scene.structure
    size = (
        float(structure.bar_lengths.mean())
        if len(structure.bars)
        else measure_diagonal(structure.nodes)
    )
    weight = 0.0 if model.scene.gravity is None else float(ca.norm_2(model.scene.gravity.at(0.0)))
    pull = weight or size / problem.longest**2
    level = [cost.level for cost in problem.costs if isinstance(cost, Prestress)]
    if level:
        gamma = per_item("Prestress.level", level[0], model.nu)
    else:
        # about twice the force densities that hold the weight
        gamma = 2 * _find_self_stress(problem) * float(model.mechanism.M.sum()) * pull / size
    gamma = np.clip(gamma, lower, upper)
    mean = float(gamma.mean()) or 1.0
    room = np.where(np.isfinite(upper), 0.2 * (upper - lower), np.inf)
    return SamplingDefaults(
        gamma, np.minimum(room, 5 * mean), lightest_mass(model), float(np.sqrt(size / pull))
    )


def _find_self_stress(problem: Problem) -> Array:
    """Find a self-stress as force densities (α,) with mean 1."""
    structure = problem.model.scene.structure
    nodes = problem.model.nodes(problem.initial_state)[: len(structure.nodes)]
    try:
        gamma = equilibrium_force_density(structure.replace(nodes=nodes), minimum=1.0)
    except (EquilibriumError, ValueError):
        return np.ones(problem.model.nu)
    return np.asarray(gamma / gamma.mean())


def find_symmetry_groups(
    problem: Problem, end: Array, tolerance: float
) -> tuple[tuple[int, ...], ...]:
    """Find groups of strings by the symmetry of start and goals.

    The strings of a group have equal initial lengths, and ends of equal initial heights. If the
    target state `end` (nx,) is farther than the tolerance [m] to the side of the start, its
    direction breaks the symmetry about the vertical: the ends are also equally far along it.
    """
    model, structure = problem.model, problem.model.scene.structure
    nodes, last = (
        model.nodes(state)[: len(structure.nodes)] for state in (problem.initial_state, end)
    )
    down = (
        np.array([0.0, 0.0, -1.0])
        if model.scene.gravity is None
        else ca.DM(model.scene.gravity.at(0.0)).full().ravel()
    )
    down /= np.linalg.norm(down) or 1.0
    moved = (last - nodes).mean(axis=0)
    aside = moved - (moved @ down) * down
    if np.linalg.norm(aside) <= tolerance:
        aside[:] = 0.0
    ends = [
        np.sort((nodes @ along)[structure.strings], axis=1)
        for along in (-down, aside / (np.linalg.norm(aside) or 1.0))
    ]
    length = distances(nodes, structure.strings)
    near = RESOLUTION * measure_diagonal(nodes)
    found: list[tuple[Array, list[int]]] = []
    for string, values in enumerate(np.column_stack([length, *ends])):
        for first, members in found:
            if np.abs(first - values).max() <= near:
                members.append(string)
                break
        else:
            found.append((values, [string]))
    return tuple(tuple(members) for _, members in found)
