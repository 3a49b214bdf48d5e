"""How large a step may be: the rates of the linearized motion against the stability region of a scheme."""

from __future__ import annotations

import warnings
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import ArpackError, ArpackNoConvergence, LinearOperator, eigs

from tenscasadi.dynamics.linearization import EquationDerivatives
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.scheme import Complex, Scheme, check_scheme, stability_limit
from tenscasadi.util.validate import Array, finite_array, instance, positive_number

DENSE = 400  # states up to which all eigenvalues are computed
_HALF_DISC = np.append(
    1j * np.linspace(0, 1, 101), np.exp(1j * np.linspace(np.pi / 2, np.pi, 100))
)  # edge of its upper half


def fastest_rate(model: Model, x: Any = None, u: Any = None, parameters: Any = None) -> float:
    """Compute ω_max, rad/s: the largest |eigenvalue| of ∂ode/∂x at state `x` (nx,) and control `u` (nu,); None: the model's initial ones.

    Above 400 states it is found by Arnoldi's method to about 1 %. NaN where the linearization is
    not finite. Raises TypeError, ValueError.
    """
    return float(np.abs(_rates(model, x, u, parameters)).max(initial=0.0))


def stable_step(
    model: Model,
    x: Any = None,
    u: Any = None,
    scheme: Scheme = RungeKutta4(),
    safety: float = 0.9,
    parameters: Any = None,
) -> float:
    """Compute the largest step at which a scheme is stable for the motion linearized at a state.

    A larger step makes vibrations grow until the run breaks down; a much smaller one is a matter of
    accuracy. Strings that go taut and bars that spin faster later on change the limit.

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
    parameters : array_like, shape (np,), or mapping, optional
        Values of the model's parameters, see `ParameterLayout.values`; nominal if None.

    Returns
    -------
    float
        Step, s; infinite where nothing limits it, NaN where the linearization is not finite.

    Raises
    ------
    TypeError, ValueError
        If an argument has another type, shape or sign.

    Warns
    -----
    UserWarning
        If the linearization is not finite.

    Notes
    -----
    The limit is where the amplification |R(step · λ)| passes 1 for an eigenvalue λ of ∂ode/∂x.
    Above 400 states the largest eigenvalues are found by Arnoldi's method, to about 1 %.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> spring = tc.Structure([(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], node_mass=[0, 1.0], pinned=[0], stiffness=100.0, rest_length=0.9)
    >>> round(tc.stable_step(tc.Model(tc.Scene(spring)), safety=1.0), 4)  # 2.83 over ω = 10 rad/s
    0.2828
    """
    check_scheme(scheme)
    limit = positive_number("safety", safety) * step_limit(scheme, _rates(model, x, u, parameters))
    if np.isnan(limit):
        warnings.warn(
            "stable_step is NaN: the equations have no finite derivative at x, as where a bar has no length",
            UserWarning,
            stacklevel=2,
        )
    return limit


def contact_rate(model: Model) -> float:
    """Compute how fast, rad/s, the lightest node bounces on the grounds of the scene, or is damped by them; 0 without one."""
    m = lightest_mass(model)
    return max(
        (max(float(np.sqrt(g.stiffness / m)), float(g.damping) / m) for g in model.scene.grounds),
        default=0.0,
    )


def contact_step(model: Model) -> float:
    """Compute the step, s, that follows what happens where nodes touch the grounds of the scene; infinite without one.

    It resolves bouncing and damping, and how fast friction of a third of the weight stops a node
    that slips, up to a tenth of the step that the former need.
    """
    rate = contact_rate(model)
    if not rate:
        return float("inf")
    g = model.scene.gravity
    push = 0.0 if g is None else float(model.mechanism.M.sum()) * float(ca.norm_2(g.at(0.0))) / 3
    m = lightest_mass(model)
    stop = max(
        (
            float(one.friction) * push / (m * float(one.slip_speed))
            for one in model.scene.grounds
            if one.friction is not None
        ),
        default=0.0,
    )
    bounce = 0.1 / rate  # a tenth of a radian
    return float(min(bounce, max(0.25 / max(stop, 1e-300), bounce / 10)))


def lightest_mass(model: Model) -> float:
    """Compute the least mass, kg, that a force on one free node moves, were it not for bars: 1/max diag M⁻¹."""
    mech = model.mechanism
    if (
        model.coordinates == "full"
    ):  # pinned nodes without mass are free there, and held by Ω: M⁻ has masses for them that do not matter
        return float(1 / mech.inverse[0].diagonal().max())
    return float(1 / np.linalg.inv(np.asarray(mech.free_mass.toarray())).diagonal().max())


def log_growth(
    model: Model,
    scheme: Scheme,
    step: float,
    x: Any,
    u: Any,
    ignored: float,
    bound: float,
    parameters: Any = None,
) -> float:
    """Compute log |R| of the mode of the motion linearized at a state that one step, s, of a scheme amplifies most; 0 where none grows.

    Growth of the motion itself is none of the scheme. What the `rate_bound` leaves below `ignored`
    is returned as 0.
    """
    if (
        _largest_log(scheme, step * bound * _HALF_DISC) <= ignored
    ):  # R is analytic: it is largest on the edge
        return 0.0
    rates = _rates(model, x, u, parameters)
    return _largest_log(scheme, step * np.where(rates.real > 0, 1j * np.abs(rates), rates))


