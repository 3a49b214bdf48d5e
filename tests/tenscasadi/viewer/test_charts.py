"""Charts in the panel, with a line at the displayed time."""

from __future__ import annotations

import re

import numpy as np
import pytest

from tenscasadi.drawing.view_content import Chart, ViewContent
from tenscasadi.viewer.charts import build_charts, mark_time

TIME = np.linspace(0.5, 2.5, 21)


def evaluate(html, time):
    """Position of the line on the chart in percent, as a browser computes it."""
    formula = re.search(r"left:calc\((.*?)\);width", html)[1]
    formula = re.sub(r"var\(--time,[^)]*\)", repr(time), formula).replace("%", "")
    return eval(formula, {"__builtins__": {}})  # noqa: S307  a formula of our own


def test_the_line_follows_the_time():
    chart = Chart("γ & more", "N/m", TIME, np.ones((21, 1)), ("string 0",))
    html = build_charts(ViewContent((), charts=(chart,)))
    first, middle, last = (evaluate(html, time) for time in (0.5, 1.5, 2.5))
    assert 5 < first < 25
    assert 75 < last <= 100
    assert middle == pytest.approx((first + last) / 2)
    assert "γ &amp; more (N/m)" in html
    assert "--time:1.7" in mark_time(1.7)


def test_many_long_curves_stay_small():
    values = np.random.default_rng(0).normal(size=(5000, 900))
    values[100:, 3] = np.nan
    names = tuple(f"string {k}" for k in range(900))
    chart = Chart("tension", "N", np.linspace(0, 1, 5000), values, names)
    html = build_charts(ViewContent((), charts=(chart,)))
    assert len(html) < 400_000
    assert "40 of 900" in html
