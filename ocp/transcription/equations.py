"""Equations of motion as residuals of accelerations and multipliers."""

from __future__ import annotations

import casadi as ca
import numpy as np

from ocp.transcription.mesh import project_states
from tenscasadi.dynamics.equation_of_motion import compute_forces
from tenscasadi.dynamics.linearization import EquationDerivatives, displacements
from tenscasadi.dynamics.model import Model
from tenscasadi.structure.class_one import measure_extent
from tenscasadi.util.casadi_tools import sparse, symbol_kind
from tenscasadi.util.linear_algebra import null_space
from tenscasadi.util.validate import Array, Indices


def constraint_names(model: Model) -> tuple[str, ...]:
    """Name the independent constraints of bars and joints."""
    joints = int(model.mechanism.active.sum())
    names = [f"{name} length" for name in model.mechanism.bar_names]
    names += [f"joint constraint {k}" for k in range(joints)]
    return tuple(names[k] for k in find_independent(model))


def find_independent(model: Model) -> Indices:
    """Find the independent constraints of bars and joints.

    Multipliers of dependent constraints would not be unique. The rank is tested at a configuration
    near the initial one, because special configurations, such as a folded linkage, make further
    constraints dependent.
    """
    return model.keep("independent constraints", lambda: _find_independent(model))


def _find_independent(model: Model) -> Indices:
    near, negligible = 1e-2, 1e-6  # × the size of the structure; of rows of unit length
    start, inputs = model.initial_state, np.append(np.zeros(model.nu), model.parameters.nominal)
    moved, ways = start.copy(), displacements(model, start)
    size = near * measure_extent(model.structure.nodes)
    moved[: model.nq] += size * ways @ np.random.default_rng(0).uniform(-1.0, 1.0, ways.shape[1])
    moved = project_states(model, moved[None], 5)[0]
    J = EquationDerivatives.of(model).system_at(moved, inputs)[1].toarray()
    lengths = np.linalg.norm(J, axis=1)
    redundant = null_space((J / np.where(lengths > 0, lengths, 1.0)[:, None]).T, negligible)
    kept = np.arange(len(J))
    while redundant.shape[1]:
        weight = np.linalg.norm(redundant, axis=1)
        # the last of the large weights: rounding does not decide between equal ones
        left_out = np.flatnonzero(weight > 0.1 * weight.max())[-1]
        kept = kept[kept != left_out]
        redundant = redundant @ null_space(redundant[left_out, None], 0.0)
    return kept


def build_constraints(model: Model) -> ca.Function:
    """Build the independent constraints, their rates and forces.

    Constraints are those of bars and joints. The Function is (x, μ) → constraints [m], rates [m/s],
    Jᵀμ [N], where Jᵀμ (nq) acts on the free coordinates.
    """
    kind, chosen = symbol_kind(model.ode), find_independent(model).tolist()
    x = kind.sym("x", model.nx)
    kept = model.constraints(x)
    values = ca.densify(ca.vertcat(kind(0, 1), kept.bars, kept.joints))[chosen]
    rates = ca.densify(ca.vertcat(kind(0, 1), kept.bar_rates, kept.joint_rates))[chosen]
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
    """Compute the multipliers (n, c) [N] at states and controls.

    Multipliers of the c bar and joint constraints are zero where undefined, such as that of a bar
    of zero length.
    """
    found = EquationDerivatives.of(model).at(states, controls).multipliers
    kept = found[:, find_independent(model)]
    return np.asarray(np.nan_to_num(kept, posinf=0.0, neginf=0.0))
