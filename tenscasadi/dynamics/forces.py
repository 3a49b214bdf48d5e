"""Forces F = W − S γ̂ C_s (Eq. 67) and potential energy.

Each feature of a scene that exerts forces is a `ForceElement`. A new kind of load or member is one
class and one line of `build_elements`. An absent feature builds no expression. In full coordinates
loads act on the first copy of each physical node, unless another one is given. In methods, `at` has
the motion of the nodes, and N and V (3×n) are their positions and velocities.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, cast

import casadi as ca
import numpy as np

from tenscasadi.dynamics.contacts import BarContacts, CapsuleContacts, ContactElement, NodeContacts
from tenscasadi.dynamics.force_element import ForceElement, NodeMotion, spread
from tenscasadi.scene.binding import bind, sets_rest_lengths
from tenscasadi.scene.cables import CableRows
from tenscasadi.scene.control import Control
from tenscasadi.scene.dissipation import has_cable_friction, is_damped
from tenscasadi.scene.strength import (
    compute_reserves,
    count_states,
    list_strengths,
    spread_states,
)
from tenscasadi.scene.strings import ForceDensity, Linear, Smooth, StringLaw
from tenscasadi.util.casadi_tools import constant_row, is_expression, scale_and_multiply, sparse
from tenscasadi.util.validate import Array, Indices

if TYPE_CHECKING:
    from tenscasadi.dynamics.mechanism import Mechanism
    from tenscasadi.scene.breaking import Yielding
    from tenscasadi.scene.loads import Gravity, NodalForce, Pressure
    from tenscasadi.scene.scene import Scene


def build_elements(scene: Scene, mech: Mechanism, w: Any, mode: Any = None) -> list[ForceElement]:
    """Build the force elements of a scene.

    Parameters
    ----------
    scene : Scene
        The scene.
    mech : Mechanism
        Columns of N and, for gravity, masses.
    w : casadi column, shape (nu + np + na,)
        Control, followed by the parameters and the internal states.
    mode : casadi row, shape (1, k), optional
        Fixed mode of all switches: strings first, then contacts, ground by ground, then bars.

    Returns
    -------
    list of ForceElement
        Force elements of the scene's features.
    """
    scene, u, internal = bind(scene, w)
    found: list[ForceElement] = []
    if len(scene.modelled.strings):
        found.append(StringForces(scene, mech, u, internal))
    if scene.modelled.elastic.any():
        found.append(ElasticBars(scene, mech))
    if scene.gravity is not None:
        found.append(Weights(scene.gravity, mech))
    contacts: list[ContactElement] = [
        kind(ground, scene.modelled, mech)
        for ground in scene.grounds
        for kind in (NodeContacts, CapsuleContacts)
    ]
    if scene.bar_contact is not None:
        contacts.append(BarContacts(scene.bar_contact, scene.modelled, mech))
    found += [element for element in contacts if element.switch_count]
    if scene.pressure is not None:
        found.append(PressureForces(scene.pressure, mech))
    if scene.forces is not None:
        found.append(NodalForces(scene.forces, mech))
    if mode is None:
        return found
    ends = np.cumsum([element.switch_count for element in found]).tolist()
    return [
        replace(element, mode=mode[:, end - element.switch_count : end])  # type: ignore[type-var]
        if element.switch_count
        else element
        for element, end in zip(found, ends, strict=True)
    ]


def internal_rates(elements: list[ForceElement], at: NodeMotion) -> Any:
    """Compute the time derivatives (na,) of all internal states.

    Internal states are, for example, rest lengths of winches. They are in the order of elements.
    `at` has positions, velocities and time.
    """
    return ca.vertcat(*(element.internal_rates(at) for element in elements))


def sum_forces(elements: list[ForceElement], mech: Mechanism, at: NodeMotion) -> Any:
    """Compute the sum F (3×n) of the elements' forces [N]."""
    return sum((element.forces(at) for element in elements), start=ca.DM.zeros(*mech.N.shape))


def total(
    scene: Scene, mech: Mechanism, N: Any, V: Any, w: Any, time: Any, mode: Any = None
) -> Any:
    """Compute the sum F (3×n) of all forces of a scene [N].

    N and V (3×n) are node positions and velocities; for the others see `build_elements`.
    """
    return sum_forces(build_elements(scene, mech, w, mode), mech, NodeMotion(N, V, time))


