"""All limits along a plan in symbols, each under a name of its own: what programs impose and reports list."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca

from ocp.problem.bounds import CornerBound, Limited, PathBound
from ocp.problem.instant import symbolic
from ocp.problem.problem import Problem


class Along(NamedTuple):
    """What a bound limits at these ends ("start", "end") of every interval, and the symbols that it is made of.

    symbols: x, u, t of an instant, or x, u, x⁺, u⁺, h of two that are h apart.
    """

    limited: Limited
    symbols: list[Any]
    ends: tuple[str, ...]

    @property
    def function(self) -> ca.Function:
        """From the symbols to the column of what is limited."""
        return ca.Function("limited", self.symbols, [ca.densify(self.limited.value)])


def limits_along(problem: Problem, kind: type[PathBound] | type[CornerBound]) -> list[Along]:
    """What the bounds of one kind limit; what several of them limit, such as the way of a bar round two obstacles, is called
    "obstacle clear of bar 0 (bounds[2])", after the bound's place in Problem.bounds.
    """
    found = {k: _along(problem, bound) for k, bound in enumerate(problem.bounds) if isinstance(bound, kind)}
    times = Counter(name for one in found.values() for name in set(one.limited.names))

    def told_apart(k: int, limited: Limited) -> Limited:
        return replace(limited, names=tuple(f"{name} (bounds[{k}])" if times[name] > 1 else name for name in limited.names))

    return [one._replace(limited=told_apart(k, one.limited)) for k, one in found.items() if one.limited.names]


def _along(problem: Problem, bound: PathBound | CornerBound) -> Along:
    now = symbolic(problem.model)
    if isinstance(bound, PathBound):
        ends = ("start", "end") if bound.needs_control else ("end",)
        return Along(bound.limited(now), [now.state, now.control, now.time], ends)
    after = symbolic(problem.model)
    h: Any = type(now.state).sym("h")
    return Along(bound.limited_between(now, after, h), [now.state, now.control, after.state, after.control, h], ("end",))
