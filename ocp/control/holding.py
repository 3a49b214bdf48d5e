"""Equilibrium of a state at rest, and its stationary regulator."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.linalg
import scipy.optimize

from tenscasadi.dynamics.linearization import EquationDerivatives
from tenscasadi.dynamics.model import Model
from tenscasadi.util.validate import Array


class HeldState(NamedTuple):
    """Force densities that hold a state at rest.

    Attributes
    ----------
    force_density : ndarray, shape (α,)
        Force densities [N/m].
    left : float
        Largest acceleration that remains [m/s²].
    coordinate : str
        Name of its coordinate.
    exact : bool
        Whether it is negligible.
    """

    force_density: Array
    left: float
    coordinate: str
    exact: bool


def find_equilibrium(model: Model, state: Array, lower: Array, upper: Array) -> HeldState:
    """Find the least force densities that hold a state at rest.

    Loads are those at the time of the state. If nothing holds it, the accelerations are least.
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
    """State at rest and the force densities that hold it.

    Attributes
    ----------
    state : ndarray, shape (nx,), or None
        State; None if nothing holds it.
    force_density : ndarray, shape (α,)
        Force densities [N/m].
    message : str
        Result in words, with the reason of a failure.
    """

    state: Array | None
    force_density: Array
    message: str


def find_rest(
    model: Model, end: Array, lower: Array, upper: Array, slow: float, margin: float = 0.0
) -> Rest:
    """Find force densities that hold the end of a motion.

    Parameters
    ----------
    slow : float
        Speed of coordinates that counts as rest [m/s].
    margin : float
        Distance from the limits that force densities keep if they can [N/m]. About strings at
        their limits, a regulator could only tighten them, and would hardly be stable.
    """
    fastest = float(np.abs(model.split(end)[1]).max(initial=0.0))
    if fastest > slow:
        return Rest(None, np.zeros(0), f"the end is not held: it moves at {fastest:.2g} m/s")
    room = np.minimum(margin, (upper - lower) / 2)
    found = find_equilibrium(model, end, lower + room, upper - room)
    if margin and not found.exact:
        found = find_equilibrium(model, end, lower, upper)
    if not found.exact:
        told = f"{found.coordinate} accelerates by {found.left:.2g} m/s² at best"
        message = f"the end is not held, as no force densities within their limits do: {told}"
        return Rest(None, np.zeros(0), message)
    return Rest(
        at_rest(model, end),
        found.force_density,
        f"the end is held by force densities up to {found.force_density.max(initial=0.0):.3g} N/m",
    )


def at_rest(model: Model, state: Array) -> Array:
    """Set the velocities of a state (nx,) to zero."""
    still = np.array(state, dtype=float)
    model.split(still)[1][:] = 0.0
    return still


def compute_stationary_cost(a: Array, b: Array, Q: Array, R: Array) -> Array:
    """Compute the cost matrix of a regulator over a long horizon.

    The system is δ⁺ = a δ + b u with the cost δᵀQδ + uᵀRu for each decision. The horizon doubles
    each time (Chu, Fan, Lin, Int. J. Control 2004, 77, 767), so that modes need not be observable
    or controllable. It ends before the cost of unstable modes leaves no digits for others.
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
