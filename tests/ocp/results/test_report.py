"""Reports name the limits that hold a plan and those that it breaks."""

from __future__ import annotations

from dataclasses import replace

import pytest
from planning import taller

import ocp
import tenscasadi as tc


def test_a_report_names_what_holds_the_plan():
    most = 13.0
    asked = taller(ocp.TensionLimits(upper=most))
    plan = ocp.solve(asked, ocp.MultipleShooting(16))
    found = plan.report()
    assert plan.success
    assert ("force density of string 0", "lower") in {(one.name, one.side) for one in found.active}
    assert not found.violated
    text = str(found)
    assert "force density of string 0: lower limit 5 N/m" in text
    assert "violated: none" in text


def test_a_report_names_what_the_replay_breaks(coarse):
    peak = coarse.replay().tension.max()
    found = replace(coarse, problem=taller(ocp.TensionLimits(upper=0.9 * peak))).report()
    worst = max(found.violated, key=lambda one: one.worst)
    assert worst.name.startswith("tension of string")
    assert worst.side == "upper"
    assert worst.worst == pytest.approx(peak)
    assert 0 <= worst.time <= 1.0
    assert worst.name in str(found)


def test_report_shows_the_names_of_members():
    structure = tc.shapes.d_bar(pinned=[0]).replace(string_names=["long", "short"])
    model = tc.Model(tc.Scene(structure, control=tc.ForceDensity()))
    goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    problem = ocp.Problem(
        model, goals=goals, bounds=[ocp.ForceDensityLimits(1.0)], costs=[ocp.Effort()]
    )
    report = ocp.solve(problem, ocp.MultipleShooting(10)).report()
    assert report.active[0].name == "force density of string 0"
    assert report.active[0].member == "long"
    assert "force density of string 0: lower limit 1 N/m" in str(report)
    assert str(report.active[0]).endswith(" (long)")
