"""A certified end of a motion: two tight solutions by different schemes and steps, and how closely they agree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tenscasadi.model import Model, instructions
from tenscasadi.schemes import DormandPrince54, DormandPrince853, Scheme
from tenscasadi.signals import ControlInput
from tenscasadi.simulate import simulate
from tenscasadi.stability import stable_step
from tenscasadi.trajectory import Trajectory
from tenscasadi.validate import Array, finite_array, instance, positive_number

_ENOUGH = 1e-12  # of the structure's size: rounding over a run is of this order
_ACCURATE = 1e-7  # of the structure's size: what does not agree as closely is no reference
_FINER = 4  # from one pair of solutions to the next
_COARSEST = 64  # steps of the first pair, at least
_FASTER = 10.0  # compiled code against the virtual machine


class NoReference(ValueError):
    """Two tight solutions do not agree: the motion is chaotic, unstable or too stiff over that time, and no error can be measured."""


@dataclass(frozen=True, eq=False)
class Reference:
    """Where the nodes of a structure end.

    nodes (n, 3) m at time t_end, s, of the scene's structure (not of its strings' segments), read-only; error, m: the largest distance of
    a node between two solutions by different schemes and steps, an estimate of the error of the worse one; message: which they were.
    """

    nodes: Array
    error: float
    t_end: float
    message: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "nodes", finite_array("Reference.nodes", self.nodes, (None, 3)))
        object.__setattr__(self, "error", positive_number("Reference.error", self.error, zero=True))
        object.__setattr__(self, "t_end", positive_number("Reference.t_end", self.t_end))


def certify(
    model: Model,
    t_end: float,
    state: Any = None,
    control: ControlInput = None,
    accuracy: float | None = None,
    enough: float | None = None,
    compiled: bool | None = None,
    work: float = 1e10,
) -> Reference:
    """The end of a motion as `DormandPrince853` and `DormandPrince54` find it, with steps that are refined until both agree.

    state, control, compiled: as for `simulate`. Refinement ends when the two agree within `enough`, m (None: 1e-12 of the structure's size),
    when finer steps do not bring them closer, or before a solution would take more than `work` instructions (a tenth in the virtual machine).
    Raises NoReference when they end further apart than `accuracy`, m (None: 1e-7 of the structure's size), TypeError, ValueError.
    """
    instance("model", model, Model, "a tenscasadi.Model")
    t_end = positive_number("t_end", t_end)
    size = float(np.ptp(model.scene.structure.nodes, axis=0).max(initial=0.0)) or 1.0
    accuracy = _ACCURATE * size if accuracy is None else positive_number("accuracy", accuracy)
    enough = min(_ENOUGH * size, accuracy) if enough is None else positive_number("enough", enough)
    schemes: tuple[Scheme, Scheme] = (DormandPrince853(), DormandPrince54())
    longest = min(stable_step(model, state, None, scheme) * ratio for scheme, ratio in zip(schemes, (1, _FINER), strict=True))
    steps = max(_COARSEST, int(np.ceil(t_end / longest))) if np.isfinite(longest) and longest > 0 else _COARSEST
    most = positive_number("work", work) / (1 if compiled is not False else _FASTER) / instructions(schemes[0].advance(model))

    best, fault, apart = None, "", np.inf
    while True:
        counts = (steps, _FINER * steps + 1)  # no multiple of each other: they meet events at different places of a step
        runs = [
            simulate(model, t_end, t_end / count, scheme, state, control, save_every=count, compiled=compiled, energy_balance=False)
            for scheme, count in zip(schemes, counts, strict=True)
        ]
        if any(map(interrupted, runs)):
            raise KeyboardInterrupt
        failed = [run for run in runs if not run.success]
        if failed:
            fault = failed[0].message
        else:
            before, apart = apart, distance(end_nodes(model, runs[0]), end_nodes(model, runs[1]))
            if best is None or apart < best.error:
                told = " and ".join(f"{type(scheme).__name__} with {count} steps" for scheme, count in zip(schemes, counts, strict=True))
                best = Reference(end_nodes(model, runs[0]), apart, t_end, f"{told} end {apart:.2g} m apart")
            if apart <= enough or (apart >= before and best.error <= accuracy):
                return best
        if steps * _FINER > most:
            break
        steps *= _FINER
    if best is not None and best.error <= accuracy:
        return best
    why = f"{best.message}, wanted {accuracy:.2g} m" if best is not None else f"the solutions diverge, the last: {fault}"
    raise NoReference(
        f"no reference up to t_end = {t_end:g} s: {why}; give a smaller t_end (chaotic and unstable motions lose all digits), "
        "a larger accuracy or more work, or remove slack and impact events by Smooth(width)"
    )


def end_nodes(model: Model, trajectory: Trajectory) -> Array:
    """The last nodes (n, 3) of the scene's structure; segments' nodes come after them and are left out."""
    return trajectory.nodes[-1, : len(model.scene.structure.nodes)]


def distance(nodes: Array, others: Array) -> float:
    """The largest distance of a node from its other self, m."""
    return float(np.linalg.norm(nodes - others, axis=1).max(initial=0.0))


def interrupted(trajectory: Trajectory) -> bool:
    """Whether a run was ended from the keyboard."""
    return not trajectory.success and trajectory.message.startswith("interrupted")
