"""Inverse dynamics: force densities of a given trajectory."""

from __future__ import annotations

from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
import scipy.optimize

from ocp.problem.control import (
    TAUT_MARGIN,
    build_force_density_model,
    controls_force_densities,
    has_elastic_strings,
    slackening_damping,
)
from ocp.problem.instant import symbolic
from tenscasadi.dynamics.linearization import EquationDerivatives
from tenscasadi.scene.loads import Gravity
from tenscasadi.statics.force_density import find_force_density
from tenscasadi.structure.cables import add_compliances
from tenscasadi.structure.structure import Structure
from tenscasadi.util.immutable import keep
from tenscasadi.util.validate import Array

if TYPE_CHECKING:
    from ocp.problem.problem import Problem
    from tenscasadi.dynamics.model import Model

# weight of the regularization toward reference force densities, relative to scaled accelerations
REFERENCE_WEIGHT = 1e-3


def inverse_dynamics(
    problem: Problem, states: Array, interval: float, balanced: tuple[Array, Array] | None = None
) -> tuple[Array, Array, float]:
    """Find the controls that best reproduce the accelerations of states.

    The states (K + 1, nx) are an interval [s] apart. `balanced` are the equilibrium force densities
    of the first and the last state, if they are known (see `balance`). Returns the states with
    internal states that follow from the controls, the controls (K, nu), within their limits, and
    the mean squared error of the accelerations.

    Accelerations are linear in the force densities, which leads to a small bounded least-squares
    problem in each interval. Self-stress does not change accelerations: it follows the equilibrium
    force densities of the first and the last state.
    """
    model, parts = build_force_density_model(problem.model), problem.model.split(states)
    ends = (
        (balance(problem, states[0]), balance(problem, states[-1]))
        if balanced is None
        else balanced
    )
    moving = np.column_stack([parts.positions, parts.velocities, parts.clock])
    middle = (moving[:-1] + moving[1:]) / 2
    wanted = np.diff(parts.velocities, axis=0) / interval
    lower, upper = _find_limits(problem, model, middle)
    count = len(middle)
    linear = EquationDerivatives.of(model).at(middle, np.zeros((count, model.nu)))
    free = model.split(linear.rates)[1]
    accelerations = linear.accelerations_by_control()
    transposed = accelerations.transpose(0, 2, 1)
    squares = transposed @ accelerations
    size = np.maximum(np.linalg.eigvalsh(squares)[:, -1:], 1e-300)
    pulls = (transposed @ (wanted - free)[:, :, None])[:, :, 0] / size
    found = _minimize_quadratics(
        squares / size[:, :, None] + REFERENCE_WEIGHT * np.eye(model.nu),
        pulls + REFERENCE_WEIGHT * _interpolate(*ends, count),
        lower,
        upper,
    )
    rest = wanted - free - (accelerations @ found[:, :, None])[:, :, 0]
    error = float(np.nan_to_num(np.mean(rest**2), nan=np.inf))
    if controls_force_densities(problem.model):
        return states, found, error
    tension, rest = _convert_forces(problem, (states[:-1] + states[1:]) / 2, found)
    if problem.model.na:
        return *_wind(problem, states, tension, rest, interval), error
    control = rest if has_elastic_strings(problem.model) else tension
    return states, np.clip(control, *problem.control_limits), error


def _wind(
    problem: Problem, states: Array, tension: Array, rest: Array, interval: float
) -> tuple[Array, Array]:
    """Compute the inputs (K, nu) of actuators for given rest lengths.

    Tensions [N] and rest lengths [m] (K, nu) are those in the middle of intervals. The initial
    internal states are those of the initial state. Also returns the states (K + 1, nx) with the
    resulting internal states. `interval` is the length of an interval [s].
    """
    states, control = states.copy(), problem.model.scene.control
    own = problem.model.split(states).internal
    nodes = np.vstack([own[:1, : rest.shape[1]], (rest[1:] + rest[:-1]) / 2, rest[-1:]])
    if control is None:
        raise TypeError("a scene without control has no internal states")
    own[1:], inputs = control.follow(nodes, tension, interval, problem.control_limits)
    return states, inputs


def _find_limits(problem: Problem, model: Model, states: Array) -> tuple[Array, Array]:
    """Compute the limits (K, α) of force densities at states [N/m].

    `model` is the one with force densities as control, to which the states (K, nx) belong. Damped
    elastic strings that get longer go slack below the force density of their damping.
    """
    damping = TAUT_MARGIN * slackening_damping(problem.model)
    lower, upper = (np.tile(limit, (len(states), 1)) for limit in problem.force_density_limits)
    if damping.any():
        lengths, rates = measure_strings(model, states)
        taut = damping * rates / np.maximum(lengths, 1e-12)  # without length, any force
        lower = np.minimum(np.maximum(lower, taut), upper)
    return lower, upper


def measure_strings(model: Model, states: Array) -> tuple[Array, Array]:
    """Compute the lengths [m] and length rates [m/s] of strings at states (K, nx)."""
    now = symbolic(model)
    measure = ca.Function("measure", [now.state], [ca.densify(now.lengths), ca.densify(now.rates)])
    lengths, rates = (value.full().T for value in measure.map(len(states))(states.T))
    return lengths, rates


