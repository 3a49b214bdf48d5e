"""Operating points, such as equilibria, as states of a model."""

from __future__ import annotations

from typing import Any

from tenscasadi.dynamics.model import Model
from tenscasadi.scene.internal_states import join_initial
from tenscasadi.scene.strength import declare_strength
from tenscasadi.util.validate import Array


class OperatingPoint:
    """Base class of nodes at rest with control and parameters.

    Functions of a state, a control and parameters take it in place of the state.

    Attributes
    ----------
    nodes : ndarray, shape (n, 3)
        Positions [m].
    control : ndarray, shape (nu,)
        Control. Winches are locked: it contains rest lengths [m].
    parameters : ndarray, shape (np,)
        Parameters.
    time : float
        Clock [s].
    """

    nodes: Array
    control: Array
    parameters: Array
    time: float

    @property
    def model(self) -> Model:
        """Model of the scene."""
        raise NotImplementedError

    def state_of(self, model: Model) -> Array:
        """Compute the corresponding state (nx,) of a model.

        Parameters
        ----------
        model : Model
            The model.

        Returns
        -------
        ndarray, shape (nx,)
            State at rest.
        """
        own, control = None, model.scene.control
        if control is not None and model.na and len(self.control):  # else initial rest lengths
            parts = (*control.internal_states(self.control), *declare_strength(model.scene))
            own = join_initial(parts)
        x = model.state(self.nodes, internal=own)
        model.split(x).clock[:] = self.time
        return x

    def control_of(self, model: Model) -> Array | None:
        """Compute the control (nu,) that keeps a model at rest here.

        None means the model's initial control.
        """
        control = model.scene.control
        if not len(self.control) or control is None:
            return None
        if control.locked is control:
            return self.control
        tension = model.tension(self.state_of(model))[model.scene.winch_strings]
        return control.initial_inputs(self.control, tension)


def split_point(model: Model, state: Any, control: Any, parameters: Any) -> tuple[Any, Any, Any]:
    """Read state, control and parameters from an operating point.

    A given control or given parameters have priority over those of the point.
    """
    if not isinstance(state, OperatingPoint):
        return state, control, parameters
    given = state.parameters if len(state.parameters) else None
    return (
        state.state_of(model),
        state.control_of(model) if control is None else control,
        given if parameters is None else parameters,
    )
