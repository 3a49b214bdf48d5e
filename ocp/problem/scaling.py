"""Scale factors of states, constraints and objective."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from ocp.problem.control import (
    controls_force_densities,
    controls_rest_lengths,
    has_elastic_strings,
)
from ocp.problem.costs import cost_terms
from ocp.problem.instant import symbolic
from tenscasadi.scene.internal_states import join_scales
from tenscasadi.scene.winches import RestLengthRate, Winch
from tenscasadi.structure.class_one import measure_diagonal
from tenscasadi.util.validate import Array, per_item, positive_number

if TYPE_CHECKING:
    from ocp.problem.problem import Problem
    from tenscasadi.dynamics.model import Model

UNBOUNDED = 100.0  # scaled size that no bounded state or unknown of a plan reaches


@dataclass(frozen=True, eq=False)
class Scales:
    """Scale factors that make the variables of order one.

    Attributes
    ----------
    length : float
        Typical length [m].
    time : float
        Typical time [s].
    mass : float
        Mass of the model [kg].
    state : ndarray, shape (nx,)
        Scale of each entry of the state.
    """

    length: float
    time: float
    mass: float
    state: Array

    @staticmethod
    def of(problem: Problem) -> Scales:
        """Compute the scale factors of a problem.

        The length is the diagonal of the structure's bounding box. The time is the longest
        duration, or twice the typical one if that is less.
        """
        model = problem.model
        length = measure_diagonal(model.structure.nodes) or 1.0
        time = min(problem.longest, 2 * problem.typical_duration)
        parts = [
            np.full(model.nq, length),
            np.full(model.nq, length / time),
            join_scales(model.scene.internal_states),
            np.full(int(model.has_clock), time),
        ]
        return Scales(length, time, float(model.mechanism.M.sum()), np.concatenate(parts))

    def read_position(self, position_scale: float | None) -> float:
        """Read the `position_scale` of a controller [m].

        By default it is 1 % of the typical length.
        """
        if position_scale is None:
            return 0.01 * self.length
        return positive_number("position_scale", position_scale)

    @property
    def units(self) -> dict[str, float]:
        """Scale of each unit by its name, such as "m/s"."""
        speed = self.length / self.time
        return {
            "m": self.length,
            "m/s": speed,
            "m/s²": speed / self.time,
            "m²/s": self.length * speed,
            "kg m²/s": self.mass * self.length * speed,
            "s": self.time,
        }


def typical_mass(model: Model) -> float:
    """Compute the geometric mean of the masses that resist motions along the axes [kg].

    One node that is far heavier or lighter than the others hardly changes it.
    """
    own = model.mechanism.free_mass.diagonal()
    return float(np.exp(np.mean(np.log(own[own > 0])))) if (own > 0).any() else 1.0


def control_scale(problem: Problem, strength: float) -> Array:
    """Compute the scale (nu,) of control changes.

    It is a typical force density ``strength`` [N/m], or the tension [N] of a string with this force
    density. Rest lengths [m] change by as much as causes this tension, at most by the string
    length. Rest-length rates [m/s] make that change within the duration. Motor torques [N m]
    balance the typical tension.
    """
    return scale_control(problem.model, strength, problem.typical_duration)


def scale_control(model: Model, strength: float, duration: float) -> Array:
    """Compute the scale (nu,) of control changes in a duration.

    `strength` is a typical force density [N/m], `duration` is in seconds. See `control_scale`.
    """
    structure = model.scene.structure
    if controls_force_densities(model):
        return np.full(len(structure.strings), strength)
    of = structure.cable_of
    if not has_elastic_strings(model):
        return strength * np.bincount(of, weights=structure.string_lengths) / np.bincount(of)
    control = model.scene.control
    if isinstance(control, Winch):
        tension = strength * np.bincount(of, weights=structure.string_lengths) / np.bincount(of)
        return np.asarray(per_item("Winch.radius", control.radius, len(tension)) * tension)
    change = structure.string_lengths * np.minimum(strength / structure.stiffness, 1.0)
    return np.asarray(np.bincount(of, weights=change)) / (
        1.0 if controls_rest_lengths(model) else duration
    )


def scale_deviations(model: Model, strength: float, speed: float) -> Array:
    """Compute the scale (nu,) of control deviations in feedback controllers.

    It is that of `scale_control`. For rest-length rates, it is the scale `speed` of velocities
    [m/s]. `strength` is a typical force density [N/m].
    """
    if isinstance(model.scene.control, RestLengthRate):
        return np.full(model.nu, speed)
    return scale_control(model, strength, 1.0)


def typical_cost(
    problem: Problem, strength: float, states: Array, force_density: Array, duration: float
) -> float:
    """Compute a typical value of the objective, which scales it.

    States are (K + 1, nx), controls ``force_density`` (K, nu), and the duration is in seconds. In
    costs of the control, the force density is one sine period about ``strength`` [N/m]. If it
    alternated between intervals instead, costs of its rate would grow with the square of the number
    of intervals. The scaled objective would then be small compared with the solver's tolerance.
    """
    count = len(force_density)
    string, interval = np.indices((len(problem.model.scene.structure.strings), count))
    pattern = strength * (
        1 + np.sqrt(0.5) * (-1.0) ** string * np.sin(2 * np.pi * (interval + 0.5) / count)
    )
    decided = pattern if controls_force_densities(problem.model) else force_density.T
    step, time = duration / count, np.linspace(0.0, duration, count + 1)
    now, terms = symbolic(problem.model), cost_terms(problem.costs)
    changed = np.diag(control_scale(problem, strength) / strength) @ pattern[: problem.model.nu]
    total = sum(
        float(ca.DM(expression(ca.DM(held), step)))
        for expressions, held in (
            (terms.control, pattern),
            (terms.effort, changed if problem.model.has_coupled_rates else pattern),
            (terms.changes, changed),
        )
        for expression in expressions
    )
    for expression in terms.running:
        rate = ca.Function("rate", now.symbols, [expression(now)]).map(count)
        total += step * float(ca.sum2(rate(states.T[:, 1:], decided, time[None, 1:])))
    for share, expression in terms.instants:
        k = round(share * count)
        value = ca.Function("value", now.symbols, [expression(now)])
        total += float(value(states[k], decided[:, max(k - 1, 0)], share * duration))
    return abs(total) if np.isfinite(total) and total else 1.0
