"""Limits of bars: of forces and against buckling."""

from __future__ import annotations

import numpy as np
import pytest
from planning import BAR, driven, prism
from rising import MODEL, along, binds, raised

import ocp


def test_bar_force_is_what_holds_the_bars(free):
    force = along(free, lambda now: now.bar_force)
    x, u = free.trajectory.states[3], free.force_density[3]
    assert force[3] == pytest.approx(MODEL.multipliers(x, u).bar_force_density * BAR, rel=1e-6)
    assert free.bar_forces() == pytest.approx(force, rel=1e-9)
    assert np.all(force > 0)  # strings in tension hold bars in compression


def test_bars_carry_no_more_than_allowed(free):
    most = 0.98 * along(free, lambda now: now.bar_force).max()
    binds(raised(ocp.BarForceLimits(compression=most)), free, lambda now: now.bar_force, most)


def test_bars_do_not_buckle(free):
    force = along(free, lambda now: now.bar_force).max()
    modulus = 0.98 * force * BAR**2 / (np.pi**3 * 0.01**4 / 4)
    bound = ocp.Buckling(2 * modulus, safety=2.0)
    assert bound.loads(MODEL.structure) == pytest.approx(0.98 * force)
    binds(raised(bound), free, lambda now: now.bar_force, 0.98 * force)


BAD = {
    "no limit": (
        lambda: ocp.BarForceLimits(),
        ValueError,
        "BarForceLimits.compression and .tension",
    ),
    "negative compression": (
        lambda: ocp.BarForceLimits(-1.0),
        ValueError,
        "BarForceLimits.compression",
    ),
    "wrong number of bars": (
        lambda: raised(ocp.BarForceLimits([1.0, 2.0])),
        ValueError,
        "BarForceLimits.compression",
    ),
    "no radius": (
        lambda: raised(ocp.Buckling(1e9), model=driven(prism(1.0))),
        ValueError,
        "Buckling needs the radius of bar 0",
    ),
    "compression in words": (
        lambda: ocp.BarForceLimits("5"),
        TypeError,
        "BarForceLimits.compression is not a real number",
    ),
    "modulus zero": (lambda: ocp.Buckling(0.0), ValueError, "Buckling.modulus"),
    "safety zero": (lambda: ocp.Buckling(1.0, 0.0), ValueError, "Buckling.safety"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_limits_of_bars_are_refused_by_name(name):
    make, error, message = BAD[name]
    with pytest.raises(error, match=message):
        make()
