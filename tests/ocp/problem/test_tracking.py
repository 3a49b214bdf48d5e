"""Tracking: nodes stay near places that may move."""

from __future__ import annotations

import pytest
from rising import raised

import ocp


def test_tracking_pulls_nodes_to_their_places(free):
    far = ocp.Tracking({0: (0.3, None, None), 3: (lambda t: (0.1 * t, None, None))}, 200.0)
    plan = raised(costs=[far, ocp.Effort()], intervals=20)
    assert plan.success, plan.message
    assert (
        abs(plan.trajectory.nodes[:, 0, 0] - 0.3).mean()
        < abs(free.trajectory.nodes[:, 0, 0] - 0.3).mean()
    )


BAD = {
    "tracking nothing": (lambda: ocp.Tracking({}), ValueError, "Tracking.positions"),
    "tracking two": (lambda: ocp.Tracking({0: (1.0, 2.0)}), ValueError, r"Tracking.positions\[0\]"),
    "tracking a function of two": (
        lambda: raised(costs=[ocp.Tracking({0: lambda t: (t, t)})]),
        ValueError,
        r"Tracking.positions\[0\]\(time\) is",
    ),
    "tracking a function of one": (
        lambda: raised(costs=[ocp.Tracking({0: lambda t: t})]),
        ValueError,
        r"Tracking.positions\[0\]\(time\) is",
    ),
    "tracking a function of a number": (
        lambda: raised(costs=[ocp.Tracking({0: lambda t: 1.0})]),
        TypeError,
        r"Tracking.positions\[0\]\(time\) is 1.0",
    ),
    "tracking no node": (
        lambda: raised(costs=[ocp.Tracking({9: (0, 0, 0)})]),
        ValueError,
        "Tracking.positions: node is 9",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_places_to_track_are_refused_by_name(name):
    make, error, message = BAD[name]
    with pytest.raises(error, match=message):
        make()
