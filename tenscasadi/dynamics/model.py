"""A scene as CasADi Functions: the ordinary differential equation, what can be observed, power and multipliers."""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca

from tenscasadi.dynamics import forces
from tenscasadi.dynamics.equation_of_motion import forward_dynamics, joint_forces
from tenscasadi.dynamics.instruction_count import TermCounts, count_terms
from tenscasadi.dynamics.mechanism import Multipliers
from tenscasadi.dynamics.state_space import StateSpace
from tenscasadi.util.casadi_tools import sparse
from tenscasadi.util.compile import compile_function


class Energy(NamedTuple):
    """Energies of a state, J: of motion, of taut strings and the ground's springs, and in gravity (zero at the origin)."""

    kinetic: float
    elastic: float
    gravity: float

    @property
    def total(self) -> float:
        """The sum, J."""
        return self.kinetic + self.elastic + self.gravity


class Model(StateSpace):
    """The equations of motion of a `Scene`, Eqs. 58-95, as CasADi Functions.

    `coordinates="reduced"`: the state holds the coordinates of physical nodes that are free to move; joints and pins cannot drift.
    `coordinates="full"`: the state holds the paper's class-one nodes, and Ω keeps joints and pins.
    Reduced systems couple all bars that hang together: long chains of joined bars, from a hundred on, are cheaper in full coordinates.
    State x = (positions, velocities), each node by node, and a clock where loads depend on time. Control u: one entry per parent
    string (`ForceDensity`, N/m; `RestLength`, m) or none. `bar_length="constant"` is the paper's λ̂ as printed, for comparison: it
    divides by l² where "current" divides by bᵀb, and then errors of length grow exponentially. Raises TypeError, ValueError;
    warns with `RedundantConstraints`.
    """

    # --- CasADi Functions ---

    @cached_property
    def ode(self) -> ca.Function:
        """(x, u) → xdot: self-contained, differentiable, usable by any CasADi tool."""
        x, u = self.symbols(self.mechanism.unrolled)
        N, V, time = self.unpack(x)
        A, _, _ = forward_dynamics(self, N, V, u, time)
        rate = [self.pack(V, A, 1)]
        # Of vector operations cse would share the zeros too that each product starts from, and copy them.
        return ca.Function("ode", [x, u], ca.cse(rate) if self.mechanism.unrolled else rate, ["x", "u"], ["xdot"])

    def compile(self) -> ca.Function:
        """`ode` as machine code: the same inputs, outputs and values, without derivatives. Raises CompileError without a C compiler."""
        return compile_function(self.ode)

    @cached_property
    def observe(self) -> ca.Function:
        """(x, u) → nodes and velocities (3n, node by node), force_density and tension (α), energy (3), bar_length_error, joint_error."""
        x, u = self.symbols(not self.mechanism.large)
        N, V, time = self.unpack(x)
        gamma, S = forces.strings(self.scene, self.mechanism, N, V, u)
        first = self.mechanism.first.tolist()
        outputs = {
            "nodes": ca.vec(N[:, first]),
            "velocities": ca.vec(V[:, first]),
            "force_density": gamma.T,
            "tension": (gamma * ca.sqrt(ca.sum1(S * S))).T,
            "energy": ca.vertcat(self._kinetic(V), *forces.potential(self.scene, self.mechanism, N, u)),
            "bar_length_error": self._bar_length_error(N),
            "joint_error": self._joint_error(N, time),
        }
        return ca.Function("observe", [x, u], [ca.densify(value) for value in outputs.values()], ["x", "u"], list(outputs))

    @cached_property
    def energy_function(self) -> ca.Function:
        """(x, u) → total energy, J, without the rest of what `observe` computes."""
        x, u = self.symbols(not self.mechanism.large)
        energy = ca.sum1(self.observe(x, u)[self.observe.index_out("energy")])
        return ca.Function("energy", [x, u], [energy], ["x", "u"], ["energy"])

    @cached_property
    def power(self) -> ca.Function | None:
        """(x, u) → power, W, of all forces that `energy` does not hold; None when there are none. Jumps of the control are not in it."""
        if self.conservative:
            return None
        x, u = self.symbols(not self.mechanism.large)
        N, V, time = self.unpack(x)
        if self._supports is None:
            push = forces.total(self.scene, self.mechanism, N, V, u, time)
        else:  # with the reactions of the supports, which work too: all that moves the mass
            push = ca.mtimes(forward_dynamics(self, N, V, u, time)[0], sparse(self.mechanism.M))
        n: Any = type(N).sym("n", N.shape)
        total = sum(forces.potential(self.scene, self.mechanism, n, u))
        slope = ca.substitute(ca.jtimes(total, n, V), n, N)
        return ca.Function("power", [x, u], [ca.densify(ca.sum2(ca.sum1(push * V)) + slope)], ["x", "u"], ["power"])

    @cached_property
    def multiplier_function(self) -> ca.Function:
        """(x, u) → λ (β) and Ω (3×c): see `multipliers`."""
        x, u = self.symbols(self.mechanism.unrolled)
        N, V, time = self.unpack(x)
        A, lam, omega = forward_dynamics(self, N, V, u, time)
        if self.coordinates == "reduced" and len(self.structure.bars):
            omega = joint_forces(self, N, V, A, lam, u, time)
        return ca.Function("multipliers", [x, u], [ca.densify(lam.T), ca.densify(omega)], ["x", "u"], ["bar_force_density", "joint_force"])

    # --- numbers in, numbers out ---

    def force_density(self, x: Any, u: Any = None) -> Any:
        """γ of the modelled strings (α,), N/m; u None: the initial control. CasADi in, CasADi out."""
        return self._observed("force_density", x, u)

    def tension(self, x: Any, u: Any = None) -> Any:
        """Tensions of the modelled strings (α,), N; u None: the initial control. CasADi in, CasADi out."""
        return self._observed("tension", x, u)

    def multipliers(self, x: Any, u: Any = None) -> Multipliers:
        """λ̂ (β,) and Ω (3, c) in the paper's signs (Eqs. 85, 87); Ω's columns are those of `structure.class_one().P`,
        then one for each node that is pinned along some axes only.

        Where constraints are redundant these are the smallest of the many that give the same motion, in scaled rows.
        """
        lam, omega = self.multiplier_function(*self.arguments(x, u))
        return Multipliers(lam.full().ravel(), omega.full())

    def energy(self, x: Any, u: Any = None) -> Energy:
        """Kinetic, elastic and gravity energy, J; strings driven by force density store none."""
        return Energy(*self._observed("energy", x, u).tolist())

    def bar_length_error(self, x: Any) -> float:
        """The largest | |b| − l | / l over the bars: 0 is exact."""
        return float(self._observed("bar_length_error", x, None)[0])

    def joint_error(self, x: Any) -> float:
        """The largest distance of a joint or pin from where it belongs, per axis, m: 0 in reduced coordinates."""
        return float(self._observed("joint_error", x, None)[0])

    @property
    def conservative(self) -> bool:
        """Whether no force outside `energy` does work while the control stands still."""
        return forces.conservative(self.scene)

    def describe(self) -> TermCounts:
        """The terms that this scene builds, each with the instructions that it adds to the right-hand side."""
        return count_terms(self, self.ode)

    # --- expressions ---

    def _kinetic(self, V: Any) -> Any:
        return ca.sum2(ca.sum1(V * ca.mtimes(V, sparse(self.mechanism.M)))) / 2

    def _bar_length_error(self, N: Any) -> Any:
        if not self.mechanism.bars:
            return ca.DM(0)
        B = self.mechanism.bar_vectors(N)
        return ca.mmax(ca.fabs(ca.sqrt(ca.sum1(B * B)) / ca.DM(self.mechanism.lengths).T - 1))

    def _joint_error(self, N: Any, time: Any) -> Any:
        if not self.mechanism.joints:
            return ca.DM(0)
        gap = (ca.mtimes(N, sparse(self.mechanism.P)) - self.targets(time)[0]) * self.mechanism.active_mask
        return ca.mmax(ca.fabs(gap))

    # --- numbers ---

    def _observed(self, name: str, x: Any, u: Any) -> Any:
        arguments = self.arguments(x, u)
        value = self.observe(*arguments)[self.observe.index_out(name)]
        return value.full().ravel() if isinstance(value, ca.DM) else value
