"""Model predictive path integral control: sampling without derivatives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ocp.control.holding import at_rest
from ocp.guess.inverse_dynamics import inverse_dynamics
from ocp.problem.control import (
    check_control,
    control_name,
    control_unit,
    controls_force_densities,
)
from ocp.problem.costs import Cost
from ocp.problem.expressions import Integral
from ocp.problem.instant import Instant
from ocp.problem.phase import reject_phases
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.sampling.horizon_costs import build_horizon_costs
from ocp.sampling.spline_noise import SplineNoise
from tenscasadi.dynamics.base_model import check_model
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.schema.definitions import resolve_names
from tenscasadi.simulation.engine.build import build_kernel
from tenscasadi.structure.cables import name_inputs
from tenscasadi.util.casadi_tools import ArrayFunction
from tenscasadi.util.renamed import rename_keywords
from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import (
    MAX_REPETITIONS,
    Array,
    finite_array,
    format_value,
    nonnegative,
    per_item,
    positive_number,
    whole_number,
)

Asked: TypeAlias = Cost | ca.Function | Callable[[Instant], Any]


class Mppi:
    """Model predictive path integral control (MPPI).

    It is a controller for `run`, also for contact and friction, where gradients are of little use.
    In each sampling period, it simulates many control sequences from the measured state. They are
    the previous sequence, shifted by a period, with smooth noise. The new sequence is their mean,
    weighted by the costs, and its first control is applied.

    Parameters
    ----------
    problem : Problem, Cost, casadi.Function, callable, or a list of the last three
        Optimal control problem, or costs per second: CasADi Functions (x, u) or (x, u, t), or
        functions of an `Instant`. Costs of a problem are integrated over the horizon, and goals are
        terminal costs. Limits of the control are kept, and violations of other limits at the end of
        a period are penalized. The duration only scales velocities. Without a problem, force
        densities have the lower limit 0.
    period : float
        Sampling period [s].
    horizon : float
        Prediction horizon [s], rounded up to whole periods.
    samples : int
        Motions in each iteration. Up to 8 are simulated at once in SIMD lanes.
    noise : SplineNoise, float or array_like of shape (nu,), optional
        Noise of the control, or its standard deviation, such as [N/m]. Default: a tenth of the
        distance between the limits of the control.
    initial : float or array_like of shape (nu,), optional
        Initial control, such as force densities [N/m]. Default: the control that balances the
        initial state best.
    temperature : float
        Temperature λ of the weights, in units of the difference between the median and the least
        cost. Towards 0, only the best motion counts.
    iterations : int
        Iterations for each decision.
    steps : int
        Number of steps of `RungeKutta4` in each period.
    position_scale : float, optional
        Distance from a goal [m] that costs 1. The scale of velocities is 10 ·
        position_scale/duration. Default: 1 % of the structure's size.
    seed : int
        Seed of the noise.
    model : Model, optional
        Model, if there is no problem.

    Attributes
    ----------
    effective_samples : float
        Effective number 1/Σw² of samples in the last call. 0 if all diverged; the previous
        control sequence is then used again.

    Raises
    ------
    TypeError, ValueError
        If a value has another type or is out of bounds, or the problem has a `Waypoint` or
        `FreeStart`.

    See Also
    --------
    Mpc : Fewer simulations, for smooth motions.

    Notes
    -----
    The weights of samples with costs S are w ∝ exp(−(S − min S)/λ) [1]_. The noise is about the
    previous controls, so the importance-sampling term is zero. It consists of splines through
    random knots, of several sizes; one sample has no noise. Costs are integrated by the rectangle
    rule at the ends of the periods. Motions have no weight if they diverge, or if the relative
    error of a bar length exceeds 10 % at the end of a period.

    References
    ----------
    .. [1] G. Williams et al., Information theoretic MPC for model-based reinforcement learning,
       ICRA 2017, 1714-1721, algorithm 2.

    Examples
    --------
    A planar cross moves to another shape:

    >>> import ocp
    >>> import tenscasadi as tc
    >>> cross = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> lengths = tc.shapes.d_bar(angle=0.7).string_lengths
    >>> problem = ocp.Problem(cross, goals=[ocp.StringLengths(lengths), ocp.AtRest()], bounds=[ocp.ForceDensityLimits(0.0, 20.0)])
    >>> controller = ocp.Mppi(problem, period=0.1, horizon=0.5, samples=32)
    >>> controller.control(0.0, cross.initial_state).shape
    (2,)

    An own cost, without a problem:

    >>> import casadi as ca
    >>> controller = ocp.Mppi(lambda now: ca.sumsqr(now.lengths - lengths), 0.1, 0.5, 32, model=cross, noise=2.0)
    >>> ocp.run(controller, 0.5).trajectory.success
    True
    """

    @rename_keywords(place="position_scale")
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
        position_scale: float | None = None,
        seed: int = 0,
        model: Model | None = None,
    ) -> None:
        problem = _read_problem(problem, model)
        reject_phases(problem.phases, "Mppi")
        check_control(problem.model)
        self.model: Model = problem.model
        self.period = positive_number("period", period)
        self.intervals = _count_intervals(horizon, self.period)
        self.samples = whole_number("samples", samples, 2, 1_000_000)
        self._temperature = positive_number("temperature", temperature)
        self._iterations = whole_number("iterations", iterations, 1, MAX_REPETITIONS)
        self._steps = whole_number("steps", steps, 1, MAX_REPETITIONS)
        self._seed = whole_number("seed", seed, 0)
        self._lower, self._upper = problem.control_limits
        noise = resolve_names(noise, self.model.scene.structure.names)
        smooth = noise if isinstance(noise, SplineNoise) else SplineNoise(self._deviation(noise))
        self._sizes, self._directions, self._basis = (
            smooth.sizes(self.samples),
            smooth.directions(self.model.nu),
            smooth.basis(self.intervals),
        )
        held, strength = _find_initial(problem)
        if initial is not None:
            held = per_item("initial", initial, self.model.nu)
            strength = float(held.mean()) if controls_force_densities(self.model) else strength
        self._initial = np.tile(np.clip(held, self._lower, self._upper), (self.intervals, 1))
        scales = Scales.of(problem)
        size = scales.read_position(position_scale)
        costs = build_horizon_costs(
            problem, scales, self.period, self.intervals, size, strength or 1.0
        )
        self._kernel = build_kernel(self.model, RungeKutta4(), stage=costs.stage, final=costs.final)
        self._control_cost = _map_cost(costs.control, self.samples)
        self._rate_cost = _map_cost(costs.rates, self.samples * self.intervals)
        self.effective_samples: float
        self._plan: Array  # controls (K, nu) of the last decision
        self._last: _Decision | None
        self.reset()
        self._evaluate(
            0.0, problem.initial_state, self._draw()
        )  # the first decision is then no slower than the others
        self.reset()

    def __repr__(self) -> str:
        return f"Mppi({self.model.nu} strings, every {self.period:g} s over {self.intervals} periods, {self.samples} samples)"

    def control(self, time: float, state: Array) -> Array:
        """Compute the control for the next sampling period.

        A time before that of the previous call begins a new run.

        Parameters
        ----------
        time : float
            Time since the beginning [s].
        state : array_like, shape (nx,)
            Measured state.

        Returns
        -------
        ndarray, shape (nu,)
            Control.
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
            tried = self._draw()
            weights = softmin(self._evaluate(time, state, tried), self._temperature)
            self.effective_samples = 1 / float(weights @ weights) if weights.any() else 0.0
            if weights.any():
                self._plan = np.clip(
                    np.tensordot(weights, tried, 1), self._lower, self._upper
                )  # sums are rounded
        self._last = _Decision(time, state, self._plan[0])
        return np.array(self._plan[0])

    def reset(self) -> None:
        """Discard the previous control sequence before another run."""
        self._random = np.random.default_rng(self._seed)
        self._plan = self._initial
        self._last = None
        self.effective_samples = 0.0

    def _deviation(self, given: ArrayLike | None) -> Array:
        if given is not None:
            return nonnegative("noise", per_item("noise", given, self.model.nu), "string")
        unlimited = np.flatnonzero(np.isinf(self._upper))
        if unlimited.size:
            name = name_inputs(self.model.structure)[unlimited[0]]
            own = f"{control_name(self.model)} of {name}"
            raise add_address(
                ValueError(
                    f"noise is None, and the {own} has no upper limit: "
                    f"give noise=, {control_unit(self.model)}, or a limit to the problem"
                )
            )
        return np.asarray(0.1 * (self._upper - self._lower))

    def _draw(self) -> Array:
        """Draw random control sequences (samples, K, nu).

        Their mean is the previous sequence.
        """
        knots = self._random.standard_normal(
            (self.samples, self._basis.shape[1], len(self._directions))
        )
        return np.clip(
            self._plan + self._basis @ (knots * self._sizes[:, None, None] @ self._directions),
            self._lower,
            self._upper,
        )

    def _evaluate(self, time: float, state: Array, tried: Array) -> Array:
        """Simulate control sequences and compute their costs (samples,).

        `tried` (samples, K, nu) are the sequences, applied from `state` (nx,) at `time` [s]. Costs
        are inf or NaN after divergence.
        """
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
        """Return state and control before and after each control change.

        They are x, u, x⁺, u⁺ of successive intervals of all samples, as arrays (samples · K, ·).
        `states` are those at the ends of all intervals, `tried` the controls (samples, K, nu).
        """
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
    """Previous decision of the controller.

    Attributes
    ----------
    time : float
        Its time [s].
    state : ndarray, shape (nx,)
        State at this time.
    force_density : ndarray, shape (nu,)
        Control of its sampling period.
    """

    time: float
    state: Array
    force_density: Array


