"""Simulations as data: scene, initial state and options."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.scheme import NamedScheme, Scheme, check_scheme
from tenscasadi.integrators.stabilization import (
    Correction,
    build_projection,
    check_correction,
)
from tenscasadi.scene.quantities import QUANTITIES
from tenscasadi.scene.scene import Scene
from tenscasadi.schema.containers import TableOf
from tenscasadi.schema.definitions import OneOf
from tenscasadi.schema.field_types import PER_ITEM, ElsewhereInFile, varying
from tenscasadi.schema.value import check_fields
from tenscasadi.simulation.inputs.run_inputs import read_inputs
from tenscasadi.simulation.simulate import simulate
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.structure.subdivision import cut_strings
from tenscasadi.util.compile import Compiled
from tenscasadi.util.validate import (
    MAX_BYTES,
    Array,
    Boolean,
    Count,
    Positive,
    choice,
    finite_array,
    instance,
)

_MOST_KEPT = MAX_BYTES / 8  # numbers in the saved states of a run


@dataclass(frozen=True, eq=False)
class Simulation:
    """Scene with its initial state and the options of `simulate`.

    A scene file describes it in the sections from [scene] to [simulation].

    Parameters
    ----------
    scene : Scene
        Scene to simulate.
    t_end : float
        End of the run [s].
    step : float, optional
        Largest step [s], see `simulate`.
    scheme : Scheme
        Integration scheme.
    correction : Projection or BarLengthCorrection, optional
        Correction of bar lengths and joints.
    save_every : int, optional
        Number of steps between saved rows, see `simulate`.
    coordinates : {"reduced", "full"}, optional
        Coordinates of the state, see `Model`. Default: those of less computation time.
    bar_length : {"current", "constant"}
        Bar length by whose square the multipliers are divided, see `Model`.
    nodes : array_like, shape (n, 3), optional
        Positions at the start [m]; by default those of the structure. Inner nodes of subdivided
        strings lie on a straight line, unless they are also given.
    velocities : array_like, shape (n, 3), optional
        Velocities at the start [m/s]; by default at rest.
    project : bool
        Whether the start is projected onto bars and joints: the nearest state that satisfies them.
    state : array_like, shape (nx,), optional
        State of the model at the start, in place of nodes and velocities.
    control : array_like, shape (nu,) or (K, nu), or callable, optional
        Control, see `simulate`.
    parameters : mapping of str to array_like, optional
        Values of the model's parameters by name, see `simulate`.
    energy_balance : bool
        Whether to integrate the work of damping, contact and control.

    Raises
    ------
    TypeError, ValueError
        A field is wrong; the message names it.

    See Also
    --------
    load_simulation : Read one from a file.
    simulate : Run a model with all options.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> swing = tc.Simulation(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()), t_end=0.1, step=1e-3)
    >>> swing.run(compiled=False).message
    'finished 100 steps of 0.001 s'
    """

    scene: Annotated[Scene, ElsewhereInFile()]
    t_end: Positive
    step: Positive | None = None
    scheme: Annotated[Scheme, OneOf(NamedScheme)] = field(default_factory=RungeKutta4)
    correction: Correction | None = None
    save_every: Count | None = None
    coordinates: Literal["reduced", "full"] | None = None
    bar_length: Literal["current", "constant"] = "current"
    nodes: Annotated[Any, ElsewhereInFile()] = None
    velocities: Annotated[Any, ElsewhereInFile()] = None
    project: Annotated[Boolean, ElsewhereInFile()] = False
    state: Annotated[Any, ElsewhereInFile()] = None
    control: Annotated[Any, varying(None)] = None
    parameters: Annotated[
        Mapping[str, Any] | None, TableOf(dict.fromkeys(QUANTITIES, PER_ITEM))
    ] = None
    energy_balance: Boolean = True

    def __post_init__(self) -> None:
        instance("Simulation.scene", self.scene, Scene, "a tenscasadi.Scene")
        check_fields(self)
        own: dict[str, Any] = {}
        if self.coordinates is not None:
            choice("Simulation.coordinates", self.coordinates, "reduced", "full")
        choice("Simulation.bar_length", self.bar_length, "current", "constant")
        check_scheme(self.scheme, "Simulation.scheme")
        check_correction(self.correction, "Simulation.correction")
        if self.state is not None:
            own["state"] = finite_array("Simulation.state", self.state, (None,))
        for name in ("nodes", "velocities"):
            if getattr(self, name) is not None:
                own[name] = self._rows(name)
                if self.state is not None:
                    raise ValueError(
                        f"Simulation.{name} is given beside Simulation.state, which defines it, too: leave one of them out"
                    )
        if self.parameters is not None:
            instance(
                "Simulation.parameters",
                self.parameters,
                Mapping,
                'a mapping such as {"stiffness": 120.0}',
            )
            own["parameters"] = dict(self.parameters)
        vars(self).update(own)

    @cached_property
    def model(self) -> Model:
        """The equations of motion of the scene."""
        return Model(self.scene, self.coordinates, self.bar_length)

    @cached_property
    def start(self) -> Array:
        """Initial state (nx,) of the run."""
        p = self.model.parameters.values(self.parameters)
        state = self.model.start_at(p) if self.state is None else self.state
        if self.nodes is not None or self.velocities is not None:
            nodes = (
                self.model.structure.nodes
                if self.nodes is None
                else self._interpolate_rows(self.nodes)
            )
            state = self.model.state(
                nodes, None if self.velocities is None else self._interpolate_rows(self.velocities)
            )
        if self.project:
            state = (
                build_projection(self.model)(state, *([p] if self.model.np else [])).full().ravel()
            )
        return np.array(state)

    def check(self) -> None:
        """Check initial state, control and parameters against the model.

        Raises TypeError or ValueError.
        """
        if len(self.start) != self.model.nx:
            raise ValueError(
                f"state has {len(self.start)} entries: give the {self.model.nx} of the model, or nodes and velocities"
            )
        inputs = read_inputs(
            self.model,
            self.t_end,
            self.step,
            self.scheme,
            self.start,
            self.control,
            self.parameters,
            many=False,
        )
        steps = inputs.grid.steps
        if self.save_every is not None and steps / self.save_every * self.model.nx > _MOST_KEPT:
            raise ValueError(
                f"save_every is {self.save_every}: {steps} steps would keep more than {_MOST_KEPT:g} numbers, give more"
            )

    def run(self, progress: bool = False, compiled: Compiled = None) -> Trajectory:
        """Simulate the scene with the stored options.

        Parameters
        ----------
        progress : bool
            Whether to show a progress bar.
        compiled : bool or Single, optional
            Whether to run as machine code, see `simulate`.

        Returns
        -------
        Trajectory
            Trajectory with its errors, see `simulate`.
        """
        return simulate(
            self.model,
            self.t_end,
            self.step,
            self.scheme,
            state=None
            if self.state is None
            and self.nodes is None
            and self.velocities is None
            and not self.project
            else self.start,
            control=self.control,
            correction=self.correction,
            save_every=self.save_every,
            compiled=compiled,
            progress=progress,
            energy_balance=self.energy_balance,
            parameters=self.parameters,
        )

    def _rows(self, name: str) -> Array:
        """Read positions or velocities (n, 3) of all nodes.

        `name` is "positions" or "velocities".
        """
        rows = finite_array(f"Simulation.{name}", getattr(self, name), (None, 3))
        counts = {len(self.scene.structure.nodes), len(self.scene.modelled.nodes)}
        if len(rows) not in counts:
            raise ValueError(
                f"Simulation.{name} has {len(rows)} rows: give one for each of the {' or '.join(map(str, sorted(counts)))} nodes"
            )
        return rows

    def _interpolate_rows(self, rows: Array) -> Array:
        """Interpolate positions or velocities of nodes inside strings.

        `rows` (n, 3) are those of the structure's nodes. They are linear between the ends of a
        string that is divided into segments.
        """
        structure = self.scene.structure
        if len(rows) == len(self.scene.modelled.nodes):
            return rows
        fractions = self.scene.segment_fractions
        return cut_strings(rows, structure.strings, fractions, lumped=False)[0]
