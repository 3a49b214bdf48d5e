"""How much of a plan's worth remains where the structure or the start is not quite as planned: many replays at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.stabilization import build_projection
from tenscasadi.scene.parameters import Parameters
from tenscasadi.util.read_only import ReadOnlyArrays
from tenscasadi.util.validate import (
    Array,
    finite_array,
    format_value,
    nesting,
    positive_number,
    text,
)

SHARES = (0.05, 0.5, 0.95)  # of the replays, whose errors a summary tells
STRINGS = ("stiffness", "damping")  # quantities that act through the strings' law
ROOM = 10  # replays for each coefficient of a regression


@dataclass(frozen=True, eq=False)
class Robustness(ReadOnlyArrays):
    """Errors of many replays of a plan, each with other parameters and another start; see `Plan.robustness`.

    Attributes
    ----------
    names : tuple of str
        What varies: parameters, and "start".
    factors : ndarray, shape (n, k)
        What each parameter of each replay is multiplied by.
    starts : ndarray, shape (n, nx)
        The starts.
    error, speed_error : ndarray, shape (n,)
        How far each replay ends from the goals, m, and in velocities, m/s; inf where it diverges.
    duration : float
        Duration of the plan, s.
    tolerance : float
        How far a replay may end from the goals, m, and as many m per duration in speed.
    importance : dict of str to float
        The share of the variance of the misses that each of `names` brings about, that of "start"
        is what the parameters leave; NaN where replays are too few to tell.
    tracked : bool
        Whether the plan was kept to by `track`.
    seconds : float
        Wall time of the replays, s.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> cross = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> plan = ocp.solve(ocp.Problem(cross, goals=goals, costs=[ocp.Effort()]), ocp.MultipleShooting(10))
    >>> found = plan.robustness({"bar_mass": 0.05}, samples=100, tolerance=0.05)
    >>> found.error.shape, found.matters_most
    ((100,), 'bar_mass')
    """

    names: tuple[str, ...]
    factors: Array
    starts: Array
    error: Array
    speed_error: Array
    duration: float
    tolerance: float
    importance: dict[str, float]
    tracked: bool
    seconds: float

    def __repr__(self) -> str:
        return f"Robustness({len(self.error)} replays, {self.share:.1%} within {self.tolerance:.2g} m, tracked={self.tracked})"

    @property
    def worst_error(self) -> Array:
        """The larger of the errors in place, and in speed times the duration (n,), m."""
        return np.maximum(self.error, self.speed_error * self.duration)

    @property
    def meets(self) -> Any:
        """Whether each replay (n,) meets the tolerance."""
        return self.worst_error <= self.tolerance

    @property
    def share(self) -> float:
        """The share of the replays that meet the tolerance."""
        return float(np.mean(self.meets))

    @property
    def matters_most(self) -> str:
        """The parameter, or "start", that brings about most of the misses; "" where replays are too few to tell."""
        return (
            max(self.importance, key=self.importance.__getitem__)
            if np.all(np.isfinite(list(self.importance.values())))
            else ""
        )

    def quantiles(self, shares: Sequence[float] = SHARES) -> Array:
        """Return errors that shares of the replays stay below.

        Parameters
        ----------
        shares : sequence of float
            Shares, from 0 to 1.

        Returns
        -------
        ndarray, shape (len(shares),)
            Values of `worst_error`, m; inf where as many diverge.

        Raises
        ------
        TypeError, ValueError
            A share is no number from 0 to 1.
        """
        wanted = finite_array("shares", shares, (None,))
        if np.any((wanted < 0) | (wanted > 1)):
            raise ValueError(f"shares is {wanted}: give shares from 0 to 1")
        ordered = np.sort(self.worst_error)
        return np.asarray(ordered[np.ceil(wanted * (len(ordered) - 1)).astype(int)])

    def summary(self) -> str:
        """Describe how the replays end.

        Returns
        -------
        str
            A few lines of text.
        """
        how = "kept to by track" if self.tracked else "open loop"
        lost = np.count_nonzero(np.isinf(self.error))
        told = [
            f"{value:.3g} m ({share:.0%})"
            for share, value in zip(SHARES, self.quantiles(), strict=True)
        ]
        parts = [
            f"{name} {value:.0%}"
            for name, value in sorted(self.importance.items(), key=lambda item: -item[1])
        ]
        lines = [
            f"replays       {len(self.error)}, {how}, {self.seconds:.3g} s"
            + (f"; {lost} diverge" if lost else ""),
            f"tolerance     {self.share:.1%} end within {self.tolerance:.3g} m",
            f"error         below {', '.join(told)}",
            f"what matters  {', '.join(parts)}"
            if self.matters_most
            else "what matters  too few replays to tell: give more samples",
        ]
        return "\n".join(lines)


def check_spreads(parameters: Any) -> dict[str, float]:
    """Return relative spreads by name, each at least 0 and less than 1. Raises TypeError, ValueError."""
    if parameters is None:
        return {}
    if not isinstance(parameters, Mapping):
        raise TypeError(
            f"parameters is {format_value(parameters)}: give spreads by name, such as {{'bar_mass': 0.05}}"
        )
    for name in parameters:
        text("parameters: a name", name)
    spreads = {
        name: positive_number(f"parameters[{format_value(name)}]", value, zero=True)
        for name, value in parameters.items()
    }
    for name, value in spreads.items():
        if name == "rest_length":
            raise ValueError(
                "parameters has 'rest_length', which a plan commands, as force densities or by winding: vary 'stiffness' instead"
            )
        if value >= 1:
            raise ValueError(
                f"parameters[{name!r}] is {value:g}: give a spread relative to its value, less than 1"
            )
    return spreads


def check_start(start: Any) -> tuple[float, float]:
    """Return the spreads of places, m, and velocities, m/s. Raises TypeError, ValueError."""
    if nesting(start) == 0:
        return positive_number("start", start, zero=True), 0.0
    pair = finite_array("start", start, (2,))
    return positive_number("start[0]", pair[0], zero=True), positive_number(
        "start[1]", pair[1], zero=True
    )


_VARIED: WeakKeyDictionary[Model, dict[Any, Model]] = WeakKeyDictionary()


def vary_model(model: Model, names: tuple[str, ...], control: Any) -> Model:
    """Return the model with factors of some quantities as its parameters, under another control; the same one each time."""
    if model.np:
        raise ValueError(
            "robustness varies the values of the scene: plan with a model whose scene has no parameters="
        )
    known = _VARIED.setdefault(model, {})
    key = names, type(control)
    if key not in known:
        scene = replace(
            model.scene, control=control, parameters=Parameters(scale=names) if names else None
        )
        known[key] = Model(
            scene, model.coordinates, "constant" if model.mechanism.constant_length else "current"
        )
    return known[key]


def draw_starts(
    model: Model,
    state: Array,
    spread: tuple[float, float],
    parameters: Array,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Return starts (n, nx) about a state, on bars and joints, and the changes (n, 2nq) of its coordinates and velocities before that."""
    count = len(parameters)
    changes = rng.uniform(-1, 1, (count, 2 * model.nq))
    starts = np.repeat(state[None], count, axis=0)
    starts[:, : model.nq] += spread[0] * changes[:, : model.nq]
    starts[:, model.nq : 2 * model.nq] += spread[1] * changes[:, model.nq :]
    given = [starts.T, parameters.T] if model.np else [starts.T]
    kept = np.repeat(spread, model.nq) > 0
    return np.asarray(build_projection(model, 10).map(count)(*given).full()).T, changes[:, kept]


