"""The page that follows the solver of a plan."""

from __future__ import annotations

import pytest
from planning import raising

import ocp
from tenscasadi.viewer import ConvergencePage

pytest.importorskip("viser", reason="viser is not installed: pip install 'tenscasadi[view]'")


@pytest.fixture
def page():
    with ConvergencePage(browser=False) as own:
        yield own


def test_page_shows_iterations_of_a_plan(page):
    plan = ocp.solve(raising(), ocp.Variational(6), progress=page)
    assert plan.success
    page.draw()
    assert f"iteration {plan.iterations}: objective" in page._chart.content
    assert page._chart.content.startswith("<svg ")


def test_stop_ends_the_search(page):
    page._stop()
    plan = ocp.solve(raising(), ocp.Variational(6), progress=page)
    assert plan.status == "User_Requested_Stop"
    assert plan.iterations == 0


def test_values_of_another_type_are_rejected(page):
    with pytest.raises(TypeError, match=r"ocp\.Progress"):
        page(3.0)
    with pytest.raises(TypeError, match="browser"):
        ConvergencePage(browser="yes")
    with pytest.raises(ValueError, match="port"):
        ConvergencePage(browser=False, port=99999)