def _convert_forces(problem: Problem, states: Array, force_density: Array) -> tuple[Array, Array]:
    """Convert force densities into tensions and rest lengths.

    Force densities are (K, α) [N/m]. At states (K, nx), a cable has the mean tension T = Σ s t/Σ s
    [N] of its strings, with lengths s and tensions t. The rest lengths are Σ s − (T − c Σ ṡ)/k [m]
    for stiffness k and damping c, clipped to their limits. Both are (K, nu). Strings have at least
    2 % of the largest force density, as slack ones do not respond to their controls.
    """
    structure = problem.model.scene.structure
    lengths, rates = measure_strings(problem.model, states)
    tension = np.maximum(force_density, 0.02 * force_density.max(initial=0.0)) * lengths
    k, c = structure.stiffness, structure.damping
    if structure.cables:
        onto = np.equal.outer(structure.cable_of, np.arange(problem.model.nu)).astype(float)
        tension, lengths = (tension * lengths) @ onto / (lengths @ onto), lengths @ onto
        rates = rates @ onto
        k, c = (add_compliances(structure.cable_of, each) for each in (k, c))
    if not has_elastic_strings(problem.model):
        return tension, lengths
    return tension, np.clip(lengths - (tension - c * rates) / k, *problem.rest_length_limits)


def balance(problem: Problem, state: Array) -> Array:
    """Find force densities (α,) in equilibrium at a state [N/m].

    They are within the limits. If no equilibrium is found, they are the lower limits. The problem
    stores them, as guesses on several meshes and paths share their first and last states.
    """
    return keep(problem, ("balance", state.tobytes()), lambda: _balance(problem, state))


def _balance(problem: Problem, state: Array) -> Array:
    lower, upper = problem.force_density_limits
    model = problem.model
    structure = model.scene.structure
    nodes = model.nodes(state)[: len(structure.nodes)]
    try:
        shape = (
            structure if np.array_equal(nodes, structure.nodes) else structure.replace(nodes=nodes)
        )
        gamma = find_force_density(shape, _weights(structure, model.scene.gravity))
    except ValueError:
        return lower
    return lower if gamma is None or np.any(gamma > upper) else np.maximum(gamma, lower)


def _interpolate(first: Array, last: Array, count: int) -> Array:
    """Interpolate between two force densities at the middle of intervals.

    The result (count, α) is linear from the first to the last (α,).
    """
    s = (np.arange(count)[:, None] + 0.5) / count
    return np.asarray((1 - s) * first + s * last)


def _weights(structure: Structure, gravity: Gravity | None) -> Array | None:
    if gravity is None:
        return None
    return np.outer(
        np.asarray(structure.mass_matrix().sum(axis=1)).ravel(),
        ca.DM(gravity.at(0.0)).full().ravel(),
    )


def _minimize_quadratics(H: Array, c: Array, lower: Array, upper: Array) -> Array:
    """Solve n bounded quadratic programs min ½ xᵀH x − cᵀx.

    H (n, k, k) are positive definite. c, the bounds `lower` and `upper` of x, and the result are
    (n, k).

    A primal-dual active-set method solves all n at once (Hintermüller, Ito, Kunisch, SIAM J. Optim.
    2002, 13, 865). It usually needs five iterations, but may cycle: SciPy then solves the remaining
    problems.
    """
    held, left = lower == upper, np.arange(len(c))
    side, x = np.where(held, -1, np.zeros(c.shape)), np.zeros_like(c)
    for _ in range(20):
        own, pull, before, low, high = (each[left] for each in (H, c, side, lower, upper))
        fixed = np.where(before < 0, low, np.where(before > 0, high, 0.0))
        free = before == 0
        masked = own * (free[:, :, None] & free[:, None, :]) + (~free)[:, :, None] * np.eye(
            c.shape[1]
        )
        wanted = np.where(free, pull - (own @ fixed[:, :, None])[:, :, 0], fixed)
        now = np.linalg.solve(masked, wanted[:, :, None])[:, :, 0]
        slope = (own @ now[:, :, None])[:, :, 0] - pull
        down = (now < low) | ((before < 0) & (slope >= 0)) | held[left]
        up = (now > high) | ((before > 0) & (slope <= 0))
        x[left], side[left] = now, np.where(down, -1, np.where(up & ~held[left], 1, 0))
        left = left[np.any(before != side[left], axis=1)]
        if not len(left):
            return np.asarray(x)
    loose = ~held  # lsq_linear requires lower < upper
    for k in left:
        root = np.linalg.cholesky(H[k]).T
        inner = scipy.optimize.lsq_linear(
            root[:, loose[k]],
            np.linalg.solve(root.T, c[k]) - root[:, held[k]] @ lower[k, held[k]],
            (lower[k, loose[k]], upper[k, loose[k]]),
            method="bvls",
        )
        x[k] = lower[k]
        x[k, loose[k]] = inner.x
    return np.asarray(x)
