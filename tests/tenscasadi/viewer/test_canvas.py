"""Canvas and player as the server holds them, without a browser."""

from __future__ import annotations

import time as clock

import numpy as np
import pytest
from moving import thrown

import tenscasadi as tc
from tenscasadi.drawing.style import STYLE
from tenscasadi.viewer import view
from tenscasadi.viewer.canvas import fit_camera, linearize_colors

pytest.importorskip("viser", reason="the extra [view] is not installed")


@pytest.fixture(scope="module")
def motion():
    return thrown(0.5)


@pytest.fixture
def shown(motion):
    other = thrown(0.3)
    with view({"one": motion, "two": other}, browser=False, wait=False) as found:
        found.player.play(False)
        yield found


def batch(found, part, layer=0):
    return found.player.canvas.layers[layer].batches[part]


def colors(found):
    return np.array(batch(found, "strings").batched_colors)


def test_colors_become_linear_light():
    found = linearize_colors(np.array([0, 255, 188], dtype=np.uint8))
    np.testing.assert_array_equal(found, [0, 255, 128])  # sRGB's 188 is half of the light


def test_strings_are_colored_by_the_chosen_quantity(shown, motion):
    player = shown.player
    player.show(0.2)
    scale = player.canvas.scale
    np.testing.assert_array_equal(colors(shown), linearize_colors(scale.colors(motion.tension[20])))
    before = colors(shown)
    player.controls.color_by("force density")
    player.show(0.2)
    scale = player.canvas.scale
    assert scale.unit == "N/m"
    expected = linearize_colors(scale.colors(motion.force_density[20]))
    np.testing.assert_array_equal(colors(shown), expected)
    assert not np.array_equal(before, colors(shown))
    assert "force density of strings (N/m)" in player.controls._legend.content
    player.controls.color_by("nonsense")  # as a page could send it
    assert player.canvas.quantity == "force density"


def test_following_keeps_the_middle_in_place(shown, motion):
    canvas = shown.player.canvas
    canvas.followed = True
    shown.player.show(0.4)
    places = np.array(batch(shown, "nodes").batched_positions)
    start = motion.nodes[0].mean(axis=0)
    np.testing.assert_allclose(places.mean(axis=0) + canvas.root.position, start, atol=1e-6)
    np.testing.assert_allclose(canvas.locate(places), motion.nodes[40], atol=1e-6)
    canvas.followed = False
    shown.player.show(0.4)
    np.testing.assert_allclose(batch(shown, "nodes").batched_positions, motion.nodes[40], atol=1e-6)


def test_motions_stand_side_by_side_with_their_surroundings(shown):
    canvas = shown.player.canvas
    second = canvas.layers[1]
    assert batch(shown, "bars", 1).opacity == 0.4
    low, high = canvas.content.corners
    canvas.arrange(True)
    assert second.root.position[0] > high[0] - low[0]
    assert batch(shown, "bars", 1).opacity is None
    shown.player.show(0.2)
    np.testing.assert_array_equal(
        batch(shown, "bars", 1).batched_colors[0], linearize_colors(STYLE.bar)
    )
    labels = shown.player.controls.labels
    for motion in (0, 1):
        labels.toggle((motion, "nodes", 0))
    labels.update()
    places = [np.array(label.position) for label in labels.clicked.values()]
    np.testing.assert_allclose(places[1] - places[0], second.root.position, atol=1e-6)
    canvas.arrange(False)
    assert not np.any(second.root.position)
    assert batch(shown, "bars", 1).opacity == 0.4


def test_shadows_can_be_switched(shown):
    canvas, nodes = shown.player.canvas, shown._server.scene._handle_from_node_name
    assert not canvas._sun.cast_shadow
    assert not nodes["/shown/around 0/ground 0"].receive_shadow
    canvas.cast_shadows(True)
    floor = nodes["/shown/around 0/ground 0"]
    assert canvas._sun.cast_shadow
    assert floor.receive_shadow > 0
    assert (batch(shown, "bars").cast_shadow, batch(shown, "bars", 1).cast_shadow) == (True, False)
    canvas.cast_shadows(False)
    assert not canvas._sun.cast_shadow


def pushed():
    """A prism on the ground that is pushed aside."""
    prism = tc.shapes.prism(prestress=50.0)
    loads = np.tile([1.0, 0.0, 0.0], (6, 1))
    ground = tc.Ground(height=prism.nodes[:, 2].min())
    scene = tc.Scene(prism, gravity=tc.Gravity(), ground=ground, forces=tc.NodalForce(loads))
    return tc.simulate(tc.Model(scene), 0.1, 1e-3, save_every=10, compiled=False)


