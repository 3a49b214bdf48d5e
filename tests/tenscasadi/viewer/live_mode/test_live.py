"""The live mode: in a browser by its sliders, buttons and the mouse, and by messages that no page of ours would send."""

from __future__ import annotations

import os
import threading
import time

import numpy as np
import pytest
from browser import colored_fraction, picture, wait_until
from visitor import CAMERA, connect, say, wait_for

import tenscasadi as tc
from tenscasadi.viewer import LiveOptions, live

pytest.importorskip("viser", reason="viser is not installed: pip install 'tenscasadi[view]'")
PRISM = tc.Scene(tc.shapes.prism(prestress=50.0, stiffness=1000.0, damping=2.0))
VIRTUAL = LiveOptions(compiled=False)
CANVAS = {"x": 0.0, "y": 160.0, "width": 560.0, "height": 400.0}
# viser's own, where what can be dragged is touched: the page goes on
KNOWN = "Unable to preventDefault inside passive event listener invocation."


def quiet(scene=PRISM, **options):
    motion = live(scene, **{"options": VIRTUAL, "browser": False, "wait": False, **options})
    motion.run()
    return motion


@pytest.fixture
def shown(open_page, tmp_path):
    with quiet(save=tmp_path / "saved.npz") as motion:
        page = open_page(motion.url, width=1000, height=700)
        wait_until(
            page, lambda: colored_fraction(picture(page, **CANVAS)) > 0.01, "the canvas is drawn"
        )
        yield motion, page
        assert [fault for fault in page.faults if fault != KNOWN] == []


def status(page):
    return page.locator(".live-status").inner_text()


def press(page, name):
    page.get_by_role("button", name=name, exact=True).click()


def at(page, slider):
    """Where a slider of the page stands."""
    return float(page.get_by_role("slider").nth(slider).get_attribute("aria-valuenow"))


def pixel(motion, page, point):
    """Where a point is on the page, by the camera that it starts with."""
    camera = motion._server.initial_camera
    look, place = np.array(camera.look_at), np.array(camera.position)
    ahead = (look - place) / np.linalg.norm(look - place)
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    size = page.viewport_size
    away = np.asarray(point) - place
    scale = size["height"] / 2 / np.tan(camera.fov / 2) / (away @ ahead)
    return (
        size["width"] / 2 + scale * (away @ right),
        size["height"] / 2 - scale * (away @ np.cross(right, ahead)),
        scale,
    )


@pytest.mark.slow
def test_people_drive_pull_save_and_reset(shown, tmp_path):
    pull(*shown)  # first: keys turn the camera, too
    slide(*shown)
    pause_save_and_reset(*shown, tmp_path)


def slide(motion, page):
    run = motion.simulation
    press(page, "Reset")
    wait_until(page, lambda: 0.1 < run.time < 2, "time goes on")
    np.testing.assert_allclose(run.nodes, PRISM.structure.nodes, atol=1e-9)  # at rest so far
    slider = page.get_by_role("slider").nth(3)  # after the pull's and all strings': string 1
    before = run.control.copy()
    slider.focus()
    for _ in range(30):
        page.keyboard.press("ArrowLeft")
    wait_until(page, lambda: run.control[1] < 0.95 * before[1], "string 1 is shorter")
    assert (run.control[[0, 2, 3]] == before[[0, 2, 3]]).all()
    wait_until(page, lambda: np.abs(run.nodes - PRISM.structure.nodes).max() > 0.005, "nodes move")
    kept = motion.trajectory()
    assert kept.control[-1, 1] < 0.95 * before[1]
    assert abs(kept.energy_error).max() < 1e-4 * kept.energy[0]


def pull(motion, page):
    run = motion.simulation
    node, begin = 3, PRISM.structure.nodes[3]
    x, y, scale = pixel(motion, page, begin)
    page.mouse.move(x, y)
    page.mouse.down()
    for k in range(1, 9):
        page.mouse.move(x - 0.05 * k * scale, y - 0.025 * k * scale)
        page.wait_for_timeout(30)
    wait_until(page, lambda: run.pull is not None, "the mouse has got hold of a node")
    assert run.pull.node == node
    wait_until(
        page,
        lambda: abs(pixel(motion, page, run.pull.target)[0] - (x - 0.4 * scale)) < 3,
        "the spring ends at the pointer",
    )
    wait_until(page, lambda: np.linalg.norm(run.nodes[node] - begin) > 0.2, "the node follows")
    assert motion.panel._arrow.visible
    wait_until(page, lambda: "pull at node 3" in status(page), "the panel tells")
    page.mouse.up()
    wait_until(page, lambda: run.pull is None, "the mouse lets go")
    wait_until(page, lambda: not motion.panel._arrow.visible, "the arrow goes")


