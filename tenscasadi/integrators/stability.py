"""Largest stable time steps of a scheme for the linearized model."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from tenscasadi.dynamics.base_model import check_model
from tenscasadi.dynamics.linearization import EquationDerivatives
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.scheme import Complex, Scheme, check_scheme, stability_limit
from tenscasadi.scene.binding import fix
from tenscasadi.util.linear_algebra import DENSE
from tenscasadi.util.renamed import lazy_module
from tenscasadi.util.validate import Array, finite_array, positive_number

if TYPE_CHECKING:
    from tenscasadi.dynamics.model import Model

linalg = lazy_module("scipy.sparse.linalg")

# edge of the upper half of the left unit half-disc


def fastest_rate(model: Model, x: Any = None, u: Any = None, parameters: Any = None) -> float:
    """Compute the largest eigenvalue magnitude ω_max [rad/s].

    It is the largest |eigenvalue| of ∂ode/∂x at state `x` (nx,) and control `u` (nu,), by default
    the initial ones. Above 400 states Arnoldi's method finds it to about 1 %. NaN if the
    linearization is not finite. Raises TypeError, ValueError. `parameters` are those of
    `stable_step`.
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
    """Compute the largest stable step of a scheme.

    The model is linearized at a state; nodes may touch the ground in any state. With a larger step,
    vibrations grow until the run fails; a much smaller one only affects accuracy. Strings that go
    taut and bars that spin faster later on change the limit.

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
        Step [s]; infinite if nothing limits it, NaN if the linearization is not finite.

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
    At the limit, |R(step · λ)| = 1 for an eigenvalue λ of ∂ode/∂x. Above 400 states, Arnoldi's
    method finds the largest eigenvalues to about 1 %. On a ground of stiffness k and damping c, the
    lightest node of mass m adds λ = i √(k/m), −c/m, and the rate at which friction of a third of the
    weight stops it.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> spring = tc.Structure([(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], node_mass=[0, 1.0], pinned=[0], stiffness=100.0, rest_length=0.9)
    >>> round(tc.stable_step(tc.Model(tc.Scene(spring)), safety=1.0), 4)  # 2.83 over ω = 10 rad/s
    0.2828
    """
    check_scheme(scheme)
    safety = positive_number("safety", safety)
    limit = find_limit(model, scheme, x, u, parameters)
    limit = safety * min(limit, step_limit(scheme, _contact_rates(model, parameters)))
    if np.isnan(limit):
        warnings.warn(
            "stable_step is NaN: the equations have no finite derivative at x, as where a bar has no length",
            UserWarning,
            stacklevel=2,
        )
    return limit


def find_limit(
    model: Model, scheme: Scheme, x: Any = None, u: Any = None, parameters: Any = None
) -> float:
    """Compute the largest stable step at a state [s].

    x (nx,) is the state, u (nu,) the control. In contrast to `stable_step`, it does not warn, and
    considers only nodes in contact. `scheme` and `parameters` are those of `stable_step`.
    """
    return step_limit(scheme, _rates(model, x, u, parameters))


def contact_rate(model: Model, parameters: Any = None) -> float:
    """Compute the largest angular frequency of ground contact [rad/s].

    It is that at which the lightest node vibrates on a ground's spring, or the rate of its damping.
    It is 0 without a ground. `parameters` are those of `stable_step`.
    """
    return float(np.abs(_bounce_rates(model, parameters)).max(initial=0.0))


def contact_step(model: Model, parameters: Any = None) -> float:
    """Compute a step that resolves ground contact [s].

    It resolves the vibration and damping of a node on a ground. It also resolves how friction of a
    third of the weight stops a slipping node, unless that needs less than a tenth of the step.
    Infinite without a ground. `parameters` are those of `stable_step`.
    """
    rate = contact_rate(model, parameters)
    if not rate:
        return float("inf")
    bounce = 0.1 / rate  # a tenth of a radian
    stop = 0.25 / max(_friction_rate(model, parameters), 1e-300)
    return float(min(bounce, max(stop, bounce / 10)))


def _bounce_rates(model: Model, parameters: Any) -> Complex:
    """Compute the eigenvalues of the lightest node on each ground [1/s].

    They are i√(k/m) and −c/m (two for each ground), for mass m, stiffness k and damping c. Friction
    is not included. They also bound those of bars: Σ w (1 − s, s)ᵀ(1 − s, s) over the contact
    points at fractions s has no eigenvalue above 1, as the weights w add up to 2. Each end has at
    most the stiffness k and damping c of the ground.
    """
    grounds, m, _ = _contact(model, parameters)
    rates = [(1j * np.sqrt(float(g.stiffness) / m), -float(g.damping) / m) for g in grounds]
    return np.array(rates, dtype=complex).ravel()


