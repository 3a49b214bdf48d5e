"""The stages of an implicit Runge-Kutta step of a mechanism, found one after the other by small symmetric systems.

Newton's method for all stages at once needs derivatives of the right-hand side and a system of 2 s times as many unknowns. Here the
method's matrix A gives way to the lower triangle L of Crout's A = L U (van der Houwen, de Swart, Triangularly implicit iteration methods
for ODE-IVP solvers, SIAM J. Sci. Comput. 18, 1997): in each sweep stage i solves (I − h lᵢᵢ ∂a/∂v − h² lᵢᵢ² ∂a/∂q) δ = a(qᵢ, vᵢ) − kᵢ for
its acceleration kᵢ. What stays is the method itself, A; L decides only how fast the sweeps converge: by 0.29 or better each (two of
Gauss's points) however stiff the strings, and much faster what is not stiff.

Bars are not stiff, they are rigid: along them δ is the residual itself. So the system is that of free nodes, M − h l C − h² l² K with C and
K from the forces alone, in which very stiff springs hold bars and joints at what the residual asks for. It is symmetric and positive
definite: LDLᵀ, a tenth of the work of other factorisations, and no derivative of the multipliers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from tenscasadi.dynamics import forces
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.events import Held, counts, held_ode, held_scene, switching
from tenscasadi.scene.scene import Scene
from tenscasadi.util.casadi_tools import call_as_sx, sparse
from tenscasadi.util.validate import Array

_RIGID = 1e5  # stiffness that stands in for bars and joints, relative to the stiffest entry: their share of a sweep is exact to its inverse
_DOUBT = 2.0  # times the last change of a stage: how far past its end a string or contact keeps its mode
_BLOCK = 8  # sweeps that are skipped at once when they are not needed


def crout(A: Array) -> Array:
    """L, lower triangular, of A = L U with ones on U's diagonal."""
    n = len(A)
    L, U = np.zeros((n, n)), np.eye(n)
    for j in range(n):
        L[j:, j] = A[j:, j] - L[j:, :j] @ U[:j, j]
        U[j, j + 1 :] = (A[j, j + 1 :] - L[j, :j] @ U[:j, j + 1 :]) / L[j, j]
    return L