def pause_save_and_reset(motion, page, tmp_path):
    run = motion.simulation
    motion.do(lambda: run.set_control([0, 1, 2], 0.7))
    wait_until(page, lambda: run.time > 0.3, "time goes on")
    press(page, "Pause")
    wait_until(page, lambda: "paused" in status(page), "it says so")
    stopped = run.time
    page.wait_for_timeout(200)
    assert run.time == stopped
    press(page, "Save")
    wait_until(page, lambda: "saved" in status(page), "it is saved")
    saved = tc.Trajectory.load(tmp_path / "saved.npz")
    assert saved.time[-1] == pytest.approx(stopped)
    with page.expect_download() as download:
        press(page, "Download")
    download.value.save_as(tmp_path / "downloaded.npz")
    same = tc.Trajectory.load(tmp_path / "downloaded.npz")
    np.testing.assert_array_equal(same.nodes, saved.nodes)
    press(page, "Reset")
    wait_until(page, lambda: run.time == 0 and "t = 0.00 s" in status(page), "it is at the start")
    assert (run.control == run.start_control).all()
    wait_until(page, lambda: at(page, 2) == pytest.approx(run.start_control[0]), "sliders go back")
    press(page, "Continue")
    wait_until(page, lambda: run.time > 0, "it goes on")


def test_a_motion_that_breaks_down_says_so_on_the_page_and_starts_again(open_page):
    stiff = tc.Scene(PRISM.structure.replace(stiffness=1e6, damping=0.0))
    with quiet(stiff, options=LiveOptions(step=0.01, compiled=False)) as motion:
        page = open_page(motion.url, width=1000, height=700)
        motion.do(
            lambda: motion.simulation.set_control([0], 0.5 * motion.simulation.start_control[0])
        )
        wait_until(page, lambda: "Reset starts again" in status(page), "the page says so")
        assert "try step=" in status(page)
        press(page, "Pause")
        press(page, "Reset")
        wait_until(
            page,
            lambda: motion.simulation.time == 0 and not motion.simulation.fault,
            "it is at the start",
        )
        wait_until(page, lambda: "Reset" not in status(page), "the message goes")
        press(page, "Continue")
        wait_until(page, lambda: motion.simulation.time > 0, "it goes on")
        assert page.faults == []


@pytest.mark.slow
def test_a_page_that_is_closed_lets_go(open_page):
    with quiet() as motion:
        page = open_page(motion.url, width=1000, height=700)
        wait_until(
            page, lambda: colored_fraction(picture(page, **CANVAS)) > 0.01, "the canvas is drawn"
        )
        x, y, scale = pixel(motion, page, PRISM.structure.nodes[3])
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x - 0.2 * scale, y, steps=5)
        wait_until(
            page, lambda: motion.simulation.pull is not None, "the mouse has got hold of a node"
        )
        page.close()
        wait_for(lambda: motion.simulation.pull is None, "nobody pulls any more")


# --- without a browser ---


def test_the_time_waits_for_a_start():
    with live(PRISM, options=VIRTUAL, browser=False, wait=False) as motion:
        wait_for(lambda: "Start runs the time" in motion.panel._status.content, "a hint")
        assert motion.panel._play.label == "Start"
        time.sleep(0.1)
        assert motion.simulation.time == 0
        motion.run()
        wait_for(lambda: motion.simulation.time > 0, "the time runs")
        wait_for(lambda: "Start" not in motion.panel._status.content, "the hint goes")
        motion.run(False)
        assert motion.panel._play.label == "Continue"


def test_messages_that_no_page_of_ours_sends_do_nothing(tmp_path):
    with quiet(save=tmp_path / "saved.npz") as motion:
        layer = motion.panel.canvas.layers[0]
        with connect(motion._server) as page:
            say(page, **CAMERA)
            wait_for(motion._server.get_clients, "the page is known")
            drag = {
                "type": "SceneNodeDragMessage",
                "start_screen_pos": (0.5, 0.5),
                "end_screen_pos": (0.5, 0.5),
                "button": "left",
                "modifier": None,
            }
            drag |= {
                "owner": layer.batches["nodes"]._impl.api._owner_id,
                "start_position": (0.0, 0.0, 0.0),
                "end_position": (1.0, 0.0, 0.0),
            }
            for name in [batch.name for batch in layer.batches.values()]:
                for index in (10**9, -5, None, np.inf):
                    say(page, **drag, name=name, phase="start", instance_index=index)
                for place in ((np.nan, 0.0, 0.0), (np.inf, 0.0, 0.0), (1e300, 1e300, 1e300)):
                    say(
                        page,
                        **{**drag, "end_position": place},
                        name=name,
                        phase="start",
                        instance_index=0,
                    )
                    say(
                        page,
                        **{**drag, "start_position": place},
                        name=name,
                        phase="start",
                        instance_index=0,
                    )
                    say(page, **drag, name=name, phase="end", instance_index=0)
            for slider, entry in motion.panel._inputs:
                for value in ("nan", "inf", -1e9, 1e300, True):
                    say(
                        page,
                        type="GuiUpdateMessage",
                        uuid=entry._impl.uuid,
                        updates={"value": value},
                    )
                say(
                    page,
                    type="GuiUpdateMessage",
                    uuid=entry._impl.uuid,
                    updates={"value": slider.low},
                )
            wait_for(
                lambda: motion.simulation.control[-1] == motion.panel._inputs[9][0].low,
                "all has been heard",
            )
            assert motion._runner.is_alive
            assert np.isfinite(motion.simulation.nodes).all()
            say(page, **drag, name=layer.batches["nodes"].name, phase="start", instance_index=2)
            wait_for(
                lambda: motion.simulation.pull is not None and motion.simulation.pull.node == 2,
                "what is right is heard",
            )
        assert os.listdir(tmp_path) == []


