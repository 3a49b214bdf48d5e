"""Model: the equations of motion of a scene as CasADi Functions."""

from __future__ import annotations

import warnings
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.dynamics import forces
from tenscasadi.dynamics.coordinates import choose_coordinates, compare_coordinates, scene_mechanism
from tenscasadi.dynamics.equation_of_motion import forward_dynamics, joint_forces
from tenscasadi.dynamics.force_element import NodeMotion
from tenscasadi.dynamics.instruction_count import TermCounts, count_terms
from tenscasadi.dynamics.mechanism import BarLength, Coordinates, Multipliers
from tenscasadi.dynamics.observations import Observations
from tenscasadi.scene.binding import fix
from tenscasadi.scene.control_function import ControlSchedule
from tenscasadi.scene.samples import interpolate_functions, reject_python_functions
from tenscasadi.scene.scene import Scene
from tenscasadi.schema.value import Value
from tenscasadi.util.casadi_tools import sparse
from tenscasadi.util.compile import compile_function
from tenscasadi.util.renamed import RenamedAttribute
from tenscasadi.util.validate import choice, instance, number


class Model(Value, Observations, kind="Model"):
    """The equations of motion of a `Scene` as CasADi Functions.

    The state x contains positions and velocities, each node by node, and a clock if loads depend on
    time. The control u has one entry for each cable or parent string (`ForceDensity` [N/m], `Tension`
    [N] or `RestLength` [m]), or none.

    Parameters
    ----------
    scene : Scene
        Structure, control and loads.
    coordinates : {"reduced", "full"}, optional
        Coordinates of the state. "reduced": free coordinates of physical nodes, so that joints and
        pins cannot drift. "full": the paper's class-one nodes, whose joints and pins are enforced
        by the multipliers Ω. Default: reduced, unless full ones need less than a quarter of the
        operations, as in chains of 40 bars or more.
    bar_length : {"current", "constant"}
        Squared length in the denominator of λ̂. "current": bᵀb. "constant": l² as in the paper, for
        comparison. Length errors then grow exponentially.

    Raises
    ------
    TypeError
        If `scene` is not a `Scene`.
    ValueError
        If an option is unknown, a bar is more than 1e12 times as heavy as another, or a parameter
        has no effect. Also if `bar_length` is "constant" in reduced coordinates, and bars share
        nodes or are pinned.

    Warns
    -----
    RedundantConstraints
        If the constraints of bars and joints are redundant in the initial shape.
    UserWarning
        If a parameter only affects the default control, such as the stiffness under
        ``control=ForceDensity()``.

    See Also
    --------
    simulate : Integrate the motion of a model in time.

    Notes
    -----
    The equations are Eqs. 58-95 of the paper. Reduced coordinates couple all connected bars.

    If the scene has `Parameters`, all Functions have their values p as an additional input after u:
    they are (x, u, p). `parameters` names the entries of p. Integrators use the form (x, w) with w =
    (u, p), into which `with_stacked_input` converts Functions.

    Sizes are `nx` (state), `nq` (positions in it), `nu` (control), `np` (parameters) and `nw` =
    `nu` + `np`. `structure` is the structure with subdivided strings, and `mechanism` contains its
    constant matrices.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(), control=tc.ForceDensity()))
    >>> model.nx, model.nu
    (36, 9)
    >>> model.ode
    Function(ode:(x[36],u[9])->(xdot[36]) SXFunction)
    >>> model.nodes(model.initial_state).shape
    (6, 3)
    >>> tc.Model(tc.Scene(tc.shapes.prism(), parameters=tc.Parameters("stiffness"))).ode
    Function(ode:(x[36],u[0],p[9])->(xdot[36]) SXFunction)
    """

    def __init__(
        self,
        scene: Scene,
        coordinates: Coordinates | None = None,
        bar_length: BarLength = "current",
    ) -> None:
        instance("Model.scene", scene, Scene, "a tenscasadi.Scene")
        choice("Model.bar_length", bar_length, "current", "constant")
        if coordinates is None:
            coordinates = choose_coordinates(scene, bar_length)
        choice("Model.coordinates", coordinates, "reduced", "full")
        super().__init__(scene, coordinates, scene_mechanism(scene, coordinates, bar_length))
        self.driven: tuple[Any, Model] | None = None  # by the control function of the last run
        self.interpolated: tuple[Any, Model] | None = None  # over the last run
        if self.np and self.nq:
            _check_parameters(self)

    def __repr__(self) -> str:
        sizes = f"{self.nx} states, {self.nu} inputs, {self.np} parameters"
        return f"Model({sizes}, {self.coordinates} coordinates)"

    def to_fields(self) -> dict[str, Any]:
        """Return the keyword arguments that build the model again."""
        bar_length = "constant" if self.mechanism.constant_length else "current"
        return {"scene": self.scene, "coordinates": self.coordinates, "bar_length": bar_length}

    def with_parameters(self, parameters: Any = None) -> Model:
        """Copy the model with parameter values as constants.

        Parameters
        ----------
        parameters : array_like, shape (np,), or mapping, optional
            Values, see `ParameterLayout.values`; nominal if None.

        Returns
        -------
        Model
            The same equations, with Functions of its own.
        """
        p = self.parameters.values(parameters)
        if not self.np:
            return self
        return self._copy(fix(self.scene, p), self.schedule)

    fixed = RenamedAttribute("with_parameters")

    def with_scene(self, scene: Scene, coordinates: Coordinates | None = None) -> Model:
        """Build the model of another scene.

        Parameters
        ----------
        scene : Scene
            The scene, often one with changed fields.
        coordinates : {"reduced", "full"}, optional
            Coordinates. Default: those of this model.

        Returns
        -------
        Model
            The model, with λ̂ computed as in this one.

        Examples
        --------
        >>> from dataclasses import replace
        >>> import tenscasadi as tc
        >>> model = tc.Model(tc.Scene(tc.shapes.prism()))
        >>> model.with_scene(replace(model.scene, control=tc.RestLength())).nu
        9
        """
        fields = {**self.to_fields(), "scene": scene}
        return type(self)(
            **fields if coordinates is None else {**fields, "coordinates": coordinates}
        )

    def with_schedule(self, schedule: ControlSchedule) -> Model:
        """Build a copy whose control follows a function of time.

        Parameters
        ----------
        schedule : ControlSchedule
            Control as a function of time.

        Returns
        -------
        Model
            Model with a clock, whose control u is added to the scheduled one. Its `power` is that
            of all forces, as the scheduled control changes the energy that strings store.
        """
        return self._copy(self.scene, schedule)

    def interpolate_functions(self, first: float, last: float) -> Model:
        """Interpolate the functions of time that CasADi cannot trace.

        The Functions of this model call Python for them, which machine code cannot. Runs use the
        interpolants.

        Parameters
        ----------
        first, last : float
            Start and end of a run [s].

        Returns
        -------
        Model
            Model with interpolants over the run; this model if all functions can be traced.

        Raises
        ------
        ValueError
            If a function raises, is not deterministic, or changes too fast. The message names the
            time.

        Examples
        --------
        >>> import tenscasadi as tc
        >>> pull = tc.NodalForce(lambda t: [[0, 0, 0], [1.0 if t > 0.2 else 0.0, 0, 0]])
        >>> model = tc.Model(tc.Scene(tc.shapes.pendulum(), forces=pull))
        >>> code = model.interpolate_functions(0.0, 1.0).compile()
        """
        number("first", first)
        if number("last", last) <= first:
            raise ValueError(f"last is {last:g}: give a time after first = {first:g} s")
        if self.interpolated is None or self.interpolated[0] != (first, last):
            scene = interpolate_functions(self.scene, first, last)
            if scene is self.scene:
                return self
            self.interpolated = (first, last), self._copy(scene, self.schedule)
        return self.interpolated[1]

    def _copy(self, scene: Scene, schedule: ControlSchedule | None) -> Model:
        constant = self.mechanism.constant_length
        bar_length: BarLength = "constant" if constant else "current"
        return _rebuild(type(self), scene, self.coordinates, bar_length, schedule)

    def __reduce__(self) -> tuple[Any, ...]:
        # Copies and other processes rebuild the Functions, which are larger than the scene.
        bar_length = "constant" if self.mechanism.constant_length else "current"
        return _rebuild, (type(self), self.scene, self.coordinates, bar_length, self.schedule)

    # --- CasADi Functions ---

    @cached_property
    def ode(self) -> ca.Function:
        """Right-hand side of the equation of motion.

        Function "ode" (x, u) → xdot, or (x, u, p) → xdot with parameters. It is self-contained and
        differentiable, so any CasADi tool can use it.
        """
        x, u = self.symbols(self.mechanism.unrolled)
        N, V, time = self.unpack(x)
        w = self.extend_inputs(x, u)
        A, _, _ = forward_dynamics(self, N, V, w, time)
        rate = [self.pack(V, A, self.internal_rates(x, u), 1)]
        # In vector expressions cse would also share the initial zeros of products, and copy them.
        return self._function(
            "ode", x, u, ca.cse(rate) if self.mechanism.unrolled else rate, ["xdot"]
        )

    @cached_property
    def has_coupled_rates(self) -> bool:
        """Whether rates of internal states depend on the state."""
        if not self.na:
            return False
        rows = np.array(self.ode.jac_sparsity(0, 0).get_triplet()[0])
        return bool(np.any((rows >= 2 * self.nq) & (rows < self.moving.stop)))

    def compile(self) -> ca.Function:
        """Compile `ode` to machine code.

        Returns
        -------
        casadi.Function
            The same inputs, outputs and values as `ode`, without derivatives.

        Raises
        ------
        CompileError
            If there is no C compiler, or it fails.
        ValueError
            If CasADi cannot trace a function of time, see `interpolate_functions`.
        """
        reject_python_functions(self.scene, "Model.compile")
        return compile_function(self.ode)

    @cached_property
    def power(self) -> ca.Function | None:
        """Power of all forces whose work is not in `energy`.

        Function "power" (x, u) → power [W]; None if all forces are conservative.
        """
        if self.conservative:
            return None
        x, u = self.symbols(not self.mechanism.large)
        N, V, time = self.unpack(x)
        given = self.extend_inputs(x, u)
        mech, w = self.with_masses(u, inverse=False), self.add_schedule(given, time)
        elements, at = forces.build_elements(self.scene, mech, w), NodeMotion(N, V, time)
        stored = self.schedule is None
        power: Any = sum((e.power(at, stored) for e in elements), start=ca.DM(0))
        if self._supports is not None:  # their reactions do work, too
            total = ca.mtimes(forward_dynamics(self, N, V, given, time)[0], sparse(mech.M))
            power += ca.sum2(ca.sum1((total - forces.sum_forces(elements, mech, at)) * V))
        power += self.internal_power(x, u, stored)
        return self._function("power", x, u, [ca.densify(power)], ["power"])

    @cached_property
    def multiplier_function(self) -> ca.Function:
        """CasADi Function of the multipliers.

        Function "multipliers" (x, u) → λ (β) [N/m] of bars and Ω (3×c) [N] of joints, see
        `multipliers`.
        """
        x, w = self.symbols(self.mechanism.unrolled)
        N, V, time = self.unpack(x)
        u = self.extend_inputs(x, w)
        A, lam, omega = forward_dynamics(self, N, V, u, time)
        if self.structure.bodies:  # there are no class-one nodes, and no joint forces
            omega = ca.DM.zeros(3, 0)
        elif self.coordinates == "reduced":
            full = scene_mechanism(self.scene, "full")
            omega = joint_forces(self, full, N, V, A, lam, u, time)
        lam = forces.bar_force_density(self.scene, self.mechanism, N, u, lam)
        return self._function(
            "multipliers",
            x,
            w,
            [ca.densify(lam.T), ca.densify(omega)],
            ["bar_force_density", "joint_force"],
        )

    # --- numbers in, numbers out ---

    def multipliers(self, x: Any, u: Any = None, parameters: Any = None) -> Multipliers:
        """Compute the force densities of bars and the joint forces.

        Parameters
        ----------
        x : array_like, shape (nx,), or CasADi column
            State.
        u : array_like, shape (nu,), or CasADi column, optional
            Control. Default: the initial control.
        parameters : array_like, shape (np,), mapping, or CasADi column, optional
            Parameters, see `ParameterLayout.values`. Default: nominal.

        Returns
        -------
        Multipliers
            λ̂ and Ω in the paper's signs (Eqs. 85, 87). Ω has the columns of
            `structure.class_one().P`, then those of nodes pinned along some axes, then those of
            inclined rollers. They are CasADi (MX) if x or u is.

        Notes
        -----
        With redundant constraints the multipliers are not unique. These have the smallest norm in
        scaled rows.
        """
        arguments = self.arguments(x, u, parameters)
        if any(
            isinstance(value, ca.SX) for value in arguments
        ) and not self.multiplier_function.is_a("SXFunction"):
            raise TypeError(
                "multipliers got SX for x, u or parameters: give MX, "
                "because the linear solver has no SX"
            )
        lam, omega = self.multiplier_function(*arguments)
        return (
            Multipliers(lam.full().ravel(), omega.full())
            if isinstance(lam, ca.DM)
            else Multipliers(lam, omega)
        )

    def describe(self) -> TermCounts:
        """Count the instructions of each term of the right-hand side.

        Returns
        -------
        TermCounts
            Dictionary from the name of a term to its instructions, with their ``"total"``; prints
            as a table. Its `advice` states whether full coordinates are cheaper, as for long chains
            of bars.
        """
        advice = compare_coordinates(self.structure, self.coordinates)
        return count_terms(self, self.ode, advice)


