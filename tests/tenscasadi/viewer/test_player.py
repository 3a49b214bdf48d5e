"""The viewer in a browser: it plays, pauses and goes where it is told to."""

from __future__ import annotations

import numpy as np
import pytest
from browser import colored_fraction, picture, wait_until
from moving import thrown

from tenscasadi.viewer import view

CANVAS = {
    "x": 0.0,
    "y": 160.0,
    "width": 560.0,
    "height": 400.0,
}  # left of the panel, below what viser says of drawing in software


@pytest.fixture(scope="module")
def motion():
    return thrown(2.0)


@pytest.fixture
def shown(motion, open_page):
    with view(motion, title="prism", browser=False, wait=False) as found:
        page = open_page(found.url)
        wait_until(
            page, lambda: colored_fraction(picture(page, **CANVAS)) > 0.01, "the canvas is drawn"
        )
        yield found, page


def press(page, name):
    page.get_by_role("button", name=name, exact=True).click()


def places(found):
    return np.array(found.player.canvas.layers[0].batches["nodes"].batched_positions)


def canvas(page):
    """The canvas in blocks of 8 × 8 pixels: viser draws in fewer pixels where it is slow."""
    image = picture(page, **CANVAS)
    return image.reshape(50, 8, 70, 8, 3).mean(axis=(1, 3))


def apart(first, second):
    """The share of blocks that differ."""
    return float((np.abs(first - second).max(axis=2) > 0.05).mean())


def settled(page):
    """The canvas once two pictures of it in a row are the same."""
    page.wait_for_timeout(300)
    last = canvas(page)

    def still():
        nonlocal last
        page.wait_for_timeout(200)
        before, last = last, canvas(page)
        return apart(last, before) == 0

    wait_until(page, still, "the canvas is still")
    return last


def time_box(page):
    return page.locator("input[inputmode]").first


def pause(page, found):
    press(page, "Pause")
    wait_until(page, lambda: not found.player.playing, "it pauses")
    wait_until(
        page,
        lambda: abs(float(time_box(page).input_value()) - found.player.time) < 0.002,
        "the page tells the time",
    )


def go_to(page, found, time):
    box = time_box(page)
    box.fill(f"{time:g}")
    box.press("Enter")
    wait_until(page, lambda: abs(found.player.time - time) < 1e-9, f"the player is at {time:g} s")
    assert float(box.input_value()) == time


@pytest.mark.slow
def test_it_plays_pauses_and_goes_where_it_is_told(shown, motion):
    found, page = shown
    assert page.title()
    before = places(found)
    wait_until(page, lambda: np.abs(places(found) - before).max() > 1e-3, "nodes move")
    moving = canvas(page)
    wait_until(page, lambda: apart(canvas(page), moving) > 0.01, "the picture moves")
    pause(page, found)
    still = settled(page)
    pictures = {}
    for time in (0.5, 1.25):
        go_to(page, found, time)
        np.testing.assert_allclose(places(found), motion.nodes[round(100 * time)], atol=1e-6)
        pictures[time] = settled(page)
    assert apart(pictures[0.5], pictures[1.25]) > 0.01
    go_to(page, found, 0.5)
    wait_until(
        page,
        lambda: apart(canvas(page), pictures[0.5]) < 0.2 * apart(pictures[1.25], pictures[0.5]),
        "the frame of 0.5 s is shown again",
    )
    assert apart(still, np.ones_like(still)) > 0.01
    press(page, "Play")
    wait_until(page, lambda: found.player.playing and found.player.time != 0.5, "it plays on")
    assert page.faults == []
    assert all(url.startswith((found.url, "data:", "blob:")) for url in page.asked)


def on_page(found, page, point):
    """Where a point, m, is on the page: projected by the camera that pages start with."""
    camera, size = found._server.initial_camera, page.viewport_size
    ahead = camera.look_at - camera.position
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    away = point - camera.position
    scale = size["height"] / 2 / np.tan(camera.fov / 2) / (away @ ahead)
    return size["width"] / 2 + scale * (away @ right), size["height"] / 2 - scale * (
        away @ np.cross(right, ahead)
    )


def test_name_appears_where_the_pointer_rests(shown, motion):
    found, page = shown
    pause(page, found)
    go_to(page, found, 0.0)
    labels = found.player.controls.labels
    bar = motion.nodes[0][motion.bars[0]]
    x, y = on_page(found, page, 0.7 * bar[0] + 0.3 * bar[1])
    page.mouse.move(x - 40, y - 40)
    page.mouse.move(x, y)
    wait_until(page, lambda: labels.hovered == (0, "bars", 0), "the bar is under the pointer")
    wait_until(page, lambda: labels._hover.text, "the label is written")
    assert labels._hover.text == "bar 0, bottom[0] – top[1]"
    assert not labels.clicked
    page.mouse.move(20, 590)
    wait_until(page, lambda: labels.hovered is None, "the name goes")
    assert labels._hover is None
    assert page.faults == []


def test_a_click_labels_a_string_with_its_numbers(shown, motion):
    found, page = shown
    pause(page, found)
    go_to(page, found, 0.5)
    settled(page)
    nodes = motion.nodes[50]
    x, y = on_page(found, page, nodes[motion.strings].mean(axis=1)[6])
    page.mouse.click(x, y)
    clicked = found.player.controls.labels.clicked
    wait_until(page, lambda: clicked, "something is clicked")
    ((_, kind, index),) = clicked
    assert kind in ("strings", "bars")
    a, b = getattr(motion, kind)[index]
    label = clicked[0, kind, index]
    wait_until(page, lambda: label.text, "the label has a text")
    name, length, *_ = label.text.splitlines()
    assert f"{kind[:-1]} {index}" in name
    assert length == f"length {np.linalg.norm(nodes[b] - nodes[a]):.4g} m"
    assert np.hypot(*(np.array(on_page(found, page, nodes[[a, b]].mean(axis=0))) - (x, y))) < 150
    for wrong in (
        (0, "strings", 10**6),
        (0, "strings", -1),
        (9, "bars", 0),
        (0, "feet", 0),
    ):  # what a page can send
        found.player.controls.labels.toggle(wrong)
    assert len(clicked) == 1
    found.player.controls.click(0, kind, index)
    wait_until(page, lambda: not clicked, "the label goes")
    assert page.faults == []


@pytest.mark.slow
def test_numbers_of_nodes_are_written_beside_them(shown, motion):
    found, page = shown
    pause(page, found)
    go_to(page, found, 0.5)
    before = settled(page)
    page.get_by_text("Numbers", exact=True).click()
    page.get_by_text("Numbers of nodes").click()
    wait_until(
        page,
        lambda: len(found.player.controls.labels.numbers["nodes"]) == 6,
        "there are six numbers",
    )
    for label, node in zip(
        found.player.controls.labels.numbers["nodes"], motion.nodes[50], strict=True
    ):
        np.testing.assert_allclose(label.position, node, atol=1e-6)
    wait_until(page, lambda: apart(canvas(page), before) > 1e-3, "the numbers are seen")
    assert page.faults == []
