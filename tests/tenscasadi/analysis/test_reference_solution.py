"""Scenes in which nothing can move, or next to nothing: simulated, certified, recommended, compared and linearized like any other."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import tenscasadi as tc

POINT = tc.Structure([[0, 0, 0]], node_mass=1.0, pinned=[0])
BAR = tc.Structure([[0, 0, 0], [1, 0, 0]], bars=[(0, 1)], pinned=[0, 1])
STRING = tc.Structure([[0, 0, 0], [1, 0, 0]], strings=[(0, 1)], node_mass=1.0, pinned=[0, 1])
SHAKEN = tc.SupportMotion({0: lambda t: (0.1 * np.sin(t), 0, 0)})
CARRIED = tc.SupportMotion({0: lambda t: (t, 0, 0), 1: lambda t: (1 + t, 0, 0)})

SCENES = {
    "one pinned node": tc.Scene(POINT),
    "one moved node": tc.Scene(POINT, supports=SHAKEN, ground=tc.Ground()),
    "one pushed node": tc.Scene(POINT, forces=tc.NodalForce(lambda t: [[t, 0, 0]])),
    "one guided node": tc.Scene(
        tc.Structure([[0, 0, 0]], node_mass=1.0, pinned={0: "xy"}),
        gravity=tc.Gravity((0, 0, -9.81)),
    ),
    "a carried bar": tc.Scene(BAR, supports=CARRIED),
    "one string": tc.Scene(STRING, supports=SHAKEN, control=tc.ForceDensity()),
}


@pytest.mark.filterwarnings("ignore::tenscasadi.RedundantConstraints")
@pytest.mark.parametrize("coordinates", ["reduced", "full"])
@pytest.mark.parametrize("name", SCENES)
def test_where_nothing_or_little_moves(name: str, coordinates: Any) -> None:
    model, t_end = tc.Model(SCENES[name], coordinates), 0.05
    for scheme in (tc.RungeKutta4(), tc.Collocation(2), tc.DormandPrince853(1e-6)):
        run = tc.simulate(model, t_end, 0.01, scheme, compiled=False)
        assert run.success
        expected = SCENES[name].structure.nodes.copy()
        expected[0, 0] += 0.1 * np.sin(t_end) if SCENES[name].supports is SHAKEN else 0.0
        expected[:, 0] += t_end if SCENES[name].supports is CARRIED else 0.0
        expected[0, 2] -= 9.81 * t_end**2 / 2 if "guided" in name else 0.0
        assert run.nodes[-1] == pytest.approx(expected, abs=1e-9)
    assert tc.reference_solution(model, t_end, compiled=False).nodes == pytest.approx(
        expected, abs=1e-9
    )
    tc.linearize(model)
    tc.modes(model)
    if coordinates == "full":
        return
    advice = tc.recommend(model, t_end, 1e-6, schemes=[tc.RungeKutta4()], compiled=False)
    assert advice.error < 1e-6
    assert (
        len(
            tc.tradeoff(model, t_end, [tc.RungeKutta4()], [0.01], compiled=(False,), repeats=1).rows
        )
        == 1
    )


def test_a_reference_is_given_up_when_its_seconds_are_over() -> None:
    """The falling bar meets the ground again and again: each pair of solutions takes longer than there is time for."""
    bar = tc.Structure([[0, 0, 1], [0.5, 0, 1.3]], bars=[(0, 1)])
    model = tc.Model(tc.Scene(bar, gravity=tc.Gravity(), ground=tc.Ground(1e6)))
    with pytest.raises(tc.NoReferenceError, match=r"the time limit of 0\.5 s expired"):
        tc.reference_solution(model, 1e3, compiled=False, time_limit=0.5)
    assert tc.reference_solution(model, 0.1, compiled=False, time_limit=100.0).error < 1e-9


@pytest.mark.parametrize(
    ("width", "impulse", "at"), [(1e-7, 1.0, 0.3333), (1e-7, 1.0, 0.7123), (1e-9, 1e-3, 0.5)]
)
def test_certificates_hold_the_rounding_of_the_clock(
    width: float, impulse: float, at: float
) -> None:
    """A bell so narrow that the last digit of the time shows in it: two solutions may agree better than both are right."""
    string = tc.Structure(
        [[0, 0, 0], [1, 0, 0]],
        strings=[(0, 1)],
        node_mass=[0, 1.0],
        pinned=[0],
        stiffness=1e-9,
        rest_length=5.0,
    )
    force = impulse / (width * np.sqrt(np.pi))
    pushed = tc.NodalForce(
        lambda t: [[0, 0, 0], [0, force * np.exp(-(((t - at) / width) ** 2)), 0]],
        breakpoints=at + width * np.arange(-7, 8),
    )
    found = tc.reference_solution(tc.Model(tc.Scene(string, forces=pushed)), 1.0, compiled=False)
    assert abs(found.nodes[1, 1] - impulse * (1 - at)) <= found.error
    assert "the clock's rounding may add" in found.message
    smooth = tc.NodalForce(lambda t: [[0, 0, 0], [0, np.sin(3 * t), 0]])
    assert (
        tc.reference_solution(tc.Model(tc.Scene(string, forces=smooth)), 1.0, compiled=False).error
        < 1e-12
    )


@pytest.mark.parametrize(
    ("middle", "width"), [(0.8589195577097951, 6.2e-8), (0.123456789, 1e-7), (0.5, 1e-5)]
)
def test_a_steep_table_is_followed_to_the_last_digits(middle, width):
    """A triangular pulse of half a newton second on a mass of 1 kg, against exact fractions of the table's own numbers."""
    times, force = [0.0, middle - width, middle, middle + width, 1.0], np.zeros((5, 1, 3))
    force[2, 0, 0] = 0.5 / width
    begins, peaks, ends = (Fraction(time) for time in times[1:4])
    top = Fraction(float(force[2, 0, 0]))
    # the end is at the sum of impulses times what is left of the time, piece by piece of the table
    rising = (peaks - begins) * top / 2 * (1 - begins - (peaks - begins) * Fraction(2, 3))
    exact = float(rising + (ends - peaks) * top / 2 * (1 - peaks - (ends - peaks) / 3))
    model = tc.Model(
        tc.Scene(tc.Structure([(0, 0, 0)], node_mass=1.0), forces=tc.NodalForce(force, times))
    )
    clock = np.spacing(middle) / width  # rounding of the time, of the width
    for scheme in (tc.DormandPrince853(), tc.DormandPrince853(rtol=1e-10)):
        run = tc.simulate(model, 1.0, 0.01, scheme, compiled=False)
        assert abs(run.nodes[-1, 0, 0] - exact) < 2 * clock * exact + 1e-15
    reference = tc.reference_solution(model, 1.0, compiled=False)
    assert abs(reference.nodes[0, 0] - exact) <= reference.error < np.spacing(1.0) / width
