"""The viewer in a browser: it plays, pauses and goes where it is told to."""

from __future__ import annotations

import numpy as np
import pytest
from browser import coloured, picture, wait_until
from moving import thrown

from tenscasadi.viewer import view

CANVAS = {"x": 0.0, "y": 160.0, "width": 560.0, "height": 400.0}  # left of the panel, below what viser says of drawing in software


@pytest.fixture(scope="module")
def motion():
    return thrown(2.0)


@pytest.fixture
def shown(motion, open_page):
    with view(motion, title="prism", browser=False, wait=False) as found:
        page = open_page(found.url)
        wait_until(page, lambda: coloured(picture(page, **CANVAS)) > 0.01, "the canvas is drawn")
        yield found, page


def press(page, name):
    page.get_by_role("button", name=name, exact=True).click()


def places(found):
    return np.array(found.player.canvas.layers[0].nodes.batched_positions)


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


def go_to(page, found, time):
    box = page.locator("input[inputmode]").first
    box.fill(f"{time:g}")
    box.press("Enter")
    wait_until(page, lambda: abs(found.player.time - time) < 1e-9, f"the player is at {time:g} s")


def test_it_plays_pauses_and_goes_where_it_is_told(shown, motion):
    found, page = shown
    assert page.title()
    before = places(found)
    wait_until(page, lambda: np.abs(places(found) - before).max() > 1e-3, "nodes move")
    moving = canvas(page)
    wait_until(page, lambda: apart(canvas(page), moving) > 0.01, "the picture moves")
    press(page, "Pause")
    wait_until(page, lambda: not found.player.playing, "it pauses")
    still = settled(page)
    pictures = {}
    for time in (0.5, 1.25):
        go_to(page, found, time)
        np.testing.assert_allclose(places(found), motion.nodes[round(100 * time)], atol=1e-6)
        pictures[time] = settled(page)
    assert apart(pictures[0.5], pictures[1.25]) > 0.01
    go_to(page, found, 0.5)
    wait_until(page, lambda: apart(canvas(page), pictures[0.5]) < 0.2 * apart(pictures[1.25], pictures[0.5]), "the frame of 0.5 s is shown again")
    assert apart(still, np.ones_like(still)) > 0.01
    press(page, "Play")
    wait_until(page, lambda: found.player.playing and found.player.time != 0.5, "it plays on")
    assert page.faults == []
    assert all(url.startswith((found.url, "data:", "blob:")) for url in page.asked)
