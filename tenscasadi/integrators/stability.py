"""How large a step may be: the rates of the linearised motion against the stability region of a scheme."""

from __future__ import annotations

import warnings
from typing import Any

import casadi as ca
import numpy as np
from scipy.sparse.linalg import ArpackError, ArpackNoConvergence, LinearOperator, eigs

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.scheme import Complex, Scheme, check_scheme, stability_limit
from tenscasadi.util.validate import finite_array, instance, positive_number

_DENSE = 400  # states up to which all eigenvalues are computed


def fastest_rate(model: Model, x: Any = None, u: Any = None) -> float:
    """Compute ω_max, rad/s: the largest |eigenvalue| of ∂ode/∂x at state `x` (nx,) and control `u` (nu,); None: the model's initial ones.

    Above 400 states it is found by Arnoldi's method to about 1 %. NaN where the linearisation is not finite. Raises TypeError, ValueError.
    """
    return float(np.abs(_rates(model, x, u)).max(initial=0.0))


def stable_step(model: Model, x: Any = None, u: Any = None, scheme: Scheme = RungeKutta4(), safety: float = 0.9) -> float:
    """Compute the largest step at which a scheme is stable for the motion linearised at a state.

    A larger step makes vibrations grow until the run breaks down; a much smaller one is a matter of accuracy. Strings that go taut and bars
    that spin faster later on change the limit.

    Parameters
    ----------
    model : Model
        Model to simulate.
    x : array_like (nx,), optional
        State; None: the model's initial state.
    u : array_like (nu,), optional
        Control; None: the model's initial control.
    scheme : Scheme
        Integration scheme.
    safety : float
        Factor on the limit.

    Returns
    -------
    float
        Step, s; infinite where nothing limits it, NaN where the linearisation is not finite.

    Raises
    ------
    TypeError, ValueError
        If an argument has another type, shape or sign.

    Warns
    -----
    UserWarning
        If the linearisation is not finite.

    Notes
    -----
    The limit is where the amplification |R(step · λ)| passes 1 for an eigenvalue λ of ∂ode/∂x. Above 400 states the largest eigenvalues are
    found by Arnoldi's method, to about 1 %.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> spring = tc.Structure([(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], node_mass=[0, 1.0], pinned=[0], stiffness=100.0, rest_length=0.9)
    >>> round(tc.stable_step(tc.Model(tc.Scene(spring)), safety=1.0), 4)  # 2.83 over ω = 10 rad/s
    0.2828
    """
    check_scheme(scheme)
    limit = positive_number("safety", safety) * step_limit(scheme, _rates(model, x, u))
    if np.isnan(limit):
        warnings.warn("stable_step is NaN: the equations have no finite derivative at x, as where a bar has no length", UserWarning, stacklevel=2)
    return limit


def step_limit(scheme: Scheme, rates: Complex) -> float:
    """Return the largest step, s, at which `scheme` is stable for these eigenvalues; infinite when nothing limits it, NaN when one is not finite."""
    if not np.all(np.isfinite(rates)):
        return float("nan")
    size = np.abs(rates)
    moving = rates[size > 1e-9 * size.max(initial=0.0)]  # the others are zero but for rounding
    return float(stability_limit(scheme, moving).min(initial=np.inf))


def _rates(model: Model, x: Any, u: Any) -> Complex:
    """Eigenvalues of ∂ode/∂x: all of them for small models, the largest for others."""
    instance("model", model, Model, "a tenscasadi.Model")
    state = ca.DM(model.initial_state if x is None else finite_array("x", x, (model.nx,)))
    control = ca.DM(model.initial_control if u is None else finite_array("u", u, (model.nu,)))
    if model.nx == 0:
        return np.zeros(0, dtype=complex)
    if model.nx <= _DENSE:
        X, U = ca.MX.sym("x", model.nx), ca.MX.sym("u", model.nu)
        jacobian = ca.Function("jacobian", [X, U], [ca.jacobian(model.ode(X, U), X)])(state, control).full()
        return _eigenvalues(jacobian)
    return _largest_eigenvalues(model, state, control)


def _eigenvalues(matrix: Any) -> Complex:
    if not np.all(np.isfinite(matrix)):
        return np.array([complex(np.nan)])
    return np.asarray(np.linalg.eigvals(matrix), dtype=complex)


def _largest_eigenvalues(model: Model, state: ca.DM, control: ca.DM) -> Complex:
    X, U, V = ca.MX.sym("x", model.nx), ca.MX.sym("u", model.nu), ca.MX.sym("v", model.nx)
    along = ca.Function("along", [X, U, V], [ca.jtimes(model.ode(X, U), X, V)])
    start = np.random.default_rng(0).normal(size=model.nx)  # fixed: the same answer every time
    if not np.all(np.isfinite(along(state, control, start).full())):
        return np.array([complex(np.nan)])
    operator = LinearOperator((model.nx, model.nx), matvec=lambda v: along(state, control, v).full().ravel(), dtype=float)
    try:
        found = eigs(operator, k=6, which="LM", v0=start, tol=1e-3, ncv=40, return_eigenvectors=False)
    except ArpackNoConvergence as error:
        found = error.eigenvalues
    except ArpackError:
        found = []
    if len(found):
        return np.asarray(found, dtype=complex)
    # Undamped motion has |eigenvalue|² at most ‖A²‖: a bound, on the safe side.
    jacobian = ca.Function("jacobian", [X, U], [ca.jacobian(model.ode(X, U), X)])(state, control).sparse()
    return np.array([1j * np.sqrt(abs(jacobian @ jacobian).sum(axis=1).max())])
