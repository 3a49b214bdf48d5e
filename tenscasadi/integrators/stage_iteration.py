"""Stages of a collocation step by triangular iteration: sweeps of small symmetric systems in place of Newton's method for all at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.dynamics import forces
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.events import (
    build_held_ode,
    build_switching,
    count_switches,
    split_mode,
)
from tenscasadi.scene.binding import bind, with_fields
from tenscasadi.scene.ground import Contact, Surface, along, slip_velocity
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import Smooth
from tenscasadi.util.casadi_tools import call_as_sx, constant_row, sparse
from tenscasadi.util.validate import Array

# stiffness that stands in for bars and joints, relative to the stiffest entry: their share of a
# sweep is exact to its inverse
_RIGID = 1e5
_DOUBT = (
    2.0  # times the last change of a stage: how far past its end a string or contact keeps its mode
)
# of the slip and the slip speed together: velocities that move by less follow the slope of friction
_SMOOTH = 0.3
_BLOCK = 8  # sweeps that are skipped at once when they are not needed


def factor_crout(A: Array) -> Array:
    """Return L, lower triangular, of A = L U with ones on U's diagonal."""
    n = len(A)
    L, U = np.zeros((n, n)), np.eye(n)
    for j in range(n):
        L[j:, j] = A[j:, j] - L[j:, :j] @ U[:j, j]
        U[j, j + 1 :] = (A[j, j + 1 :] - L[j, :j] @ U[:j, j + 1 :]) / L[j, j]
    return L


