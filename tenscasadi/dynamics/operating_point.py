"""Operating points, such as equilibria."""

from __future__ import annotations

from typing import Any

from tenscasadi.dynamics.model import Model
from tenscasadi.util.validate import Array


class OperatingPoint:
    """Nodes at rest with control and parameters.

    Functions of a state, a control and parameters take it in place of the state.

    Attributes
    ----------
    nodes : ndarray, shape (n, 3)
        Positions [m].
    control : ndarray, shape (nu,)
        Control.
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
        """Compute the state (nx,) of a model.

        Parameters
        ----------
        model : Model
            The model.

        Returns
        -------
        ndarray, shape (nx,)
            State at rest.
        """
        x = model.state(self.nodes)
        model.split(x)[2][:] = self.time
        return x


def split_point(model: Model, state: Any, control: Any, parameters: Any) -> tuple[Any, Any, Any]:
    """Read state, control and parameters of an operating point.

    Control and parameters that are given have priority.
    """
    if not isinstance(state, OperatingPoint):
        return state, control, parameters
    own = state.control if len(state.control) else None
    given = state.parameters if len(state.parameters) else None
    return (
        state.state_of(model),
        own if control is None else control,
        given if parameters is None else parameters,
    )
