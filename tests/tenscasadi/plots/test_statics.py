"""Pictures of forces and modes: colors, widths, panels, and wrong input."""

from __future__ import annotations

import numpy as np
import pytest
from mpl_toolkits.mplot3d.art3d import Line3DCollection

import tenscasadi as tc
from tenscasadi import plots


def lines(figure, axes: int = 0) -> Line3DCollection:
    found = [c for c in figure.axes[axes].collections if isinstance(c, Line3DCollection)]
    return max(found, key=lambda collection: len(collection.get_linewidths()))


def test_forces_have_colors_by_sign_and_width_by_size() -> None:
    s = tc.Structure(
        [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)],
        bars=[(0, 1)],
        strings=[(0, 2), (0, 3)],
        node_mass=1.0,
    )
    figure = plots.forces(s, [100.0, 25.0], [-100.0])
    drawn = lines(figure)
    colors = np.asarray(drawn.get_colors())[:, :3]
    widths = np.asarray(drawn.get_linewidths())
    blue, orange = np.array([0, 114, 178]) / 255, np.array([213, 94, 0]) / 255
    push = np.abs(colors - blue).max(axis=1) < 0.01
    pull = np.abs(colors - orange).max(axis=1) < 0.01
    assert push.any()
    assert pull.any()
    np.testing.assert_allclose(widths[push].max(), widths[pull].max())
    assert np.sum(np.isclose(widths, widths[push].max())) == 18  # nine pieces of two members


def test_zero_forces_are_drawn() -> None:
    s = tc.shapes.prism()
    figure = plots.forces(s, np.zeros(9), 0.0, reactions=np.zeros((6, 3)), title="at rest")
    assert figure.get_suptitle() == "at rest"


def test_modes_have_a_panel_each(tmp_path) -> None:
    st = tc.stability(tc.shapes.prism(prestress=10.0))
    path = tmp_path / "modes.png"
    figure = plots.mode_shapes(st.structure, st.modes[:5], path=path)
    assert [ax.get_title() for ax in figure.axes] == [f"mode {k}" for k in range(5)]
    assert path.exists()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: plots.forces(3, [], []), "structure is 3: give a tenscasadi.Structure"),
        (lambda s: plots.forces(s, np.zeros(8), 0.0), r"tension has shape \(8,\)"),
        (lambda s: plots.forces(s, 0.0, np.nan), "bar_force is nan"),
        (lambda s: plots.mode_shapes(s, np.zeros((0, 6, 3))), "modes is empty"),
        (lambda s: plots.mode_shapes(s, np.zeros((1, 6, 3)), ["a", "b"]), "labels has 2 entries"),
    ],
)
def test_wrong_input_is_named(call, message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        call(tc.shapes.prism())