def potential_energy(scene: Scene, mech: Mechanism, N: Any, w: Any) -> tuple[Any, Any]:
    """Compute elastic and gravity energy [J].

    The elastic energy is that of strings, bars and contacts. N (3×n) are node positions; for `mech`
    and w see `build_elements`.
    """
    elastic = gravity = ca.DM(0)
    for element in build_elements(scene, mech, w):
        if isinstance(element, Weights):
            gravity = element.energy(N)
        else:
            elastic = elastic + element.energy(N)
    return elastic, gravity


def string_force_density(scene: Scene, mech: Mechanism, N: Any, V: Any, w: Any) -> tuple[Any, Any]:
    """Compute force densities γ (1×α) [N/m] and string vectors S (3×α)."""
    scene, u, internal = bind(scene, w)
    return StringForces(scene, mech, u, internal).force_density(N, V)


def bar_force_density(scene: Scene, mech: Mechanism, N: Any, w: Any, lam: Any) -> Any:
    """Compute λ (1×bars) of rigid and elastic bars [N/m].

    It is positive in compression. `lam` is λ of rigid bars and bodies, N (3×n) are node positions;
    for w see `build_elements`. The massless bars that represent rigid bodies are omitted.
    """
    lam = lam[:, : mech.bars - len(mech.body_of_bar)]
    if not mech.C_e.shape[0]:
        return lam
    bars = ElasticBars(bind(scene, w)[0], mech)
    E = ca.mtimes(N, sparse(mech.C_e.T))
    return mech.join_bars(lam, -bars.law_density(ca.sum1(E * E)))