def stages(model: Model, A: Array, sweeps: int, tolerance: float) -> ca.Function:
    """(x, u, h) → accelerations of the stages (nq, s) and the last change of a velocity times h, or of a velocity: m or m/s.

    Sweeps end when they move none by more than `tolerance`, or after `sweeps`.
    """
    nq, s = model.nq, len(A)
    symbols = [ca.MX.sym("k", nq, s), ca.MX.sym("changes", 2), ca.MX.sym("x", model.nx), ca.MX.sym("u", model.nu), ca.MX.sym("h")]
    names, results = ["k", "changes", "x", "u", "h"], ["k_next", "changes_next"]
    sweep = ca.Function("sweep", symbols, _sweep(model, A, *symbols), names, results)
    idle = ca.Function("idle", symbols, symbols[:2], names, results)

    def guarded(name: str, function: ca.Function, times: int) -> ca.Function:
        choice = ca.Function.if_else(f"{name}_choice", function, idle)
        k, changes, *rest = symbols
        for _ in range(times):
            k, changes = choice(ca.logic_not(changes[0] <= tolerance), k, changes, *rest)
        return ca.Function(name, symbols, [k, changes], names, results)

    all_sweeps = guarded("all_sweeps", guarded("sweeps", sweep, _BLOCK), -(-sweeps // _BLOCK))
    x, u, h = symbols[2:]
    k, changes = all_sweeps(ca.DM.zeros(nq, s), ca.DM.inf(2), x, u, h)
    return ca.Function("stages", [x, u, h], [k, changes[0]], ["x", "u", "h"], ["k", "change"])


def stage_states(model: Model, A: Array, x: Any, k: Any, h: Any) -> list[Any]:
    """The state at each stage with accelerations k (nq, s)."""
    nq, c = model.nq, A.sum(axis=1)
    q, v, clock = x[:nq], x[nq : 2 * nq], x[2 * nq :]
    Q, V = h**2 * ca.mtimes(k, ca.DM((A @ A).T)), h * ca.mtimes(k, ca.DM(A.T))
    return [ca.vertcat(q + c[i] * h * v + Q[:, i], v + V[:, i], clock + c[i] * h) for i in range(len(A))]


def _sweep(model: Model, A: Array, k: Any, changes: Any, x: Any, u: Any, h: Any) -> list[Any]:
    """All stages once: their accelerations, how far this sweep moved them, and the least that any sweep did."""
    nq, L = model.nq, crout(A)
    squared = L @ L
    gaps = switching(model)
    ode = model.ode if gaps is None else held_ode(model)
    solve = _solver(model)
    found: list[Any] = []
    for i, state in enumerate(stage_states(model, A, x, k, h)):
        for j, change in enumerate(found):
            state = state + ca.vertcat(h**2 * squared[i, j] * change, h * L[i, j] * change, ca.DM.zeros(model.nx - 2 * nq))
        w = u
        if gaps is not None:
            # The first sweep keeps the step's first mode. Then strings are held taut while they are too short by less than stages
            # still move: they would let go and catch in turns. The least move counts, or that would begin anew when one does let go.
            least = changes[1]
            doubt = ca.if_else(least < np.inf, _DOUBT * least, 0) * (h + _lead(model))
            w = ca.vertcat(u, ca.if_else(least < np.inf, gaps(state, u) > -doubt, gaps(x, u) > 0))
        found.append(solve(state, w, h * L[i, i], ode(state, w)[nq : 2 * nq] - k[:, i]))
    delta = ca.horzcat(*found)
    moved = h * ca.fmax(1, h) * ca.norm_inf(ca.vec(delta))
    return [k + delta, ca.vertcat(moved, ca.fmin(changes[1], moved))]


def _lead(model: Model) -> ca.DM:
    """By how much a switching function moves with a velocity, s: damping over stiffness (k,)."""
    scene, (strings, nodes) = model.scene, counts(model)
    s = scene.modelled
    lead = np.divide(s.damping, s.stiffness, out=np.zeros(len(s.damping)), where=s.stiffness > 0)[:strings]
    ground = np.full(nodes, scene.ground.damping / scene.ground.stiffness if scene.ground is not None else 0.0)
    return ca.DM(np.concatenate([lead, ground]))


def _solver(model: Model) -> ca.Function:
    """(x, w, g, r) → δ with (I − g ∂a/∂v − g² ∂a/∂q) δ = r, close enough to converge; w as for `held_ode`."""
    mech, nq = model.mechanism, model.nq
    free = np.flatnonzero(mech.free.ravel())
    M = sparse(sp.csr_array(sp.kron(mech.M, sp.eye_array(3)))[free][:, free])
    strings, nodes = counts(model)

    def linear(x: Any, w: Any, g: Any, r: Any) -> tuple[Any, ...]:
        N, V, time = model.unpack(x)
        u, taut, touching = w[: model.nu], w[model.nu : model.nu + strings].T, w[model.nu + strings :].T
        scene = held_scene(model.scene, taut if strings else None, touching)
        length = type(x).sym("length", 1, strings)
        springs = replace(scene, slack=_Pulling(taut, length)) if strings else scene
        if springs.ground is not None:
            springs = replace(springs, ground=replace(springs.ground, friction=None))  # its share is not symmetric

        def push(scene: Scene) -> Any:
            F = sum(forces.terms(scene, mech, N, V, u, time).values(), start=ca.DM.zeros(*mech.N.shape))
            return model.pack(F, F, 0)[:nq]

        S = ca.mtimes(N, sparse(mech.C_s.T))
        K = ca.substitute(ca.jacobian(push(springs), x)[:, :nq], length, ca.sqrt(ca.sum1(S * S))) if strings else ca.jacobian(push(scene), x)[:, :nq]
        C = ca.jacobian(push(scene), x)[:, nq : 2 * nq]
        W = M - g * _symmetric(C) - g**2 * _symmetric(K)
        B = ca.mtimes(N, sparse(mech.C_b.T))
        kept = ca.vertcat(ca.sum1(B * B).T / ca.DM(2 * mech.lengths), ca.vec(ca.mtimes(N, sparse(mech.P)) * ca.DM(mech.active.astype(float))))
        G = ca.jacobian(kept, x)[:, :nq]
        rigid = _RIGID * ca.mmax(ca.diag(W)) * ca.mtimes(G.T, G)
        return W + rigid, ca.mtimes(M + rigid, r)

    symbols: list[Any] = [ca.MX.sym("x", model.nx), ca.MX.sym("w", model.nu + strings + nodes), ca.MX.sym("g"), ca.MX.sym("r", nq)]
    matrix, rhs = call_as_sx(mech.large, linear, *symbols)
    return ca.Function("solver", symbols, [ca.solve(matrix, rhs, "ldl")], ["x", "w", "g", "r"], ["delta"])


@dataclass(frozen=True, eq=False)
class _Pulling(Held):
    """Strings that pull where they are taut, none with less than no force: what pushes would make the system indefinite. No damping."""

    length: Any

    def force_density(self, squared: Any, rest: Any, stiffness: Any, rate: Any | None, unit: Any) -> Any:
        return super().force_density(squared, ca.fmin(rest, self.length), stiffness, None, unit)


def _symmetric(J: Any) -> Any:
    return (J + J.T) / 2
