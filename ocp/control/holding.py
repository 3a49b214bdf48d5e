"""Equilibrium at the end of a plan, and its stationary feedback."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.linalg
import scipy.optimize

from ocp.problem.bounds.string_bounds import TensionLimits
from ocp.problem.control import build_force_model, has_elastic_strings
from ocp.problem.problem import Problem
from tenscasadi.dynamics.linearization import EquationDerivatives
from tenscasadi.dynamics.model import Model
from tenscasadi.scene.internal_states import join_initial
from tenscasadi.scene.winches import Winch
from tenscasadi.structure.cables import add_compliances, name_inputs
from tenscasadi.structure.class_one import distances
from tenscasadi.util.validate import Array, per_item


class HeldState(NamedTuple):
    """Smallest string forces that keep a state at rest.

    Attributes
    ----------
    force_density : ndarray, shape (nu,)
        Force densities [N/m], or tensions [N] if these are the control.
    left : float
        Largest remaining acceleration [m/s²].
    coordinate : str
        Name of the coordinate with this acceleration.
    exact : bool
        Whether this acceleration is negligible.
    """

    force_density: Array
    left: float
    coordinate: str
    exact: bool


def find_equilibrium(model: Model, state: Array, lower: Array, upper: Array) -> HeldState:
    """Find the smallest string forces that keep a state at rest.

    `lower` and `upper` (nu,) are limits of these forces. The control of the model is force
    densities or tensions. Loads are those at the time of the state. If no forces within the limits
    balance the loads, they minimize the accelerations.
    """
    count = model.nu
    still = EquationDerivatives.of(model).at(at_rest(model, state)[None], np.zeros((1, count)))
    (free,), (A,) = model.split(still.rates)[1], still.accelerations_by_control()
    size = float(np.linalg.norm(A, 2)) or 1.0
    strength = (
        max(
            float(np.linalg.norm(np.linalg.lstsq(A, free)[0])),
            float(np.abs(lower).max(initial=0.0)),
        )
        or 1.0
    )
    balance = 1e6  # weight of accelerations against force densities, both scaled
    rows = np.concatenate([balance * A / size, np.eye(count)])
    wanted = np.concatenate([-balance * free / size, np.zeros(count)]) / strength
    gamma, loose = np.array(lower, dtype=float), lower < upper
    if loose.any():
        room = lower[loose] / strength, upper[loose] / strength
        gamma[loose] = (
            strength
            * scipy.optimize.lsq_linear(
                rows[:, loose], wanted - rows @ np.where(loose, 0.0, lower / strength), room, "bvls"
            ).x
        )
    left = np.abs(free + A @ gamma)
    worst = int(np.argmax(left))
    pull = max(float(np.abs(free).max()), float(np.abs(A).max(initial=0.0)) * strength)
    return HeldState(
        np.clip(gamma, lower, upper),
        float(left[worst]),
        model.mechanism.coordinate_names[worst],
        bool(left[worst] <= 1e-4 * pull),
    )


class Rest(NamedTuple):
    """State at rest with the control that keeps it there.

    Attributes
    ----------
    state : ndarray, shape (nx,), or None
        Equilibrium state; None if there is none.
    control : ndarray, shape (nu,)
        Control of the model in equilibrium.
    message : str
        Description of the result, with the reason of a failure.
    """

    state: Array | None
    control: Array
    message: str


def find_rest(
    model: Model, end: Array, lower: Array, upper: Array, slow: float, margin: float = 0.0
) -> Rest:
    """Find the control that keeps the final state of a plan at rest.

    The string forces in equilibrium are found first. Rest lengths follow from these forces and the
    stiffness, and the torques of winches from the tensions.

    Parameters
    ----------
    end : ndarray, shape (nx,)
        Final state of the plan.
    lower, upper : ndarray, shape (nu,)
        Limits of the forces, see `force_limits`.
    slow : float
        Speed of coordinates that counts as rest [m/s].
    margin : float
        Distance from the limits that forces keep if they can. About strings at their limits, a
        regulator could only tighten them, and would hardly be stable.
    """
    parts = model.split(end)
    fastest = float(np.abs(parts.velocities).max(initial=0.0))
    if fastest > slow:
        return Rest(None, np.zeros(0), f"the end is not held: it moves at {fastest:.2g} m/s")
    for k in np.flatnonzero(lower > upper)[:1]:
        name = name_inputs(model.scene.structure)[k]
        told = f"its limits require at least {lower[k]:.3g} and at most {upper[k]:.3g}"
        return Rest(None, np.zeros(0), f"the end is not held by {name}: {told}")
    forced = build_force_model(model)
    own = np.concatenate([parts.positions, parts.velocities, parts.clock])
    room = np.minimum(margin, (upper - lower) / 2)
    found = find_equilibrium(forced, own, lower + room, upper - room)
    if margin and not found.exact:
        found = find_equilibrium(forced, own, lower, upper)
    control = forced.scene.control
    quantity, unit = ("forces", "N") if control is None else (control.quantity, control.unit)
    if not found.exact:
        told = f"{found.coordinate} accelerates by {found.left:.2g} m/s² at best"
        message = f"the end is not held, as no {quantity} within the limits balance it: {told}"
        return Rest(None, np.zeros(0), message)
    state, held = _follow_forces(model, at_rest(model, end), found.force_density)
    largest = found.force_density.max(initial=0.0)
    return Rest(state, held, f"the end is held by {quantity} up to {largest:.3g} {unit}")


def force_limits(model: Model, problem: Problem | None, state: Array) -> tuple[Array, Array]:
    """Compute the limits (nu,) of the string forces in a state.

    They limit force densities [N/m] if these are the control. Otherwise they limit the tensions [N]
    of cables and of strings in no cable, and result from all limits of the problem, which may
    contradict each other. Without a problem, they are 0 and inf.
    """
    if problem is None:
        return np.zeros(model.nu), np.full(model.nu, np.inf)
    structure, control = model.scene.structure, model.scene.control
    lower, upper = problem.force_density_limits
    if control is None or control.commands_densities:
        return lower, upper
    of, lengths = structure.cable_of, _string_lengths(model, state)
    low, high = problem.limits(TensionLimits)
    low, high = np.maximum(low, 0.0), np.array(high)
    np.maximum.at(low, of, lower * lengths)
    np.minimum.at(high, of, upper * lengths)
    if has_elastic_strings(model):
        stiffness, total = add_compliances(of, structure.stiffness), np.bincount(of, lengths)
        shortest, longest = problem.rest_length_limits
        low = np.maximum(low, stiffness * (total - longest))
        high = np.minimum(high, stiffness * (total - shortest))
    if isinstance(control, Winch):
        high = np.minimum(
            high, problem.control_limits[1] / per_item("Winch.radius", control.radius, len(high))
        )
    return low, high


def _follow_forces(model: Model, state: Array, forces: Array) -> tuple[Array, Array]:
    """Compute internal states and control for given string forces.

    `forces` (nu,) are those in the state (nx,). Returns the state with its internal states, such as
    rest lengths of winches, and the control (nu,).
    """
    control, structure = model.scene.control, model.scene.structure
    if control is None or control.commands_forces:
        return state, forces
    of = structure.cable_of
    total = np.bincount(of, _string_lengths(model, state))
    rest = np.asarray(total - forces / add_compliances(of, structure.stiffness))
    if not model.na:
        return state, rest
    state = np.array(state)
    model.split(state).internal[:] = join_initial(control.internal_states(rest))
    return state, control.initial_inputs(rest, forces)


def _string_lengths(model: Model, state: Array) -> Array:
    """Compute the lengths (α,) of parent strings in a state [m]."""
    return distances(model.nodes(state), model.scene.structure.strings)


def at_rest(model: Model, state: Array) -> Array:
    """Copy a state (nx,) with zero velocities."""
    still = np.array(state, dtype=float)
    model.split(still)[1][:] = 0.0
    return still


def compute_stationary_cost(a: Array, b: Array, Q: Array, R: Array) -> Array:
    """Compute the cost matrix of an LQR with a long horizon.

    The system is δ⁺ = a δ + b u, with the cost δᵀQδ + uᵀRu at each time step. The horizon is
    doubled repeatedly (Chu, Fan, Lin, Int. J. Control 2004, 77, 767), so that modes need not be
    observable or controllable. Doubling ends before the cost of unstable modes exceeds the
    precision of the others. Q and R are symmetric matrices.
    """
    A, G, H = a, b @ scipy.linalg.solve(R, b.T, assume_a="pos"), Q
    eye = np.eye(len(a))
    for _ in range(10):  # 1024 decisions
        inner = np.linalg.solve(eye + G @ H, np.column_stack([A, G]))
        forward, spread = inner[:, : len(a)], inner[:, len(a) :]
        longer = H + A.T @ H @ forward
        if not np.abs(longer).max(initial=0.0) <= 1e9 * np.abs(Q).max(initial=0.0):
            break
        G, H = G + A @ spread @ A.T, longer
        A = A @ forward
        G, H = (G + G.T) / 2, (H + H.T) / 2
    return H
