"""What a correction does: how far it moves nodes, and what it adds to the energy."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.scheme import Scheme
from tenscasadi.integrators.stabilization import Correction
from tenscasadi.util.validate import Array


def correction_effect(model: Model, scheme: Scheme, correction: Correction, states: Array, controls: Array, step: float) -> tuple[Array, Array]:
    """The largest movement of a node, m, and the energy added, J, (T,) each: of the correction that follows `every` steps from each state.

    states (T, nx) and controls (T, nu) are those of a trajectory, `step` its step, s. The steps are taken again without correction and
    the correction's part is measured at their end.
    """
    project = correction.step(model)
    if project is None:
        return np.zeros(len(states)), np.zeros(len(states))
    advance, energy = scheme.advance(model), model.energy_function
    x, u = ca.MX.sym("x", model.nx), ca.MX.sym("u", model.nu)
    chained = advance if correction.every == 1 else advance.fold(correction.every)
    before: Any = chained(x, ca.repmat(u, 1, correction.every), ca.DM.ones(1, correction.every) * step)
    after = project(before)
    shift = model.nodes(after) - model.nodes(before)
    distance = ca.sqrt(ca.mmax(ca.sum1(shift * shift)))
    effect = ca.Function("effect", [x, u], [ca.vertcat(distance, energy(after, u) - energy(before, u))])
    with np.errstate(all="ignore"):
        values = effect.map(len(states))(ca.DM(states.T), ca.DM(controls.T) if model.nu else ca.DM(0, len(states))).full()
    return values[0], values[1]
