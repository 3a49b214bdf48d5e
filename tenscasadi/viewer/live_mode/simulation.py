"""A motion that goes on tick by tick, while its control changes and somebody pulls at a node."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tenscasadi.dynamics.constraint_forces import RedundantConstraints
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.scheme import Scheme, check_scheme
from tenscasadi.integrators.stability import contact_rate, lightest_mass, stable_step
from tenscasadi.integrators.stabilization import Correction, Projection
from tenscasadi.scene.loads import NodalForce
from tenscasadi.scene.parameters import Parameters
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import RestLength
from tenscasadi.simulation.diagnosis import describe_doubts, explain_divergence
from tenscasadi.simulation.engine.engine import FAULTS
from tenscasadi.simulation.engine.kernel import build_kernel
from tenscasadi.simulation.engine.request import FINISHED, Intervals, Rolled
from tenscasadi.simulation.engine.step_code import Account
from tenscasadi.simulation.trajectory import Trajectory, observe_states, record_trajectory
from tenscasadi.util.compile import Compiled
from tenscasadi.util.validate import (
    SMALLEST,
    Array,
    finite_array,
    instance,
    node_index,
    positive_number,
)
from tenscasadi.viewer.live_mode.recording import Recording

_STEP, _BOUNCE = 1e-3, 0.1  # s; radians of a node's bounce in a step
_PULL_RATE = 2 * np.pi  # rad/s: the whole structure swings at the pointer once a second
_HELD = 0.3  # radians that the lightest node may swing at the pointer while its pull is held


@dataclass(frozen=True)
class Stepping:
    """How a motion is computed while it is watched.

    Parameters
    ----------
    step : float, optional
        Largest step, s. Default: 1 ms, or half of what is stable at the start where that is less.
    scheme : Scheme
        Integration scheme.
    correction : Projection or BarLengthCorrection, optional
        Correction after every `correction.every`-th step.
    compiled : bool, optional
        As for `simulate`.
    tick : float
        Time of the motion, s, between two looks at the controls.

    Examples
    --------
    >>> from tenscasadi.viewer import Stepping
    >>> Stepping(step=5e-4).tick < 0.02
    True
    """

    step: float | None = None
    scheme: Scheme = field(default_factory=RungeKutta4)
    correction: Correction | None = field(default_factory=Projection)
    compiled: Compiled = None
    tick: float = 1 / 60

    def __post_init__(self) -> None:
        check_scheme(self.scheme)
        positive_number("tick", self.tick)
        if self.step is not None:
            positive_number("step", self.step)


@dataclass(frozen=True)
class Pull:
    """A damped spring from a node to a point, m; stiffness in N/m, damping in N·s/m."""

    node: int
    target: tuple[float, float, float]
    stiffness: float
    damping: float

    def force(self, place: Array, velocity: Array) -> Array:
        """Return the force (3,) on the node, N."""
        return np.asarray(
            self.stiffness * (np.array(self.target) - place) - self.damping * velocity
        )


class LiveSimulation:
    """The motion of a model, driven while it goes on.

    Between ticks the control may be changed, and a node be pulled at by a spring. In a tick both
    are held. What has happened can be read as a trajectory at any time. A motion that breaks down
    stays at its last good state and says so in `fault`, until it is reset.

    Parameters
    ----------
    model : Model or Scene
        What moves. Strings without control are driven by their rest lengths.
    state : array_like, shape (nx,), optional
        State at the start. Default: the model's initial state.
    control : array_like, shape (nu,), optional
        Control at the start. Default: the model's initial control.
    stepping : Stepping
        Step, scheme and correction.
    parameters : array_like, shape (np,), or mapping of str to array_like, optional
        Values of the model's parameters, see `tenscasadi.ParameterLayout.values`; nominal if None.

    Raises
    ------
    CompileError
        Machine code was asked for and cannot be made.
    TypeError, ValueError
        An argument is wrong; the message names it.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> from tenscasadi.viewer.live_mode.simulation import LiveSimulation, Stepping
    >>> run = LiveSimulation(tc.Scene(tc.shapes.prism()), stepping=Stepping(compiled=False))
    >>> run.set_control([0, 1, 2], 0.8 * run.start_control[0])
    >>> run.advance(3)
    3
    >>> round(run.time, 3), run.fault
    (0.05, '')
    """

    def __init__(
        self,
        model: Model | Scene,
        state: Any = None,
        control: Any = None,
        stepping: Stepping = Stepping(),
        parameters: Any = None,
    ) -> None:
        instance("model", model, (Model, Scene), "a tenscasadi.Model or Scene")
        own = (Model(model) if isinstance(model, Scene) else model).with_parameters(parameters)
        self.model = model = _driven(own)
        self.start_state = np.array(
            model.initial_state if state is None else finite_array("state", state, (model.nx,))
        )
        self.start_control = np.array(
            model.initial_control
            if control is None
            else finite_array("control", control, (model.nu,))
        )
        self._check_lengths(self.start_control)
        self.stepping, self.tick = stepping, stepping.tick
        largest = (
            _default_step(model, stepping.scheme, self.start_state, self.start_control)
            if stepping.step is None
            else stepping.step
        )
        self.substeps = _substeps(stepping, largest)
        self.step = self.tick / self.substeps
        self._kernel = build_kernel(
            model,
            stepping.scheme,
            stepping.correction,
            measured=True,
            account=Account(model.power is not None, False),
            lanes=1,
            compiled=stepping.compiled,
        )
        self.compiled = self._kernel.lanes > 0
        self.note = self._kernel.note and f"; {self._kernel.note}"
        self._energy = model.stacked(model.energy_function)
        mass = float(model.mechanism.M.sum())
        self._least_mass = lightest_mass(model) if self.pullable.any() else 0.0
        #: stiffness of the spring at the pointer, N/m
        self.pull_stiffness = min(mass * _PULL_RATE**2, self._least_mass * (_HELD / self.tick) ** 2)
        self.reset()

    @property
    def pullable(self) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Which nodes (n,) can be pulled: those of the structure that are not held; none where its nodal forces change over time."""
        s = self.model.scene.structure
        return np.asarray(~s.fixed.all(axis=1) & bool(self.model.np))

    # --- what a person does ---

    def reset(self) -> None:
        """Go back to the start: state, control, and nothing recorded."""
        self._z = np.append(self.start_state, np.zeros(int(self.model.power is not None)))
        self.control = self.start_control.copy()
        self.ticks, self.seconds, self.fault = 0, 0.0, ""
        self.pull: Pull | None = None
        self._last_control = self.control.copy()
        self._recording = Recording(self.model.nx + 1 + self.model.nu)
        self._jumps = 0.0  # energy that changes of the control have given, J
        self._seen: dict[str, Array] | None = None

    def set_control(self, strings: Any, value: float) -> None:
        """Give some strings a rest length, m, or force density, N/m, from the next tick on.

        Parameters
        ----------
        strings : sequence of int
            Strings of the structure.
        value : float
            The control of each.

        Raises
        ------
        ValueError
            It is not finite, or a rest length that is not greater than 0.
        """
        control = self.control.copy()
        control[list(strings)] = finite_array("value", value, ())
        self._check_lengths(control)
        self.control = control

    def grab(self, node: int, target: Any) -> None:
        """Pull a node to a point from the next tick on, by a damped spring of `pull_stiffness`.

        Parameters
        ----------
        node : int
            Node of the structure.
        target : array_like, shape (3,)
            The point, m.

        Raises
        ------
        ValueError
            There is no such node, it is held, or the point is not finite.
        """
        place = node_index("node", node, len(self.pullable))
        if not self.pullable[place]:
            raise ValueError(
                f"node {place} cannot be pulled: give one of {np.flatnonzero(self.pullable).tolist()}"
            )
        x, y, z = finite_array("target", target, (3,)).tolist()
        damping = float(np.sqrt(self.pull_stiffness * self._least_mass))
        self.pull = Pull(place, (x, y, z), self.pull_stiffness, damping)

    def release(self) -> None:
        """Let go of the node."""
        self.pull = None

    # --- time ---

    def advance(self, ticks: int = 1) -> int:
        """Compute so many ticks.

        Parameters
        ----------
        ticks : int
            How many.

        Returns
        -------
        int
            How many were computed: fewer where the motion broke down, which `fault` explains.
        """
        return sum(1 for _ in range(ticks) if not self.fault and self._advance())

    def _advance(self) -> bool:
        w = self._held()
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
        self.ticks, self._seen = self.ticks + 1, None
        return True

    def _roll(self, states: Array, inputs: Array, steps: int) -> Rolled:
        """Take steps from states (n, nx) under inputs (n, nw)."""
        whole = Intervals(*(np.array([value]) for value in (0, steps, self.step)))
        with np.errstate(all="ignore"):
            return self._kernel.run(
                states, inputs[:, None], whole, save_every=steps, longest=self.step
            )

    def _explain(self, rolled: Rolled) -> str:
        found = FAULTS.get(int(rolled.status[0]), "a step could not be computed")
        states = np.stack([self.start_state, self.state])
        held = np.tile(np.concatenate([self.control, self.model.parameters.nominal]), (2, 1))
        times = np.array([0.0, max(self.time, self.step)])
        record = record_trajectory(self.model, times, states, held, step=self.step, message="")
        return f"{found}; {explain_divergence(self.model, self.stepping.scheme, record, 1)}"

    def _held(self) -> Array:
        p = self.model.parameters.nominal
        if self.pull is not None:
            p = p.copy()
            p[3 * self.pull.node : 3 * self.pull.node + 3] += self.pull_force
        return np.concatenate([self.control, p])

    # --- what is seen ---

    @property
    def time(self) -> float:
        """Time since the start, s."""
        return self.ticks * self.tick

    @property
    def state(self) -> Array:
        """State (nx,)."""
        return self._z[: self.model.nx]

    @property
    def nodes(self) -> Array:
        """Nodes (n, 3), m."""
        return np.asarray(self.model.nodes(self.state))

    @property
    def pull_force(self) -> Array:
        """Force (3,) at the pointer, N; 0 where nothing is pulled."""
        if self.pull is None:
            return np.zeros(3)
        node = self.pull.node
        return self.pull.force(
            self.nodes[node], np.asarray(self.model.velocities(self.state))[node]
        )

    @property
    def observed(self) -> dict[str, Array]:
        """All that `Model.observe` tells of the present state, by name."""
        if self._seen is None:
            rows = observe_states(self.model, self.state[None], self._held()[None])
            self._seen = {name: values[0] for name, values in rows.items()}
        return self._seen

    # --- what is kept ---

    def _keep(self) -> None:
        """Record the state at which a tick begins, with the control in it: a change of the control changes the energy at once."""
        if np.any(self.control != self._last_control):
            p, x = self.model.parameters.nominal, self.state
            before, after = (
                float(self._energy(x, np.concatenate([u, p])))
                for u in (self._last_control, self.control)
            )
            self._jumps += after - before
            self._last_control, self._seen = self.control.copy(), None
        supplied = self._jumps + (float(self._z[-1]) if self.model.power is not None else 0.0)
        self._recording.keep(self.ticks, np.concatenate([self.state, [supplied], self.control]))

    def trajectory(self) -> Trajectory:
        """Return what has been recorded, with its errors, up to the present state.

        Long recordings keep fewer rows, spread over all of it. The work of pulls is in the balance
        of the energy; their forces are not kept.

        Returns
        -------
        Trajectory
            The motion. `success` is False where it broke down or cannot be trusted, and `message`
            says why.
        """
        self._keep()
        ticks, rows = self._recording.rows()
        model, stepping = self.model, self.stepping
        nx = model.nx
        held = np.hstack(
            [rows[:, nx + 1 :], np.broadcast_to(model.parameters.nominal, (len(rows), model.np))]
        )
        kept = record_trajectory(
            model,
            np.asarray(ticks * self.tick, dtype=float),
            rows[:, :nx],
            held,
            step=self.step,
            message="",
            supplied=rows[:, nx] - rows[0, nx],
            seconds=self.seconds,
        )
        if stepping.correction is not None:
            shift = np.full((2, len(rows)), np.nan)
            if not stepping.scheme.adaptive:
                again = self._roll(kept.states, held, stepping.correction.every).corrected
                shift = np.zeros_like(shift) if again is None else again[:, 0].T
            kept = replace(kept, correction_shift=shift[0], correction_energy=shift[1])
        success, message = not self.fault, self.fault
        if success:
            doubts, success = (
                describe_doubts(model, stepping.scheme, kept, stepping.compiled)
                if len(rows) > 1
                else ("", True)
            )
            message = f"driven by hand for {self.ticks * self.substeps} steps of {self.step:.3g} s{self.note}{doubts}"
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


