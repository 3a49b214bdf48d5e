"""Model predictive path integral control: decisions from sampled motions, without derivatives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ocp.problem.control import refuse_wound
from ocp.problem.costs import Cost
from ocp.problem.expressions import Integral
from ocp.problem.instant import Instant
from ocp.problem.phase import refuse_phases
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.sampling.horizon_costs import build_horizon_costs
from ocp.sampling.spline_noise import SplineNoise
from ocp.transcription.inverse_dynamics import inverse_dynamics
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.simulation.engine.build import build_kernel
from tenscasadi.util.casadi_tools import ArrayFunction
from tenscasadi.util.validate import (
    Array,
    finite_array,
    format_value,
    instance,
    nonnegative,
    per_item,
    positive_number,
    whole_number,
)

MOST, MOST_SAMPLES = (
    1000,
    1_000_000,
)  # periods of a horizon, improvements of a decision and steps of a period; motions
Asked: TypeAlias = Cost | ca.Function | Callable[[Instant], Any]
RANGE = 0.1  # of the limits' range: the deviation of the noise where none is given


class Mppi:
    """Model predictive path integral control: a controller for `run` that samples motions, and needs no derivatives of them.

    At each decision the motion from the measured state is simulated under many force densities over
    the horizon: the last decision, shifted, with smooth noise. Their mean, weighted by how little
    each costs, is the new decision; its first period is applied. That works through contact and
    friction, where gradients mislead.

    Parameters
    ----------
    problem : Problem, Cost, casadi.Function, callable, or a list of the last three
        What is asked. Costs are integrated over the horizon, at whose end goals are to be met as
        nearly as they can. Limits of force densities are kept; overstepping other bounds at the
        decisions' times costs much. The duration of a problem is a scale only. Without a problem
        force densities are not limited but by 0: a CasADi Function (x, u) or (x, u, t), or a
        function of an `Instant`, is then a cost per second.
    period : float
        Time from one decision to the next, s.
    horizon : float
        Time that is looked ahead, s; rounded up to whole periods.
    samples : int
        Motions for each improvement, of which 8 are simulated at once where the processor can.
    noise : SplineNoise, float or array_like of shape (α,), optional
        The noise, or its standard deviation, N/m. Default: a tenth of the range of the force
        densities' limits.
    initial : float or array_like of shape (α,), optional
        Force densities to begin with, N/m. Default: those that hold the problem's start best.
    temperature : float
        How far cost is forgiven: 0.1 lets motions count that cost a little more than the best;
        towards 0 only the best counts. In units of the difference between the median and the best
        cost.
    iterations : int
        Improvements for each decision.
    steps : int
        Steps of `RungeKutta4` in each period.
    place : float, optional
        Departure from a goal, m, that costs 1, as does 10 of it in the problem's duration for goals
        of speed. Default: 1 % of the structure's size.
    seed : int
        Seed of the noise: the same run has the same decisions.
    model : Model, optional
        The model, where no problem has it.

    Attributes
    ----------
    effective_samples : float
        At the last decision, how many motions its mean consisted of in effect, 1/Σw²; 0 where all
        diverged, and the decision before went on.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong, or the problem asks for a motion of a given duration (`Waypoint`,
        `FreeStart`).

    See Also
    --------
    Mpc : for smooth motions, where its derivatives need fewer simulations.

    Notes
    -----
    With costs S of samples γ, weights are w ∝ exp(−(S − min S)/λ) [1]_. Noise is about the last
    decision, for which the term of importance sampling vanishes, and smooth: splines through random
    knots, of many sizes. λ is `temperature` times the difference of the median and the least cost,
    so that it does not depend on the costs' units. One of the samples has no noise. Costs are
    integrated by the rectangle rule, at the ends of the periods. A motion that diverges, or whose
    bars are off by more than 10 % of their length at the end of a period, does not count.

    References
    ----------
    .. [1] G. Williams, N. Wagener, B. Goldfain, P. Drews, J. M. Rehg, B. Boots, E. A. Theodorou,
    "Information theoretic MPC for
       model-based reinforcement learning", ICRA 2017, 1714-1721, algorithm 2.

    Examples
    --------
    A planar cross is brought to another shape:

    >>> import ocp
    >>> import tenscasadi as tc
    >>> cross = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> lengths = tc.shapes.d_bar(angle=0.7).string_lengths
    >>> problem = ocp.Problem(cross, goals=[ocp.StringLengths(lengths), ocp.AtRest()], bounds=[ocp.ForceDensityLimits(0.0, 20.0)])
    >>> controller = ocp.Mppi(problem, period=0.1, horizon=0.5, samples=32)
    >>> controller.control(0.0, cross.initial_state).shape
    (2,)

    A cost of one's own, without a problem:

    >>> import casadi as ca
    >>> controller = ocp.Mppi(lambda now: ca.sumsqr(now.lengths - lengths), 0.1, 0.5, 32, model=cross, noise=2.0)
    >>> ocp.run(controller, 0.5).trajectory.success
    True
    """

    def __init__(
        self,
        problem: Problem | Asked | Sequence[Asked],
        period: float = 0.05,
        horizon: float = 0.5,
        samples: int = 64,
        *,
        noise: SplineNoise | ArrayLike | None = None,
        initial: ArrayLike | None = None,
        temperature: float = 0.1,
        iterations: int = 1,
        steps: int = 10,
        place: float | None = None,
        seed: int = 0,
        model: Model | None = None,
    ) -> None:
        problem = _problem(problem, model)
        refuse_phases(problem.phases, "Mppi")
        refuse_wound(problem.model, "Mppi")
        self.model: Model = problem.model
        self.period = positive_number("period", period)
        ratio = positive_number("horizon", horizon) / self.period
        if ratio > MOST:
            raise ValueError(
                f"horizon is {horizon:g}: that is {ratio:.1g} periods of {self.period:g} s, give at most {MOST}"
            )
        self.intervals = max(1, int(np.ceil(ratio - 1e-9)))
        self.samples = whole_number("samples", samples, 2, MOST_SAMPLES)
        self._temperature = positive_number("temperature", temperature)
        self._iterations = whole_number("iterations", iterations, 1, MOST)
        self._steps = whole_number("steps", steps, 1, MOST)
        self._seed = whole_number("seed", seed, 0)
        self._lower, self._upper = problem.force_density_limits
        smooth = noise if isinstance(noise, SplineNoise) else SplineNoise(self._deviation(noise))
        self._sizes, self._directions, self._basis = (
            smooth.sizes(self.samples),
            smooth.directions(self.model.nu),
            smooth.basis(self.intervals),
        )
        held = _held(problem) if initial is None else per_item("initial", initial, self.model.nu)
        self._initial = np.tile(np.clip(held, self._lower, self._upper), (self.intervals, 1))
        scales = Scales.of(problem)
        size = 0.01 * scales.length if place is None else positive_number("place", place)
        costs = build_horizon_costs(
            problem, scales, self.period, self.intervals, size, float(held.mean()) or 1.0
        )
        self._kernel = build_kernel(self.model, RungeKutta4(), stage=costs.stage, final=costs.final)
        self._control_cost = (
            None if costs.control is None else ArrayFunction(costs.control.map(self.samples))
        )
        self._rate_cost = (
            None
            if costs.rates is None
            else ArrayFunction(costs.rates.map(self.samples * self.intervals))
        )
        self.effective_samples: float
        self._plan: Array  # γ (K, α) of the last decision
        self._last: _Decision | None
        self.reset()
        self._costs(
            0.0, problem.first_state, self._perturbed()
        )  # the first decision is then no slower than the others
        self.reset()

    def __repr__(self) -> str:
        return f"Mppi({self.model.nu} strings, every {self.period:g} s over {self.intervals} periods, {self.samples} samples)"

    def control(self, time: float, state: Array) -> Array:
        """Decide the force densities until the next decision. An earlier time than that of the last decision begins a new run.

        Parameters
        ----------
        time : float
            Time since the beginning, s.
        state : array_like, shape (nx,)
            The measured state, m and m/s.

        Returns
        -------
        ndarray, shape (α,)
            Force densities, N/m.
        """
        time, state = (
            positive_number("time", time, zero=True),
            finite_array("state", state, (self.model.nx,)),
        )
        if self._last is not None and time < self._last.time:
            self.reset()
        if self._last is not None:
            self._plan = np.concatenate([self._plan[1:], self._plan[-1:]])
        for _ in range(self._iterations):
            tried = self._perturbed()
            weights = softmin(self._costs(time, state, tried), self._temperature)
            self.effective_samples = 1 / float(weights @ weights) if weights.any() else 0.0
            if weights.any():
                self._plan = np.clip(
                    np.tensordot(weights, tried, 1), self._lower, self._upper
                )  # sums are rounded
        self._last = _Decision(time, state, self._plan[0])
        return np.array(self._plan[0])

    def reset(self) -> None:
        """Forget the last decision, for another run."""
        self._random = np.random.default_rng(self._seed)
        self._plan = self._initial
        self._last = None
        self.effective_samples = 0.0

    def _deviation(self, given: ArrayLike | None) -> Array:
        if given is not None:
            return nonnegative("noise", per_item("noise", given, self.model.nu), "string")
        unlimited = np.flatnonzero(np.isinf(self._upper))
        if unlimited.size:
            raise ValueError(
                f"noise is None, and string {unlimited[0]} has no upper limit: give noise=, N/m, or the problem a ForceDensityLimits(lower, upper)"
            )
        return np.asarray(RANGE * (self._upper - self._lower))

    def _perturbed(self) -> Array:
        """Return the force densities (samples, K, α) that are tried: those of the last decision, and changes of all sizes."""
        knots = self._random.standard_normal(
            (self.samples, self._basis.shape[1], len(self._directions))
        )
        return np.clip(
            self._plan + self._basis @ (knots * self._sizes[:, None, None] @ self._directions),
            self._lower,
            self._upper,
        )

    def _costs(self, time: float, state: Array, tried: Array) -> Array:
        """Return the cost (samples,) of the motion from a state under each of the force densities; inf or NaN where it diverges."""
        count, K, nu = tried.shape
        inputs = np.empty((count, K, nu + 1))
        inputs[:, :, :nu] = tried
        inputs[:, :, nu] = time + self.period * np.arange(1, K + 1)
        save = None if self._rate_cost is None else self._steps
        rolled = self._kernel(state[None], inputs, self.period / self._steps, self._steps, save)
        cost = rolled.cost
        if self._control_cost is not None:
            cost = cost + self._control_cost(tried)[0].ravel()
        if self._rate_cost is not None and rolled.saved is not None:
            cost = cost + self._rate_cost(*self._changes(rolled.saved, tried))[0].reshape(
                count, K
            ).sum(axis=1)
        return np.asarray(cost)

    def _changes(self, states: Array, tried: Array) -> list[Array]:
        """Return x, γ, x⁺, γ⁺ (samples · K, ·) of all changes of γ: first that from the last decision; without one, from itself."""
        now = _Decision(0.0, states[0, 0], tried[0, 0]) if self._last is None else self._last
        free = (
            tried[:, :1]
            if self._last is None
            else np.broadcast_to(now.force_density, tried[:, :1].shape)
        )
        x = np.concatenate(
            [np.broadcast_to(now.state, states[:, :1].shape), states[:, :-1]], axis=1
        )
        u = np.concatenate([free, tried], axis=1)
        return [
            values.reshape(-1, values.shape[2])
            for values in (x[:, :-1], u[:, :-1], x[:, 1:], u[:, 1:])
        ]


class _Decision(NamedTuple):
    """When, at which state (nx,), and what: γ (α,)."""

    time: float
    state: Array
    force_density: Array


def softmin(costs: Array, temperature: float) -> Array:
    """Return the weights exp(−(S − min S)/λ) of costs S (n,), summed to 1, with λ = temperature · (median S − min S).

    What diverged has no weight: costs that are not finite; all zero where no cost is finite.
    """
    finite = np.isfinite(costs)
    if not finite.any():
        return np.zeros(len(costs))
    excess = np.where(finite, costs, np.inf) - costs[finite].min()
    scale = temperature * float(np.median(excess[finite]))
    weights = np.exp(-excess / scale) if scale > 0 else (excess == 0).astype(float)
    return np.asarray(weights / weights.sum())


def _problem(asked: Any, model: Any) -> Problem:
    """Return the problem, or that of costs with a model. Raises TypeError, ValueError."""
    if isinstance(asked, Problem):
        if model is not None and model is not asked.model:
            raise ValueError("model is given, and the problem has one: leave model= out")
        return asked
    several = list(asked) if isinstance(asked, (list, tuple)) else [asked]
    example = "an ocp.Problem, or with model= a cost: of ocp, a casadi.Function (x, u), or a function of an ocp.Instant"
    for k, one in enumerate(several):
        if isinstance(one, type) or not (isinstance(one, Cost) or callable(one)):
            raise TypeError(
                f"problem{f'[{k}]' * (one is not asked)} is {format_value(one)}: give {example}"
            )
    if model is None or not several:
        raise TypeError(
            f"problem is {format_value(asked)}, model is {format_value(model)}: give {example}"
        )
    instance("model", model, Model, "a tenscasadi.Model")
    return Problem(
        model,
        costs=[
            one if isinstance(one, Cost) else _own(k, one, model) for k, one in enumerate(several)
        ],
    )


def _own(k: int, cost: Any, model: Model) -> Cost:
    """Return the cost of a Function (x, u) or (x, u, t), or of a function of an Instant. Raises ValueError."""
    name = f"problem[{k}]"
    if not isinstance(cost, ca.Function):
        return Integral(name, cost)
    sizes = [cost.size_in(i) for i in range(cost.n_in())]
    if (
        sizes not in (wanted := [(model.nx, 1), (model.nu, 1)], [*wanted, (1, 1)])
        or cost.n_out() != 1
    ):
        raise ValueError(
            f"{name} is {cost}: give a casadi.Function (x[{model.nx}], u[{model.nu}]) or (x, u, t) that returns a scalar"
        )
    return Integral(name, lambda now: cost(*now.symbols[: cost.n_in()]))


def _held(problem: Problem) -> Array:
    """Return the γ (α,) that hold the start most nearly."""
    state = problem.first_state.copy()
    state[problem.model.nq : 2 * problem.model.nq] = 0.0
    return np.asarray(inverse_dynamics(problem, np.array([state, state]), 1.0)[0])