def _rebuild(
    kind: type[Model],
    scene: Scene,
    coordinates: Coordinates,
    bar_length: BarLength,
    schedule: ControlSchedule | None,
) -> Model:
    """Build a copy of a model without repeating its warnings.

    `kind` is its class, and the others are its arguments; for `schedule` see `Model.with_schedule`.
    """
    model = kind.__new__(kind)
    model.schedule = schedule
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        kind.__init__(model, scene, coordinates, bar_length)
    return model


def _check_parameters(model: Model) -> None:
    """Check that each parameter has an effect.

    Raises ValueError. Warns of parameters that affect the initial control only.
    """
    unused, control = _find_unused(model), model.scene.control
    forces_given = model.scene.commands_forces
    replaced = ("stiffness", "rest_length") if forces_given else ("rest_length",)
    commanded = "" if control is None else control.quantity
    for name in unused:
        if control is None or name not in replaced:
            reason = ""
            if forces_given and name == "damping":
                reason = f" (under {control} {commanded} are commanded)"
            elif name == "string_mass":
                reason = " (strings have mass where segments= cuts them)"
            raise ValueError(
                f"Parameters has {name!r}, which has no effect on this scene{reason}: remove the name"
            )
    winds = control is not None and control.locked is not control
    started = ("rest_length",) if winds else ()  # initial internal states
    for name in [name for name in unused if name not in started]:
        warnings.warn(
            f"Parameters has {name!r}, which only sets the default control: under {control} "
            f"{commanded} are commanded, and motions with a given control do not depend on it",
            UserWarning,
            stacklevel=3,
        )


def _find_unused(model: Model) -> list[str]:
    """Find the parameters that do not enter the equations of motion."""
    places = model.parameters.places
    x, u, one = ca.MX.sym("x", model.nx), ca.MX.sym("u", model.nu), ca.MX.sym("one", len(places))
    p = ca.vertcat(
        *(ca.repmat(one[k], place.stop - place.start, 1) for k, place in enumerate(places.values()))
    )
    by_quantity = ca.Function("by_quantity", [x, u, one], [model.ode(x, u, p)]).jac_sparsity(0, 2)
    used = set(by_quantity.get_triplet()[1])
    return [name for k, name in enumerate(places) if k not in used]