@dataclass(frozen=True, eq=False)
class StringForces(ForceElement):
    """Force element of the strings, whose constants may be expressions.

    Attributes
    ----------
    control : casadi column
        Control inputs (nu).
    internal : casadi column
        Internal states (na).
    mode : casadi row or None
        1 for each taut string; only strings that can go slack have an entry.
    damped : bool
        Whether damping acts.
    longest : casadi row or None
        Upper bounds (1×α) of rest lengths [m], which smooth strings ignore.
    """

    name: ClassVar[str] = "strings"
    scene: Scene
    mech: Mechanism
    control: Any
    internal: Any
    mode: Any = None
    damped: bool = True
    longest: Any = None

    @property
    def switch_count(self) -> int:  # type: ignore[override]
        """Number of cables, and of strings in no cable, that can go slack."""
        return len(self.scene.switching_inputs)

    def force_density(self, N: Any, V: Any) -> tuple[Any, Any]:
        """Compute force densities γ (1×α) [N/m] and string vectors S (3×α).

        See Eq. 66.
        """
        S = ca.mtimes(N, sparse(self.mech.C_s.T))
        gamma = self.law_density(ca.sum1(S * S), self._rate(S, V))
        if self.damped and self._cables is not None and has_cable_friction(self.scene):
            rates = ca.mtimes(V, sparse(self.mech.C_s.T))
            ratios = self._cables.friction_ratios(S, rates, self.scene.commands_forces)
            gamma = gamma * (
                1 + (ratios - 1) * (gamma > 0)
            )  # a cable in compression touches no node
        return gamma, S

    def law_density(self, squared: Any, rate: Any = None) -> Any:
        """Compute force densities γ (1×α) from the string laws (Eqs. 98, 99).

        `squared` are squared lengths [m²] of strings, and `rate` is c sᵀṡ [N·m] of cables and of
        strings in no cable, for damping c. Cables have no friction.
        """
        gamma = self._intact_density(squared, rate)
        if not len(self.scene.breakable_inputs):
            return gamma
        return gamma * spread_states(self.scene, self._own_states[1], self.scene.input_of, 1)

    def _intact_density(self, squared: Any, rate: Any) -> Any:
        """Compute force densities γ (1×α) as if no string were broken."""
        scene = self.scene
        if isinstance(scene.control, ForceDensity):  # tension is constant along a parent string
            return self._per_segment(1 / scene.modelled.string_fraction)
        if scene.commands_forces:
            s = scene.modelled
            lengths = ca.sqrt(squared + (1e-9 * constant_row(s.rest_length)) ** 2)
            return self._command[scene.input_of.tolist(), :].T / lengths
        switching, longest = scene.switching_inputs, self.longest
        if longest is not None and self._cables is not None:
            longest = self._cables.sum(longest)

        def law_of(
            law: StringLaw, which: Indices, squared: Any, rest: Any, k: Any, unit: Any, rate: Any
        ) -> Any:
            if longest is not None and not isinstance(law, Smooth):
                rest = ca.fmin(rest, _columns(longest, which))
            taut = self.mode
            if taut is not None and law.switches and len(which) < len(switching):
                taut = taut[:, np.searchsorted(switching, which).tolist()]
            return law.force_density(squared, rest, k, rate, unit, taut)

        gamma = self._by_law(law_of, squared, rate)
        return gamma if self._cables is None else self._cables.force_densities(gamma, squared)

    def forces(self, at: NodeMotion) -> Any:
        """Compute −S γ̂ C_s (3×n) [N] (Eq. 56)."""
        gamma, S = self.force_density(at.N, at.V)
        return scale_and_multiply(S, gamma, -self.mech.C_s)

    def power(self, at: NodeMotion, stored: bool) -> Any:
        """Compute the power −γ sᵀṡ of all strings [W].

        If `stored`, only the power that does not change their elastic energy: that of damping.
        """
        gamma, S = self.force_density(at.N, at.V)
        if stored and not self.scene.commands_forces:
            gamma = gamma - self.law_density(ca.sum1(S * S))
        return -ca.sum2(gamma * ca.sum1(S * ca.mtimes(at.V, sparse(self.mech.C_s.T))))

    def energy(self, N: Any) -> Any:
        """Compute the elastic energy [J], 0 if forces are commanded."""
        if self.scene.commands_forces:
            return ca.DM(0)
        S = ca.mtimes(N, sparse(self.mech.C_s.T))
        energies = self._by_law(
            lambda law, _, squared, rest, k, unit, rate: law.energy(squared, rest, k, unit),
            ca.sum1(S * S),
            None,
        )
        if len(self.scene.breakable_inputs):
            energies = energies * spread_states(self.scene, self._own_states[1], self._members, 1)
        return ca.sum2(energies)

    def margins(self, at: NodeMotion) -> Any:
        """Compute the elongations (1×m) [m] of strings until they break.

        Cables and strings in no cable have one each. They have the unit and the scale of the
        switching functions of slack strings.
        """
        s, breakable = self.scene.modelled, self.scene.breakable_inputs
        if not len(breakable):
            return ca.DM(1, 0)
        first = np.array([np.argmax(self.scene.input_of == k) for k in breakable])
        weakest = list_strengths(self.scene).min()
        unit = constant_row(s.stiffness) + ca.DM(weakest / s.string_lengths).T
        return self._reserves(at) / unit[:, first.tolist()]

    def _reserves(self, at: NodeMotion) -> Any:
        """Compute strength minus tension (1×m) of strings that can fail [N].

        Cables have one entry each.
        """
        gamma, S = self.force_density(at.N, at.V)
        return compute_reserves(self.scene, gamma * ca.sqrt(ca.sum1(S * S)))

    def switches(self, at: NodeMotion) -> Any:
        """Compute functions (1×k) [m] that are positive for taut strings.

        Only cables, and strings in no cable, that can go slack have one.
        """
        S = ca.mtimes(at.N, sparse(self.mech.C_s.T))
        return self.excess_lengths(ca.sum1(S * S), self._rate(S, at.V))

    def internal_rates(self, at: NodeMotion) -> Any:
        """Compute time derivatives of the strings' internal states.

        Those of the control come first, then those of string failure.
        """
        strength, own = self.scene.strength, self._own_states[1]
        rates = [self._control_rates(at)]
        if len(self.scene.breakable_inputs):
            rates += [ca.DM.zeros(own.shape[0]), own]
        elif len(self.scene.limited_inputs):
            rates.append(ca.fmax(-self._reserves(at), 0).T / cast("Yielding", strength).viscosity)
        return ca.vertcat(*rates)

    def _control_rates(self, at: NodeMotion) -> Any:
        if self._own_states[0].shape[0] == 0:
            return ca.DM(0, 1)
        gamma, S = self.force_density(at.N, at.V)
        unit = 1e-9 * constant_row(self.scene.modelled.rest_length)
        tension = (gamma * ca.sqrt(ca.sum1(S * S) + unit**2)).T
        return self._law.internal_rates(
            self.control, self._own_states[0], tension[self.scene.winch_strings.tolist(), :]
        )

    def internal_kinetic_energy(self) -> Any:
        """Compute the kinetic energy of the control's internal states [J]."""
        own = self._own_states[0]
        return self._law.kinetic_energy(own) if own.shape[0] else ca.DM(0)

    @property
    def _own_states(self) -> tuple[Any, Any]:
        """Internal states of the control, then those of string failure."""
        count = len(self.scene.limited_inputs)
        end = self.internal.shape[0] - count_states(self.scene)
        return self.internal[:end, :], self.internal[end : end + count, :]

    @property
    def _members(self) -> Indices:
        """Index of the control input for each cable and string in no cable."""
        return np.asarray(self.scene.structure.cable_of[self._inputs.string_parent])

    @property
    def _law(self) -> Control:
        return cast("Control", self.scene.control)

    @property
    def _command(self) -> Any:
        """Forces or rest lengths (nu,) that the control prescribes."""
        return self._law.command(self.control, self._own_states[0])

    def excess_lengths(self, squared: Any, rate: Any = None) -> Any:
        """Compute functions (1×k) [m] that are positive for taut strings.

        Only cables, and strings in no cable, that can go slack have one. `squared` are squared
        lengths of strings [m²], and `rate` is c sᵀṡ [N·m] for damping c.
        """

        def gap(law: Any, _: Indices, squared: Any, rest: Any, k: Any, unit: Any, rate: Any) -> Any:
            return law.gap(squared, rest, k, rate, unit)

        return self._by_law(gap, squared, rate, switching=True)

    def _rate(self, S: Any, V: Any) -> Any:
        """Compute c sᵀṡ (1×m) [N·m], the damping of strings (Eq. 98).

        c is the damping. The vector of a string is s, a column of S; for a cable, s is its length.
        V are node velocities (3×n). Returns None without damping.
        """
        if not self.damped or not is_damped(self.scene):
            return None
        rates = ca.sum1(S * ca.mtimes(V, sparse(self.mech.C_s.T)))
        if self._cables is not None:
            rates = self._cables.rates(ca.sum1(S * S), rates)
        return rates * constant_row(self._inputs.damping)

    @cached_property
    def _cables(self) -> CableRows | None:
        """Conversion between strings and cables, None without cables."""
        s = self.scene.modelled
        return CableRows(s) if s.cables else None

    @cached_property
    def _inputs(self) -> Any:
        """Stiffness, damping and rest lengths of cables.

        Strings that belong to no cable count as cables of one string. Names are those of
        `Structure`.
        """
        return self.scene.modelled if self._cables is None else self._cables.constants()

    def _by_law(
        self, evaluate: Callable[..., Any], squared: Any, rate: Any, switching: bool = False
    ) -> Any:
        """Call `evaluate` for each string law, and join the results.

        Its arguments are the law and its strings; their squared lengths, rest lengths, stiffness,
        typical lengths; and `rate` (c sᵀṡ) or None. If `switching`, only laws with slack are
        evaluated.
        """
        s, laws = self._inputs, self.scene.input_laws
        if self._cables is not None:
            squared = self._cables.squared_lengths(squared)
        by_control = sets_rest_lengths(self.scene)
        rest = self._per_segment(s.string_fraction) if by_control else constant_row(s.rest_length)
        if len(self.scene.limited_inputs) > len(self.scene.breakable_inputs):
            plastic = spread_states(self.scene, self._own_states[1], self._members, 0)
            rest = rest + plastic * ca.DM(s.string_fraction).T
        rows = squared, rest, constant_row(s.stiffness), constant_row(s.rest_length)
        if len(laws) == 1:
            return evaluate(*laws[0], *rows, rate)
        chosen = [(law, which) for law, which in laws if law.switches or not switching]
        parts = []
        for law, which in chosen:
            damped = rate is not None and (is_expression(s.damping) or np.any(s.damping[which] > 0))
            own = [_columns(row, which) for row in rows]
            parts.append(evaluate(law, which, *own, _columns(rate, which) if damped else None))
        place = np.argsort(np.concatenate([which for _, which in chosen]))
        return ca.horzcat(*parts)[:, place.tolist()]

    def _per_segment(self, factor: Array) -> Any:
        """Assign control values to modeled strings, multiplied by `factor`.

        A string that is divided into segments has several modeled strings; a cable has one value.
        """
        parent, u = self._members, self._command
        row = u.T if len(parent) == u.shape[0] else u[parent.tolist(), :].T
        return row if np.all(factor == 1) else row * ca.DM(factor).T


