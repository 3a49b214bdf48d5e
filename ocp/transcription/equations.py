"""Equations of motion in accelerations and multipliers."""

from __future__ import annotations

import casadi as ca
import numpy as np

from tenscasadi.dynamics.equation_of_motion import compute_forces, forward_dynamics
from tenscasadi.dynamics.model import Model
from tenscasadi.util.casadi_tools import sparse, symbol_kind
from tenscasadi.util.validate import Array


def constraint_names(model: Model) -> tuple[str, ...]:
    """Name the constraints of bars and joints."""
    joints = len(model.constraints(model.initial_state).joints)
    bars = [f"{name} length" for name in model.mechanism.bar_names]
    return (*bars, *(f"joint constraint {k}" for k in range(joints)))


def build_constraints(model: Model) -> ca.Function:
    """Build the constraints, their rates and their forces.

    Constraints are those of bars and joints. The Function is (x, μ) → constraints [m], rates [m/s],
    Jᵀμ [N], where Jᵀμ (nq) acts on the free coordinates.
    """
    kind = symbol_kind(model.ode)
    x = kind.sym("x", model.nx)
    kept = model.constraints(x)
    values = ca.densify(ca.vertcat(kind(0, 1), kept.bars, kept.joints))
    rates = ca.densify(ca.vertcat(kind(0, 1), kept.bar_rates, kept.joint_rates))
    mu = kind.sym("mu", rates.shape[0])
    forces = model.split(ca.jtimes(rates, x, mu, True)).velocities
    return ca.Function("constraints", [x, mu], [values, rates, forces])


def build_residuals(model: Model) -> ca.Function:
    """Build the residuals of the equations of motion.

    The Function is (x, u, r, μ) → M a − F − Jᵀμ (nq) [N], J a + c [m/s²], b − g (na). The rates r
    are the accelerations a of the free coordinates, followed by the rates b of the internal states,
    which are g. μ are the multipliers of the constraints.
    """
    constraints, kind = build_constraints(model), symbol_kind(model.ode)
    sizes = {"x": model.nx, "u": model.nu, "r": model.nq + model.na}
    x, u, r = (kind.sym(name, size) for name, size in sizes.items())
    a, b = r[: model.nq], r[model.nq :]
    mu = kind.sym("mu", constraints.size1_in(1))
    _, rates, push = constraints(x, mu)
    N, V, time = model.unpack(x)
    F, _ = compute_forces(model, N, V, model.extend_inputs(x, u), time)
    forces = model.mechanism.generalized_forces(F) + push
    _, v, _, clock = model.split(x)
    drift = ca.vertcat(v, r, kind.ones(*clock.shape))
    bends = ca.jtimes(rates, x, drift)
    M = sparse(model.mechanism.free_mass)
    changes = b - model.internal_rates(x, u)
    return ca.Function("residuals", [x, u, r, mu], [ca.mtimes(M, a) - forces, bends, changes])


def evaluate_multipliers(model: Model, states: Array, controls: Array) -> Array:
    """Compute the multipliers (n, c) [N] of states and controls.

    Undefined multipliers are zero, such as those of a bar of zero length.
    """
    kind, mech = symbol_kind(model.ode), model.mechanism
    x, u = kind.sym("x", model.nx), kind.sym("u", model.nu)
    N, V, time = model.unpack(x)
    _, lam, Omega = forward_dynamics(model, N, V, model.extend_inputs(x, u), time)
    held = np.flatnonzero(mech.active.ravel(order="F")).tolist()
    joints = ca.vec(ca.densify(Omega))
    if mech.frames is not None:
        joints = ca.mtimes(mech.constrained_directions.T, joints)
    mu = ca.densify(ca.vertcat(lam.T * ca.DM(mech.lengths), joints[held]))
    found = ca.Function("multipliers", [x, u], [mu]).map(len(states))(states.T, controls.T)
    return np.asarray(np.nan_to_num(found.full().T, posinf=0.0, neginf=0.0))
