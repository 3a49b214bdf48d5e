"""Monte Carlo robustness of plans to parameter and state errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.stabilization import build_projection
from tenscasadi.scene.parameters import Parameters
from tenscasadi.util.immutable import ReadOnlyArrays
from tenscasadi.util.renamed import RenamedAttribute
from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import Array, finite_array

SHARES = (0.05, 0.5, 0.95)  # probabilities of the quantiles in a summary
STRINGS = ("stiffness", "damping")  # quantities of the string law, without effect under given γ
ROOM = 10  # minimum number of replays for each regression coefficient


@dataclass(frozen=True, eq=False)
class Robustness(ReadOnlyArrays):
    """Errors of replays with random parameters and initial states.

    `Plan.robustness` returns them.

    Attributes
    ----------
    names : tuple of str
        Varied quantities: parameters, and "start" for the initial state.
    factors : ndarray, shape (n, k)
        Factors of the k parameters in each of the n replays.
    starts : ndarray, shape (n, nx)
        Initial states.
    error, speed_error : ndarray, shape (n,)
        Largest residual of the goals in each replay, of positions [m] and of velocities [m/s]; inf
        if the replay diverges.
    duration : float
        Duration of the plan [s].
    tolerance : float
        Largest permitted residual of the goals in a replay [m]; that of velocities is multiplied by
        the duration.
    importance : dict of str to float
        Fraction of the residuals' variance that each of `names` explains. That of "start" is the
        fraction that the parameters do not explain. NaN if there are too few replays.
    tracked : bool
        Whether the replays are under `track`.
    seconds : float
        Wall time of the replays [s].
    interrupted : bool
        Whether Ctrl-C ended the study. It then holds the replays that had ended.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> cross = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> plan = ocp.solve(ocp.Problem(cross, goals=goals, costs=[ocp.Effort()]), ocp.MultipleShooting(10))
    >>> found = plan.robustness({"bar_mass": 0.05}, samples=100, tolerance=0.05)
    >>> found.error.shape, found.dominant_factor
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
    interrupted: bool = False

    def __repr__(self) -> str:
        return f"Robustness({len(self.error)} replays, {self.success_rate:.1%} within {self.tolerance:.2g} m, tracked={self.tracked})"

    @property
    def worst_error(self) -> Array:
        """Larger of both errors of each replay (n,) [m].

        They are the position error, and velocity error × duration.
        """
        return np.maximum(self.error, self.speed_error * self.duration)

    @property
    def meets(self) -> Any:
        """Whether each replay (n,) meets the tolerance."""
        return self.worst_error <= self.tolerance

    @property
    def success_rate(self) -> float:
        """Fraction of the replays that meet the tolerance."""
        return float(np.mean(self.meets))

    @property
    def dominant_factor(self) -> str:
        """Varied quantity that explains most variance of the residuals.

        It is a parameter or "start", and "" if there are too few replays.
        """
        return (
            max(self.importance, key=self.importance.__getitem__)
            if np.all(np.isfinite(list(self.importance.values())))
            else ""
        )

    share = RenamedAttribute("success_rate")
    matters_most = RenamedAttribute("dominant_factor")

    def quantiles(self, shares: Sequence[float] = SHARES) -> Array:
        """Compute quantiles of the replay error.

        Parameters
        ----------
        shares : sequence of float
            Probabilities, from 0 to 1.

        Returns
        -------
        ndarray, shape (len(shares),)
            Quantiles of `worst_error` [m]. A quantile among diverging replays is inf.

        Raises
        ------
        TypeError, ValueError
            If a probability is no number from 0 to 1.
        """
        wanted = finite_array("shares", shares, (None,))
        if np.any((wanted < 0) | (wanted > 1)):
            raise ValueError(f"shares is {wanted}: give shares from 0 to 1")
        ordered = np.sort(self.worst_error)
        return np.asarray(ordered[np.ceil(wanted * (len(ordered) - 1)).astype(int)])

    def summary(self) -> str:
        """Describe the success rate, the errors, and the dominant variations.

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
            + (f"; {lost} diverge" if lost else "")
            + ("; interrupted from the keyboard" if self.interrupted else ""),
            f"tolerance     {self.success_rate:.1%} end within {self.tolerance:.3g} m",
            f"error         below {', '.join(told)}",
            f"importance    {', '.join(parts)}"
            if self.dominant_factor
            else "importance    unknown, too few replays: give more samples",
        ]
        return "\n".join(lines)


def vary_model(model: Model, names: tuple[str, ...], control: Any) -> Model:
    """Build a model whose parameters scale some of its quantities.

    `names` are these quantities, and `control` replaces the control. Models are cached. Raises
    ValueError if the model already has parameters.
    """
    if model.np:
        raise add_address(
            ValueError(
                "robustness varies the values of the scene: plan with a model whose scene has no parameters="
            )
        )
    parameters = Parameters(scale=names) if names else None

    def build() -> Model:
        return model.with_scene(replace(model.scene, control=control, parameters=parameters))

    return model.keep(("varied", names, type(control)), build)


def draw_starts(
    model: Model,
    state: Array,
    spread: tuple[float, float],
    parameters: Array,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Draw random initial states about a given state.

    Parameters
    ----------
    model : Model
        Model of the replays.
    state : ndarray, shape (nx,)
        Planned initial state.
    spread : (float, float)
        Spreads of coordinates [m] and velocities [m/s].
    parameters : ndarray, shape (n, k)
        Parameters of the replays.
    rng : Generator
        Generator of random numbers.

    Returns
    -------
    starts : ndarray, shape (n, nx)
        Initial states, projected onto bars and joints.
    changes : ndarray, shape (n, 2nq)
        Errors of coordinates and velocities before the projection, relative to their spread.
        Columns with zero spread are omitted.
    """
    count = len(parameters)
    changes = rng.uniform(-1, 1, (count, 2 * model.nq))
    starts = np.repeat(state[None], count, axis=0)
    starts[:, : model.nq] += spread[0] * changes[:, : model.nq]
    starts[:, model.nq : 2 * model.nq] += spread[1] * changes[:, model.nq :]
    given = [starts.T, parameters.T] if model.np else [starts.T]
    kept = np.repeat(spread, model.nq) > 0
    return build_projection(model, 10).map(count)(*given).full().T, changes[:, kept]


def share_variance(draws: Mapping[str, Array], misses: Array) -> dict[str, float]:
    """Decompose the variance of residuals by independent inputs.

    A quadratic regression yields first-order sensitivity indices (Sobol). Its terms are each scalar
    input, its square, and the products of any two; they are uncorrelated. The index of an input is
    the fraction of the variance that its linear and quadratic terms explain. Inputs with several
    columns are not part of the regression, as their effects need not be polynomial. They have the
    fraction of the variance that the regression leaves.

    Parameters
    ----------
    draws : mapping of str to ndarray, shape (n, c)
        Independent inputs of mean zero by name.
    misses : ndarray, shape (n, m)
        Residuals of the replays; NaN for diverging ones, which do not count.

    Returns
    -------
    dict of str to float
        Fraction of the variance by name; NaN if there are too few replays, or no variance.
    """
    single = {name: x for name, x in draws.items() if x.shape[1] == 1}
    products = [single[one] * single[other] for one, other in combinations(single, 2)]
    columns = [_centered(part) for x in single.values() for part in (x, x**2)] + [
        _centered(part) for part in products
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


def _centered(values: Array) -> Array:
    return np.asarray(values - values.mean(axis=0))
