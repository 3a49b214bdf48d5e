"""Diagrams: curves keep the order of cost, and a solver is drawn as it goes on."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import numpy as np
import pytest

import ocp
import tenscasadi as tc
from tenscasadi.plots import Convergence, work_precision


def test_a_solver_is_drawn_as_it_works(tmp_path):
    path, told = tmp_path / "solver.png", []
    picture = Convergence(path, every=1e-9)

    def watch(now):
        picture(now)
        told.append((now, path.stat().st_mtime_ns))

    model = tc.Model(tc.Scene(tc.shapes.prism(), control=tc.ForceDensity()))
    limits = [ocp.ForceDensityLimits(1.0, 50.0)]
    plan = ocp.solve(
        ocp.Problem(model, 0.5, bounds=limits, costs=[ocp.Effort()]),
        ocp.Variational(4),
        ocp.Ipopt(callback=watch),
    )
    assert plan.success
    assert len({written for _, written in told}) == len(told) == plan.iterations + 1
    above, below = (ax.lines[0].get_xydata() for ax in picture.figure().axes)
    assert np.array_equal(above, [(now.iteration, now.objective) for now, _ in told])
    assert np.array_equal(below, [(now.iteration, now.infeasibility) for now, _ in told])
    assert above[-1, 1] == pytest.approx(plan.objective, rel=1e-6)


def test_chart_follows_the_automatic_method_in_a_notebook(monkeypatch):
    shown = []
    place = SimpleNamespace(update=shown.append)
    display = SimpleNamespace(display=lambda figure, display_id: shown.append(figure) or place)
    shell = SimpleNamespace(kernel=None)
    notebook = SimpleNamespace(display=display, get_ipython=lambda: shell, version_info=(8, 24))
    monkeypatch.setitem(sys.modules, "IPython", notebook)
    model = tc.Model(tc.Scene(tc.shapes.prism(), control=tc.ForceDensity()))
    limits = [ocp.ForceDensityLimits(1.0, 50.0)]
    problem = ocp.Problem(model, 0.5, bounds=limits, costs=[ocp.Effort()])
    plan = ocp.solve(problem, progress=Convergence(every=1e-9))
    assert plan.success
    assert len(shown) > plan.iterations
    assert len(shown[-1].axes[0].lines[0].get_xydata()) == len(shown)


def test_no_file_and_no_iteration_are_fine():
    picture = Convergence()
    assert len(picture.figure().axes) == 2
    picture(ocp.Progress(0, 1.0, 0.0))
    picture(ocp.Progress(1, 0.5, 1e-3))
    assert picture.figure().axes[1].get_yscale() == "log"


def test_a_time_that_is_none_is_refused():
    with pytest.raises(ValueError, match="every is 0"):
        Convergence("solver.png", every=0)


def test_curves_follow_the_cost_and_the_reference_is_shown_where_it_is_near():
    floor = [(1e-3, 1.0), (1e-5, 2.0), (4e-5, 4.0)]  # rounding grows with the steps
    for reference_error, shaded in ((1e-14, 0), (1e-6, 1)):
        (axes,) = work_precision({"scheme": floor}, reference_error=reference_error).axes
        (line,) = axes.lines
        assert line.get_ydata().tolist() == [1.0, 2.0, 4.0]
        assert len(axes.patches) == shaded


def test_long_names_leave_the_curves_their_room():
    for name in ("short", 60 * "long "):
        figure = work_precision({name: [(1e-3, 1.0), (1e-5, 2.0)]})
        figure.draw_without_rendering()
        assert figure.axes[0].get_position().width > 0.7
