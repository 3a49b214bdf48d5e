"""States, controls and parameters of a scene."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Hashable
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import casadi as ca
import numpy as np

from tenscasadi.dynamics.constraint_forces import (
    RedundantConstraints,
    find_redundancy,
    project_velocities,
    residual_rates,
    residuals,
)
from tenscasadi.dynamics.node_coordinates import NodeCoordinates, check_column
from tenscasadi.scene.binding import declare_internal_states, initial_control
from tenscasadi.scene.internal_states import join_initial
from tenscasadi.structure.mass_checks import check_mass_ratio
from tenscasadi.structure.names import add_names
from tenscasadi.util.casadi_tools import symbol_kind
from tenscasadi.util.immutable import read_only
from tenscasadi.util.renamed import RenamedAttribute
from tenscasadi.util.troubleshooting import append_address
from tenscasadi.util.validate import Array, finite_array

if TYPE_CHECKING:
    from tenscasadi.dynamics.mechanism import Coordinates, Mechanism
    from tenscasadi.scene.scene import Scene

Kept = TypeVar("Kept")


class Constraints(NamedTuple):
    """Constraint residuals at a state, and their rates.

    Attributes
    ----------
    bars : ndarray, shape (β,), or CasADi column
        (bᵀb − l²)/(2 l) of each bar [m]: its excess length to first order.
    bar_rates : ndarray, shape (β,), or CasADi column
        bᵀḃ/l of each bar [m/s].
    joints : ndarray, shape (k,), or CasADi column
        N P − D along each constrained axis of joints and pins [m], empty in reduced coordinates.
    joint_rates : ndarray, shape (k,), or CasADi column
        V P − Ḋ along the same axes [m/s].

    Examples
    --------
    >>> import tenscasadi as tc
    >>> bar = tc.Structure([(0, 0, 0), (2, 0, 0)], bars=[(0, 1)])
    >>> model = tc.Model(tc.Scene(bar))
    >>> model.constraints(model.state([(0, 0, 0), (2.002, 0, 0)])).bars.round(6)
    array([0.002001])
    """

    bars: Any
    bar_rates: Any
    joints: Any
    joint_rates: Any


class StateSpace(NodeCoordinates):
    """Base class of `Model` with initial states, inputs and constraints."""

    def __init__(
        self,
        scene: Scene,
        coordinates: Coordinates,
        mechanism: Mechanism,
    ) -> None:
        super().__init__(scene, coordinates, mechanism)
        s = self.structure
        check_mass_ratio("Structure.bar_mass", s, s.bar_mass, s.node_mass)
        if mechanism.constant_length and mechanism.system_size and not mechanism.joints:
            raise ValueError(
                'Model.bar_length is "constant": give coordinates="full", '
                "because bars share nodes or are pinned"
            )
        self.nu = scene.nu
        self.parameters = scene.layout
        self.np = len(self.parameters)
        self.functions: dict[Any, Any] = {}  # see `keep`
        self.redundancy = find_redundancy(self.mechanism)
        if self.redundancy:
            message = append_address(add_names(self.redundancy, s))
            warnings.warn(message, RedundantConstraints, stacklevel=3)

    # --- numbers ---

    @cached_property
    def initial_state(self) -> Array:
        """State (nx,) of the structure's nodes at rest.

        With moving supports, the velocities are the smallest that satisfy the constraints.
        """
        inputs = np.concatenate([self.initial_control, self.parameters.nominal])
        return read_only(self._at_rest(inputs))  # type: ignore[no-any-return]

    def _at_rest(self, w: Array) -> Array:
        x = self.state(self.structure.nodes, internal=self.internal_at(w[self.nu :]))
        if self._supports is None or not self.mechanism.constrained:
            return x
        N, V, time = self.unpack(ca.DM(x))
        V = project_velocities(self.with_masses(ca.DM(w)), N, V, self.targets(time)[1])
        return self.pack(N, V, self.split(ca.DM(x)).internal, time).full().ravel()  # type: ignore[no-any-return]

    @cached_property
    def initial_control(self) -> Array:
        """Control (nu,) that keeps the structure's rest lengths.

        It consists of rest lengths [m], or of the corresponding force densities [N/m].
        """
        return read_only(self.control_at(self.parameters.nominal))  # type: ignore[no-any-return]

    def control_at(self, p: Array) -> Array:
        """Compute the initial control (nu,) for parameters (np,)."""
        return initial_control(self.scene, p)

    def internal_at(self, p: Array) -> Array:
        """Compute the initial internal states (na,) for parameters (np,)."""
        return join_initial(declare_internal_states(self.scene, p))

    def stack_inputs(self, u: Any = None, parameters: Any = None) -> Array:
        """Check and stack control and parameters (nw,).

        Default: the initial control and nominal parameters.
        """
        p = self.parameters.values(parameters)
        return np.concatenate(
            [self.control_at(p) if u is None else finite_array("u", u, (self.nu,)), p]
        )

    def start_at(self, p: Array) -> Array:
        """Compute the initial state (nx,) for parameters (np,).

        Masses affect the initial velocities if supports move. Rest lengths that are internal states
        follow the parameters.
        """
        moved = self._supports is not None and self.mechanism.masses is not None
        if not moved and not self.na:
            return self.initial_state
        return self._at_rest(np.concatenate([self.control_at(p), p]))

    def constraints(self, x: Any) -> Constraints:
        """Compute the constraint residuals and their rates.

        Parameters
        ----------
        x : array_like, shape (nx,), or CasADi column
            State.

        Returns
        -------
        Constraints
            Arrays, or CasADi columns if x is CasADi.

        Notes
        -----
        In optimal control, impose ``ca.vertcat(*model.constraints(x)) == 0`` only on a free initial
        state. The dynamics preserve these constraints, so they are redundant at later times.
        """
        value = self.arguments(x, None)[0]
        if isinstance(value, ca.SX):  # many derivations ask for these expressions
            return Constraints(*self.keep("constraints", self._build_constraints).call([value]))
        rows = self._constraint_rows(value)
        return Constraints(*(row.full().ravel() if isinstance(row, ca.DM) else row for row in rows))

    def _build_constraints(self) -> ca.Function:
        x = ca.SX.sym("x", self.nx)
        return ca.Function("constraints", [x], [ca.SX(row) for row in self._constraint_rows(x)])

    def _constraint_rows(self, x: Any) -> list[Any]:
        """Compute the rows of `constraints` for a CasADi column x."""
        N, V, time = self.unpack(x)
        mech = self.mechanism
        B, (D, Dd, _) = mech.bar_vectors(N), self.targets(time)
        held = np.flatnonzero(mech.active.ravel(order="F")).tolist()
        (bars, joints), (bar_rates, joint_rates) = (
            residuals(mech, N, B, D),
            residual_rates(mech, V, B, Dd),
        )
        own = [ca.vec(ca.densify(row)) for row in (joints, joint_rates)]
        if mech.frames is not None:
            own = [ca.mtimes(mech.constrained_directions.T, row) for row in own]
        rows = [row.T / ca.DM(mech.lengths) for row in (bars, bar_rates)]
        return rows + [row[held] for row in own]

    def arguments(self, x: Any, u: Any, parameters: Any = None) -> tuple[Any, ...]:
        """Convert state, control and parameters to CasADi values.

        Their sizes are nx, nu and np. Defaults are the initial control and nominal parameters.
        Models without parameters have no p. Raises TypeError or ValueError.
        """
        symbolic = isinstance(parameters, (ca.SX, ca.MX))
        p = parameters if symbolic else self.parameters.values(parameters)
        if u is None and symbolic and self.nu:
            raise ValueError("u is None: give the control, too, because parameters are CasADi's")
        given = [
            ("x", x, self.nx),
            (
                "u",
                (self.initial_control if symbolic else self.control_at(p)) if u is None else u,
                self.nu,
            ),
        ]
        if self.np or symbolic:
            given.append(("parameters", p, self.np))
        return tuple(check_column(name, value, size) for name, value, size in given)

    @property
    def over_time(self) -> list[Any]:
        """Time-varying loads, support motions and control."""
        return [*self.scene.over_time, *([] if self.schedule is None else [self.schedule])]

    def add_schedule(self, w: Any, time: Any) -> Any:
        """Add the scheduled control to the stacked input w.

        Internal states may follow in w. `time` is the clock [s].
        """
        if self.schedule is None:
            return w
        rest = w.shape[0] - self.nu
        return w + ca.vertcat(self.schedule.at(time), ca.DM.zeros(rest))

    def extend_inputs(self, x: Any, w: Any) -> Any:
        """Append the internal states of x to the stacked input w.

        Force elements depend on them as on inputs.
        """
        return ca.vertcat(w, self.split(x).internal) if self.na else w

    @property
    def nw(self) -> int:
        """Size of the input w: control u, then parameters p."""
        return self.nu + self.np

    # --- CasADi Functions ---

    def keep(self, key: Hashable, build: Callable[[], Kept]) -> Kept:
        """Return the cached value of a key, and build it at the first call."""
        if key not in self.functions:
            self.functions[key] = build()
        value: Kept = self.functions[key]
        return value

    def with_stacked_input(self, function: ca.Function) -> ca.Function:
        """Convert a Function of (x, u, p) to (x, w).

        The stacked input w is the control u followed by the parameters p, because integrators have
        one input. Without parameters, the Function is returned unchanged.

        Parameters
        ----------
        function : casadi.Function
            One of the model's Functions, such as `Model.ode`.

        Returns
        -------
        casadi.Function
            The same outputs, of x (nx) and w (nu + np).
        """
        if not self.np:
            return function

        def build() -> tuple[ca.Function, ca.Function]:
            kind = symbol_kind(function)
            x, w = kind.sym("x", self.nx), kind.sym("w", self.nw)
            outputs = function.call([x, w[: self.nu], w[self.nu :]], True, False)
            names = ["x", "w"], function.name_out()
            return function, ca.Function(function.name(), [x, w], outputs, *names)

        # The hash is a memory address. The Function is kept, too, so that the address stays unique.
        return self.keep(("stacked", hash(function)), build)[1]

    stacked = RenamedAttribute("with_stacked_input")

    def _function(
        self, name: str, x: Any, w: Any, outputs: list[Any], names: list[str]
    ) -> ca.Function:
        """Build a Function with public inputs from expressions of x and w.

        The inputs are (x, u), or (x, u, p) with parameters. `names` are those of the outputs.
        """
        if not self.np:
            return ca.Function(name, [x, w], outputs, ["x", "u"], names)
        stacked = ca.Function(name, [x, w], outputs, ["x", "w"], names)
        x, u, p = type(x).sym("x", self.nx), type(x).sym("u", self.nu), type(x).sym("p", self.np)
        public = ca.Function(
            name,
            [x, u, p],
            stacked.call([x, ca.vertcat(u, p)], True, False),
            ["x", "u", "p"],
            names,
        )
        self.functions["stacked", hash(public)] = public, stacked
        return public

    # --- expressions ---

    def with_masses(self, w: Any, inverse: bool = True) -> Mechanism:
        """Build the mechanism with the masses in the input w.

        w is a CasADi column. M⁻ is computed only if `inverse`.
        """
        mechanism, masses = self.mechanism, self.mechanism.masses
        if masses is None:
            return mechanism
        if inverse:
            return mechanism.with_masses(masses.weigh(w[self.nu : self.nw]))
        return replace(mechanism, M=masses.mass_matrix(w[self.nu : self.nw]), inverse=())

    def symbols(self, scalar: bool) -> tuple[Any, Any]:
        """Create symbols of the state x and the stacked input w.

        They are scalars (SX) or vectors (MX).
        """
        kind = ca.SX if scalar else ca.MX
        return kind.sym("x", self.nx), kind.sym("u", self.nw)