@dataclass(frozen=True, eq=False)
class ElasticBars(ForceElement):
    """Force element of elastic bars with the tension k (l − ρ)."""

    name: ClassVar[str] = "elastic bars"
    scene: Scene
    mech: Mechanism

    def law_density(self, squared: Any) -> Any:
        """Compute force densities (1×bars) [N/m] from squared lengths [m²].

        They are positive in tension.
        """
        stiffness, rest = self._constants()
        return Linear().force_density(squared, rest, stiffness, None, rest)

    def forces(self, at: NodeMotion) -> Any:
        """Compute the forces of elastic bars on nodes (3×n) [N]."""
        E = ca.mtimes(at.N, sparse(self.mech.C_e.T))
        return scale_and_multiply(E, self.law_density(ca.sum1(E * E)), -self.mech.C_e)

    def energy(self, N: Any) -> Any:
        """Compute the elastic energy of the bars [J]."""
        E = ca.mtimes(N, sparse(self.mech.C_e.T))
        stiffness, rest = self._constants()
        return ca.sum2(Linear().energy(ca.sum1(E * E), rest, stiffness, rest))

    def _constants(self) -> list[Any]:
        """Select stiffness and rest lengths (1×bars) of elastic bars."""
        s = self.scene.modelled
        which = np.flatnonzero(s.elastic)
        return [
            _columns(row, which) if is_expression(row) else constant_row(row[which])
            for row in (s.bar_stiffness, s.bar_rest_length)
        ]