def share_variance(draws: Mapping[str, Array], misses: Array) -> dict[str, float]:
    """Return the share of the variance of misses (n, m) that each of the independent draws (n, c), of mean zero, brings about.

    Of single columns by least squares on them and their squares, which are not correlated, beside
    the products of any two. What all of these leave is that of draws of several columns, whose
    effects need not be polynomials.
    """
    single = {name: x for name, x in draws.items() if x.shape[1] == 1}
    products = [single[one] * single[other] for one, other in combinations(single, 2)]
    columns = [_centred(part) for x in single.values() for part in (x, x**2)] + [
        _centred(part) for part in products
    ]
    seen = np.all(np.isfinite(misses), axis=1)
    total = float(np.var(misses[seen], axis=0).sum()) if seen.any() else 0.0
    if seen.sum() < ROOM * (len(columns) + 1) or total == 0:
        return dict.fromkeys(draws, np.nan)
    known = np.hstack([*columns, np.ones((len(misses), 1))])[seen]
    slopes = np.linalg.lstsq(known, misses[seen])[0]
    left = float(np.var(misses[seen] - known @ slopes, axis=0).sum()) / total
    parts = {
        name: known[:, 2 * k : 2 * k + 2] @ slopes[2 * k : 2 * k + 2]
        for k, name in enumerate(single)
    }
    return {
        name: float(np.var(parts[name], axis=0).sum()) / total if name in parts else left
        for name in draws
    }


def _centred(values: Array) -> Array:
    return np.asarray(values - values.mean(axis=0))
