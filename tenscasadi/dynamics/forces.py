"""Forces on the columns of N (Eq. 67).

They are F = W − S γ̂ C_s.

F (3×n) and its potential energy are built from the features that the scene has. In full coordinates
loads act on the first copy of each physical node, unless another one is given. If the scene has
parameters, they follow the control in u (nu + np).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from tenscasadi.dynamics.mechanism import Mechanism
from tenscasadi.scene.binding import bind
from tenscasadi.scene.ground import Surface
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import ForceDensity, RestLength, Smooth, StringLaw
from tenscasadi.util.casadi_tools import constant_row, is_expression, sparse, weighted_product
from tenscasadi.util.validate import Array, Indices


class Mode(NamedTuple):
    """Contact mode: taut strings (1×k) and active contacts (1×c).

    Entries are 1 or 0, whatever the length or depth. None: they follow from length and depth.
    """

    taut: Any
    touching: Any


FREE = Mode(None, None)


def string_force_density(
    scene: Scene,
    mech: Mechanism,
    N: Any,
    V: Any,
    u: Any,
    damped: bool = True,
    taut: Any = None,
    longest: Any = None,
) -> tuple[Any, Any]:
    """Compute force densities γ (1×α) [N/m] and string vectors S.

    S is (3×α) [m]. `taut`: see `Mode`. `longest` (1×α) [m]: upper bounds of rest lengths, which
    smooth strings ignore.
    """
    scene, u = bind(scene, u)
    S = ca.mtimes(N, sparse(mech.C_s.T))  # 3×α, Eq. 66
    if isinstance(scene.control, ForceDensity):
        return _per_child(
            scene, u, 1 / scene.modelled.string_fraction
        ), S  # the tension is constant along a straight parent string
    switching = scene.switching_strings

    def law_of(
        law: StringLaw,
        which: Indices,
        squared: Any,
        rest: Any,
        stiffness: Any,
        rate: Any,
        unit: Any,
    ) -> Any:
        if longest is not None and not isinstance(law, Smooth):
            rest = ca.fmin(rest, _columns(longest, which))
        held = (
            taut
            if taut is None or not law.switches or len(which) == len(switching)
            else taut[:, np.searchsorted(switching, which).tolist()]
        )
        return law.force_density(squared, rest, stiffness, rate, unit, held)

    return _by_law(scene, law_of, _law_inputs(scene, mech, S, V, u, damped)), S


def string_gaps(scene: Scene, mech: Mechanism, N: Any, V: Any, u: Any) -> Any:
    """Compute gap lengths (1×k) of switching strings.

    They are in m, positive if the string is taut.
    """
    scene, u = bind(scene, u)
    inputs = _law_inputs(scene, mech, ca.mtimes(N, sparse(mech.C_s.T)), V, u, True)
    return _by_law(scene, lambda law, which, *rows: law.gap(*rows), inputs, switching=True)


def _law_inputs(
    scene: Scene, mech: Mechanism, S: Any, V: Any, u: Any, damped: bool
) -> tuple[Any, ...]:
    """Compute the inputs of string laws.

    They are rows over modeled strings.

    They are squared lengths, rest lengths, stiffness, rates, and typical lengths.
    """
    s = scene.modelled
    rate = None
    if damped and is_damped(scene):
        rate = ca.sum1(S * ca.mtimes(V, sparse(mech.C_s.T))) * constant_row(
            s.damping
        )  # c sᵀṡ, Eq. 98
    return (
        ca.sum1(S * S),
        _rest(scene, u),
        constant_row(s.stiffness),
        rate,
        constant_row(s.rest_length),
    )


def _by_law(
    scene: Scene, evaluate: Callable[..., Any], rows: tuple[Any, ...], switching: bool = False
) -> Any:
    """Evaluate a function per string law and join the rows.

    `evaluate` has the arguments law, its strings, and their entries of `rows`. With `switching`,
    only laws that switch are included.
    """
    laws = [(law, which) for law, which in scene.string_laws if law.switches or not switching]
    if len(scene.string_laws) == 1:
        return evaluate(*laws[0], *rows)
    damping = scene.modelled.damping
    parts = []
    for law, which in laws:
        squared, rest, stiffness, rate, unit = (
            None if row is None else _columns(row, which) for row in rows
        )
        parts.append(
            evaluate(
                law,
                which,
                squared,
                rest,
                stiffness,
                rate if is_expression(damping) or np.any(damping[which] > 0) else None,
                unit,
            )
        )
    place = np.argsort(np.concatenate([which for _, which in laws]))
    return ca.horzcat(*parts)[:, place.tolist()]


def _columns(row: Any, which: Indices) -> Any:
    return row if row.shape[1] == 1 else row[:, which.tolist()]


def is_damped(scene: Scene) -> bool:
    """Return whether any string has damping.

    Strings under force-density control have none.
    """
    if isinstance(scene.control, ForceDensity):
        return False
    damping = scene.modelled.damping
    return is_expression(damping) or scene.has_parameter("damping") or bool(np.any(damping > 0))


def is_rough(scene: Scene) -> bool:
    """Return whether any ground has damping or friction."""
    return scene.has_parameter("ground_damping") or any(
        not ground.conservative for ground in scene.grounds
    )


def contacts(scene: Scene, mech: Mechanism) -> list[tuple[Surface, list[int], slice]]:
    """List each ground with its columns and contact indices.

    There is one column of N for each node.
    """
    found: list[tuple[Surface, list[int], slice]] = []
    count = 0
    for ground in scene.grounds:
        columns = mech.first if ground.nodes is None else mech.first[list(ground.nodes)]
        found.append((ground, columns.tolist(), slice(count, count := count + len(columns))))
    return found


def string_forces(mech: Mechanism, gamma: Any, S: Any) -> Any:
    """Compute −S γ̂ C_s (3×n, Eq. 56) [N]."""
    return weighted_product(S, gamma, -mech.C_s)


def terms(
    scene: Scene, mech: Mechanism, N: Any, V: Any, u: Any, time: Any, mode: Mode = FREE
) -> dict[str, Any]:
    """Compute the terms of F (3×n) [N] by name."""
    scene, u = bind(scene, u)
    first = mech.first.tolist()
    result: dict[str, Any] = {}
    if len(scene.modelled.strings):
        result["strings"] = string_forces(
            mech, *string_force_density(scene, mech, N, V, u, taut=mode.taut)
        )
    if scene.gravity is not None:
        result["gravity"] = _weights(scene, mech, time)
    if scene.ground is not None:
        result["ground"] = _ground_forces(scene, mech, N, V, mode.touching)
    if scene.pressure is not None:
        result["pressure"] = _on_first(mech, scene.pressure.forces(N[:, first], time))
    if scene.forces is not None:
        result["nodal forces"] = _on_columns(
            mech, scene.forces.forces(time), _loaded_columns(scene, mech)
        )
    return result


def total(
    scene: Scene, mech: Mechanism, N: Any, V: Any, u: Any, time: Any, mode: Mode = FREE
) -> Any:
    """Compute F (3×n) [N], the sum of all `terms`."""
    return sum(terms(scene, mech, N, V, u, time, mode).values(), start=ca.DM.zeros(*mech.N.shape))


def potential_energy(scene: Scene, mech: Mechanism, N: Any, u: Any) -> tuple[Any, Any]:
    """Compute elastic energy and gravity energy [J].

    Elastic energy is that of taut strings and of the ground's springs.
    """
    scene, u = bind(scene, u)
    s = scene.modelled
    elastic: Any = ca.DM(0)
    if len(s.strings) and not isinstance(scene.control, ForceDensity):
        squared, rest, stiffness, _, unit = _law_inputs(
            scene, mech, ca.mtimes(N, sparse(mech.C_s.T)), None, u, False
        )
        elastic = ca.sum2(
            _by_law(
                scene,
                lambda law, _, *rows: law.energy(*rows[:3], rows[4]),
                (squared, rest, stiffness, None, unit),
            )
        )
    if scene.ground is not None:
        elastic = elastic + sum(
            ground.energy(N[:, columns]) for ground, columns, _ in contacts(scene, mech)
        )
    if scene.gravity is None:
        return elastic, ca.DM(0)
    if is_expression(mech.M):
        return elastic, ca.DM(0) if scene.gravity.varies else -ca.sum1(
            ca.sum2(N * _weights(scene, mech, 0))
        )
    return elastic, scene.gravity.energy(N, mech.node_weight)


def _weights(scene: Any, mech: Mechanism, time: Any) -> Any:
    """Compute the weights (3×n) of the columns [N]."""
    if is_expression(mech.M):
        return ca.mtimes(scene.gravity.at(time), mech.node_weight)
    return scene.gravity.forces(mech.node_weight, time)


def is_conservative(scene: Scene) -> bool:
    """Return whether all forces are conservative under constant control."""
    driven = isinstance(scene.control, ForceDensity) and len(scene.modelled.strings) > 0
    loaded = scene.pressure is not None or scene.forces is not None or bool(scene.over_time)
    return not (driven or is_damped(scene) or is_rough(scene) or loaded)


def _rest(scene: Scene, u: Any) -> Any:
    s = scene.modelled
    return (
        _per_child(scene, u, s.string_fraction)
        if isinstance(scene.control, RestLength)
        else constant_row(s.rest_length)
    )


def _per_child(scene: Scene, u: Any, factor: Array) -> Any:
    """Expand u to a row over modeled strings, times `factor`."""
    parent = scene.modelled.string_parent
    row = u.T if len(parent) == u.shape[0] else u[parent.tolist(), :].T
    return row if np.all(factor == 1) else row * ca.DM(factor).T


def _ground_forces(scene: Scene, mech: Mechanism, N: Any, V: Any, touching: Any) -> Any:
    """Compute the forces of all grounds (3×n) [N].

    `touching` (1×c): see `Mode`.
    """
    parts = [
        _on_columns(
            mech,
            ground.forces(
                N[:, columns], V[:, columns], None if touching is None else touching[:, places]
            ),
            columns,
        )
        for ground, columns, places in contacts(scene, mech)
    ]
    return sum(parts[1:], start=parts[0])


def _loaded_columns(scene: Scene, mech: Mechanism) -> list[int]:
    """Select the column for the nodal force of each node.

    It is the first copy, or that of the given bar.
    """
    columns = mech.first[: len(scene.structure.nodes)].copy()
    for node, bar in (
        scene.forces.bars if scene.forces is not None and scene.forces.bars else {}
    ).items():
        ends = mech.C_b[[bar]].tocoo().col
        columns[node] = ends[mech.physical[ends] == node][0]
    return columns.tolist()  # type: ignore[no-any-return]


def _on_first(mech: Mechanism, W: Any) -> Any:
    """Assign loads on physical nodes to their first copies.

    W is (3×m) and may omit the last nodes, those inside strings.
    """
    return _on_columns(mech, W, mech.first[: W.shape[1]].tolist())


def _on_columns(mech: Mechanism, W: Any, columns: list[int]) -> Any:
    """Assign forces (3×m) on these columns to 3×n."""
    count, n = len(columns), mech.N.shape[1]
    if columns == list(range(n)):
        return W
    return ca.mtimes(W, ca.DM.triplet(list(range(count)), columns, ca.DM.ones(count), count, n))