@dataclass(frozen=True, eq=False)
class Weights(ForceElement):
    """Force element of gravity on nodes."""

    name: ClassVar[str] = "gravity"
    gravity: Gravity
    mech: Mechanism

    def forces(self, at: NodeMotion) -> Any:
        """Compute the weights (3×n) [N]."""
        return self.gravity.forces(self.mech.node_weight, at.time)

    def energy(self, N: Any) -> Any:
        """Compute the potential energy [J], see `Gravity.energy`."""
        return self.gravity.energy(N, self.mech.node_weight)


@dataclass(frozen=True, eq=False)
class PressureForces(ForceElement):
    """Force element of pressure on triangles of nodes."""

    name: ClassVar[str] = "pressure"
    pressure: Pressure
    mech: Mechanism

    def forces(self, at: NodeMotion) -> Any:
        """Compute the forces (3×n) [N]."""
        first = self.mech.first.tolist()
        return spread(self.mech, self.pressure.forces(at.N[:, first], at.time), first)


@dataclass(frozen=True, eq=False)
class NodalForces(ForceElement):
    """Force element of given forces on nodes, or on ends of given bars."""

    name: ClassVar[str] = "nodal forces"
    load: NodalForce
    mech: Mechanism

    def forces(self, at: NodeMotion) -> Any:
        """Compute the forces (3×n) [N]."""
        W = self.load.at(at.time)
        columns = self.mech.first[: W.shape[1]].copy()  # nodes inside strings have no load
        for node, bar in (self.load.bars or {}).items():
            ends = self.mech.bar_ends[bar]
            columns[node] = ends[self.mech.physical[ends] == node][0]
        return spread(self.mech, W, columns.tolist())


def _columns(row: Any, which: Indices) -> Any:
    return row if row.shape[1] == 1 else row[:, which.tolist()]