def fastest_damped(model: Model, x: Any, u: Any, parameters: Any = None) -> float:
    """Compute the fastest rate, 1/s, at which damping slows a mode of the motion linearized at a state down rather than lets it swing; 0: none."""
    rates = _rates(model, x, u, parameters)
    return float(-rates.real[-rates.real > np.abs(rates.imag)].min(initial=0.0))


def _largest_log(scheme: Scheme, z: NDArray[Any]) -> float:
    if not np.isfinite(z).all():
        return 0.0  # not known
    with np.errstate(all="ignore"):
        largest = float(np.abs(scheme.amplification(z)).max(initial=1.0))
    return float(np.log(largest)) if largest > 1 + 1e-9 else 0.0


def rate_bound(model: Model, x: Any, u: Any, parameters: Any = None) -> float:
    """Return a bound on ω_max, rad/s, that costs little: from λ² q = (λ C + K) q; for large models an estimate that is rather too high."""
    w = model.held(u, parameters)
    if model.nx > DENSE:
        along, v, size = _directional(model), np.random.default_rng(0).normal(size=model.nx), 1.0
        sizes = []
        for _ in range(4):
            v = along(x, w, v / size if size else v).full().ravel()
            size = float(np.linalg.norm(v))
            sizes.append(size)
        pairs = np.sqrt(np.multiply(sizes[1:], sizes[:-1]))  # positions and velocities by turns
        return 3.0 * float(pairs[-1])  # few products find less than the largest
    jacobian, n = _jacobian(model, x, w), model.nq
    K, C = (
        min(abs(block).sum(axis=0).max(initial=0.0), abs(block).sum(axis=1).max(initial=0.0))
        for block in (jacobian[n : 2 * n, :n], jacobian[n : 2 * n, n : 2 * n])
    )
    return float(C + np.sqrt(C * C + 4 * K)) / 2


def _jacobian(model: Model, x: Any, w: Any) -> Array:
    """Compute ∂ode/∂x at a state and its inputs."""
    control, p = np.split(np.asarray(w), [model.nu])
    at = EquationDerivatives.of(model).at(np.asarray(x)[None], control[None], p)
    return at.jacobian(0)[:, : model.nx]


def _directional(model: Model) -> ca.Function:
    """Build (x, w, v) -> ∂ode/∂x v, which takes large models less than their Jacobian."""

    def build() -> ca.Function:
        X, W, V = ca.MX.sym("x", model.nx), ca.MX.sym("w", model.nw), ca.MX.sym("v", model.nx)
        along = ca.jtimes(model.stacked(model.ode)(X, W), X, V)
        return ca.Function("along", [X, W, V], [along])

    return model.keep("tangent", build)


def step_limit(scheme: Scheme, rates: Complex) -> float:
    """Return the largest step, s, at which `scheme` is stable for these eigenvalues; infinite when nothing limits it, NaN when one is not finite."""
    if not np.all(np.isfinite(rates)):
        return float("nan")
    size = np.abs(rates)
    moving = rates[size > 1e-9 * size.max(initial=0.0)]  # the others are zero but for rounding
    return float(stability_limit(scheme, moving).min(initial=np.inf))


def _rates(model: Model, x: Any, u: Any, parameters: Any) -> Complex:
    """Eigenvalues of ∂ode/∂x: all of them for small models, the largest for others."""
    instance("model", model, Model, "a tenscasadi.Model")
    state = model.initial_state if x is None else finite_array("x", x, (model.nx,))
    inputs = model.held(u, parameters)
    if model.nx == 0:
        return np.zeros(0, dtype=complex)
    if model.nx <= DENSE:
        return _eigenvalues(_jacobian(model, state, inputs))
    return _largest_eigenvalues(model, state, inputs)


def _eigenvalues(matrix: Any) -> Complex:
    if not np.all(np.isfinite(matrix)):
        return np.array([complex(np.nan)])
    return np.asarray(np.linalg.eigvals(matrix), dtype=complex)


def _largest_eigenvalues(model: Model, state: Array, control: Array) -> Complex:
    along = _directional(model)
    start = np.random.default_rng(0).normal(size=model.nx)  # fixed: the same answer every time
    if not np.all(np.isfinite(along(state, control, start).full())):
        return np.array([complex(np.nan)])
    operator = LinearOperator(
        (model.nx, model.nx), matvec=lambda v: along(state, control, v).full().ravel(), dtype=float
    )
    try:
        found = eigs(
            operator, k=6, which="LM", v0=start, tol=1e-3, ncv=40, return_eigenvectors=False
        )
    except ArpackNoConvergence as error:
        found = error.eigenvalues
    except ArpackError:
        found = []
    if len(found):
        return np.asarray(found, dtype=complex)
    # Undamped motion has |eigenvalue|² at most ‖A²‖: a bound, on the safe side.
    jacobian = _jacobian(model, state, control)
    return np.array([1j * np.sqrt(abs(jacobian @ jacobian).sum(axis=1).max())])
