"""All limits along a plan, symbolic and scaled: what programs and controllers impose, and reports list."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from ocp.problem.bounds.bound import PathBound, PathConstraint, RateBound
from ocp.problem.bounds.string_bounds import ForceDensityLimits, RestLengthLimits
from ocp.problem.control import winds
from ocp.problem.instant import symbolic
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from tenscasadi.util.validate import Array


def path_constraints(
    problem: Problem, kind: type[PathBound] | type[RateBound]
) -> list[PathConstraint]:
    """Return what the bounds of one kind limit, each under a name of its own.

    What several of them limit, such as the way of a bar round two obstacles, is called "obstacle
    clear of bar 0 (bounds[2])", after the bound's place in Problem.bounds.
    """
    decided = (
        RestLengthLimits if winds(problem.model) else ForceDensityLimits
    )  # which limit the unknowns themselves
    found = {
        k: bound.constraint(problem.model)
        for k, bound in enumerate(problem.bounds)
        if isinstance(bound, kind) and not isinstance(bound, decided)
    }
    times = Counter(name for one in found.values() for name in set(one.names))

    def told_apart(k: int, one: PathConstraint) -> PathConstraint:
        return replace(
            one,
            names=tuple(f"{name} (bounds[{k}])" if times[name] > 1 else name for name in one.names),
        )

    own = [_pulling(problem)] if kind is PathBound and winds(problem.model) else []
    return [*own, *(told_apart(k, one) for k, one in found.items() if one.names)]


def _pulling(problem: Problem) -> PathConstraint:
    """Return the limits of the force densities that follow from rest lengths: at least 0, as strings do not push."""
    now, (lower, upper) = symbolic(problem.model), problem.force_density_limits
    names = tuple(f"force density of string {k}" for k in range(len(lower)))
    return PathConstraint(
        now.force_density, lower, upper, names, "N/m", now.symbols, PathBound.ends
    )


@dataclass(frozen=True, eq=False)
class ScaledRows:
    """Rows lower ≤ function(symbols) ≤ upper of what is limited, divided by `scale`; symbols and ends as in `PathConstraint`."""

    function: ca.Function
    lower: Array
    upper: Array
    names: tuple[str, ...]
    ends: tuple[str, ...]
    scale: Array


def scaled_rows(
    problem: Problem, kind: type[PathBound] | type[RateBound], scales: Scales, strength: float
) -> list[ScaledRows]:
    """Return the path constraints of one kind as rows of order one. strength: a typical γ, N/m."""
    return [_scaled(one, scales, strength) for one in path_constraints(problem, kind)]


def _scaled(limited: PathConstraint, scales: Scales, strength: float) -> ScaledRows:
    scale = _row_scale(limited, scales, strength)
    function = ca.Function("bound", limited.symbols, [ca.densify(limited.value / ca.DM(scale))])
    return ScaledRows(
        function, limited.lower / scale, limited.upper / scale, limited.names, limited.ends, scale
    )


def _row_scale(limited: PathConstraint, scales: Scales, strength: float) -> Array:
    """Return the size that one row of each entry stands for: by its unit; of own constraints, which have none, by its limits."""
    sizes = {
        "N": strength * scales.length,
        "N/m": strength,
        "N/(m s)": strength / scales.time,
        **scales.units,
    }
    if limited.unit:
        return np.full(len(limited.names), sizes[limited.unit])
    ends = np.array([limited.lower, limited.upper])
    largest = np.max(np.where(np.isfinite(ends), np.abs(ends), 0.0), axis=0)
    return np.where(largest > 0, largest, 1.0)
