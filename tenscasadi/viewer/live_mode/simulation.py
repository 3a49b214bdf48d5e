"""Interactive simulation, in ticks of constant inputs."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tenscasadi.drawing.view_content import Frame
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.stability import lightest_mass
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import RestLength
from tenscasadi.simulation.engine.build import build_kernel
from tenscasadi.simulation.engine.request import FINISHED, Intervals, Rolled
from tenscasadi.simulation.engine.step_code import Account
from tenscasadi.simulation.trajectory import Trajectory, observe_states, record_trajectory
from tenscasadi.simulation.verdict.endings import FAULTS, RunSamples, explain_loss
from tenscasadi.simulation.verdict.judge import find_doubts, measure_trajectory
from tenscasadi.util.renamed import rename_keywords
from tenscasadi.util.validate import SMALLEST, Array, Booleans, finite_array, instance
from tenscasadi.viewer.live_mode.inputs import add_inputs
from tenscasadi.viewer.live_mode.options import LiveOptions, count_substeps
from tenscasadi.viewer.live_mode.recording import Recording


@dataclass(frozen=True)
class Pull:
    """Damped spring from a node to a target [m].

    Its stiffness is in N/m, and its damping in N s/m.
    """

    node: int
    target: tuple[float, float, float]
    stiffness: float
    damping: float

    def force(self, place: Array, velocity: Array) -> Array:
        """Compute the force (3,) on the node [N].

        `place` (3,) is its position [m], and `velocity` (3,) its velocity [m/s].
        """
        return np.asarray(
            self.stiffness * (np.array(self.target) - place) - self.damping * velocity
        )


class LiveSimulation:
    """Simulation of a model with inputs that change interactively.

    In a tick the control and the spring that pulls a node are constant. The recording is available
    as a trajectory at any time. A simulation that fails stays at its last valid state and explains
    it in `fault`, until it is reset.

    Parameters
    ----------
    model : Model or Scene
        Model. Strings without control are controlled by their rest lengths.
    state : array_like, shape (nx,), optional
        Initial state. Default: that of the model.
    control : array_like, shape (nu,), optional
        Initial control. Default: that of the model.
    options : LiveOptions
        Step, scheme and correction.
    parameters : array_like, shape (np,), or mapping of str to array_like, optional
        Values of the model's parameters, see `tenscasadi.ParameterLayout.values`; nominal if None.

    Raises
    ------
    CompileError
        Machine code was requested and cannot be made.
    TypeError, ValueError
        An argument is wrong; the message names it.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> from tenscasadi.viewer import LiveOptions, LiveSimulation
    >>> run = LiveSimulation(tc.Scene(tc.shapes.prism()), options=LiveOptions(compiled=False))
    >>> run.set_control([0, 1, 2], 0.8 * run.start_control[0])
    >>> run.advance(3)
    3
    >>> round(run.time, 3), run.fault
    (0.05, '')
    """

    @rename_keywords(stepping="options")
    def __init__(
        self,
        model: Model | Scene,
        state: Any = None,
        control: Any = None,
        options: LiveOptions = LiveOptions(),
        parameters: Any = None,
    ) -> None:
        instance("model", model, (Model, Scene), "a tenscasadi.Model or Scene")
        given = Model(model) if isinstance(model, Scene) else model
        self.model = model = add_inputs(given, parameters)
        self.start_state = np.array(
            model.initial_state if state is None else finite_array("state", state, (model.nx,))
        )
        self.start_control = np.array(
            model.initial_control
            if control is None
            else finite_array("control", control, (model.nu,))
        )
        self._check_lengths(self.start_control)
        self.options, self.tick = options, options.tick
        self.substeps = count_substeps(options, model, self.start_state, self.start_control)
        self.step = self.tick / self.substeps
        self._kernel = build_kernel(
            model,
            options.scheme,
            options.correction,
            measured=True,
            account=Account(model.power is not None, False),
            lanes=1,
            compiled=options.compiled,
        )
        self.compiled = self._kernel.lanes > 0
        self.note = self._kernel.note and f"; {self._kernel.note}"
        self._energy = model.with_stacked_input(model.energy_function)
        mass = float(model.mechanism.M.sum())
        self._least_mass = lightest_mass(model) if self.pullable.any() else 0.0
        # The whole structure swings at the pointer once a second, and the lightest node by at most
        # 0.3 rad in a tick, in which the pull is constant.
        stiffness = mass * (2 * np.pi) ** 2, self._least_mass * (0.3 / self.tick) ** 2
        #: stiffness of the spring at the pointer [N/m]
        self.pull_stiffness = min(stiffness)
        self.reset()

    @property
    def pullable(self) -> Booleans:
        """Mask (n,) of the nodes that the user can pull.

        Pinned ones cannot be pulled, nor any if nodal forces vary with time.
        """
        s = self.model.scene.structure
        return np.asarray(~s.fixed.all(axis=1) & ("forces" in self.model.parameters.places))

    # --- actions of a person ---

    def reset(self) -> None:
        """Return to the initial state, and clear the recording.

        Control and parameters return to their initial values, too.
        """
        self._z = np.append(self.start_state, np.zeros(int(self.model.power is not None)))
        self.control = self.start_control.copy()
        self.parameters = self.model.parameters.nominal.copy()
        self.ticks, self.seconds, self.fault = 0, 0.0, ""
        self.pull: Pull | None = None
        self._last_inputs = self._constant_inputs()
        self._recording = Recording(self.model.nx + 1 + self.model.nw)
        self._jumps = 0.0  # energy that changes of control and parameters have given, J
        self._observed: dict[str, Array] | None = None

    def set_control(self, strings: Any, value: float) -> None:
        """Set the control of some strings from the next tick on.

        Parameters
        ----------
        strings : sequence of int or str
            Strings of the structure, or cables and strings in no cable, by index or name.
        value : float
            Rest length [m] or force density [N/m] of each.

        Raises
        ------
        ValueError
            It is not finite, or a rest length is not greater than 0.
        """
        control = self.control.copy()
        names = self.model.scene.structure.names
        control[names.mask("strings", "input", strings)] = finite_array("value", value, ())
        self._check_lengths(control)
        self.control = control

    def set_parameters(self, name: str, values: Any) -> None:
        """Set a parameter of the model from the next tick on.

        Parameters
        ----------
        name : str
            Quantity, such as ``"gravity"`` or one of the scene's own.
        values : array_like
            Value of each item, or one number for all.

        Raises
        ------
        TypeError, ValueError
            There is no such quantity, or a value is wrong.
        """
        changed = self.model.parameters.values({name: values})
        place = self.model.parameters.places[name]
        self.parameters[place] = changed[place]

    def grab(self, node: int | str, target: Any) -> None:
        """Pull a node to a target from the next tick on.

        A damped spring of stiffness `pull_stiffness` pulls it.

        Parameters
        ----------
        node : int or str
            Node of the structure, by its index or name.
        target : array_like, shape (3,)
            Target [m].

        Raises
        ------
        ValueError
            There is no such node, it is pinned, or the target is not finite.
        """
        place = self.model.scene.structure.names.index("node", "node", node)
        if not self.pullable[place]:
            raise ValueError(
                f"node {place} cannot be pulled: give one of {np.flatnonzero(self.pullable).tolist()}"
            )
        x, y, z = finite_array("target", target, (3,)).tolist()
        damping = float(np.sqrt(self.pull_stiffness * self._least_mass))
        self.pull = Pull(place, (x, y, z), self.pull_stiffness, damping)

    def release(self) -> None:
        """Remove the spring that pulls a node."""
        self.pull = None

    # --- time ---

    def advance(self, ticks: int = 1) -> int:
        """Simulate a number of ticks.

        Parameters
        ----------
        ticks : int
            Number of ticks.

        Returns
        -------
        int
            Number of simulated ticks: fewer if the simulation failed, which `fault` explains.
        """
        return sum(1 for _ in range(ticks) if not self.fault and self._advance())

    def _advance(self) -> bool:
        w = self._inputs()
        self._keep()
        began = time.perf_counter()
        rolled = self._roll(self.state[None], w[None], self.substeps)
        self.seconds += time.perf_counter() - began
        if rolled.status[0] != FINISHED:
            self.fault = f"stopped at t = {self.time:.3g} s: {self._explain(rolled)}"
            self.pull = None
            return False
        supplied = self._z[self.model.nx :] + rolled.supplied[: len(self._z) - self.model.nx]
        self._z = np.append(rolled.states[0], supplied)
        self.ticks, self._observed = self.ticks + 1, None
        return True

    def _roll(self, states: Array, inputs: Array, steps: int) -> Rolled:
        """Simulate steps from states (n, nx) under inputs (n, nw)."""
        whole = Intervals(*(np.array([value]) for value in (0, steps, self.step)))
        with np.errstate(all="ignore"):
            return self._kernel.run(
                states, inputs[:, None], whole, save_every=steps, longest=self.step
            )

    def _explain(self, rolled: Rolled) -> str:
        found = FAULTS.get(int(rolled.status[0]), "a step could not be computed")
        states = np.stack([self.start_state, self.state])
        held = np.tile(self._constant_inputs(), (2, 1))
        samples = RunSamples(np.array([0.0, self.time]), states, held)
        return f"{found}; {explain_loss(self.model, self.options.scheme, self.step, samples)}"

    def _constant_inputs(self) -> Array:
        """Return control and parameters (nw,) without the pull."""
        return np.concatenate([self.control, self.parameters])

    def _inputs(self) -> Array:
        p = self.parameters.copy()
        if self.pull is not None:
            first = self.model.parameters.places["forces"].start + 3 * self.pull.node
            p[first : first + 3] += self.pull_force
        return np.concatenate([self.control, p])

    # --- present state ---

    @property
    def time(self) -> float:
        """Time since the start [s]."""
        return self.ticks * self.tick

    @property
    def state(self) -> Array:
        """Present state (nx,)."""
        return self._z[: self.model.nx]

    @property
    def nodes(self) -> Array:
        """Present node positions (n, 3) [m]."""
        return np.asarray(self.model.nodes(self.state))

    @property
    def frame(self) -> Frame:
        """Frame of the present state."""
        seen = self.observed
        velocities = seen["velocities"].reshape(-1, 3)
        return Frame(self.nodes, velocities, seen["tension"], seen["force_density"])

    @property
    def pull_force(self) -> Array:
        """Force (3,) of the pulling spring [N]; 0 if there is none."""
        if self.pull is None:
            return np.zeros(3)
        node = self.pull.node
        return self.pull.force(
            self.nodes[node], np.asarray(self.model.velocities(self.state))[node]
        )

    @property
    def observed(self) -> dict[str, Array]:
        """Outputs of `Model.observe` in the present state, by name."""
        if self._observed is None:
            rows = observe_states(self.model, self.state[None], self._inputs()[None])
            self._observed = {name: values[0] for name, values in rows.items()}
        return self._observed

    # --- recording ---

    def _keep(self) -> None:
        """Record the state at the start of a tick, and its inputs.

        The force of the pulling spring is not recorded. A change of control or parameters changes
        the energy instantly.
        """
        inputs = self._constant_inputs()
        if np.any(inputs != self._last_inputs):
            before, after = (
                float(self._energy(self.state, w)) for w in (self._last_inputs, inputs)
            )
            self._jumps += after - before
            self._last_inputs, self._observed = inputs, None
        supplied = self._jumps + (float(self._z[-1]) if self.model.power is not None else 0.0)
        self._recording.keep(self.ticks, np.concatenate([self.state, [supplied], inputs]))

    def trajectory(self) -> Trajectory:
        """Return the recording with its errors, up to the present state.

        Long recordings contain fewer rows, evenly spread. The energy balance includes the work of
        pulls, whose forces are not recorded.

        Returns
        -------
        Trajectory
            The trajectory. `success` is False if it failed or is not trustworthy, which `message`
            explains.
        """
        self._keep()
        ticks, rows = self._recording.rows()
        model, options = self.model, self.options
        nx = model.nx
        held = rows[:, nx + 1 :]
        kept = record_trajectory(
            model,
            np.asarray(ticks * self.tick, dtype=float),
            rows[:, :nx],
            held,
            step=self.step,
            message="",
            seconds=self.seconds,
        )
        energy = kept.energy - rows[:, nx]
        kept = replace(kept, energy_error=energy - energy[0])
        if options.correction is not None:
            shift = np.full((2, len(rows)), np.nan)
            if not options.scheme.adaptive:
                again = self._roll(kept.states, held, options.correction.every).corrected
                shift = np.zeros_like(shift) if again is None else again[:, 0].T
            kept = replace(kept, correction_shift=shift[0], correction_energy=shift[1])
        success, message = not self.fault, self.fault
        if success:
            doubts = find_doubts(measure_trajectory(model, kept))
            success = not doubts.failed[0]
            message = f"controlled interactively for {self.ticks * self.substeps} steps of {self.step:.3g} s{self.note}{doubts.text[0]}"
        attempts = self.ticks * self.substeps
        return replace(
            kept,
            success=success,
            message=message,
            compiled=self.compiled,
            attempts=attempts,
            parameters=np.zeros(0),
        )

    def _check_lengths(self, control: Array) -> None:
        if isinstance(self.model.scene.control, RestLength) and np.any(control < SMALLEST):
            raise ValueError(
                f"control has the rest length {control.min():g} m: give lengths greater than 0"
            )