def test_whoever_waits_for_the_trajectory_gets_it_when_the_viewer_closes():
    with quiet() as motion:
        begun, going = threading.Event(), threading.Event()
        motion.do(lambda: (begun.set(), going.wait(20.0)))
        assert begun.wait(20.0)
        found = []
        waiting = threading.Thread(target=lambda: found.append(motion.trajectory()), daemon=True)
        waiting.start()
        motion._runner._ended = True  # as by close, in the middle of an order
        going.set()
        waiting.join(20.0)
        assert len(found) == 1


def test_what_cannot_be_saved_is_said(tmp_path):
    with quiet(save=tmp_path) as motion:  # a folder
        motion.do(motion._save)
        wait_for(lambda: "not saved" in motion.panel._said, "it says so")
    with quiet(save=tmp_path / "run.npz") as motion:
        motion.do(motion._save)
        wait_for((tmp_path / "run.npz").exists, "it is saved")
    assert len(motion.trajectory().time) >= 1  # after it is closed, too


def test_a_motion_that_is_too_slow_says_by_how_much():
    with quiet(options=LiveOptions(step=1e-5, compiled=False)) as motion:
        wait_for(lambda: "times real time" in motion._pace.message, "it says so")
        wait_for(lambda: "times real time" in motion.panel._status.content, "the panel, too")
        assert 0 < motion._pace.measured < 0.9


def pause(motion):
    done = []
    motion.do(lambda: motion.panel.run(False))
    motion.do(lambda: done.append(True))
    wait_for(lambda: done, "it pauses")
    time.sleep(0.1)  # until it is shown


def shown_nodes(motion):
    canvas = motion.panel.canvas
    return np.array(canvas.layers[0].batches["nodes"].batched_positions) + canvas.root.position


def test_falling_structures_are_followed():
    falling = tc.Scene(PRISM.structure, gravity=tc.Gravity())
    grounded = tc.Scene(PRISM.structure, gravity=tc.Gravity(), ground=tc.Ground(height=-2.0))
    for scene, follows in ((falling, True), (grounded, False)):
        with quiet(scene) as motion:
            canvas = motion.panel.canvas
            assert canvas.followed == follows  # it would be out of sight soon
            motion.do(lambda canvas=canvas: setattr(canvas, "followed", True))
            wait_for(lambda run=motion.simulation: run.time > 0.3, "it falls")
            pause(motion)
            shown, start = shown_nodes(motion), PRISM.structure.nodes.mean(axis=0)
            np.testing.assert_allclose(shown.mean(axis=0), start, atol=1e-5)
            located = canvas.locate(shown)
            np.testing.assert_allclose(located, motion.simulation.nodes, atol=1e-5)
    with quiet() as motion:
        assert not motion.panel.canvas.followed


def test_force_densities_have_sliders_and_colors():
    with quiet(
        tc.Scene(PRISM.structure, control=tc.ForceDensity()), groups={"ring": [0, 1, 2]}
    ) as motion:
        motion.do(lambda: motion.panel.drive(1, 0.0))
        wait_for(lambda: (motion.simulation.control[:3] == 0).all(), "they are driven")
        motion.do(lambda: motion.panel.controls.color_by("force density"))
        wait_for(
            lambda: getattr(motion.panel.canvas.scale, "quantity", "") == "force density",
            "the legend changes",
        )
        assert motion.panel._inputs[0][1].value < 1.0  # the slider of all strings follows


def test_odd_input_is_refused_before_there_is_a_server():
    for wrong, words in (
        ({"groups": {"a": [99]}}, "groups"),
        ({"speed": 0.0}, "speed"),
        ({"save": 3}, "save"),
        ({"control": [1.0]}, "control"),
        ({"port": 99999}, "port"),
        ({"browser": "yes"}, "browser"),
        ({"title": 3}, "title"),
    ):
        with pytest.raises((TypeError, ValueError), match=words):
            quiet(**wrong)


def test_the_old_name_of_the_options_warns():
    from tenscasadi import viewer

    with pytest.warns(DeprecationWarning, match="use tenscasadi.viewer.LiveOptions"):
        assert viewer.Stepping is LiveOptions
