"""Path constraints of a plan, built from its bounds.

Nonlinear programs and controllers impose them, and reports list them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from ocp.problem.bounds.bound import Bound, PathBound, PathConstraint, RateBound
from ocp.problem.bounds.string_bounds import (
    ForceDensityLimits,
    RestLengthLimits,
    RestLengthRateLimits,
    TensionLimits,
)
from ocp.problem.constraints import build_constraint
from ocp.problem.control import controls_force_densities, has_elastic_strings
from ocp.problem.instant import Instant, symbolic
from tenscasadi.dynamics.model import Model
from tenscasadi.scene.strings import ForceDensity, RestLength, Tension
from tenscasadi.scene.winches import RestLengthRate, Winch
from tenscasadi.structure.cables import name_inputs, select_first
from tenscasadi.util.validate import Array

if TYPE_CHECKING:
    from ocp.problem.problem import Problem
    from ocp.problem.scaling import Scales

MARGIN = 1e-4  # relative to the range or size of a limit: largest excess that is no violation
_LIMITS: dict[type, type[Any]] = {
    ForceDensity: ForceDensityLimits,
    Tension: TensionLimits,
    RestLength: RestLengthLimits,
    RestLengthRate: RestLengthRateLimits,
}


def control_limits(model: Model) -> type[Any] | tuple[()]:
    """Return the class of bounds that limit the model's control.

    They are bounds on decision variables instead of path constraints. Controls that have limits of
    their own, such as winches, have no such class.
    """
    return _LIMITS.get(type(model.scene.control), ())


def path_constraints(
    problem: Problem, kind: type[PathBound] | type[RateBound], implied: bool = False
) -> list[PathConstraint]:
    """Build the path constraints of all bounds of a class.

    ``kind`` is the class. Names are unique: if several bounds limit a quantity, its name includes
    the index of the bound, as in "obstacle clear of bar 0 (bounds[2])". ``implied`` selects the
    weaker constraints that the bounds imply (`PathBound.imply`).
    """
    found = dict(_build_constraints(problem, kind, implied))
    times = Counter(name for one in found.values() for name in set(one.names))
    own = []
    if kind is PathBound and not controls_force_densities(problem.model):
        now = symbolic(problem.model)
        own = _limit_force_densities(problem, now) + _limit_internal_states(problem, now)
    for k, one in found.items():
        names = tuple(f"{name} (bounds[{k}])" if times[name] > 1 else name for name in one.names)
        own += [replace(one, names=names)] if names else []
    return own


def _build_constraints(
    problem: Problem, kind: type, implied: bool
) -> Iterator[tuple[int, PathConstraint]]:
    """Yield path constraints with the index of their bound.

    Limits of the control itself are omitted, as they are bounds on decision variables. `kind` is
    the class of the bounds. `implied` selects the weaker constraints of `PathBound.imply`.
    """
    model = problem.model
    control = control_limits(model)
    for k, bound in enumerate(problem.bounds):
        if isinstance(bound, kind) and not isinstance(bound, control):
            own: Bound = bound
            if implied and isinstance(bound, PathBound):
                own = bound.imply(model.scene.structure)
            yield k, build_constraint(own, model)


def _limit_force_densities(problem: Problem, now: Instant) -> list[PathConstraint]:
    """Build the limits of force densities that are not controls.

    Strings carry no compression, so that lower limits are at least 0. A cable needs one such
    constraint. If tensions are the control, none is needed. They are built at the instant ``now``.
    """
    lower, upper = problem.force_density_limits
    own = (lower > 0) | np.isfinite(upper)
    if has_elastic_strings(problem.model):
        own[select_first(problem.model.scene.structure.cable_of)] = True
    which = np.flatnonzero(own)
    if not which.size:
        return []
    names = tuple(f"force density of string {k}" for k in which)
    value = now.force_density if own.all() else now.force_density[which.tolist()]
    limits = lower[which], upper[which]
    return [PathConstraint(value, *limits, names, "N/m", now.symbols, PathBound.ends)]


def _limit_internal_states(problem: Problem, now: Instant) -> list[PathConstraint]:
    """Build the limits of winches' rest lengths and motor speeds.

    Both are states of the model. The limits are built at the instant ``now``.
    """
    if not problem.model.na:
        return []
    scene = problem.model.scene
    inputs, least = name_inputs(scene.structure), problem.rest_length_limits[0]
    value, none = now.rest_lengths(scene.structure.stiffness), np.full(len(inputs), np.inf)
    names = tuple(f"rest length of {name}" for name in inputs)
    own = [PathConstraint(value, least, none, names, "m", now.symbols, PathBound.ends)]
    largest = none
    if isinstance(scene.control, Winch):
        largest = scene.control.limits("speed", len(inputs))
    which = np.flatnonzero(np.isfinite(largest)).tolist()
    if which:
        speed = problem.model.split(now.state).internal[len(inputs) :][which]
        names, largest = tuple(f"winding speed of {inputs[k]}" for k in which), largest[which]
        own.append(PathConstraint(speed, -largest, largest, names, "", now.symbols, PathBound.ends))
    return own


@dataclass(frozen=True, eq=False)
class ScaledRows:
    """Scaled constraints lower ≤ function(symbols) ≤ upper.

    Attributes
    ----------
    function : casadi.Function
        Function from symbols to rows of order one.
    lower, upper, names, ends, unit
        As in `PathConstraint`; limits are scaled.
    scale : ndarray, shape (m,)
        Scale of each row, in the unit of its quantity.
    """

    function: ca.Function
    lower: Array
    upper: Array
    names: tuple[str, ...]
    ends: tuple[str, ...]
    scale: Array
    unit: str


def compute_margins(values: Array, lower: Array, upper: Array) -> Array:
    """Compute the margins (2, m) by which lower and upper limits may be exceeded.

    Values within them are active limits, values beyond are violations. Values are (n, m), limits
    (m,). A margin is relative to the range of the limits or to the size of the limit.
    """
    size = np.maximum(np.abs([lower, upper]), np.abs(values).max(initial=0.0))
    size = np.minimum(size, np.where(np.isfinite(upper - lower), upper - lower, np.inf))
    return MARGIN * np.where(size > 0, size, 1.0)


def scaled_rows(
    problem: Problem, kind: type[PathBound] | type[RateBound], scales: Scales, strength: float
) -> list[ScaledRows]:
    """Build the scaled path constraints of a class of bounds.

    ``strength`` is a typical force density [N/m]. ``kind`` is the class.
    """
    return [_scale(one, scales, strength) for one in path_constraints(problem, kind)]


def _scale(limited: PathConstraint, scales: Scales, strength: float) -> ScaledRows:
    """Scale a path constraint to order one.

    `limited` is the constraint, and `strength` a typical force density [N/m]. Scales follow from
    the unit. User-defined expressions have no unit, and are scaled by their limits.
    """
    sizes = {
        "N": strength * scales.length,
        "N/m": strength,
        "N/(m s)": strength / scales.time,
        **scales.units,
    }
    if limited.unit:
        scale = np.full(len(limited.names), sizes[limited.unit])
    else:
        both = np.array([limited.lower, limited.upper])
        largest = np.max(np.where(np.isfinite(both), np.abs(both), 0.0), axis=0)
        scale = np.where(largest > 0, largest, 1.0)
    function = ca.Function("bound", limited.symbols, [ca.densify(limited.value / ca.DM(scale))])
    return ScaledRows(
        function,
        limited.lower / scale,
        limited.upper / scale,
        limited.names,
        limited.ends,
        scale,
        limited.unit,
    )
