"""Conversion of a bound into a symbolic path constraint."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ocp.problem.bounds.bound import Bound, PathBound, PathConstraint, RateBound
from ocp.problem.instant import symbolic

if TYPE_CHECKING:
    from tenscasadi.dynamics.model import Model


def build_constraint(bound: Bound, model: Model) -> PathConstraint:
    """Convert a bound into a path constraint in new symbols."""
    now = symbolic(model)
    if isinstance(bound, RateBound):
        after = symbolic(model)
        interval: Any = type(now.state).sym("h")
        symbols = now.state, now.control, after.state, after.control, interval
        return PathConstraint(*bound.limit(now, after, interval), symbols, bound.ends)
    if not isinstance(bound, PathBound):
        raise TypeError(f"{type(bound).__name__} is no path constraint: derive it from PathBound")
    return PathConstraint(*bound.limit(now), now.symbols, bound.ends)
