"""Report of a scene at rest: numbers as computed elsewhere, and lines for people."""

from __future__ import annotations

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.analysis.statics_report import find_utilization, report_statics

STEEL = tc.Material(modulus=200e9, density=7850.0, strength=235e6)


def test_report_of_a_prism_agrees_with_its_parts() -> None:
    prism = tc.shapes.prism(prestress=50.0, stiffness=1e4)
    report = report_statics(tc.Scene(prism))
    st = tc.stability(prism)
    np.testing.assert_allclose(report.stability.eigenvalues, st.eigenvalues)
    np.testing.assert_allclose(
        report.modes.frequency, tc.modes(tc.Model(tc.Scene(prism))).frequency[:6], rtol=1e-6
    )
    assert (report.self_stresses, report.mechanisms) == (1, 1)
    text = report.summary()
    for line in (
        "bars          3, class 1",
        "self-stresses 1",
        "mechanisms    1 infinitesimal",
        "stable        yes; super-stable: yes",
        "utilization   unknown: give a modulus and a strength",
    ):
        assert line in text
    assert len(text.splitlines()) < 25


def test_counts_are_those_of_the_given_nodes() -> None:
    tower = tc.shapes.prism_tower(prestress=100.0, stiffness=1e4, pinned=[0, 1, 2])
    report = report_statics(tc.Scene(tower, gravity=tc.Gravity()))
    assert report.self_stresses == len(tc.self_stress(tower)) > 0
    assert "reactions     sum (0, 0, 58.86) N" in report.summary()


def test_utilization_is_force_over_capacity() -> None:
    area = np.pi * 0.01**2
    s = tc.Structure(
        [(0, 0, 0), (0, 0, 1), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)],
        bars=[(0, 1)],
        strings=[(1, 2), (1, 3), (1, 4), (1, 5)],
        bar_radius=0.01,
        pinned={0: "xyz", 2: "xyz", 3: "xyz", 4: "xyz", 5: "xyz"},
        stiffness=200e9 * 1e-6 / 2**0.5,
    ).prestressed(1e3)
    eq = tc.find_equilibrium(tc.Scene(s))
    use = find_utilization(eq, STEEL)
    euler = np.pi**2 * 200e9 * area**2 / (4 * np.pi)
    assert use[4] == pytest.approx(4e3 / min(euler, 235e6 * area), rel=1e-9)
    string = 200e9 * 1e-6 / 2**0.5 * s.rest_length[0] / 200e9
    np.testing.assert_allclose(use[:4], 1e3 * 2**0.5 / (235e6 * string))
    assert "at most, in string 0" in report_statics(tc.Scene(s), STEEL).summary()


def test_members_without_section_are_counted() -> None:
    report = report_statics(tc.Scene(tc.shapes.prism(prestress=50.0)), STEEL)
    assert report.utilization is not None
    assert np.all(np.isnan(report.utilization[9:]))
    assert "3 members have no section" in report.summary()


def test_soft_motions_and_frequencies_of_a_pressurized_membrane_agree() -> None:
    """The free edges of an open membrane give its pressure no energy."""
    s = tc.shapes.membrane(8, 5).prestressed(10.0)
    pressure = tc.Pressure(tc.shapes.membrane_faces(8, 5), 3.0)
    report = report_statics(tc.Scene(s, pressure=pressure))
    assert report.equilibrium.success
    assert report.stability.stable
    assert report.stability.eigenvalues[0] > 0.0
    assert report.modes.frequency[0] > 0.0
    assert report.stability.modes.shape[0] + report.modes.rigid == 3 * len(s.nodes)


def test_slack_structures_and_mechanisms_are_reported() -> None:
    text = report_statics(tc.Scene(tc.shapes.prism())).summary()
    assert "all slack: give a prestress" in text
    assert "stable        no" in text
    held = tc.Structure([(0, 0, 0), (1, 0, 0)], bars=[(0, 1)], pinned=[0, 1])
    assert "softest       none" in report_statics(tc.Scene(held)).summary()
