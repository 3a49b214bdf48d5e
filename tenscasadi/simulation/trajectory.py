"""Trajectories with forces, energies and errors, in .npz files."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import casadi as ca
import numpy as np

from tenscasadi.dynamics.body_motion import body_angular_velocity, body_orientation
from tenscasadi.dynamics.model import Model
from tenscasadi.scene.failed_strings import name_limited
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strength import STATES
from tenscasadi.schema.stored import array_fields, check_indices
from tenscasadi.simulation.scene_result import SceneResult, format_largest
from tenscasadi.simulation.string_breaks import (
    StringBreak,
    StringYield,
    find_breaks,
    find_yields,
)
from tenscasadi.structure.structure import Structure
from tenscasadi.util.tables import MOST_LISTED, Quantity, Tabular
from tenscasadi.util.troubleshooting import describe_address
from tenscasadi.util.validate import LARGEST, Array, Indices
from tenscasadi.util.viewable import Viewable


@dataclass(frozen=True, eq=False)
class Trajectory(
    Tabular, Viewable, SceneResult, form="tenscasadi trajectory 1", title="trajectory"
):
    """Trajectory of a structure with its numerical errors.

    It describes n nodes, β bars and α strings at T saved times. `simulate` and the plans of `ocp`
    return it. All arrays are read-only.

    Attributes
    ----------
    time : ndarray, shape (T,)
        Saved times [s].
    nodes : ndarray, shape (T, n, 3)
        Positions of the nodes [m].
    velocities : ndarray, shape (T, n, 3)
        Velocities of the nodes [m/s].
    force_density : ndarray, shape (T, α)
        Force densities of the strings [N/m].
    tension : ndarray, shape (T, α)
        Tensions of the strings [N].
    energy : ndarray, shape (T,)
        Total energy [J].
    energy_parts : ndarray, shape (T, 3)
        Kinetic, elastic and gravitational energy [J].
    energy_error : ndarray, shape (T,)
        Energy gained beyond the work of all forces and of changes of the control [J], due to
        numerical errors. NaN if it was not computed.
    bar_length_error : ndarray, shape (T,)
        Largest relative error of a bar's length.
    joint_error : ndarray, shape (T,)
        Largest joint error [m].
    correction_shift : ndarray, shape (T,)
        Distance by which the first correction after this row moves a node [m]. It is 0 without a
        correction, and NaN for schemes with error control.
    correction_energy : ndarray, shape (T,)
        Energy that this correction adds [J]; 0 and NaN as above.
    states : ndarray, shape (T, nx)
        States of the model.
    control : ndarray, shape (T, nu)
        Controls of the model. Each row acts from its time on, but the last row acts until its time.
    bars : ndarray of int, shape (β, 2)
        Nodes at the ends of each bar.
    strings : ndarray of int, shape (α, 2)
        Nodes at the ends of each string.
    pinned : ndarray of int
        Nodes with pins or rollers.
    success : bool
        Whether the run reached its end and is trustworthy, see `simulate`.
    message : str
        End of the run, and reasons not to trust it.
    step : float
        Mean length of a step [s].
    seconds : float
        Wall time of the time loop [s].
    compiled : bool
        Whether the loop ran as machine code.
    attempts : int
        Number of computed steps, including rejected ones and those that locate events; 0 if they
        were not counted.
    interrupted : bool
        Whether the run was interrupted from the keyboard.
    parameters : ndarray, shape (np,)
        Values of the model's parameters.
    error_estimate : float
        Estimated step-size error of the node positions [m], from a repetition of the run with other
        steps; NaN if it was not repeated.
    scene : Scene or None
        The simulated scene; None if the file does not contain it. Its functions of time are tables
        of samples at the saved times after loading.
    sampled : tuple of str
        Fields of `scene` that are such tables.

    See Also
    --------
    simulate : Simulate a model.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> run = tc.simulate(tc.Model(tc.Scene(tc.shapes.prism())), t_end=0.1, step=0.01, compiled=False)
    >>> run
    Trajectory(11 rows, 6 nodes, t = 0 … 0.1 s, success=True)
    >>> run.nodes.shape
    (11, 6, 3)
    """

    # the shape by the letters of the docstring, and NumPy's letter of the numbers (i: also small
    # integers)
    time: Annotated[Array, "T", "f"]
    nodes: Annotated[Array, "Tn3", "f"]
    velocities: Annotated[Array, "Tn3", "f"]
    force_density: Annotated[Array, "Tα", "f"]
    tension: Annotated[Array, "Tα", "f"]
    energy: Annotated[Array, "T", "f"]
    energy_parts: Annotated[Array, "T3", "f"]
    energy_error: Annotated[Array, "T", "f"]
    bar_length_error: Annotated[Array, "T", "f"]
    joint_error: Annotated[Array, "T", "f"]
    correction_shift: Annotated[Array, "T", "f"]
    correction_energy: Annotated[Array, "T", "f"]
    states: Annotated[Array, "Tx", "f"]
    control: Annotated[Array, "Tu", "f"]
    bars: Annotated[Indices, "β2", "i"]
    strings: Annotated[Indices, "α2", "i"]
    pinned: Annotated[Indices, "p", "i"]
    success: Annotated[bool, "", "b"]
    message: Annotated[str, "", "U"]
    step: Annotated[float, "", "f"]
    seconds: Annotated[float, "", "f"]
    compiled: Annotated[bool, "", "b"]
    attempts: Annotated[int, "", "i"] = 0
    interrupted: Annotated[bool, "", "b"] = False
    parameters: Annotated[Array, "q", "f"] = dataclasses.field(default_factory=lambda: np.zeros(0))
    error_estimate: Annotated[float, "", "f"] = np.nan
    scene: Scene | None = None
    sampled: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if not len(self.time):
            raise ValueError("field 'time' is empty")
        for name in ("bars", "strings", "pinned"):
            check_indices(name, getattr(self, name), self.nodes.shape[1])

    def __repr__(self) -> str:
        return f"Trajectory({len(self.time)} rows, {self.nodes.shape[1]} nodes, t = {self.time[0]:g} … {self.time[-1]:g} s, success={self.success})"

    @property
    def internal_states(self) -> dict[str, Array]:
        """Internal states (T, nu) by name, such as "rest length" under `RestLengthRate`.

        "intact", "time intact" and "plastic elongation" are (T, m), for the strings and cables that
        can break or yield.
        """
        if self.scene is None or not self.scene.internal_states:
            return {}
        parts = self.scene.internal_states
        end = self.states.shape[1] - int(self.scene.has_clock)
        begins = end - np.cumsum([len(part.initial) for part in parts[::-1]])[::-1]
        return {
            part.quantity: self.states[:, begin : begin + len(part.initial)]
            for part, begin in zip(parts, begins.tolist(), strict=True)
        }

    @property
    def breaks(self) -> tuple[StringBreak, ...]:
        """Strings and cables that break, in the order of time.

        See `Breaking`.
        """
        return () if self.scene is None else find_breaks(self.scene, self.states)

    @property
    def yields(self) -> tuple[StringYield, ...]:
        """Strings and cables that yield, in the order of time; see `Yielding`."""
        return () if self.scene is None else find_yields(self.scene, self.time, self.states)

    def orientation(self, body: int) -> Array:
        """Compute the orientation of a rigid body.

        Parameters
        ----------
        body : int
            Index of the body in ``Structure.bodies``.

        Returns
        -------
        ndarray, shape (T, 3, 3)
            Rotation matrices from the structure's nodes to those of each row.

        Raises
        ------
        TypeError, ValueError
            If there is no such body, it is a thin rod, or the trajectory has no scene.
        """
        return body_orientation(self._require_structure(), body, self.nodes)

    def angular_velocity(self, body: int) -> Array:
        """Compute the angular velocity of a rigid body.

        Parameters
        ----------
        body : int
            Index of the body in ``Structure.bodies``.

        Returns
        -------
        ndarray, shape (T, 3)
            Angular velocities along x, y and z [rad/s].

        Raises
        ------
        TypeError, ValueError
            If there is no such body, it is a thin rod, or the trajectory has no scene.
        """
        structure = self._require_structure()
        return body_angular_velocity(structure, body, self.nodes, self.velocities)

    def _require_structure(self) -> Structure:
        if self.scene is None:
            raise ValueError("the trajectory has no scene, and so no bodies: simulate it again")
        return self.scene.structure

    def summary(self) -> str:
        """Format the ending, errors and speed of the run.

        Returns
        -------
        str
            One line for each quantity, with its unit.
        """
        steps = round((self.time[-1] - self.time[0]) / self.step)
        rate = f" ({steps / self.seconds:,.0f} steps/s)" if self.seconds > 0 else ""
        tried = f" by {self.attempts} attempts" if self.attempts > steps else ""
        way = ("compiled" if self.compiled else "not compiled") + (
            ", interrupted" if self.interrupted else ""
        )
        lines = [
            f"{self.message}",
            f"time          {self.time[0]:g} … {self.time[-1]:g} s, {steps} steps of {self.step:g} s{tried}, {len(self.time)} rows kept",
            f"wall time     {self.seconds:.3g} s{rate}, {way}",
            f"energy        {self.energy[0]:.6g} → {self.energy[-1]:.6g} J, largest error {format_largest(self.energy_error, 'J')}",
            f"bar lengths   largest relative error {format_largest(self.bar_length_error)}",
            f"joints        largest gap {format_largest(self.joint_error, 'm')}",
        ]
        if np.any(self.correction_shift > 0):
            lines.append(
                f"correction    moves a node by {format_largest(self.correction_shift, 'm')} "
                f"and adds {format_largest(self.correction_energy, 'J')} at most"
            )
        elif np.any(np.isnan(self.correction_shift)):
            lines.append("correction    effect not measured for schemes with error control")
        if self.tension.size:
            lines.append(f"tension       {self.tension.min():.4g} … {self.tension.max():.4g} N")
        lines += [f"break         {one}" for one in self.breaks[:MOST_LISTED]]
        lines += [f"yield         {one}" for one in self.yields[:MOST_LISTED]]
        return "\n".join([*lines, *describe_address(self.message)])

    def _quantities(self) -> Iterable[Quantity]:
        kinetic, elastic, gravitational = self.energy_parts.T
        string = ("string",)
        return (
            Quantity("time", "time (s)", self.time),
            Quantity("position", "node {} {} (m)", self.nodes, ("node", "axis")),
            Quantity("velocity", "node {} velocity {} (m/s)", self.velocities, ("node", "axis")),
            Quantity("force_density", "string {} force density (N/m)", self.force_density, string),
            Quantity("tension", "string {} tension (N)", self.tension, string),
            Quantity("energy", "energy (J)", self.energy),
            Quantity("kinetic_energy", "kinetic energy (J)", kinetic),
            Quantity("elastic_energy", "elastic energy (J)", elastic),
            Quantity("gravitational_energy", "gravitational energy (J)", gravitational),
            Quantity("energy_error", "energy error (J)", self.energy_error),
            Quantity("bar_length_error", "bar length error", self.bar_length_error),
            Quantity("joint_error", "joint error (m)", self.joint_error),
            Quantity("control", "control {}", self.control, ("input",)),
            *(
                Quantity(name.replace(" ", "_"), f"input {{}} {name}", values, ("input",))
                if name not in STATES
                else Quantity(name.replace(" ", "_"), f"{{}} {name}", values, ("limited",))
                for name, values in self.internal_states.items()
            ),
        )

    def _labels(self) -> Mapping[str, Sequence[str]]:
        if self.scene is None:
            return {}
        structure = self.scene.modelled
        names = {"node": structure.node_names, "string": structure.string_names}
        return names | {"limited": name_limited(self.scene)}

    @classmethod
    def _check_loaded(cls, given: Mapping[str, Any]) -> None:
        _check_values(given)


def observe_states(model: Model, states: Array, controls: Array) -> dict[str, Array]:
    """Evaluate `model.observe` on states and controls.

    States (T, nx) and controls (T, nw) with the parameters give outputs by name, each (T, size).
    """
    rows = len(states)
    mapped = model.with_stacked_input(model.observe).map(rows)
    results = mapped.call([ca.DM(states.T), ca.DM(controls.T) if model.nw else ca.DM(0, rows)])
    return {
        name: result.full().T.copy()
        for name, result in zip(model.observe.name_out(), results, strict=True)
    }


def name_measures(model: Model, states: Array, measures: Array) -> dict[str, Array]:
    """Convert the time loop's columns of errors and energies to a dictionary.

    `measures` (T, 5 + 2α) give the result of `observe_states` at states (T, nx).
    """
    strings = len(model.scene.modelled.strings)
    names = ("bar_length_error", "joint_error", "energy", "force_density", "tension")
    columns = np.split(measures, np.cumsum([1, 1, 3, strings]), axis=1)
    nodes, velocities = (
        np.asarray(values).reshape(len(states), -1)
        for values in (model.nodes(states), model.velocities(states))
    )
    return {"nodes": nodes, "velocities": velocities, **dict(zip(names, columns, strict=True))}


def record_trajectory(
    model: Model,
    time: Array,
    states: Array,
    controls: Array,
    *,
    step: float,
    message: str,
    observed: dict[str, Array] | None = None,
    **others: Any,
) -> Trajectory:
    """Build a trajectory, with forces and energies, from states.

    The states are (T, nx) at `time` (T,). The controls (T, nw) are followed by the parameters.
    `step` is the time step [s], and `message` describes the run's end. `observed` is the result of
    `observe_states`, if it is known. Other fields of `Trajectory` may be given; by default, the run
    has succeeded and its energy error is not known.
    """
    rows = len(time)
    if observed is None:
        observed = observe_states(model, states, controls)
    nodes = (rows, len(model.structure.nodes), 3)
    fields: dict[str, Any] = {
        "energy_error": np.full(rows, np.nan),
        "correction_shift": np.zeros(rows),
        "correction_energy": np.zeros(rows),
        "scene": model.scene,
        "success": True,
        "seconds": 0.0,
        "compiled": False,
    }
    return Trajectory(
        time=time,
        nodes=observed["nodes"].reshape(nodes),
        velocities=observed["velocities"].reshape(nodes),
        force_density=observed["force_density"],
        tension=observed["tension"],
        energy=observed["energy"].sum(axis=1),
        energy_parts=observed["energy"],
        bar_length_error=observed["bar_length_error"][:, 0],
        joint_error=observed["joint_error"][:, 0],
        states=states.copy(),
        control=controls[:, : model.nu],
        parameters=controls[0, model.nu :].copy(),
        bars=model.structure.bars,
        strings=model.structure.strings,
        pinned=np.array(sorted({*model.structure.pinned, *model.structure.rollers}), dtype=np.intp),
        step=step,
        message=message,
        **fields | others,
    )


_UNKNOWN = (
    "energy_error",
    "correction_shift",
    "correction_energy",
    "error_estimate",
)  # may be NaN, as they are not always computed


def _check_values(content: Mapping[str, Any]) -> None:
    """Check the values of the fields of a file (`content`).

    Raises ValueError with the name of the first wrong field. Only failed runs may contain values
    that are not finite.
    """
    time = np.asarray(content["time"])
    if (bad := np.flatnonzero(np.diff(time) <= 0)).size:
        raise ValueError(
            f"field 'time' is {time[bad[0] + 1]:g} s at row {bad[0] + 1}, after {time[bad[0]]:g} s: times must increase"
        )
    for name, valid in {
        "step": content["step"] > 0,
        "seconds": content["seconds"] >= 0,
        "attempts": content["attempts"] >= 0,
    }.items():
        if not valid and not np.isnan(content[name]):
            raise ValueError(
                f"field {name!r} is {content[name]:g}: it must be {'greater than' if name == 'step' else 'at least'} 0"
            )
    known = [name for name, (_, kind) in array_fields(Trajectory).items() if kind == "f"]
    for name in set(known) - set(_UNKNOWN) if content["success"] else ():
        value = np.asarray(content[name])
        if np.abs(value).max(initial=0.0) <= LARGEST:  # much faster than the places
            continue
        for place in np.argwhere(~(np.abs(value) <= LARGEST))[:1].tolist():
            raise ValueError(
                f"field {name!r} is {value[tuple(place)]} at {place}, although the run succeeded: it must be finite, below {LARGEST:g}"
            )
