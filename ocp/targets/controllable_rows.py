"""Selection of the controllable rows of a target."""

from __future__ import annotations

from dataclasses import replace

from ocp.targets.control_sensitivities import REACHED, ControlSensitivities
from ocp.targets.target import Target
from tenscasadi.util.validate import Array


def drop_uncontrollable_rows(
    target: Target,
    reach: ControlSensitivities,
    force_density: Array,
    duration: float,
    least: float = REACHED,
) -> Target:
    """Drop the rows that the controls cannot change.

    The test is to first order along the trajectory under force densities (K, α).
    """
    if not count_rows(target) or target.free_start is not None:  # a free start can change them, too
        return target
    intervals = len(force_density)

    def reduced(part: Target, share: float) -> Target:
        if not part.count:
            return part
        end = max(1, round(share * intervals))
        kept = reach.controllable_rows(
            part.single, part.weights, target.start, force_density, duration, end, least
        )
        return part if len(kept) == part.count else part.keep(kept, "out of control")

    waypoints = tuple(
        one._replace(target=reduced(one.target, one.share)) for one in target.waypoints
    )
    return replace(reduced(target, 1.0), waypoints=waypoints)


def count_rows(target: Target) -> int:
    """Count the rows imposed at the end and at waypoints."""
    return sum(part.count for _, part, _ in target.instants)