def test_forces_are_arrows_that_can_be_hidden():
    with view(pushed(), browser=False, wait=False) as found:
        player = found.player
        player.play(False)
        player.show(0.1)
        loads, contacts = batch(found, "load shafts"), batch(found, "contact heads")
        assert loads.visible
        assert contacts.visible
        assert (loads.batched_scales[:, 2] > 0).all()
        assert 0 < (contacts.batched_scales[:, 2] > 0).sum() <= 3
        nodes = player.canvas.frames[0].nodes
        tips = nodes + (0.25 * player.canvas.content.size, 0.0, 0.0)
        middle = loads.batched_positions
        np.testing.assert_allclose(middle[:, 1:], nodes[:, 1:], atol=1e-5)
        assert (middle[:, 0] > nodes[:, 0]).all()
        assert (batch(found, "load heads").batched_positions[:, 0] < tips[:, 0]).all()
        assert "loads, 1 N as 0.25 m" in player.controls._legend.content
        player.controls.show_forces("load", False)
        player.show(0.1)
        assert not loads.visible
        assert "loads" not in player.controls._legend.content


def test_shorter_motions_stay_at_their_end(shown, motion):
    shown.player.show(0.5)
    for layer, row in ((0, -1), (1, 30)):
        places = batch(shown, "nodes", layer).batched_positions
        np.testing.assert_allclose(places, motion.nodes[row], atol=1e-6)
    shown.player.show(7.0)
    assert shown.player.time == 0.5


def test_it_plays_at_its_speed_and_stops_at_the_end(shown):
    player = shown.player
    player.speed = 0.1
    player.show(0.0)
    began = clock.perf_counter()
    player.play(True)
    while player.time < 0.05:
        clock.sleep(0.01)
    assert clock.perf_counter() - began > 0.4  # a tenth of the time, except for a frame
    player.speed, player.repeats = 5.0, False
    while player.playing:
        clock.sleep(0.01)
    assert player.time == 0.5
    player.play(True)
    while player.time == 0.5:
        clock.sleep(0.01)
    player.play(False)


def test_slack_strings_are_thin():
    prism = tc.shapes.prism(stiffness=100.0)
    loose = prism.replace(rest_length=np.where(np.arange(9) < 3, 2.0, 0.9) * prism.string_lengths)
    with loose.view(browser=False, wait=False) as found:
        widths = np.array(batch(found, "strings").batched_scales)[:, 0]
        np.testing.assert_allclose(widths[:3], 0.5 * widths[3], rtol=1e-6)
        slack = np.tile(linearize_colors(STYLE.slack), (3, 1))
        np.testing.assert_array_equal(colors(found)[:3], slack)


def test_lost_nodes_are_not_drawn():
    flown = thrown(0.1)
    nodes = flown.nodes.copy()
    nodes[5:] = np.nan
    lost = tc.Trajectory(
        **{**vars(flown), "nodes": nodes, "success": False, "message": "it diverged"}
    )
    with lost.view(browser=False, wait=False) as found:
        found.player.show(0.09)
        for part in ("bars", "strings"):
            assert np.isfinite(batch(found, part).batched_positions).all()
            np.testing.assert_array_equal(batch(found, part).batched_scales, 0.0)


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_structures_of_all_sizes_are_visible(size):
    prism = tc.shapes.prism(height=size, radius=0.5 * size)
    with prism.view(browser=False, wait=False) as found:
        camera = found._server.initial_camera
        distance = np.linalg.norm(camera.position - prism.nodes.mean(axis=0))
        assert 1 < distance / size < 10
        assert 1e-3 < found.content.bar_radius / size < 0.1
        assert camera.near < 0.1 * distance < distance < camera.far


def test_hulls_of_bodies_follow_their_nodes():
    nodes = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], dtype=float)
    plate = tc.Structure(nodes, bodies=[tc.RigidBody(range(4), 1.0)])
    model = tc.Model(tc.Scene(plate))
    spin = np.array([0.0, 0.0, 2.0])
    state = model.state(nodes, np.cross(spin, nodes - nodes.mean(axis=0)) + [0, 0, 1.0])
    run = tc.simulate(model, 0.5, 0.05, state=state)
    with view(run, browser=False, wait=False) as found:
        found.player.play(False)
        found.player.show(0.5)
        hull = batch(found, "body 0")
        np.testing.assert_allclose(hull.position, (0.5, 0.5, 0.5), atol=1e-6)
        np.testing.assert_allclose(hull.wxyz, (np.cos(0.5), 0, 0, np.sin(0.5)), atol=1e-5)
        assert "rigid bodies" in found.player.controls._legend.content


@pytest.mark.parametrize(("width", "height"), [(390, 800), (900, 900)])
def test_narrow_pages_show_the_middle_beside_the_panel(width, height):
    middle, towards = np.array([1.0, 2.0, 3.0]), np.array([0.48, -0.8, 0.36])
    towards = towards / np.linalg.norm(towards)
    _, position = fit_camera(middle, towards, 2.0, width, height)
    right = np.cross(-towards, (0, 0, 1))
    right = right / np.linalg.norm(right)
    away = middle - position
    pixels = height / 2 / np.tan(np.radians(20)) / (away @ -towards)
    x = width / 2 + pixels * (away @ right)
    y = height / 2 - pixels * (away @ np.cross(right, -towards))
    free = (width, 0.4 * height) if width < 600 else (width - 335, height)
    assert (x, y) == pytest.approx((free[0] / 2, free[1] / 2))
    assert 0.7 * min(free) < 2.0 * pixels < 0.9 * min(free)