def _friction_rate(model: Model, parameters: Any) -> float:
    """Compute the rate at which friction stops the lightest node [1/s].

    The normal force on the node is a third of the weight. The rate is 0 without friction.
    """
    grounds, m, weight = _contact(model, parameters)
    rates = [float(g.friction) / float(g.slip_speed) for g in grounds if g.friction is not None]
    return max(rates, default=0.0) * weight / 3 / m if rates else 0.0


def _contact_rates(model: Model, parameters: Any) -> Complex:
    """Compute the eigenvalues of the lightest node in contact [1/s].

    That of friction is limited to the rate at which `contact_step` is stable.
    """
    friction = min(_friction_rate(model, parameters), 2.5 / contact_step(model, parameters))
    return np.append(_bounce_rates(model, parameters), -friction)


def lightest_mass(model: Model, parameters: Any = None) -> float:
    """Compute the smallest effective mass of a node [kg].

    It is 1/max diag M⁻¹, for the mass matrix M at these `parameters`, as if no bar were rigid.
    """
    w = ca.DM(model.stack_inputs(None, parameters))
    return float(1 / max(_numbers(part).diagonal().max() for part in model.with_masses(w).inverse))


def _numbers(matrix: Any) -> Array:
    return np.asarray(matrix.full() if isinstance(matrix, ca.DM) else matrix.toarray())


def _contact(model: Model, parameters: Any) -> tuple[Any, float, float]:
    """Collect contact laws, smallest mass [kg] and weight [N].

    The mass is that of `lightest_mass`, and the weight that of the whole structure. Both are 0
    without contacts.
    """
    p = model.parameters.values(parameters)
    scene = fix(model.scene, p) if model.np else model.scene
    if not scene.contact_laws:
        return (), 0.0, 0.0
    mass = float(
        np.sum(_numbers(model.with_masses(ca.DM(model.stack_inputs(None, p)), inverse=False).M))
    )
    pull = 0.0 if scene.gravity is None else float(ca.norm_2(scene.gravity.at(0.0)))
    return scene.contact_laws, lightest_mass(model, p), mass * pull


def _jacobian(model: Model, x: Any, w: Any) -> Array:
    """Compute the Jacobian ∂ode/∂x (nx, nx) [1/s].

    x (nx,) is the state. The inputs w (nw,) are the control and the parameters.
    """
    control, p = np.split(np.asarray(w), [model.nu])
    at = EquationDerivatives.of(model).at(np.asarray(x)[None], control[None], p)
    return at.jacobian(0)[:, : model.nx]


def _directional(model: Model) -> ca.Function:
    """Build the Function (x, w, v) → ∂ode/∂x v.

    x is the state, w the control with the parameters, and v (nx) a direction. For large models the
    Function is cheaper than the Jacobian.
    """

    def build() -> ca.Function:
        X, W, V = ca.MX.sym("x", model.nx), ca.MX.sym("w", model.nw), ca.MX.sym("v", model.nx)
        along = ca.jtimes(model.with_stacked_input(model.ode)(X, W), X, V)
        return ca.Function("along", [X, W, V], [along])

    return model.keep("tangent", build)


def step_limit(scheme: Scheme, rates: Complex) -> float:
    """Compute the largest stable step for given eigenvalues [s].

    `rates` are the eigenvalues of the linearized model [1/s]. The step is infinite if nothing
    limits it, and NaN if an eigenvalue is not finite.
    """
    if not np.all(np.isfinite(rates)):
        return float("nan")
    size = np.abs(rates)
    moving = rates[size > 1e-9 * size.max(initial=0.0)]  # the others are zero up to rounding
    return float(stability_limit(scheme, moving).min(initial=np.inf))


def _rates(model: Model, x: Any, u: Any, parameters: Any) -> Complex:
    """Compute eigenvalues of the linearized model, ∂ode/∂x [1/s].

    x (nx,) is the state and u (nu,) the control, by default the initial ones. For small models they
    are all eigenvalues, for others the largest. They are NaN if the linearization is not finite.
    """
    check_model(model)
    state = model.initial_state if x is None else finite_array("x", x, (model.nx,))
    inputs = model.stack_inputs(u, parameters)
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
    start = np.random.default_rng(0).normal(size=model.nx)  # fixed seed: reproducible results
    if not np.all(np.isfinite(along(state, control, start).full())):
        return np.array([complex(np.nan)])
    operator = linalg.LinearOperator(
        (model.nx, model.nx), matvec=lambda v: along(state, control, v).full().ravel(), dtype=float
    )
    try:
        found = linalg.eigs(
            operator, k=6, which="LM", v0=start, tol=1e-3, ncv=40, return_eigenvectors=False
        )
    except linalg.ArpackNoConvergence as error:
        found = error.eigenvalues
    except linalg.ArpackError:
        found = []
    if len(found):
        return np.asarray(found, dtype=complex)
    # Undamped motion has |eigenvalue|² ≤ ‖A²‖, a safe bound.
    jacobian = _jacobian(model, state, control)
    return np.array([1j * np.sqrt(abs(jacobian @ jacobian).sum(axis=1).max())])
