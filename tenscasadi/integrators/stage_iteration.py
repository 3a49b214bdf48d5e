"""Triangular iteration for the stages of a collocation step.

Sweeps of small symmetric systems replace Newton's method for all stages at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from tenscasadi.dynamics import forces
from tenscasadi.dynamics.contacts import ContactElement
from tenscasadi.dynamics.force_element import ForceElement, NodeMotion
from tenscasadi.integrators.events import (
    build_mode_ode,
    build_switching,
    count_switches,
    split_mode,
)
from tenscasadi.scene.binding import bind, with_fields
from tenscasadi.scene.contact_law import compute_slip, press
from tenscasadi.scene.strings import Smooth
from tenscasadi.util.casadi_tools import call_as_sx, constant_row, sparse
from tenscasadi.util.validate import Array

if TYPE_CHECKING:
    from tenscasadi.dynamics.model import Model

_BLOCK = 8  # sweeps that one branch skips after convergence


def factor_crout(A: Array) -> Array:
    """Compute the lower triangle L of Crout's factorization A = L U.

    The diagonal of U is 1.
    """
    n = len(A)
    L, U = np.zeros((n, n)), np.eye(n)
    for j in range(n):
        L[j:, j] = A[j:, j] - L[j:, :j] @ U[:j, j]
        U[j, j + 1 :] = (A[j, j + 1 :] - L[j, :j] @ U[:j, j + 1 :]) / L[j, j]
    return L


def solve_stages(model: Model, A: Array, sweeps: int) -> ca.Function:
    """Build the solver for the stages of a step.

    Function (x, u, h, tolerance) → rates of the velocities and internal states of all stages
    (nq + na, s), and the last change of a velocity or of h times a velocity [m or m/s]. Small
    symmetric systems give one stage after the other. The sweeps end when no stage moves by more
    than the tolerance, or after `sweeps`.

    Newton's method for all stages at once needs derivatives of the right-hand side and a system
    with 2 s times as many unknowns. Here the lower triangle L of Crout's A = L U [1]_ replaces A
    in the iteration matrix. In each sweep, stage i solves (I − h lᵢᵢ ∂a/∂v − h² lᵢᵢ² ∂a/∂q) δ =
    a(qᵢ, vᵢ) − kᵢ for its acceleration kᵢ. The converged stages are those of A. L decides only the
    convergence: a factor of 0.29 or better per sweep (two Gauss points) for any stiffness, and
    much better without stiff strings.

    Bars are rigid, not stiff: along them, δ is the residual itself. The system is therefore that
    of free nodes, M − h l C − h² l² K. C and K contain the forces alone, and very stiff springs
    hold bars and joints at the residual. The matrix is symmetric and positive definite. LDLᵀ takes
    a tenth of the work of other factorizations, and no derivative of the multipliers is needed.

    .. [1] van der Houwen, de Swart, Triangularly implicit iteration methods for ODE-IVP solvers,
       SIAM J. Sci. Comput. 18, 1997.
    """
    s = len(A)
    sizes = {
        "k": (model.nq + model.na, s),
        "changes": (2, 1),
        "x": (model.nx, 1),
        "u": (model.nw, 1),
        "h": (1, 1),
        "tolerance": (1, 1),
    }
    symbols = [ca.MX.sym(name, *size) for name, size in sizes.items()]
    names, results = list(sizes), ["k_next", "changes_next"]
    sweep = ca.Function("sweep", symbols, _sweep(model, A, *symbols[:-1]), names, results)
    idle = ca.Function("idle", symbols, symbols[:2], names, results)

    def loop_until_converged(name: str, function: ca.Function, times: int) -> ca.Function:
        choice = ca.Function.if_else(f"{name}_choice", function, idle)
        k, changes, *rest = symbols
        for _ in range(times):
            k, changes = choice(ca.logic_not(changes[0] <= rest[-1]), k, changes, *rest)
        return ca.Function(name, symbols, [k, changes], names, results)

    all_sweeps = loop_until_converged(
        "all_sweeps", loop_until_converged("sweeps", sweep, _BLOCK), -(-sweeps // _BLOCK)
    )
    k, changes = all_sweeps(ca.DM.zeros(*sizes["k"]), ca.DM.inf(2), *symbols[2:])
    return ca.Function("stages", symbols[2:], [k, changes[0]], names[2:], ["k", "change"])


def stage_states(model: Model, A: Array, x: Any, k: Any, h: Any) -> list[Any]:
    """Compute the states (nx,) at all stages of a collocation step.

    The step of length h [s] starts at x (nx,). A (s, s) are the coefficients of the method. k (nq +
    na, s) are the time derivatives of velocities and internal states.
    """
    c, (q, v, own, clock) = A.sum(axis=1), model.split(x)
    Q = h**2 * ca.mtimes(k[: model.nq, :], ca.DM((A @ A).T))
    changes = h * ca.mtimes(k, ca.DM(A.T))
    return [
        ca.vertcat(q + c[i] * h * v + Q[:, i], ca.vertcat(v, own) + changes[:, i], clock + c[i] * h)
        for i in range(len(A))
    ]


def _sweep(model: Model, A: Array, k: Any, changes: Any, x: Any, u: Any, h: Any) -> list[Any]:
    """Build one sweep of the triangular iteration over all stages.

    The step of length h [s] starts at the state x (nx) with the input u, control and parameters. A
    (s, s) are the coefficients of the method. k (nq + na, s) are the time derivatives of velocities
    and internal states after the last sweep. `changes` are its change of the states and the
    smallest one so far. Returns the new k and changes.
    """
    L = factor_crout(A)
    squared = L @ L
    gaps = build_switching(model)
    ode = model.with_stacked_input(model.ode) if gaps is None else build_mode_ode(model)
    solve = _solver(model)
    found: list[Any] = []
    for i, state in enumerate(stage_states(model, A, x, k, h)):
        for j, change in enumerate(found):
            state = state + ca.vertcat(
                h**2 * squared[i, j] * change[: model.nq],
                h * L[i, j] * change,
                ca.DM.zeros(model.nx - 2 * model.nq - model.na),
            )
        w = u
        if gaps is not None:
            # The first sweep keeps the initial mode. Later sweeps keep a string taut until it is
            # too short by more than twice the smallest update so far; otherwise modes alternate.
            least = changes[1]
            doubt = ca.if_else(least < np.inf, 2.0 * least, 0) * (h + _lead(model, u))
            w = ca.vertcat(u, ca.if_else(least < np.inf, gaps(state, u) > -doubt, gaps(x, u) > 0))
        slope = ode(state, w)[model.nq : 2 * model.nq + model.na] - k[:, i]
        change = solve(state, w, h * L[i, i], slope[: model.nq], changes[0])
        found.append(ca.vertcat(change, slope[model.nq :]) if model.na else change)
    delta = ca.horzcat(*found)
    moved = h * ca.fmax(1, h) * ca.norm_inf(ca.vec(delta))
    return [k + delta, ca.vertcat(moved, ca.fmin(changes[1], moved))]


def _lead(model: Model, u: Any) -> Any:
    """Compute damping over stiffness of each switching function [s].

    It is the derivative (k,) of a switching function with respect to its velocity. u is the control
    and the parameters.
    """
    w = model.extend_inputs(ca.DM(model.initial_state), u)
    scene = bind(model.scene, w)[0]
    stiffness, damping = (
        constant_row(scene.modelled.stiffness),
        constant_row(scene.modelled.damping),
    )
    lead = ca.if_else(stiffness > 0, damping / stiffness, 0).T
    lead = ca.densify(
        lead if lead.shape[0] != 1 else ca.repmat(lead, len(scene.modelled.strings), 1)
    )
    first = scene.first_strings[scene.switching_inputs]
    clamped = ca.DM(np.isin(first, scene.clamped_strings).astype(float))
    grounds = [
        ca.repmat(ca.densify(one.surface.damping / one.surface.stiffness), one.switch_count, 1)
        for one in forces.build_elements(model.scene, model.mechanism, w)
        if isinstance(one, ContactElement)
    ]
    switching = ca.reshape(lead[first.tolist()], clamped.shape[0], 1)  # a column, even if empty
    return ca.vertcat(switching * clamped, *grounds)


def _solver(model: Model) -> ca.Function:
    """Build the linear solver of one stage.

    Function (x, w, g, r, moved) → δ with (I − g ∂a/∂v − g² ∂a/∂q) δ = r, approximately, for the
    acceleration a. See `build_mode_ode` for w. `moved` is the change of velocities in the last
    sweep [m/s]. x is the state. g (h times a coefficient of the method) is the effective step [s].
    q are the coordinates, and v their velocities.
    """
    nq = model.nq

    def linear(x: Any, w: Any, g: Any, r: Any, moved: Any) -> tuple[Any, ...]:
        N, V, time = model.unpack(x)
        given, mode = split_mode(model, w)
        mech = model.with_masses(given, inverse=False)
        u = model.add_schedule(model.extend_inputs(x, given), time)
        M = sparse(mech.free_mass)

        at = NodeMotion(N, V, time)
        elements = forces.build_elements(model.scene, mech, u, mode)

        def slopes(elements: list[ForceElement]) -> Any:
            F = forces.sum_forces(elements, mech, at)
            return ca.jacobian(mech.generalized_forces(F), x)

        K, C = ca.horzsplit(_drag_slopes(slopes, elements, at, moved), [0, nq, 2 * nq, model.nx])[
            :2
        ]
        if any(
            len(which) and not isinstance(law, Smooth) for law, which in model.scene.string_laws
        ):
            S = ca.mtimes(N, sparse(mech.C_s.T))
            length = type(x).sym("length", 1, S.shape[1])
            # compressive string forces would make the system indefinite
            pulling = [
                replace(one, damped=False, longest=length)
                if isinstance(one, forces.StringForces)
                else _without_friction(one)
                for one in elements
            ]
            K = ca.substitute(slopes(pulling)[:, :nq], length, ca.sqrt(ca.sum1(S * S)))
        W = M - g * _symmetric(C) - g**2 * _symmetric(K)
        kept = model.constraints(x)
        G = ca.jacobian(ca.vertcat(kept.bars, kept.joints), x)[:, :nq]
        # Bars and joints are springs 1e5 times as stiff as the stiffest entry: exact to 1e-5. Rows
        # of unit length keep the matrix definite if the sweeps diverge.
        G = G / ca.repmat(ca.fmax(ca.sqrt(ca.sum2(G * G)), 1e-300), 1, nq)
        rigid = 1e5 * ca.mmax(ca.diag(W)) * ca.mtimes(G.T, G)
        return W + rigid, ca.mtimes(M + rigid, r)

    sizes = {"x": model.nx, "w": model.nw + count_switches(model), "g": 1, "r": nq, "moved": 1}
    symbols: list[Any] = [ca.MX.sym(name, size) for name, size in sizes.items()]
    matrix, rhs = call_as_sx(model.mechanism.large, linear, *symbols)
    return ca.Function("solver", symbols, [ca.solve(matrix, rhs, "ldl")], list(sizes), ["delta"])


@dataclass(frozen=True, eq=False)
class _Dragging(ForceElement):
    """Linearized friction in a contact, as a force element.

    It does not depend on the normal force, so the derivatives are symmetric. At the m points of
    `contacts`, the force is `drag` (1×m) [N s/m] times the slip velocity without its component
    along `direction` (3×m).
    """

    contacts: ContactElement
    drag: Any
    direction: Any

    def forces(self, at: NodeMotion) -> Any:
        touch = self.contacts.locate_contact(at.N)
        slip, _ = compute_slip(touch.contact, touch.velocities(at.N, at.V))
        slip = slip - self.direction * ca.repmat(ca.sum1(self.direction * slip), 3, 1)
        friction = -slip * ca.repmat(self.drag, 3, 1)
        return _without_friction(self.contacts).forces(at) + self.contacts.assemble(
            touch, at.N, friction
        )


def _without_friction(element: ForceElement) -> ForceElement:
    if not isinstance(element, ContactElement):
        return element
    return replace(element, surface=with_fields(element.surface, friction=None))


def _drag_slopes(
    slopes: Callable[[list[ForceElement]], Any],
    elements: list[ForceElement],
    at: NodeMotion,
    moved: Any,
) -> Any:
    """Compute force derivatives with linearized friction.

    The function `slopes` differentiates the total force of a list of elements with respect to the
    state. For a node far from its final velocity, friction is linearized by the secant from rest
    instead of the derivative. Friction of a sliding node hardly changes, so Newton's method would
    step past rest and back. `at` has the positions and velocities of the nodes. `moved` is the last
    change of the velocities [m/s], small near convergence.
    """
    linear: list[ForceElement] = []
    held: list[tuple[Any, Any]] = []
    for k, element in enumerate(elements):
        if not isinstance(element, ContactElement) or element.surface.friction is None:
            linear.append(element)
            continue
        law, touch = element.surface, element.locate_contact(at.N)
        v = touch.velocities(at.N, at.V)
        slip, steepness = compute_slip(touch.contact, v)
        speed = ca.sqrt(ca.sum1(slip * slip) + law.slip_speed**2)
        push = ca.fmax(press(law, touch.contact, v, element.mode), 0)
        drag = law.friction * (push if steepness is None else push * steepness) / speed
        # Near convergence, the derivative of friction replaces its secant.
        direction = slip * ca.repmat(ca.if_else(moved < 0.3 * speed, 1 / speed, 0), 3, 1)
        symbols = [
            type(at.N).sym(f"{name}{k}", value.shape)
            for name, value in (("drag", drag), ("direction", direction))
        ]
        linear.append(_Dragging(element, *symbols))
        held += zip(symbols, (drag, direction), strict=True)
    if not held:
        return slopes(elements)
    return ca.substitute([slopes(linear)], *(list(side) for side in zip(*held, strict=True)))[0]


def _symmetric(J: Any) -> Any:
    return (J + J.T) / 2
