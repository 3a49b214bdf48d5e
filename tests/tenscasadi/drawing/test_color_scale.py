"""Colors of string forces."""

from __future__ import annotations

import numpy as np

from tenscasadi.drawing.color_scale import ColorScale
from tenscasadi.drawing.style import STYLE


def test_colors_run_over_the_ramp():
    scale = ColorScale.of("tension", np.array([0.0, 2.0, 4.0, -1.0, np.nan]))
    assert (scale.largest, scale.highest, scale.lowest, scale.slack) == (4.0, 4.0, -1.0, True)
    np.testing.assert_array_equal(
        scale.colors(np.array([0.0, -1.0, 4.0, 2.0, np.nan])),
        [STYLE.slack, STYLE.compression, STYLE.ramp[-1], STYLE.ramp[4], STYLE.slack],
    )
    assert scale.label == "tension (N); gray: slack; green: compression, up to 1 N"


def test_an_impact_does_not_wash_out_the_rest():
    values = np.ones((1000, 5))
    values[500] = 1e4
    scale = ColorScale.of("tension", values)
    assert scale.largest == 1.0
    assert scale.highest == 1e4
    np.testing.assert_array_equal(scale.colors(np.array([1e4])), [STYLE.ramp[-1]])


def test_a_scale_widens_only_for_clearly_larger_values():
    scale = ColorScale.of("tension", np.array([1.0, 2.0]))
    assert scale.widen(np.array([2.05])).largest == 2.0
    wider = scale.widen(np.array([3.0, 0.0, -2.0]))
    assert (wider.largest, wider.slack, wider.lowest) == (3.0, True, -2.0)


def test_brightness_of_the_ramps_is_monotonic():
    for ramp, sign in ((STYLE.ramp, 1), (STYLE.time_ramp, -1)):
        brightness = np.array(ramp) @ (0.2126, 0.7152, 0.0722)
        assert (sign * np.diff(brightness) > 0).all()
