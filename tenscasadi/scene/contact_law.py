"""Penalty law of contacts: normal force, switching function and slip."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca


class Contact(NamedTuple):
    """Penetration of n points into a surface.

    `depth` is the penetration depth, and `outward` the direction of the normal force, of length
    `steepness`. `weight` multiplies the force.
    """

    depth: Any  # 1×n [m], negative above the surface
    outward: Any  # −∂depth/∂n, 3×n, or 3×1 if it is the same for all nodes
    steepness: Any  # length of `outward`, 1×n, or None if it is 1
    weight: Any = None  # factors on stiffness and damping, 1×n, or None if they are 1


def press(law: Any, contact: Contact, V: Any, touching: Any = None) -> Any:
    """Compute the normal forces w (k d − c v) (1×n) [N], at least 0.

    w are the weights of the contact points, d the depths and v the normal velocities. `law` has
    stiffness k and damping c, and V (3×n) [m/s] are relative velocities. If the flags `touching`
    (1×n) are given, the forces are not limited, and vanish where a flag is 0. `contact` has
    weights, depths and normal directions.
    """
    depth, outward = contact.depth, contact.outward
    push = law.stiffness * depth
    if isinstance(law.damping, ca.SX | ca.MX | ca.DM) or law.damping:  # a parameter, or not 0
        push = push - law.damping * along(outward, V)
        push = ca.fmax(push, 0) if touching is None else push
    if contact.weight is not None:
        push = push * contact.weight
    return ca.if_else(depth > 0, push, 0) if touching is None else touching * push


def compute_forces(law: Any, contact: Contact, V: Any, touching: Any = None) -> Any:
    """Compute contact forces (3×n) [N] with normal and friction parts.

    `law` is a ground or `BarContact`, with the friction coefficient μ and the slip velocity v_s.
    `contact` has depths and normal directions; for `touching` see `press`. V (3×n) [m/s] are
    relative velocities v of the touching surfaces. Coulomb's friction is μ f v_t/√(v_t² + v_s²) for
    the normal force f and the tangential velocity v_t.
    """
    push = press(law, contact, V, touching)
    W = times(contact.outward, push)
    if law.friction is None:
        return W
    slip, steepness = compute_slip(contact, V)
    normal_force = push if steepness is None else push * steepness
    regularized = ca.sqrt(ca.sum1(slip * slip) + law.slip_speed**2)
    return W - slip * ca.repmat(law.friction * normal_force / regularized, 3, 1)


def find_switching(law: Any, contact: Contact, V: Any) -> Any:
    """Compute functions (1×n) [m] whose signs change as normal forces begin or end.

    They are positive where the surfaces overlap and the damped normal force presses. `law` is a
    ground or `BarContact`. V (3×n) [m/s] are relative velocities of the touching surfaces.
    `contact` has the penetration depths.
    """
    depth = contact.depth
    return ca.fmin(depth, depth - law.damping / law.stiffness * along(contact.outward, V))


def along(outward: Any, V: Any) -> Any:
    """Compute the components (1×n) of vectors V (3×n) along `outward`.

    `outward` is one direction for each vector (3×n), or one for all (3×1).
    """
    return ca.mtimes(outward.T, V) if outward.shape[1] == 1 else ca.sum1(outward * V)


def times(outward: Any, row: Any) -> Any:
    """Multiply the columns of `outward` by the entries of a row (1×n).

    `outward` has n columns, or one for all. The result is 3×n.
    """
    return ca.mtimes(outward, row) if outward.shape[1] == 1 else outward * ca.repmat(row, 3, 1)


def compute_slip(contact: Contact, V: Any) -> tuple[Any, Any]:
    """Compute the slip velocities (3×n) along a surface [m/s].

    V (3×n) [m/s] are relative velocities of the touching surfaces. Also returns the ratio (1×n) of
    the normal force to k d − c v, None if it is 1. `contact` has the normal directions.
    """
    outward, steepness = contact.outward, contact.steepness
    if steepness is None:
        return V - times(outward, along(outward, V)), None
    return V - times(outward, along(outward, V) / steepness**2), steepness