def _driven(model: Model) -> Model:
    """Return the model with a control and with a push on each node as parameters, so that one compiled loop serves all of them."""
    scene = model.scene
    control = (
        scene.control
        if scene.control is not None or not len(scene.structure.strings)
        else RestLength()
    )
    forces = (
        NodalForce(np.zeros((len(scene.structure.nodes), 3)))
        if scene.forces is None
        else scene.forces
    )
    if forces.varies:
        scene = replace(scene, control=control)
    else:
        scene = replace(scene, control=control, forces=forces, parameters=Parameters("forces"))
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", RedundantConstraints
        )  # the model that was given has said so
        return Model(
            scene, model.coordinates, "constant" if model.mechanism.constant_length else "current"
        )


def _default_step(model: Model, scheme: Scheme, x: Array, u: Array) -> float:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # NaN where the start has no derivative
        stable = 0.5 * stable_step(model, x, u, scheme, safety=1.0)
    limits = [
        _STEP,
        stable,
        _BOUNCE / (contact_rate(model) or np.inf) if contact_rate(model) else np.inf,
    ]
    return float(np.nanmin([limit for limit in limits if limit > 0]))


def _substeps(stepping: Stepping, largest: float) -> int:
    """Count the grid steps of a tick."""
    if stepping.scheme.adaptive:
        return 1
    every = 1 if stepping.correction is None else stepping.correction.every
    return max(1, every * int(np.ceil(stepping.tick / largest / every - 1e-9)))
