"""What `view` and the methods of that name take, and what they write."""

from __future__ import annotations

import dataclasses
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import ocp
import tenscasadi as tc
from tenscasadi.viewer import View, view
from tenscasadi.viewer.exhibit import exhibit_of

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


def test_a_plan_is_its_replay_with_the_plan_over_it(plan):
    exhibit = exhibit_of(plan)
    assert [motion.name for motion in exhibit.motions] == ["replay", "plan"]
    np.testing.assert_array_equal(exhibit.motions[0].nodes, plan.replay().nodes)
    np.testing.assert_array_equal(exhibit.motions[1].nodes, plan.trajectory.nodes)
    assert exhibit.grounds == plan.model.scene.grounds
    (obstacle,) = exhibit.obstacles
    np.testing.assert_array_equal(obstacle[0], (3.0, 0.0, 0.0))
    assert obstacle[1] == 0.5
    assert exhibit.boxes[0][0][2] == -0.9
    end = plan.trajectory.nodes[-1, 0]
    np.testing.assert_allclose(exhibit.targets, [(end[0], end[1], PRISM.nodes[0, 2] + 0.05)])
    assert [(chart.title, chart.unit) for chart in exhibit.charts] == [
        ("force density", "N/m"),
        ("tension of the replay", "N"),
    ]
    np.testing.assert_array_equal(exhibit.charts[0].values, plan.force_density)
    assert exhibit.charts[0].upper.tolist() == [200.0] * 9
    assert exhibit.charts[1].upper.tolist() == [500.0] * 9


def test_targets_on_the_way_lie_where_the_plan_is_then(plan):
    wanted = ocp.NodePositions({0: (None, None, 1.0)})
    half, end = len(plan.time) // 2, len(plan.time) - 1
    for goal, row in (
        (ocp.Waypoint([wanted], share=0.5), half),
        (ocp.Waypoint([wanted.soft()], share=0.5), half),
        (wanted.soft(), end),
    ):
        asked = ocp.Problem(plan.model, goals=[goal])
        place = plan.trajectory.nodes[row, 0]
        np.testing.assert_allclose(
            exhibit_of(dataclasses.replace(plan, problem=asked)).targets,
            [(place[0], place[1], 1.0)],
            atol=1e-12,
        )


def test_targets_of_phases_lie_where_the_plan_is_at_their_ends(plan):
    phases = [ocp.Phase(0.5, goals=[ocp.NodePositions({k: (None, None, 1.0)})]) for k in (0, 1)]
    model = tc.Model(tc.Scene(PRISM, control=tc.ForceDensity()))
    asked = ocp.Problem(model, phases=phases)
    ends = [plan.trajectory.nodes[row, k] for row, k in ((len(plan.time) // 2, 0), (-1, 1))]
    targets = exhibit_of(dataclasses.replace(plan, problem=asked)).targets
    np.testing.assert_allclose(targets, [(x, y, 1.0) for x, y, _ in ends], atol=1e-12)


def test_a_node_alone_is_given_the_room_of_its_motion():
    node = tc.Structure([[0.0, 0.0, 1.0]], [], [], node_mass=1.0)
    fall = tc.simulate(tc.Model(tc.Scene(node, gravity=tc.Gravity())), 1.0, 0.01, compiled=False)
    low, high = exhibit_of(fall).corners()
    assert low[2] == fall.nodes[-1, 0, 2]
    assert high[2] == 1.0


def test_scenes_bear_what_the_laws_of_their_strings_give_them():
    loose = PRISM.replace(rest_length=1.1 * PRISM.string_lengths)
    for slack in (tc.Clip(), tc.Linear(), tc.Smooth(0.1), {0: tc.Linear(), 4: tc.Smooth(0.1)}):
        scene = tc.Scene(loose, slack=slack)
        begun = tc.simulate(tc.Model(scene), 0.002, 0.001, compiled=False)
        shown = exhibit_of(scene).motions[0]
        np.testing.assert_allclose(shown.tension[0], begun.tension[0], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(
            shown.force_density[0], begun.force_density[0], rtol=1e-9, atol=1e-9
        )


def test_a_plan_that_was_not_found_says_so(plan):
    lost = dataclasses.replace(plan, success=False)
    assert any("no plan was found" in note for note in exhibit_of(lost).notes)
    assert (
        not any("no plan was found" in note for note in exhibit_of(plan).notes) or not plan.success
    )


def test_motions_over_each_other_have_names_of_their_own(motion):
    assert [m.name for m in exhibit_of([motion, motion]).motions] == [
        "1: trajectory",
        "2: trajectory",
    ]
    assert [m.name for m in exhibit_of({"a": motion, "b": PRISM}).motions] == ["a", "b"]


def test_lost_motions_leave_room_for_the_rest(motion):
    nodes = motion.nodes.copy()
    nodes[-1, 0] = 1e9
    nodes[-2, 0] = np.nan
    flown = dataclasses.replace(motion, nodes=nodes, success=False, message="it diverged")
    low, high = exhibit_of(flown).corners()
    assert (high - low).max() < 5.0
    assert exhibit_of(flown).notes == ("trajectory: it diverged",)


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
    assert "force density (N/m)</tspan>, limits ≥ 1, ≤ 200" in Path("plan.html").read_text(
        encoding="utf-8"
    )
    assert re.search(
        r"lines of the ground [\d.]+ m apart", Path("scene.html").read_text(encoding="utf-8")
    )


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
        ("colour", "red", ValueError),
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
def test_what_is_wrong_is_named(motion, field, value, kind):
    with pytest.raises(kind, match=field):
        view(**{"things": motion, "html": "page.html", field: value})


def test_without_viser_the_cure_is_told(motion, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(ImportError, match=r"pip install 'tenscasadi\[view\]'"):
        motion.view(html="page.html")
