"""Arguments of `view`, and the pages that it writes."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest

import ocp
import tenscasadi as tc
from tenscasadi.viewer import View, view

PRISM = tc.shapes.prism(stiffness=1000.0, prestress=50.0)


@pytest.fixture(scope="module")
def motion():
    return tc.simulate(tc.Model(tc.Scene(PRISM)), 0.1, 0.01, compiled=False)


@pytest.fixture(scope="module")
def plan():
    model = tc.Model(tc.Scene(PRISM, control=tc.ForceDensity(), ground=tc.Ground(height=-1.0)))
    place = tuple(PRISM.nodes[0] + [0, 0, 0.05])
    goals = [ocp.NodePositions({0: (None, None, place[2])})]
    bounds = [
        ocp.ForceDensityLimits(1.0, 200.0),
        ocp.Obstacle((3.0, 0, 0), 0.5),
        ocp.AboveGround(-0.9),
        ocp.TensionLimits(upper=500.0),
    ]
    return ocp.solve(
        ocp.Problem(model, goals=goals, bounds=bounds, costs=[ocp.Effort()]), ocp.Variational(6)
    )


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def _viser():
    pytest.importorskip("viser", reason="the extra [view] is not installed")


@pytest.mark.usefixtures("_viser")
def test_pages_hold_their_title_legend_and_units(motion, plan):
    scene = tc.Scene(
        PRISM,
        ground=[
            tc.Ground(normal=(0.2, 0, 1)),
            tc.Terrain(np.random.default_rng(0).normal(size=(5, 4)) / 9, (-1, -1), (1, 1)),
        ],
    )
    things = {"motion": motion, "plan": plan, "scene": scene, "structure": PRISM}
    for name, thing in things.items():
        assert isinstance(thing.view(html=f"{name}.html", title=f"<{name}>"), View)
        page = Path(f"{name}.html").read_text(encoding="utf-8")
        text = page[page.index('<details id="shown"') :]
        assert f"<title>&lt;{name}&gt;</title>" in page
        assert "tension of strings (N)" in text
        assert len(page) > 500_000  # with the player itself
    plan_page, scene_page = (
        Path(f"{name}.html").read_text(encoding="utf-8") for name in ("plan", "scene")
    )
    assert "force density (N/m)</text>" in plan_page
    assert "limits: ≥ 1 and ≤ 200 N/m" in plan_page
    assert re.search(r"grid lines [\d.]+ m apart", scene_page)


@pytest.mark.usefixtures("_viser")
def test_a_notebook_gets_the_page_itself(motion):
    shown = view(motion, html="prism.html")._repr_html_()
    assert shown.startswith("<iframe srcdoc=")
    assert "&quot;" in shown


@pytest.mark.parametrize(
    ("field", "value", "kind"),
    [
        ("html", "page.png", ValueError),
        ("html", 3, TypeError),
        ("color", "red", ValueError),
        ("speed", 0.0, ValueError),
        ("speed", 1e-9, ValueError),
        ("follow", 1, TypeError),
        ("title", 5, TypeError),
        ("ground", "flat", TypeError),
        ("things", 3.0, TypeError),
        ("things", [], ValueError),
        ("things", {1: PRISM}, TypeError),
    ],
)
def test_wrong_arguments_are_named(motion, field, value, kind):
    with pytest.raises(kind, match=field):
        view(**{"things": motion, "html": "page.html", field: value})


def test_a_missing_viser_is_reported_with_the_cure(motion, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(ImportError, match=r"pip install 'tenscasadi\[view\]'"):
        motion.view(html="page.html")


def test_the_old_keyword_for_the_color_warns(motion):
    with pytest.warns(DeprecationWarning, match="use color="):
        view(motion, html="page.html", colour="force density")