def solve_stages(model: Model, A: Array, sweeps: int) -> ca.Function:
    """Return (x, u, h, tolerance) → accelerations of the stages (nq, s) and the last change of a velocity times h, or of a velocity: m or m/s.

    Stages are found one after the other by small symmetric systems, in sweeps that end when they
    move none by more than the tolerance, or after `sweeps`.

    Newton's method for all stages at once needs derivatives of the right-hand side and a system of
    2 s times as many unknowns. Here the method's matrix A gives way to the lower triangle L of
    Crout's A = L U [1]_: in each sweep stage i solves (I − h lᵢᵢ ∂a/∂v − h² lᵢᵢ² ∂a/∂q) δ = a(qᵢ,
    vᵢ) − kᵢ for its acceleration kᵢ. What stays is the method itself, A; L decides only how fast
    the sweeps converge: by 0.29 or better each (two of Gauss's points) however stiff the strings,
    and much faster what is not stiff.

    Bars are not stiff, they are rigid: along them δ is the residual itself. So the system is that
    of free nodes, M − h l C − h² l² K with C and K from the forces alone, in which very stiff
    springs hold bars and joints at what the residual asks for. It is symmetric and positive
    definite: LDLᵀ, a tenth of the work of other factorizations, and no derivative of the
    multipliers.

    .. [1] van der Houwen, de Swart, Triangularly implicit iteration methods for ODE-IVP solvers,
    SIAM J. Sci. Comput. 18, 1997.
    """
    nq, s = model.nq, len(A)
    sizes = {
        "k": (nq, s),
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

    def guarded(name: str, function: ca.Function, times: int) -> ca.Function:
        choice = ca.Function.if_else(f"{name}_choice", function, idle)
        k, changes, *rest = symbols
        for _ in range(times):
            k, changes = choice(ca.logic_not(changes[0] <= rest[-1]), k, changes, *rest)
        return ca.Function(name, symbols, [k, changes], names, results)

    all_sweeps = guarded("all_sweeps", guarded("sweeps", sweep, _BLOCK), -(-sweeps // _BLOCK))
    k, changes = all_sweeps(ca.DM.zeros(nq, s), ca.DM.inf(2), *symbols[2:])
    return ca.Function("stages", symbols[2:], [k, changes[0]], names[2:], ["k", "change"])


def stage_states(model: Model, A: Array, x: Any, k: Any, h: Any) -> list[Any]:
    """Return the state (nx,) at each stage with accelerations k (nq, s)."""
    c, (q, v, clock) = A.sum(axis=1), model.split(x)
    Q, V = h**2 * ca.mtimes(k, ca.DM((A @ A).T)), h * ca.mtimes(k, ca.DM(A.T))
    return [
        ca.vertcat(q + c[i] * h * v + Q[:, i], v + V[:, i], clock + c[i] * h) for i in range(len(A))
    ]


def _sweep(model: Model, A: Array, k: Any, changes: Any, x: Any, u: Any, h: Any) -> list[Any]:
    """All stages once: their accelerations, how far this sweep moved them, and the least that any sweep did."""
    L = factor_crout(A)
    squared = L @ L
    gaps = build_switching(model)
    ode = model.stacked(model.ode) if gaps is None else build_held_ode(model)
    solve = _solver(model)
    found: list[Any] = []
    for i, state in enumerate(stage_states(model, A, x, k, h)):
        for j, change in enumerate(found):
            state = state + ca.vertcat(
                h**2 * squared[i, j] * change,
                h * L[i, j] * change,
                ca.DM.zeros(model.nx - 2 * model.nq),
            )
        w = u
        if gaps is not None:
            # The first sweep keeps the step's first mode. Then strings are held taut while they are
            # too short by less than stages still move: they would let go and catch in turns. The
            # least move counts, or that would begin anew when one does let go.
            least = changes[1]
            doubt = ca.if_else(least < np.inf, _DOUBT * least, 0) * (h + _lead(model, u))
            w = ca.vertcat(u, ca.if_else(least < np.inf, gaps(state, u) > -doubt, gaps(x, u) > 0))
        found.append(
            solve(state, w, h * L[i, i], model.split(ode(state, w))[1] - k[:, i], changes[0])
        )
    delta = ca.horzcat(*found)
    moved = h * ca.fmax(1, h) * ca.norm_inf(ca.vec(delta))
    return [k + delta, ca.vertcat(moved, ca.fmin(changes[1], moved))]


def _lead(model: Model, u: Any) -> Any:
    """By how much a switching function moves with a velocity, s: damping over stiffness (k,)."""
    scene = bind(model.scene, u)[0]
    stiffness, damping = (
        constant_row(scene.modelled.stiffness),
        constant_row(scene.modelled.damping),
    )
    lead = ca.if_else(stiffness > 0, damping / stiffness, 0).T
    lead = ca.densify(
        lead if lead.shape[0] != 1 else ca.repmat(lead, len(scene.modelled.strings), 1)
    )
    clamped = ca.DM(np.isin(scene.switching_strings, scene.clamped_strings).astype(float))
    contacts = forces.contacts(scene, model.mechanism)
    grounds = [
        ca.repmat(ca.densify(ground.damping / ground.stiffness), len(columns), 1)
        for ground, columns, _ in contacts
    ]
    switching = ca.reshape(
        lead[scene.switching_strings.tolist()], clamped.shape[0], 1
    )  # a column, without entries too
    return ca.vertcat(switching * clamped, *grounds)


def _solver(model: Model) -> ca.Function:
    """(x, w, g, r, moved) → δ with (I − g ∂a/∂v − g² ∂a/∂q) δ = r, close enough to converge; w as for `build_held_ode`.

    moved, m/s: by how much the last sweep moved velocities.
    """
    nq = model.nq

    def linear(x: Any, w: Any, g: Any, r: Any, moved: Any) -> tuple[Any, ...]:
        N, V, time = model.unpack(x)
        u, mode = split_mode(model, w)
        u, mech = model.add_schedule(u, time), model.weighted(u, inverse=False)
        M = sparse(mech.free_mass)

        def slopes(scene: Scene, longest: Any = None) -> Any:
            found = forces.terms(scene, mech, N, V, u, time, mode)
            if (
                longest is not None
            ):  # no string with less than no force: what pushes would make the system indefinite
                pulling = forces.string_force_density(
                    scene, mech, N, V, u, damped=False, taut=mode.taut, longest=longest
                )
                found["strings"] = forces.string_forces(mech, *pulling)
            F = sum(found.values(), start=ca.DM.zeros(*mech.N.shape))
            return ca.jacobian(model.split(model.pack(F, F, 0))[0], x)

        rubs = any(ground.friction is not None for ground in model.scene.grounds)
        slope = _drag_slopes(model, slopes, N, V, u, mode, moved) if rubs else slopes(model.scene)
        K, C = ca.horzsplit(slope, [0, nq, 2 * nq, model.nx])[:2]
        if any(
            len(which) and not isinstance(law, Smooth) for law, which in model.scene.string_laws
        ):
            S = ca.mtimes(N, sparse(mech.C_s.T))
            length = type(x).sym("length", 1, S.shape[1])
            frictionless = with_fields(
                model.scene, ground=tuple(map(_without_friction, model.scene.grounds)) or None
            )
            K = ca.substitute(slopes(frictionless, length)[:, :nq], length, ca.sqrt(ca.sum1(S * S)))
        W = M - g * _symmetric(C) - g**2 * _symmetric(K)
        kept = model.constraints(x)
        G = ca.jacobian(ca.vertcat(kept.bars, kept.joints), x)[:, :nq]
        rigid = _RIGID * ca.mmax(ca.diag(W)) * ca.mtimes(G.T, G)
        return W + rigid, ca.mtimes(M + rigid, r)

    sizes = {"x": model.nx, "w": model.nw + sum(count_switches(model)), "g": 1, "r": nq, "moved": 1}
    symbols: list[Any] = [ca.MX.sym(name, size) for name, size in sizes.items()]
    matrix, rhs = call_as_sx(model.mechanism.large, linear, *symbols)
    return ca.Function("solver", symbols, [ca.solve(matrix, rhs, "ldl")], list(sizes), ["delta"])


@dataclass(frozen=True, eq=False)
class _Dragging(Surface):
    """A ground whose friction is linear in the velocity and does not change with the push: its slopes are symmetric.

    It is drag (1×n), N s/m, times the slip, less what of it goes along a direction (3×n).
    """

    frictionless: Surface
    drag: Any
    direction: Any
    nodes: Any

    def contact(self, N: Any) -> Contact:
        return self.frictionless.contact(N)

    def forces(self, N: Any, V: Any, touching: Any = None) -> Any:
        slip, _ = slip_velocity(self.contact(N), V)
        slip = slip - self.direction * ca.repmat(ca.sum1(self.direction * slip), 3, 1)
        return self.frictionless.forces(N, V, touching) - slip * ca.repmat(self.drag, 3, 1)


def _without_friction(ground: Any) -> Surface:
    frictionless: Surface = with_fields(ground, friction=None)
    return frictionless


def _drag_slopes(
    model: Model,
    slopes: Callable[[Scene], Any],
    N: Any,
    V: Any,
    u: Any,
    mode: forces.Mode,
    moved: Any,
) -> Any:
    """Return `slopes` of the scene with the friction of `_Dragging` in place of the grounds'.

    While velocities still move by more than friction is smooth over, its secant from rest stands in
    for its slope: from a sliding node, whose friction hardly changes, Newton's method would step
    past rest and back.
    """
    grounds: list[Surface] = []
    held: list[tuple[Any, Any]] = []
    for k, (ground, columns, places) in enumerate(
        forces.contacts(bind(model.scene, u)[0], model.mechanism)
    ):
        frictionless = _without_friction(ground)
        if ground.friction is None:
            grounds.append(ground)
            continue
        n, v, contact = N[:, columns], V[:, columns], ground.contact(N[:, columns])
        slip, share = slip_velocity(contact, v)
        speed = ca.sqrt(ca.sum1(slip * slip) + ground.slip_speed**2)
        push = ca.fmax(
            along(contact.outward, frictionless.forces(n, v, mode.touching[:, places])), 0
        )
        drag = ground.friction * (push if share is None else push / share) / speed
        direction = slip * ca.repmat(ca.if_else(moved < _SMOOTH * speed, 1 / speed, 0), 3, 1)
        symbols = [
            type(N).sym(f"{name}{k}", value.shape)
            for name, value in (("drag", drag), ("direction", direction))
        ]
        grounds.append(_Dragging(frictionless, symbols[0], symbols[1], ground.nodes))
        held += zip(symbols, (drag, direction), strict=True)
    return ca.substitute(
        [slopes(with_fields(model.scene, ground=tuple(grounds)))],
        *(list(side) for side in zip(*held, strict=True)),
    )[0]


def _symmetric(J: Any) -> Any:
    return (J + J.T) / 2
