"""3-D pictures and histories: their content, not their beauty."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pytest
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from PIL import Image

import ocp
import tenscasadi as tc
from tenscasadi import plots
from tenscasadi.animation import animate
from tenscasadi.drawing.style import STYLE


@pytest.fixture(scope="module")
def prism():
    return tc.shapes.prism(prestress=50.0, stiffness=1000.0)


@pytest.fixture(scope="module")
def motion(prism):
    model = tc.Model(tc.Scene(prism))
    state = model.state(
        prism.nodes, np.cross((0.0, 0.0, 2.0), prism.nodes) + np.array([0.5, 0.0, 0.0])
    )
    return tc.simulate(model, 0.5, step=0.005, state=state, compiled=False)


@pytest.fixture(scope="module")
def swing():
    model = tc.Model(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity((0.0, 0.0, -9.81))))
    return tc.simulate(model, 0.5, step=0.005, compiled=False)


def lines(figure):
    return figure.axes[0].collections[0]


def colors_of(figure):
    """Colors of the members, without those of nodes."""
    nodes = np.array([STYLE.node, STYLE.joint])
    colors = np.round(255 * lines(figure).get_colors()[:, :3]).astype(int)
    return {tuple(color) for color in colors.tolist() if not (color == nodes).all(axis=1).any()}


def test_structure_shows_bars_thicker_than_strings(prism):
    shown = lines(plots.structure(prism))
    widths, colors = shown.get_linewidths(), np.round(255 * shown.get_colors()[:, :3])
    bar, node = ((colors == color).all(axis=1) for color in (STYLE.bar, STYLE.node))
    assert bar.sum() == 3 * (~bar & ~node).sum() / 9
    assert np.min(np.array(widths)[bar]) > 2 * np.max(np.array(widths)[~bar & ~node])


def test_structure_colours_strings_by_tension(prism):
    tension = np.zeros(9)
    tension[4] = 10.0
    seen = colors_of(plots.structure(prism, tension))
    assert STYLE.slack in seen
    assert len(seen) == 3  # bars, slack strings, the taut one
    figure = plots.structure(prism)
    assert len(colors_of(figure)) == 3  # two tensions of the self-stress
    assert figure.axes[1].get_ylim() == pytest.approx(
        (0.0, (prism.stiffness * (prism.string_lengths - prism.rest_length)).max())
    )


def test_structure_says_which_strings_push(prism):
    figure = plots.structure(prism, [-7.0, 0.0, *[5.0] * 7])
    label = "tension (N); gray: slack; green: compression, up to 7 N"
    assert figure.axes[1].get_ylabel() == label
    assert {STYLE.slack, STYLE.compression} <= colors_of(figure)


def test_structure_says_that_all_strings_are_slack():
    figure = plots.structure(tc.shapes.prism())
    assert len(figure.axes) == 1
    assert "slack" in figure.get_supxlabel()


def test_axes_have_one_scale(motion):
    for figure in (plots.structure(motion), plots.time_lapse(motion)):
        axes = figure.axes[0]
        extents = np.ptp([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()], axis=1)
        ratio = axes._box_aspect / extents
        assert ratio == pytest.approx(np.full(3, ratio[0]))
        assert axes.get_zlabel() == "z (m)"


def test_a_thin_axis_has_one_round_tick():
    tower = tc.Structure([(-0.0115, 0.0115, 0.0), (-0.0115, 0.0115, 4.0)], [(0, 1)])
    axes = plots.structure(tower).axes[0]
    assert [list(ticks) for ticks in (axes.get_xticks(), axes.get_yticks())] == [[0.0], [0.0]]


def test_nothing_is_cut_off(motion):
    figure = plots.time_lapse(motion, title="title")
    figure.draw_without_rendering()
    inside = figure.bbox.padded(1.0)
    for axis in (figure.axes[0].xaxis, figure.axes[0].yaxis, figure.axes[0].zaxis):
        box = axis.get_tightbbox(figure.canvas.get_renderer())
        assert inside.contains(box.x0, box.y0)
        assert inside.contains(box.x1, box.y1)


def test_time_lapse_shows_the_start_and_the_end(motion):
    shown = np.array(lines(plots.time_lapse(motion, 3))._segments3d)
    assert len(shown) == 3 * len(lines(plots.structure(motion))._segments3d)
    for nodes in (motion.nodes[0], motion.nodes[-1]):
        assert np.linalg.norm(shown.reshape(-1, 3) - nodes[0], axis=1).min() < 1e-12


def test_structure_of_a_trajectory_is_the_one_at_that_time(motion):
    shown = np.array(lines(plots.structure(motion, time=0.1))._segments3d).reshape(-1, 3)
    row = int(np.argmin(abs(motion.time - 0.1)))
    assert np.linalg.norm(shown - motion.nodes[row, 0], axis=1).min() < 1e-12


def test_pinned_nodes_are_marked(swing):
    marks = plots.structure(swing).axes[0].collections[1]
    assert np.ravel(marks._offsets3d) == pytest.approx(swing.nodes[-1, 0])


def test_labels_name_or_number_the_nodes(prism):
    named = prism.replace(node_names=["foot", "", "", "", "", "top"])
    labels = plots.structure(named, labels=True).axes[0].texts
    assert [text.get_text() for text in labels] == ["foot", "1", "2", "3", "4", "top"]


def test_a_lone_mass_and_a_net_can_be_drawn():
    assert (
        len(plots.structure(tc.Structure([(0.0, 0.0, 0.0)], node_mass=1.0)).axes[0].collections)
        == 1
    )
    assert plots.structure(tc.shapes.membrane(4, 3)).axes


def test_node_that_is_an_array_is_refused_by_name(motion):
    with pytest.raises((TypeError, ValueError), match="nodes"):
        plots.node_histories(motion, [np.array([0, 2])])


def test_node_histories(motion, swing):
    panels = plots.node_histories(motion, [2, 0]).axes
    assert [line.get_label() for line in panels[0].lines] == ["bottom[2]", "bottom[0]"]
    assert sorted(text.get_text() for text in panels[0].texts) == ["bottom[0]", "bottom[2]"]
    assert panels[1].lines[1].get_ydata() == pytest.approx(motion.nodes[:, 0, 1])
    assert [line.get_label() for line in plots.node_histories(swing).axes[0].lines] == [
        "node 1"
    ]  # node 0 does not move


def test_force_densities_of_a_trajectory(motion):
    ax = plots.force_densities(motion, upper=80.0).axes[0]
    curves = {line.get_label(): line for line in ax.lines}
    assert curves["top[0]"].get_ydata() == pytest.approx(motion.force_density[:, 3])
    assert list(ax.lines[-1].get_ydata()) == [80.0, 80.0]
    assert ax.get_title(loc="right") == "limits: ≤ 80 N/m"


def test_equal_strings_share_a_color_and_a_label(prism):
    rest = tc.simulate(tc.Model(tc.Scene(prism)), 0.1, 0.01, compiled=False)
    ax = plots.force_densities(rest).axes[0]
    assert len({line.get_color() for line in ax.lines}) == 2  # horizontal and vertical strings
    assert [text.get_text() for text in ax.texts] == [
        "bottom[0, 1, 2], top[0], …",
        "vertical[0, 1, 2]",
    ]


def test_force_densities_of_a_plan_are_steps_with_their_bounds():
    plan = SimpleNamespace(
        time=np.array([0.0, 1.0, 3.0]), force_density=np.array([[1.0, 2.0], [5.0, 6.0]])
    )
    ax = plots.force_densities(plan, lower=0.0, upper=[8.0, np.inf]).axes[0]
    stairs = [patch.get_data().values.tolist() for patch in ax.patches[:2]]
    assert stairs == [[1.0, 5.0], [2.0, 6.0]]
    assert sorted(line.get_ydata()[0] for line in ax.lines) == [0.0, 8.0]


def test_errors_keep_exact_zeros_and_leave_out_the_unknown(motion):
    unknown = dataclasses.replace(motion, energy_error=np.full(len(motion.time), np.nan))
    ax = plots.errors(unknown).axes[0]
    energy, bars, joints = ax.lines
    assert np.isnan(energy.get_ydata()).all()
    assert energy.get_label().endswith("not computed")
    assert joints.get_label().endswith("exactly 0")
    assert np.all(joints.get_ydata() == ax.get_ylim()[0])
    assert bars.get_ydata()[1:] == pytest.approx(motion.bar_length_error[1:])
    assert ax.get_yscale() == "log"


def test_errors_too_small_to_be_drawn_are_told(motion):
    tiny = dataclasses.replace(motion, joint_error=np.full(len(motion.time), 1e-26))
    assert plots.errors(tiny).axes[0].lines[2].get_label() == "joint gap (m): below 1e-18"


def test_errors_that_are_all_zero_are_drawn(motion):
    zero = np.zeros(len(motion.time))
    plots.errors(
        dataclasses.replace(motion, energy_error=zero, bar_length_error=zero, joint_error=zero)
    ).draw_without_rendering()


def test_a_single_row_can_be_drawn(motion):
    one = {
        name: getattr(motion, name)[:1]
        for name in ("time", "nodes", "velocities", "force_density", "tension", "energy")
    }
    one |= {
        name: getattr(motion, name)[:1]
        for name in (
            "energy_parts",
            "energy_error",
            "bar_length_error",
            "joint_error",
            "correction_shift",
            "correction_energy",
            "states",
            "control",
        )
    }
    start = dataclasses.replace(motion, **one)
    for draw in (
        plots.structure,
        plots.time_lapse,
        plots.node_histories,
        plots.force_densities,
        plots.errors,
    ):
        draw(start).draw_without_rendering()


@pytest.mark.parametrize(
    "draw",
    [plots.structure, plots.time_lapse, plots.node_histories, plots.force_densities, plots.errors],
)
def test_pictures_are_saved(draw, motion, tmp_path):
    file = tmp_path / "picture.png"
    draw(motion, title="title", path=file)
    with Image.open(file) as image:
        assert min(image.size) > 400
        assert len(image.convert("L").getcolors()) > 20


def test_animation_shows_every_frame_at_the_right_speed(motion, tmp_path):
    file = animate(motion, tmp_path / "motion.gif", speed=0.5, frames_per_second=10)
    with Image.open(file) as image:
        assert image.n_frames == 11
        assert image.info["duration"] == 100
        frames = []
        for k in (0, 10):
            image.seek(k)
            frames.append(np.array(image.convert("L"), dtype=float))
    assert abs(frames[1] - frames[0]).max() > 100


def test_no_global_state(motion):
    before = dict(mpl.rcParams)
    plots.time_lapse(motion)
    assert dict(mpl.rcParams) == before


@pytest.mark.parametrize(
    ("mistake", "error", "named"),
    [
        (lambda motion, path: plots.structure(motion.nodes), TypeError, "data"),
        (lambda motion, path: plots.structure(motion, [1.0]), ValueError, "tension"),
        (lambda motion, path: plots.structure(motion, time=-1.0), ValueError, "time"),
        (lambda motion, path: plots.time_lapse(None), TypeError, "data"),
        (lambda motion, path: plots.time_lapse(motion, 1), ValueError, "instants"),
        (lambda motion, path: plots.node_histories(motion, [6]), ValueError, "nodes"),
        (lambda motion, path: plots.force_densities(motion, strings=[9]), ValueError, "strings"),
        (lambda motion, path: plots.force_densities(motion, upper=[1.0, 2.0]), ValueError, "upper"),
        (lambda motion, path: plots.force_densities(motion, lower="high"), TypeError, "lower"),
        (
            lambda motion, path: plots.force_densities(
                SimpleNamespace(time=[0.0, 1.0], force_density=np.ones((4, 1)))
            ),
            ValueError,
            "force_density",
        ),
        (lambda motion, path: plots.force_densities("x"), TypeError, "history is 'x'"),
        (lambda motion, path: plots.errors(3), TypeError, "trajectory"),
        (lambda motion, path: plots.errors(motion, path=path / "picture.xyz"), ValueError, "xyz"),
        (lambda motion, path: plots.errors(motion, path=3.0), TypeError, r"^path is 3\.0"),
        (lambda motion, path: plots.errors(motion, title=[1, 2]), TypeError, "^title is"),
        (lambda motion, path: plots.structure(motion, title=np.ones(2)), TypeError, "^title is"),
        (lambda motion, path: plots.structure(motion, labels=np.ones(2)), TypeError, "^labels is"),
        (lambda motion, path: plots.node_histories(motion, 3), TypeError, "^nodes is 3"),
        (lambda motion, path: plots.force_densities(motion, strings=len), TypeError, "^strings is"),
        (
            lambda motion, path: plots.work_precision({"a": [1.0, 2.0]}),
            ValueError,
            r"^curves\['a'\] has shape",
        ),
        (lambda motion, path: plots.work_precision([]), TypeError, "^curves is"),
        (
            lambda motion, path: plots.work_precision({}, reference_error=-1.0),
            ValueError,
            "^reference_error is",
        ),
        (lambda motion, path: plots.Convergence(3.0), TypeError, "^path is"),
        (lambda motion, path: plots.Convergence()((1, 2)), TypeError, "^now is"),
        (
            lambda motion, path: animate(motion, path / "motion.gif", title=3),
            TypeError,
            "^title is",
        ),
        (lambda motion, path: animate(motion, path / "motion.avi"), ValueError, "path"),
        (
            lambda motion, path: animate(motion, path / "motion.gif", speed=1e-5),
            ValueError,
            "speed",
        ),
        (
            lambda motion, path: animate(motion, path / "motion.gif", frames_per_second=0),
            ValueError,
            "frames_per_second",
        ),
    ],
)
def test_mistakes_are_named(mistake, error, named, motion, tmp_path):
    with pytest.raises(error, match=named):
        mistake(motion, tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def plan(prism):
    model = tc.Model(tc.Scene(prism, control=tc.ForceDensity(), ground=tc.Ground(height=-0.5)))
    bounds = [ocp.ForceDensityLimits(0.0, 100.0), ocp.Obstacle((1.0, 0.0, 0.5), 0.2)]
    problem = ocp.Problem(model, 0.1, costs=[ocp.Effort()], bounds=bounds)
    return ocp.solve(problem, ocp.MultipleShooting(2))


def test_pictures_of_a_plan_show_its_scene(plan, tmp_path):
    for draw in (plots.structure, plots.time_lapse):
        axes = draw(plan).axes[0]
        surfaces = [part for part in axes.collections if isinstance(part, Poly3DCollection)]
        assert len(surfaces) == 2  # ground and obstacle
        assert axes.get_xlim()[1] > 1.2
        assert axes.get_zlim()[0] < -0.5
    assert animate(plan, tmp_path / "plan.gif", frames_per_second=10).stat().st_size > 1000


def test_a_scene_is_drawn_with_its_ground(prism):
    scene = tc.Scene(prism, ground=tc.Ground(height=-0.2))
    for data in (scene, tc.Model(scene)):
        axes = plots.structure(data).axes[0]
        assert any(isinstance(part, Poly3DCollection) for part in axes.collections)


def test_other_things_are_rejected_with_the_cure(plan):
    for draw in (plots.node_histories, plots.errors):
        with pytest.raises(TypeError, match=r"^trajectory is Plan\(.*such as plan\.trajectory"):
            draw(plan)
    with pytest.raises(TypeError, match=r"^data is 3: give a Structure, Scene"):
        plots.structure(3)
    with pytest.raises(TypeError, match=r"^history is 3: give a tenscasadi\.Trajectory or an ocp"):
        plots.force_densities(3)
    with pytest.warns(DeprecationWarning, match="use data="):
        plots.structure(what=plan)
    assert plots.force_densities(plan).axes
