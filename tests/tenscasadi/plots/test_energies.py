"""Energies, tensions and phase portraits of a motion."""

from __future__ import annotations

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi import plots
from tenscasadi.plots.histories import find_contact_intervals


@pytest.fixture(scope="module")
def bounce():
    """A prism that falls to the ground and bounces off it."""
    prism = tc.shapes.prism(prestress=50.0, stiffness=1000.0)
    ground = tc.Ground(height=prism.nodes[:, 2].min() - 0.05, stiffness=2e4)
    model = tc.Model(tc.Scene(prism, gravity=tc.Gravity(), ground=ground))
    return tc.simulate(model, 0.3, 1e-3, save_every=5, compiled=False)


def test_energies_add_up(bounce):
    ax = plots.energies(bounce).axes[0]
    curves = {line.get_label(): line.get_ydata() for line in ax.lines}
    assert list(curves) == ["kinetic", "elastic", "gravitational", "total"]
    parts = curves["kinetic"] + curves["elastic"] + curves["gravitational"]
    assert curves["kinetic"] == pytest.approx(bounce.energy_parts[:, 0])
    free = bounce.time < 0.09  # then the ground has energy, too
    assert parts[free] == pytest.approx(curves["total"][free])


def test_contacts_are_shaded(bounce):
    intervals = find_contact_intervals(bounce)
    start, end = intervals[0]
    fall = np.sqrt(2 * 0.05 / 9.81)
    assert start == pytest.approx(fall, abs=0.01)
    assert fall < end < 0.3
    spans = plots.tensions(bounce).axes[0].patches
    assert len(spans) == len(intervals)
    assert spans[0].get_x() == pytest.approx(start)
    assert spans[0].get_width() == pytest.approx(end - start)


def test_motions_without_a_ground_have_no_contacts():
    swing = tc.simulate(tc.Model(tc.Scene(tc.shapes.pendulum())), 0.02, 0.01, compiled=False)
    assert find_contact_intervals(swing) == ()


def test_tensions_of_named_strings(bounce):
    lines = plots.tensions(bounce, strings=["top[1]", 0]).axes[0].lines
    assert [line.get_label() for line in lines] == ["top[1]", "bottom[0]"]
    assert lines[0].get_ydata() == pytest.approx(bounce.tension[:, 4])
    with pytest.raises(ValueError, match="strings names string 'middle'"):
        plots.tensions(bounce, strings=["middle"])


@pytest.mark.parametrize(("name", "strings"), [("guys", 2), ("guys[1]", 1), ("x", 1)])
@pytest.mark.parametrize("segments", [1, 2])
def test_tensions_show_the_segments_of_a_group(name, strings, segments):
    names = ["guys[0]", "guys[1]", *"xyzuvwt"]
    structure = tc.shapes.prism(string_mass=0.1).replace(string_names=names)
    model = tc.Model(tc.Scene(structure, segments=segments))
    motion = tc.simulate(model, 0.002, 1e-3, compiled=False)
    lines = plots.tensions(motion, strings=[name]).axes[0].lines
    assert len(lines) == strings * segments
    tension = motion.tension[:, : strings * segments]
    if name == "guys":
        np.testing.assert_allclose(np.transpose([line.get_ydata() for line in lines]), tension)


def test_phase_portraits_start_at_the_point(bounce):
    ax = plots.phase_portrait(bounce, ["top[0]"], axis="z").axes[0]
    curve, start = ax.lines
    assert curve.get_label() == "top[0]"
    assert curve.get_xdata() == pytest.approx(bounce.nodes[:, 3, 2])
    assert curve.get_ydata() == pytest.approx(bounce.velocities[:, 3, 2])
    assert start.get_xydata()[0] == pytest.approx([bounce.nodes[0, 3, 2], 0.0])
    with pytest.raises(ValueError, match="axis"):
        plots.phase_portrait(bounce, axis="w")
