"""Options of an interactive simulation."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.scheme import Scheme, check_scheme
from tenscasadi.integrators.stability import contact_rate, find_limit
from tenscasadi.integrators.stabilization import Correction, Projection
from tenscasadi.schema.value import check_fields
from tenscasadi.util.compile import Compiled
from tenscasadi.util.validate import Array, Positive


@dataclass(frozen=True)
class LiveOptions:
    """Options of an interactive simulation.

    Parameters
    ----------
    step : float, optional
        Largest step [s]. Default: 1 ms, or half of the stable step at the start if it is less.
    scheme : Scheme
        Integration scheme.
    correction : Projection or BarLengthCorrection, optional
        Correction after every `correction.every`-th step.
    compiled : bool, optional
        As for `simulate`.
    tick : float
        Simulated time between two readings of the controls [s].

    Examples
    --------
    >>> from tenscasadi.viewer import LiveOptions
    >>> LiveOptions(step=5e-4).tick < 0.02
    True
    """

    step: Positive | None = None
    scheme: Scheme = field(default_factory=RungeKutta4)
    correction: Correction | None = field(default_factory=Projection)
    compiled: Compiled = None
    tick: Positive = 1 / 60

    def __post_init__(self) -> None:
        check_scheme(self.scheme)
        check_fields(self)


def count_substeps(options: LiveOptions, model: Model, state: Array, control: Array) -> int:
    """Compute the number of time steps in a tick.

    A tick is the interval in which inputs are constant. The step depends on the state (nx,) and the
    control (nu,).
    """
    if options.scheme.adaptive:
        return 1
    step = options.step or _choose_step(model, options.scheme, state, control)
    every = 1 if options.correction is None else options.correction.every
    return max(1, every * int(np.ceil(options.tick / step / every - 1e-9)))


def _choose_step(model: Model, scheme: Scheme, state: Array, control: Array) -> float:
    """Choose the largest step that resolves strings and contacts [s].

    It depends on the stability of the scheme at a state (nx,) and a control (nu,).
    """
    # NaN without a derivative at the start
    stable = 0.5 * find_limit(model, scheme, state, control)
    rate = contact_rate(model)  # rad/s
    limits = [1e-3, stable, 0.1 / rate if rate else np.inf]
    return float(np.nanmin([limit for limit in limits if limit > 0]))
