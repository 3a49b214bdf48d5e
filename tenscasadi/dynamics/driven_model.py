"""A model whose control follows a function of time."""

from __future__ import annotations

import warnings

from tenscasadi.dynamics.model import Model
from tenscasadi.scene.control_function import ControlSchedule


class DrivenModel(Model):
    """The equations of motion of a scene whose control follows a schedule.

    Its control u is added to that of the schedule. The state has a clock. `power` is that of all
    forces, as the control changes the energy that strings store.

    Parameters
    ----------
    model : Model
        The model to drive.
    schedule : ControlSchedule
        The control over time.
    """

    def __init__(self, model: Model, schedule: ControlSchedule) -> None:
        self.schedule = schedule
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the model has warned
            super().__init__(
                model.scene,
                model.coordinates,
                "constant" if model.mechanism.constant_length else "current",
            )