def softmin(costs: Array, temperature: float) -> Array:
    """Compute normalized weights exp(−(S − min S)/λ) of costs S.

    λ = temperature · (median S − min S). Costs that are not finite have no weight.
    """
    finite = np.isfinite(costs)
    if not finite.any():
        return np.zeros(len(costs))
    excess = np.where(finite, costs, np.inf) - costs[finite].min()
    scale = temperature * float(np.median(excess[finite]))
    weights = np.exp(-excess / scale) if scale > 0 else (excess == 0).astype(float)
    return np.asarray(weights / weights.sum())


def _read_problem(asked: Any, model: Any) -> Problem:
    """Read a problem, or costs with a model.

    `asked` is the argument of the user. Raises TypeError, ValueError.
    """
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
    check_model(model)
    return Problem(
        model,
        costs=[
            one if isinstance(one, Cost) else _read_cost(k, one, model)
            for k, one in enumerate(several)
        ],
    )


def _read_cost(k: int, cost: Any, model: Model) -> Cost:
    """Convert a CasADi Function or a callable to a cost.

    The result is its integral over time. `k` is its place in the argument `problem`, for messages.
    A Function has the arguments (x, u) or (x, u, t), a callable an `Instant`. Raises ValueError for
    a Function with other arguments.
    """
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


def _count_intervals(horizon: float, period: float) -> int:
    ratio = positive_number("horizon", horizon) / period
    if ratio > MAX_REPETITIONS:
        raise ValueError(
            f"horizon is {horizon:g}: that is {ratio:.1g} periods of {period:g} s, give at most {MAX_REPETITIONS}"
        )
    return max(1, int(np.ceil(ratio - 1e-9)))


def _map_cost(cost: ca.Function | None, count: int) -> ArrayFunction | None:
    return None if cost is None else ArrayFunction(cost.map(count))


def _find_initial(problem: Problem) -> tuple[Array, float]:
    """Find the control (nu,) that best balances the initial state.

    Also returns the mean force density.
    """
    state = at_rest(problem.model, problem.initial_state)
    states, inputs, _ = inverse_dynamics(problem, np.array([state, state]), 1.0)
    if controls_force_densities(problem.model):
        return inputs[0], float(inputs[0].mean())
    return inputs[0], float(np.mean(problem.model.force_density(states[0], inputs[0])))
