"""A canvas and its player, as the server holds them: no browser is needed."""

from __future__ import annotations

import time as clock

import numpy as np
import pytest
from moving import thrown

import tenscasadi as tc
from tenscasadi.viewer import view
from tenscasadi.viewer.colours import PUSHING, RAMP, SLACK, Scale, linear

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


def colours(found):
    return np.array(found.player.canvas.layers[0].strings.batched_colors)


def test_colours_run_from_the_first_to_the_last_of_the_ramp():
    scale = Scale.of("tension", "N", [np.array([0.0, 2.0, 4.0, -1.0, np.nan])])
    assert (scale.largest, scale.slack, scale.pushing, scale.least) == (4.0, True, True, -1.0)
    np.testing.assert_array_equal(
        scale.colours(np.array([0.0, -1.0, 4.0, 2.0, np.nan])),
        [SLACK, PUSHING, RAMP[-1], RAMP[len(RAMP) // 2], SLACK],
    )
    np.testing.assert_array_equal(
        linear(np.array([0, 255, 188], dtype=np.uint8)), [0, 255, 128]
    )  # sRGB's 188 is half of the light


def test_strings_take_the_colour_of_what_they_bear(shown, motion):
    player = shown.player
    player.show(0.2)
    np.testing.assert_array_equal(
        colours(shown), linear(player.canvas.scale.colours(motion.tension[20]))
    )
    before = colours(shown)
    player._recolour("force density")
    assert player.canvas.scale.unit == "N/m"
    np.testing.assert_array_equal(
        colours(shown), linear(player.canvas.scale.colours(motion.force_density[20]))
    )
    assert not np.array_equal(before, colours(shown))
    assert "force density of strings (N/m)" in player._legend.content
    player._recolour("nonsense")  # as a page could send it
    assert player.canvas.colour == "force density"


def test_following_keeps_the_middle_where_it_was(shown, motion):
    canvas = shown.player.canvas
    canvas.follow(True)
    shown.player.show(0.4)
    middle = motion.nodes[40].mean(axis=0) + np.array(canvas.root.position)
    np.testing.assert_allclose(middle, motion.nodes[0].mean(axis=0), atol=1e-12)
    canvas.follow(False)
    np.testing.assert_array_equal(canvas.root.position, 0.0)


def test_motions_of_other_lengths_stay_where_they_end(shown, motion):
    shown.player.show(0.5)
    first, second = shown.player.canvas.layers
    np.testing.assert_allclose(first.nodes.batched_positions, motion.nodes[-1], atol=1e-6)
    np.testing.assert_allclose(second.nodes.batched_positions, motion.nodes[30], atol=1e-6)
    shown.player.show(7.0)
    assert shown.player.time == 0.5


def test_it_plays_at_its_speed_and_stops_at_the_end_unless_it_repeats(shown):
    player = shown.player
    player._set_speed("0.1", ("0.1", "1"))
    player._set_speed("1e9", ("0.1", "1"))  # as a page could send it
    assert player.speed == 0.1
    player.show(0.0)
    began = clock.perf_counter()
    player.play(True)
    while player.time < 0.05:
        clock.sleep(0.01)
    assert clock.perf_counter() - began > 0.4  # a tenth of the time, but for a frame
    player.speed = 5.0
    player._loop.value = False
    while player.playing:
        clock.sleep(0.01)
    assert player.time == 0.5
    player.play(True)
    while player.time == 0.5:
        clock.sleep(0.01)
    player.play(False)


def test_slack_strings_are_thin(motion):
    prism = tc.shapes.prism(stiffness=100.0)
    loose = prism.replace(rest_length=np.where(np.arange(9) < 3, 2.0, 0.9) * prism.string_lengths)
    with loose.view(browser=False, wait=False) as found:
        widths = np.array(found.player.canvas.layers[0].strings.batched_scales)[:, 0]
        np.testing.assert_allclose(widths[:3], 0.5 * widths[3], rtol=1e-6)
        np.testing.assert_array_equal(colours(found)[:3], np.tile(linear(SLACK), (3, 1)))


def test_what_diverged_is_drawn_without_the_rest():
    flown = thrown(0.1)
    nodes = flown.nodes.copy()
    nodes[5:] = np.nan
    lost = tc.Trajectory(
        **{**vars(flown), "nodes": nodes, "success": False, "message": "it diverged"}
    )
    with lost.view(browser=False, wait=False) as found:
        found.player.show(0.09)
        for batch in (found.player.canvas.layers[0].bars, found.player.canvas.layers[0].strings):
            assert np.isfinite(batch.batched_positions).all()
            np.testing.assert_array_equal(batch.batched_scales, 0.0)


def test_all_sizes_are_seen():
    for size in (1e-6, 1.0, 1e6):
        prism = tc.shapes.prism(height=size, radius=0.5 * size)
        with prism.view(browser=False, wait=False) as found:
            canvas = found.player.canvas
            away = np.linalg.norm(found._server.initial_camera.position - prism.nodes.mean(axis=0))
            assert 1 < away / size < 10
            assert 1e-3 < canvas.radius / size < 0.1
            assert (
                found._server.initial_camera.near
                < 0.1 * away
                < away
                < found._server.initial_camera.far
            )
