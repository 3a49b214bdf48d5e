"""Equilibria with friction and non-conservative loads."""

from __future__ import annotations

import numpy as np

from tenscasadi.statics.solver.motions import find_stable_factors
from tenscasadi.statics.solver.newton_system import NewtonSystem
from tenscasadi.statics.solver.static_equations import Conditions
from tenscasadi.statics.solver.trust_region import (
    ACCURACY,
    SearchResult,
    allowed_residual,
    find_rest,
    pull_to_bars,
)
from tenscasadi.structure.class_one import measure_extent
from tenscasadi.util.validate import MAX_ITERATIONS, ROUNDING, TOLERANCE, Array

ROUGH = 1e-4  # accuracy before the final Newton iterations, relative to the largest force


def settle(system: NewtonSystem, nodes: Array, given: Conditions) -> SearchResult:
    """Find a stable equilibrium under all static loads.

    Loads may have no energy. Contacts with friction slip as little as possible from the initial
    nodes.

    Parameters
    ----------
    system : NewtonSystem
        Newton systems of the scene.
    nodes : ndarray, shape (n, 3)
        Start of the search [m].
    given : Conditions
        Inputs and time. Its slip distance is that of the final equilibrium.

    Returns
    -------
    SearchResult
        The equilibrium, or the last iterate and the reason.
    """
    if system.equations.has_friction:
        given = prepare_friction(system, nodes, given)
        deep = nodes - structure_size(nodes) * system.equations.ground_normals(nodes)
        stuck = find_rest(system, nodes, given._replace(pressing=deep), ROUGH)
        rest = find_rest(system, stuck.point.nodes, given, ROUGH)
    else:
        # forces without an energy lead away from equilibrium: the final Newton iterations reach it
        symmetric = system.is_symmetric(system.equations.at(nodes, given))
        rest = find_rest(system, nodes, given, ACCURACY if symmetric else ROUGH)
    exact = not system.equations.has_friction and system.is_symmetric(rest.point)
    return rest if exact else finish(system, rest, given._replace(pressing=None))


def prepare_friction(system: NewtonSystem, nodes: Array, given: Conditions) -> Conditions:
    """Set the reference nodes (n, 3) from which slip in contacts is measured.

    Returns `given` with these nodes, if there is friction.
    """
    if not system.equations.has_friction:
        return given
    return given._replace(anchor=nodes, slip=TOLERANCE * structure_size(nodes))


def structure_size(nodes: Array) -> float:
    """Compute the largest extent of the nodes [m].

    It is 1 if all nodes coincide.
    """
    return measure_extent(nodes) or 1.0


def finish(system: NewtonSystem, rest: SearchResult, given: Conditions) -> SearchResult:
    """Find an equilibrium by Newton's method with the exact tangent.

    The start is near an equilibrium.

    Parameters
    ----------
    system : NewtonSystem
        Newton systems of the scene.
    rest : SearchResult
        Start.
    given : Conditions
        Inputs, time and friction.

    Returns
    -------
    SearchResult
        The equilibrium, or the start where the iterations do not converge.
    """
    equations = system.equations
    point, tension = equations.at(rest.point.nodes, given), rest.tension
    for step in range(MAX_ITERATIONS):
        bars = equations.bar_forces(point, tension)
        residual = equations.in_free_directions(point.applied + bars)
        if np.abs(residual).max(initial=0.0) <= allowed_residual(system, point, tension):
            # its stiffness is that with constant normal forces, which is symmetric
            point = equations.at(point.nodes, given._replace(pressing=point.nodes))
            stable = find_stable_factors(system, point, tension) is not None
            found = stable or find_stable_factors(system, point, tension, ROUNDING) is not None
            reason = "" if found else "the equilibrium found is unstable"
            steps = rest.iterations + step
            return SearchResult(point, tension, residual, found, stable, not found, reason, steps)
        try:
            p, change = system.solve_unsymmetric(
                point, tension, residual, -equations.bar_errors(point.nodes)
            )
        except np.linalg.LinAlgError:
            break
        nodes = pull_to_bars(
            system, equations.displace(point.nodes, p), system.factor_bars(point.bars)
        )
        if nodes is None or not np.isfinite(nodes).all():
            break
        point, tension = equations.at(nodes, given), tension + change
    reason = rest.reason or "the forces of the loads do not balance near the minimum of the energy"
    return rest._replace(converged=False, stalled=True, reason=reason)
