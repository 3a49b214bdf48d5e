"""Pictures of replays' errors."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from tenscasadi import plots


def found(factor=1.0, **importance):
    return SimpleNamespace(
        worst_error=factor * np.array([0.04, 0.01, np.inf, 0.02]),
        tolerance=0.03,
        importance=importance,
    )


def test_one_curve_shows_the_share_within_each_error(tmp_path):
    path = tmp_path / "robust.png"
    figure = plots.robustness(found(bar_mass=0.7, start=0.2), title="prism", path=path)
    curve = figure.axes[0].lines[0]
    assert curve.get_xdata().tolist() == [0.01, 0.02, 0.04]
    assert curve.get_ydata().tolist() == [25.0, 50.0, 75.0]  # one in four diverges
    assert [text.get_text() for text in figure.axes[0].texts] == ["50 %"]
    assert [round(bar.get_width()) for bar in figure.axes[1].patches] == [70, 20]
    assert path.stat().st_size > 5000


def test_several_are_told_by_name():
    figure = plots.robustness(
        {"open loop": found(bar_mass=0.7), "tracked": found(0.1, bar_mass=0.1, start=0.8)}
    )
    assert [text.get_text() for text in figure.axes[0].get_legend().get_texts()] == [
        "open loop",
        "tracked",
    ]
    assert [label.get_text() for label in figure.axes[1].get_yticklabels()] == ["bar_mass", "start"]


def test_too_few_replays_to_tell_leave_the_bars_empty():
    assert plots.robustness(found(bar_mass=np.nan)).axes[1].patches[0].get_width() == 0.0


@pytest.mark.parametrize(
    ("what", "error"),
    [(3.0, TypeError), ({"a": 1}, TypeError), ({}, ValueError), ({1: found()}, TypeError)],
)
def test_what_is_no_robustness_is_refused(what, error):
    with pytest.raises(error, match=r"^data"):
        plots.robustness(what)


def test_a_title_that_is_no_text_is_refused():
    with pytest.raises(TypeError, match="title"):
        plots.robustness(found(), title=3)
