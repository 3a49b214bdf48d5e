"""Curves are where their numbers are: read back from the picture."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from tenscasadi.viewer.charts import chart_svg, cursors
from tenscasadi.viewer.exhibit import Chart, Exhibit

TIME = np.linspace(0.5, 2.5, 21)


def scales(svg):
    """Functions from the picture to time and value, by its ticks and the frame."""
    frame = svg.find("rect").attrib
    left, wide = float(frame["x"]), float(frame["width"])
    ticks = [
        (float(tick.text), float(tick.attrib["y"]) - 3)
        for tick in svg.findall("text")
        if tick.attrib.get("text-anchor") == "end" and "." in tick.attrib["y"]
    ]
    (a, ya), (b, yb) = ticks[0], ticks[-1]
    return (
        lambda x: TIME[0] + (x - left) / wide * (TIME[-1] - TIME[0]),
        lambda y: a + (y - ya) / (yb - ya) * (b - a),
    )


def curves(svg):
    return [
        np.array([[float(v) for v in point.split(",")] for point in line.attrib["points"].split()])
        for line in svg.findall("polyline")
    ]


def test_curves_lie_at_their_values():
    values = np.column_stack([3 * np.sin(TIME), TIME**2])
    svg = ElementTree.fromstring(
        chart_svg(Chart("γ & more", "N/m", TIME, values, ("string 0", "string <1>")))
    )
    time, value = scales(svg)
    for k, curve in enumerate(curves(svg)):
        np.testing.assert_allclose(time(curve[:, 0]), TIME, atol=0.01)
        np.testing.assert_allclose(value(curve[:, 1]), values[:, k], atol=0.02)
    assert "γ & more (N/m)" in "".join(svg.itertext())
    assert "string <1>" in "".join(svg.itertext())


def test_what_is_held_is_drawn_in_steps():
    svg = ElementTree.fromstring(
        chart_svg(Chart("γ", "N/m", TIME, np.arange(20.0)[:, None], ("string 0",)))
    )
    time, value = scales(svg)
    (curve,) = curves(svg)
    np.testing.assert_allclose(time(curve[:, 0]), np.repeat(TIME, 2)[1:-1], atol=0.01)
    np.testing.assert_allclose(value(curve[:, 1]), np.repeat(np.arange(20.0), 2), atol=0.1)


def test_limits_are_dashed_and_told():
    limits = {"lower": np.full(1, 1.0), "upper": np.full(1, 9.0)}
    text = chart_svg(
        Chart("γ", "N/m", TIME, np.linspace(2, 8, 21)[:, None], ("string 0",), **limits)
    )
    _, value = scales(ElementTree.fromstring(text))
    dashed = [
        float(y) for y in re.findall(r'd="M44 ([\d.]+)h\d+" stroke="#000" stroke-dasharray', text)
    ]
    np.testing.assert_allclose(np.sort([value(y) for y in dashed]), [1.0, 9.0], atol=0.05)
    assert "limits ≥ 1, ≤ 9" in text
    far = chart_svg(Chart("γ", "N/m", TIME, np.ones((21, 1)), ("string 0",), upper=np.full(1, 1e6)))
    assert "dasharray" not in far
    assert "≤ 1e+06" in far


def test_a_cursor_marks_the_time():
    exhibit = Exhibit((), charts=(Chart("γ", "N/m", TIME, np.ones((21, 1)), ("string 0",)),))
    svg = ElementTree.fromstring(chart_svg(exhibit.charts[0]))
    time, _ = scales(svg)
    for moment in (0.5, 1.7, 2.5):
        x = float(re.search(r'x1="([\d.]+)"', cursors(exhibit, moment)).group(1))
        assert time(x) == pytest.approx(moment, abs=0.01)


def test_many_long_and_lost_curves_stay_light():
    values = np.random.default_rng(0).normal(size=(5000, 900))
    values[100:, 3] = np.nan
    text = chart_svg(
        Chart(
            "tension",
            "N",
            np.linspace(0, 1, 5000),
            values,
            tuple(f"string {k}" for k in range(900)),
        )
    )
    assert len(text) < 400_000
    assert "40 of 900" in text
    assert "nan" not in text
